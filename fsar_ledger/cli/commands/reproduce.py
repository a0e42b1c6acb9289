"""The command `reproduce`."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import (
    AdoptOption,
    KeyOption,
    OnlyOption,
    ReproducedRunsOption,
    WideOption,
    WorkersOption,
    examples,
)
from fsar_ledger.cli.progress import Progress
from fsar_ledger.cli.terminal import show
from fsar_ledger.printable import counted

if TYPE_CHECKING:
    from fsar_ledger.runtime.experiment import SimulationResult

EXAMPLES = examples("fsar-ledger reproduce", "fsar-ledger reproduce --out out/paper --only results --runs 20")
SHOWN = ("architecture", "metric", "mean", "sd", "n", "ci_low", "ci_high")
AFTER_INTERRUPTION = "what is committed stays, and the same command continues there"


def reproduce(
    out: Annotated[
        Path, typer.Option("--out", metavar="FOLDER", help="Where the ledgers, the tables and the report go.")
    ] = Path("fsar-out"),
    only: OnlyOption = None,
    runs: ReproducedRunsOption = None,
    key: KeyOption = None,
    adopt: AdoptOption = False,
    workers: WorkersOption = None,
    wide: WideOption = False,
) -> None:
    """Run the paper's experiments, judge them and typeset the report.

    FOLDER then holds report.pdf, its numbers as reproduction.json, metrics.csv, statistics.csv and a ledger of each
    experiment: results/, ablation/, scaling/ and workflows/. The key signs results/ under its name NAME, and the others
    under NAME/ablation, NAME/scaling and NAME/workflows, because no two ledgers may have one origin.
    """
    from fsar_ledger.api.functions import reproduce as make
    from fsar_ledger.cli.tables import table

    began = time.monotonic()
    found = make(out, only=only, runs=runs, key=key, adopt=adopt, workers=workers, showing=Progress)
    results = found.made["results"]
    head = results.head
    took = f"{head.size:,} events, root {head.root}, {time.monotonic() - began:.0f} s"
    text = printable.joined(table(found.metrics.rows(), SHOWN, wide=wide), printable.lines(*beyond(results)))
    show(printable.joined(text, printable.lines("", took, str(found.report))))


def beyond(made: "SimulationResult") -> list[str]:
    """Return a line on runs beyond those asked for, which are judged too; none where there are none."""
    more = made.held - made.asked
    return (
        [
            f"the ledger holds {counted(more, 'run')} beyond the {made.asked:,} of the paper's experiment, and they "
            "are judged here, too"
        ]
        if more
        else []
    )
