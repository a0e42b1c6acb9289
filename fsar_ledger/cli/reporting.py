"""The command `report`."""

from pathlib import Path
from typing import Annotated

import typer

from fsar_ledger import printable

from .memory import readers_of
from .options import (
    BesideOption,
    LedgerArgument,
    NumbersOption,
    PoolOption,
    SensitivityOption,
    WorkersOption,
    WorkflowLedgerOption,
    examples,
    pools_seeds,
)
from .progress import Progress
from .terminal import show

REPORT = examples(
    "fsar-ledger report out/ledger --out out/report.pdf",
    "fsar-ledger report out/ledger --with out/workflows --with out/untrusting --out out/report.pdf",
    "fsar-ledger report out/ledger --out out/report.pdf --numbers out/numbers.json",
)


def report(
    ledger: LedgerArgument,
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE", help="The PDF; replaced if it exists.", show_default=False)
    ],
    beside: BesideOption = None,
    workflows: WorkflowLedgerOption = None,
    sensitivity: SensitivityOption = None,
    numbers: NumbersOption = None,
    pool: PoolOption = None,
    workers: WorkersOption = None,
) -> None:
    """Typeset the evaluation as a PDF.

    Each number of the paper stands beside the ledger's, with its interval and a verdict. Ablations, larger fleets and workflows are sections of
    their own where this ledger, or one given with --with, holds them. First all rows are compared with their root, as `verify` does it.
    """
    from fsar_ledger.report import write_report

    pooled = pools_seeds(pool)
    with Progress("verified", "segments") as progress:
        write_report(
            ledger,
            out,
            workflows,
            readers_of(workers, ledger),
            progress,
            beside=beside or (),
            pools_seeds=pooled,
            sensitivity=sensitivity,
            numbers_out=numbers,
        )
    show(printable.lines(*(f"{one}" for one in (out, numbers) if one is not None)))
