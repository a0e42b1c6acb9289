"""The verb `study run multiverse`: the results table under every reading that the paper's text allows."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from msgspec import structs

from fsar_ledger.base import printable
from fsar_ledger.base.printable import SafeText, counted
from fsar_ledger.base.progress import Progress
from fsar_ledger.metrics.multiverse import Cell, Multiverse, Ranking, ReadingNames

from .answers import Answer, Row, Screen
from .names import Names, Place, names_of, pools_seeds
from .verbs import PoolOption, Shows, declare, verb

if TYPE_CHECKING:
    from fsar_ledger.metrics.provenance import Provenance

    from .ledger import Ledger
    from .table import Table

OURS = "our reading"
CELL = ("metric", "architecture", "paper", "ours", "lowest", "highest", "combinations", "most_moving", "moved_by")
RANKING = (
    *("metric", "better", "order", "combinations", "same_order"),
    *("changed_under", "fsar_best", "fsar_not_best_under"),
)
WHERE_TELLING = ("configuration", "fleet_size", "seed", "kind", "source", "model_version", "constants")
"""Columns that a table for people shows only where they tell rows apart."""
WHERE_ANY = ("undefined", "runs_not_observed")
"""Columns that it shows only where a value is not 0."""


class MultiverseResult(Answer, Multiverse, frozen=True, kw_only=True):
    """A `Multiverse` with its provenance."""

    provenance: "Provenance"

    def table(self) -> "Table":
        """Return the cells as a table."""
        from .table import Table, of_structs

        return Table(of_structs(self.cells, Cell), self.provenance)

    def draw(self, file: Place, kind: str | None = None) -> None:  # noqa: ARG002 - it is SVG
        """Draw every cell under every combination of readings as SVG.

        Raises: WriteFailed if the file cannot be written.
        """
        from fsar_ledger.base.publishing import publish
        from fsar_ledger.report import study_charts

        publish(Path(file), study_charts.curves(self))

    def text(self, screen: Screen) -> Iterator[SafeText]:
        """Yield the ranges, the rankings and the readings as tables."""
        from .table import plain

        if not self.cells:
            yield printable.line("no runs to read")
            return
        cells, rankings = plain(self.cells), [_named(row) for row in self.rankings]
        readings: list[Row] = [
            {"name": one.name, "instead of": one.reading, "says": one.title} for one in self.readings
        ]
        yield screen.table(cells, _columns(cells, CELL))
        yield printable.line("")
        yield screen.table(rankings, _columns(rankings, RANKING))
        yield printable.lines("", *_verdicts(self.rankings), "")
        yield screen.table(readings)


@verb(
    "study run multiverse out/ledger",
    "study run multiverse out/ledger --metric authority_conflicts --json",
    "study run multiverse out/ledger --metric human_intervention --svg out/multiverse.svg",
    name="study run multiverse",
    takes=("svg", "verified", "json", "csv", "raw", "wide"),
)
def multiverse(
    ledger: "Ledger",
    metric: Names = declare("NAME", "Only this metric; may be repeated.", "all"),
    pool: PoolOption = None,
    *,
    progress: Annotated[Progress | None, Shows("read", "combinations of readings")] = None,
) -> MultiverseResult:
    """Compute the results table under every reading that the paper's text allows.

    For each cell: the paper's number, ours, the lowest and the highest mean over all combinations of readings, and the
    reading that moves it most when it alone replaces ours. For each metric: whether the order of the architectures is
    the same under all combinations, under how many FSAR is best, and the smallest combinations that change either.
    Nothing is simulated again. --json also has the mean under each combination.

    Raises:
        InvalidExperiment: There is no such metric.
    """
    from fsar_ledger.designs.registered import known
    from fsar_ledger.metrics.multiverse import multiverse as read
    from fsar_ledger.metrics.provenance import of_judgement

    pooled = pools_seeds(pool)
    with ledger.database() as database:
        every = tuple(row["metric"] for row in database.rows("SELECT metric FROM metric_definitions ORDER BY position"))
        found = read(database, known("metric", names_of(metric), every), pools_seeds=pooled, progress=progress)
        return MultiverseResult(**structs.asdict(found), provenance=of_judgement(database))


def _verdicts(rankings: Sequence[Ranking]) -> Iterator[str]:
    """Yield in how many rankings FSAR is best, and in how many our order stays, under every combination."""
    for what, count in (
        ("FSAR is the best one", "fsar_best"),
        ("the order of the architectures is ours", "same_order"),
    ):
        judged = [row for row in rankings if getattr(row, count) is not None]
        always = sum(getattr(row, count) == row.combinations for row in judged)
        never = sum(getattr(row, count) == 0 for row in judged)
        if judged:
            yield (
                f"{what} under every combination in {always} of {counted(len(judged), 'ranking')}, under some in "
                f"{len(judged) - always - never}, under none in {never}"
            )
        else:
            fsar = ", one of them FSAR" if count == "fsar_best" else ""
            yield f"whether {what}: nothing to rank; that takes means of two architectures{fsar}"


def _columns(rows: Sequence[Row], columns: tuple[str, ...]) -> list[str]:
    """Return the columns to show: those of the setting after the first, those of `WHERE_ANY` at the end."""
    telling = [name for name in WHERE_TELLING if name in rows[0] and len({row[name] for row in rows}) > 1]
    return [columns[0], *telling, *columns[1:], *(name for name in WHERE_ANY if any(row.get(name) for row in rows))]


def _named(row: Ranking) -> Row:
    changed, not_best = _texts(row.changed_under), _texts(row.fsar_not_best_under)
    return {**structs.asdict(row), "changed_under": changed, "fsar_not_best_under": not_best}


def _texts(sets: tuple[ReadingNames, ...] | None) -> str | None:
    """Return the combinations in words; None where there are none, or nothing can be said."""
    return "; ".join(" + ".join(names) or OURS for names in sets) if sets else None
