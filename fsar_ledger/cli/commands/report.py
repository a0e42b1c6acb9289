"""The command `report`."""

from pathlib import Path
from typing import Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import (
    BesideOption,
    LedgerArgument,
    NumbersOption,
    PoolOption,
    SensitivityOption,
    WorkersOption,
    WorkflowLedgerOption,
    examples,
)
from fsar_ledger.cli.progress import Progress
from fsar_ledger.cli.terminal import show

EXAMPLES = examples(
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

    Each number of the paper stands beside the ledger's, with its interval and a verdict. Ablations, larger fleets and
    workflows have sections of their own where this ledger, or one given by --with, holds them. All rows are compared
    with their root first, as `verify` does.
    """
    from fsar_ledger.api.ledger import Ledger

    Ledger(ledger).report(
        out,
        beside=beside or (),
        workflows=workflows,
        sensitivity=sensitivity,
        numbers=numbers,
        pool=pool,  # type: ignore[arg-type]  # it refuses any other text
        workers=workers,
        showing=Progress,
    )
    show(printable.lines(*(f"{one}" for one in (out, numbers) if one is not None)))
