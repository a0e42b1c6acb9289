"""The command `sensitivity`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import WideOption, WorkersOption, examples
from fsar_ledger.cli.progress import Progress
from fsar_ledger.cli.terminal import show

if TYPE_CHECKING:
    from fsar_ledger.metrics.effects import Sensitivity

EXAMPLES = examples(
    "fsar-ledger sensitivity --out out/sensitivity.parquet --svg out/sensitivity.svg",
    "fsar-ledger sensitivity --out out/short.parquet --trajectories 2 --runs 1 --points 0",
)
AFTER_INTERRUPTION = "finished evaluations are kept beside --out, and the same command continues there"


def sensitivity(
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FILE", help="The effects, as Parquet; replaced if it exists.", show_default=False
        ),
    ],
    trajectories: Annotated[int, typer.Option(metavar="N", help="How often each factor is moved.")] = 20,
    runs: Annotated[int, typer.Option(metavar="N", help="Runs per scenario and architecture of each evaluation.")] = 10,
    points: Annotated[
        int, typer.Option(metavar="N", help="Evaluations for the Sobol indices; 0: none, only the screening.")
    ] = 512,
    svg: Annotated[
        Path | None,
        typer.Option(
            "--svg", metavar="FILE", help="Also draw them, as SVG; replaced if it exists.", show_default=False
        ),
    ] = None,
    workers: WorkersOption = None,
    wide: WideOption = False,
) -> None:
    """Measure how much each number depends on each constant; takes most of an hour on two cores.

    Morris screening varies every constant of the world and of the structure, the load and the fleet size. Sobol indices
    then give the part of each number's variance that is due to each of the dozen constants that move a number furthest.
    An interrupted study continues where it stopped.
    """
    from fsar_ledger.ledger.store.paths import require_outside
    from fsar_ledger.publishing import publish
    from fsar_ledger.report.sensitivity import heat_map
    from fsar_ledger.studies.sensitivity import sensitivity as study

    if svg is not None:
        require_outside(svg, f"--svg {svg}")
    with Progress("evaluated", "points") as progress:
        found = study(out, trajectories=trajectories, runs=runs, points=points, workers=workers, progress=progress)
    _tell(found, wide=wide)
    show(printable.line(f"{out}"))
    if svg is not None:
        publish(svg, heat_map(found))
        show(printable.line(f"{svg}"))


def _tell(found: "Sensitivity", *, wide: bool) -> None:
    from fsar_ledger.cli.tables import table
    from fsar_ledger.metrics.effects import dozen, reach

    rows = dozen(found)
    still = sum(furthest == 0 for furthest in reach(found).values())
    head = (
        f"{len(found.about.factors)} factors, {found.about.evaluations:,} evaluations; {still} factors move "
        "nothing; in margins of the cell moved furthest:"
    )
    show(
        printable.joined(
            printable.line(head),
            table(rows, list(rows[0]), wide=wide) if rows else printable.line("none moves anything"),
        )
    )
