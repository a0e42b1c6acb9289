"""Typeset the evaluation as a PDF, with its tables and figures beside the paper's.

`gather` runs the queries, `findings` defines what they yield, `printing` and `figures` render it by the specs of
`reports/`, `document` lays it out, and `build` makes the PDF. Heavy imports wait until they are needed.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fsar_ledger.report.build import result_figure_png, result_figure_svg, write_report

__all__ = ["result_figure_png", "result_figure_svg", "write_report"]


def __getattr__(name: str) -> Any:
    """Load `build` when one of its functions is first asked for."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from fsar_ledger.report import build

    return getattr(build, name)
