"""The command `report`."""

from pathlib import Path
from typing import Annotated

import typer

from fsar_ledger import printable

from .memory import readers_of
from .options import LedgerArgument, PoolOption, SensitivityOption, WorkersOption, WorkflowLedgerOption, examples, pools_seeds
from .progress import Progress
from .terminal import show

REPORT = examples("fsar-ledger report out/ledger --out out/report.pdf", "fsar-ledger report out/ledger --workflows out/workflows --out out/report.pdf")


def report(
    ledger: LedgerArgument,
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="The PDF; replaced if it exists.", show_default=False)],
    workflows: WorkflowLedgerOption = None,
    sensitivity: SensitivityOption = None,
    pool: PoolOption = None,
    workers: WorkersOption = None,
) -> None:
    """Typeset the evaluation as a PDF.

    Each number of the paper stands beside the ledger's, with its interval and a verdict. First all rows are compared with their root, as
    `verify` does it.
    """
    from fsar_ledger.report import write_report

    pooled = pools_seeds(pool)
    with Progress("verified", "segments") as progress:
        write_report(ledger, out, workflows, readers_of(workers, ledger), progress, pools_seeds=pooled, sensitivity=sensitivity)
    show(printable.line(f"{out}"))
