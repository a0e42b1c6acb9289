"""The report: tables and figures of the evaluation beside the paper's, typeset as a PDF.

`gather` asks the queries, `findings` holds their rows, `printing` and `figures` show them by the specs of
`reports/`, `document` lays them out, `typeset` makes the PDF. Nothing heavy is imported until it is needed.
"""

from collections.abc import Callable
from pathlib import Path

__all__ = ["result_figure_png", "result_figure_svg", "write_report"]


def write_report(
    ledger: Path,
    out: Path,
    workflows: Path | None = None,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
    demanded: str | None = None,
) -> None:
    """The PDF about the ledger's present head, and about a ledger of workflows, is at `out`, after a whole look at both.

    Arguments and errors: as `fsar_ledger.report.build.write_report`.
    """
    from fsar_ledger.report import build

    build.write_report(ledger, out, workflows, workers, progress, demanded)


def result_figure_svg(ledger: Path, out: Path) -> None:
    """The figure "Evaluation results" is at `out` as SVG. Raises: as `fsar_ledger.report.build.write_report`."""
    from fsar_ledger.report import build

    build.result_figure_svg(ledger, out)


def result_figure_png(ledger: Path, out: Path) -> None:
    """The figure "Evaluation results" is at `out` as PNG. Raises: as `fsar_ledger.report.build.write_report`."""
    from fsar_ledger.report import build

    build.result_figure_png(ledger, out)
