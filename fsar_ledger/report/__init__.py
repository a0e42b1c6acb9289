"""The report: tables and figures of the evaluation beside the paper's, typeset as a PDF.

`gather` asks the queries, `findings` holds their rows, `printing` and `figures` show them by the specs of
`reports/`, `document` lays them out, `typeset` makes the PDF. Nothing heavy is imported until it is needed.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fsar_ledger.report.build import result_figure_png, result_figure_svg, write_report

__all__ = ["result_figure_png", "result_figure_svg", "write_report"]


def __getattr__(name: str) -> Any:
    """What `build` makes, which is loaded only then."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from fsar_ledger.report import build

    return getattr(build, name)
