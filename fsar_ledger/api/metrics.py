"""The verbs `metrics`, `statistics` and `study run multiverse`: the metrics, in pairs, and under other readings."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
from msgspec import structs

from fsar_ledger.base import printable
from fsar_ledger.base.printable import SafeText, counted
from fsar_ledger.base.progress import Progress

from .answers import Answer, Row, Screen
from .names import Names, Place, by_scenario, names_of, pools_seeds
from .verbs import ROWS, ByOption, PoolOption, Shows, declare, verb

if TYPE_CHECKING:
    from fsar_ledger.metrics.comparability import DifferingWorlds
    from fsar_ledger.metrics.multiverse import Cell, Reading, ReadingNames, Universe
    from fsar_ledger.metrics.provenance import Provenance
    from fsar_ledger.metrics.results import StatisticRow
    from fsar_ledger.metrics.robustness import OrderUnderReadings

    from .ledger import Ledger
    from .table import Table

NOTHING = (
    "nothing to compare; this needs runs of two architectures, or of one with and without a mechanism, that met "
    "the same world"
)
OURS = "our reading"
CELL = ("metric", "architecture", "paper", "ours", "lowest", "highest", "combinations", "most_moving", "moved_by")
RANKING = (
    *("metric", "better", "order", "combinations", "same_order"),
    *("changed_under", "fsar_best", "fsar_not_best_under"),
)
WHERE_TELLING = ("configuration", "fleet_size", "seed", "kind", "source", "model_version", "constants")
"""Columns that a text table shows only if they distinguish rows."""
WHERE_ANY = ("undefined", "runs_not_observed")
"""Columns that a text table shows only if some value is not 0."""


@verb(
    "metrics out/ledger",
    "metrics out/ledger --by scenario",
    "metrics out/ledger --pool seeds",
    "metrics out/ledger --verified --json",
    takes=("cluster", *ROWS),
)
def metrics(ledger: "Ledger", by: ByOption = None, pool: PoolOption = None) -> "Table":
    """Compute the metrics of a ledger: the eight of the paper, then any that were added.

    Shows mean, SD, 95 % interval and denominator for each architecture, configuration and fleet size; runs of different
    seeds, constants, models or kinds have rows of their own. Shares are in [0,1], latency is in seconds. Where a metric
    is not defined, a table shows `-` and JSON null.
    """
    from fsar_ledger.metrics.provenance import of_outcomes
    from fsar_ledger.metrics.results import MetricRow, metric_rows

    from .table import MetricTable, of_structs

    per_scenario, pooled = by_scenario(by), pools_seeds(pool)
    with ledger.database() as database:
        rows = of_structs(metric_rows(database, by_scenario=per_scenario, pools_seeds=pooled), MetricRow)
        provenance = of_outcomes(database)
        if not per_scenario:
            return MetricTable(rows.drop_columns(["scenario"]), provenance)
        [without] = database.rows("SELECT count(*) AS runs FROM runs WHERE scenario IS NULL")
        return MetricTable(rows, provenance, left_out=without["runs"])


class Statistics(Answer, msgspec.Struct, frozen=True):
    """The answer of `statistics`: rows, differing worlds, why some comparisons have no pairs, and remarks."""

    rows: list[dict[str, Any]]
    columns: list[str]
    differing: list["DifferingWorlds"]
    not_compared: list[str]
    remarks: list[str]
    provenance: "Provenance"
    notes: list[str]
    """How to read the rows; none of them is a warning."""

    @property
    def before(self) -> list[str]:
        """Return the lines above the numbers: which worlds differ, or that nothing is compared."""
        return [*map(str, self.differing), *([] if self.rows else [NOTHING, *self.not_compared])]

    @property
    def after(self) -> list[str]:
        """Return the lines below the numbers: how Holm adjusts several families, and what is missing."""
        published = _published()
        families = {
            (row["family"], row["family_tests"])
            for row in self.rows
            if row["family_tests"] is not None and row["metric"] in published
        }
        families_text = (
            [f"Holm adjusts together: {'; '.join(f'{count} tests of {name}' for name, count in sorted(families))}"]
            if len(families) > 1
            else []
        )
        return (
            [*families_text, *(f"not compared: {why}" for why in self.not_compared), *self.remarks] if self.rows else []
        )

    @property
    def exit_code(self) -> int:
        """1 if facts differ that an experiment keeps the same."""
        return int(any(world.is_fault for world in self.differing))

    def document(self, _: Screen) -> Mapping[str, object]:
        """Return the rows, and what they leave out."""
        return {
            "rows": self.rows,
            "differing_worlds": self.differing,
            "not_compared": self.not_compared,
            "remarks": [*self.remarks, *self.notes],
        }

    def table(self) -> "Table":
        """Return the rows as a table."""
        from fsar_ledger.metrics.results import StatisticRow

        from .table import Table, of_structs

        return Table(of_structs([StatisticRow(**row) for row in self.rows], StatisticRow), self.provenance)

    def beside_rows(self) -> list[str]:
        """Return what the rows leave out."""
        return [*self.before, *self.after]

    def text(self, screen: Screen) -> Iterator[printable.SafeText]:
        """Yield the rows, with what they leave out above and below."""
        from .table import telling, unit_of_interventions

        yield printable.lines(*self.before, *([""] if self.before and self.rows else []))
        if self.rows:
            yield screen.table(self.rows, telling(self.rows))
        yield printable.lines(*(["", *self.after, *self.notes] if self.after or self.notes else []))
        yield from unit_of_interventions(screen)


@verb("statistics out/ledger", "statistics out/ledger --csv", takes=("cluster", *ROWS))
def statistics(ledger: "Ledger", pool: PoolOption = None) -> Statistics:
    """Compare the architectures of a ledger in pairs, and FSAR with and without a mechanism.

    For each metric and pair: paired t, Wilcoxon signed-rank, effect sizes, exact McNemar for human intervention, and
    Holm over the 24 tests of the architectures, or over those of all ablations. Runs that did not meet the same world
    are named first and left out; exit code 1 if facts differ that an experiment keeps the same. The answer says what
    cannot be compared, and why. A run without failures counts as in the paper (containment 1, latency 0 s); `query
    statistics/all_pairwise_tests` also has the tests without such pairs (basis defined). The columns pooled_* test what
    the results table prints: containment and latency pooled over failures.
    """
    from fsar_ledger.metrics.comparability import (
        differing_worlds,
        imputed,
        left_over,
        not_compared,
        remarks_on,
        too_few,
    )
    from fsar_ledger.metrics.provenance import of_outcomes
    from fsar_ledger.metrics.results import StatisticRow, statistic_rows

    pooled = pools_seeds(pool)
    with ledger.database() as database:
        rows = statistic_rows(database, pools_seeds=pooled)
        metrics = [row["metric"] for row in database.rows("SELECT metric FROM metric_definitions ORDER BY position")]
        return Statistics(
            [structs.asdict(row) for row in rows],
            list(StatisticRow.__struct_fields__),
            differing_worlds(database),
            not_compared(database),
            [*remarks_on(rows, metrics), *left_over(database)],
            of_outcomes(database),
            [*too_few(rows), *imputed(database, rows), *_alone(rows)],
        )


def _published() -> frozenset[str]:
    from fsar_ledger.metrics.definitions import published_metrics

    return frozenset(metric.name for metric in published_metrics())


def _alone(rows: "Sequence[StatisticRow]") -> list[str]:
    """Return a note on metrics that the paper does not print; Holm adjusts each by itself."""
    names = sorted({row.metric for row in rows} - _published())
    return [f"Holm adjusts each metric that the paper does not print by itself: {', '.join(names)}"] if names else []


class MultiverseResult(Answer, msgspec.Struct, frozen=True):
    """The readings, the range of each cell, the rankings, the mean in each universe, and their provenance."""

    readings: "tuple[Reading, ...]"
    cells: "tuple[Cell, ...]"
    rankings: "tuple[OrderUnderReadings, ...]"
    universes: "tuple[Universe, ...]"
    provenance: "Provenance"

    def table(self) -> "Table":
        """Return the cells as a table."""
        from fsar_ledger.metrics.multiverse import Cell

        from .table import Table, of_structs

        return Table(of_structs(self.cells, Cell), self.provenance)

    def draw(self, file: Place, kind: str | None = None) -> None:  # noqa: ARG002 - it is SVG
        """Draw every cell under every combination of readings as SVG.

        Raises: WriteFailed if the file cannot be written.
        """
        from fsar_ledger.base.publishing import publish
        from fsar_ledger.metrics.multiverse import Multiverse
        from fsar_ledger.report import study_charts

        result = Multiverse(self.readings, self.cells, self.rankings, self.universes)
        publish(Path(file), study_charts.curves(result))

    def text(self, screen: Screen) -> Iterator[SafeText]:
        """Yield the ranges, the rankings and the readings as tables."""
        from .table import plain

        if not self.cells:
            yield printable.line("no runs to read")
            return
        cells, rankings = plain(self.cells), [_ranking_row(row) for row in self.rankings]
        readings: list[Row] = [
            {"name": reading.name, "instead of": reading.reading, "says": reading.title} for reading in self.readings
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
    takes=("svg", "cluster", "verified", "json", "csv", "raw", "wide"),
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
    from fsar_ledger.designs.registered import known_names
    from fsar_ledger.metrics.multiverse import multiverse as read
    from fsar_ledger.metrics.provenance import of_outcomes

    pooled = pools_seeds(pool)
    with ledger.database() as database:
        names = tuple(row["metric"] for row in database.rows("SELECT metric FROM metric_definitions ORDER BY position"))
        result = read(database, known_names("metric", names_of(metric), names), pools_seeds=pooled, progress=progress)
        return MultiverseResult(result.readings, result.cells, result.rankings, result.universes, of_outcomes(database))


def _verdicts(rankings: "Sequence[OrderUnderReadings]") -> Iterator[str]:
    """Yield in how many rankings FSAR is best, and in how many our order stays, under every combination."""
    for what, count in (
        ("FSAR is the best one", "fsar_best"),
        ("the order of the architectures is ours", "same_order"),
    ):
        ranked = [row for row in rankings if getattr(row, count) is not None]
        always = sum(getattr(row, count) == row.combinations for row in ranked)
        never = sum(getattr(row, count) == 0 for row in ranked)
        if ranked:
            yield (
                f"{what} under every combination in {always} of {counted(len(ranked), 'ranking')}, under some in "
                f"{len(ranked) - always - never}, under none in {never}"
            )
        else:
            fsar = ", one of them FSAR" if count == "fsar_best" else ""
            yield f"whether {what}: nothing to rank; this needs means of two architectures{fsar}"


def _columns(rows: Sequence[Row], columns: tuple[str, ...]) -> list[str]:
    """Return the columns to show: those of the setting after the first, those of `WHERE_ANY` at the end."""
    distinguishing = [name for name in WHERE_TELLING if name in rows[0] and len({row[name] for row in rows}) > 1]
    return [
        columns[0],
        *distinguishing,
        *columns[1:],
        *(name for name in WHERE_ANY if any(row.get(name) for row in rows)),
    ]


def _ranking_row(row: "OrderUnderReadings") -> Row:
    changed, not_best = _texts(row.changed_under), _texts(row.fsar_not_best_under)
    return {**structs.asdict(row), "changed_under": changed, "fsar_not_best_under": not_best}


def _texts(sets: "tuple[ReadingNames, ...] | None") -> str | None:
    """Return the combinations in words; None if there are none, or it is unknown."""
    return "; ".join(" + ".join(names) or OURS for names in sets) if sets else None
