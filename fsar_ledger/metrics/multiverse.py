"""Compute every cell of the results table under every reading of the paper's text, and whether the ranking survives.

A reading (`queries/readings/*.sql`) replaces one relation by another with the same columns. Readings of different
questions combine; those of one question exclude each other. The multiverse of a metric is every combination of the
readings that affect it; the empty one is ours. Nothing is simulated again: the same ledger is read differently.
"""

from collections.abc import Iterable, Iterator, Sequence
from functools import cache, partial
from itertools import product

import msgspec
import pyarrow as pa

from fsar_ledger.base.progress import Progress
from fsar_ledger.designs.registered import PAPER_SCENARIOS

from .database import Database
from .library import READINGS, Query, library
from .results import SETTINGS, named_setting, setting_of, typed
from .robustness import OrderUnderReadings, rankings, steady
from .slices import SliceQuery
from .verdicts import published

ReadingNames = tuple[str, ...]
"""The readings that replace ours, by name and in order; () is our own."""

PRINTED = ("full", 4, "simulated")
"""Configuration, fleet size and kind of the runs in the paper's results table, which has no forks."""

AT_ONCE = 8
"""Combinations per statement: more are hardly faster, and take more memory."""

MEANS = """
    WITH definitions AS ({definitions}), means AS (
        SELECT
            measured.universe,
            runs.architecture, runs.configuration, runs.fleet_size, {seed} AS seed,
            runs.kind, runs.source, runs.model_version, settings.constants,
            CASE
                WHEN any_value(definitions.is_pooled)
                    THEN sum(measured.numerator)::DOUBLE / nullif(sum(measured.denominator)::DOUBLE, 0)
                        / any_value(definitions.numerator_units)
                WHEN count(measured.value) > 0 -- else nothing happened that could be counted
                    THEN avg(CASE WHEN measured.not_observed IS NULL THEN coalesce(measured.value,
                        definitions.undefined_value) END ORDER BY measured.run_id)
            END AS mean,
            count(measured.not_observed) AS runs_not_observed
        FROM measured
        INNER JOIN definitions ON measured.universe = definitions.universe
        INNER JOIN runs ON measured.run_id = runs.run_id
        INNER JOIN run_settings AS settings ON measured.run_id = settings.run_id
        GROUP BY ALL
    )
    SELECT *
    FROM means
    ORDER BY universe, {order}, list_position(['fsar', 'cfc', 'dhma'], architecture), architecture
"""
MEASURED = "SELECT {universe} AS universe, run_id, numerator, denominator, value, not_observed FROM {metric}"
DEFINED = (
    "SELECT {universe} AS universe, is_pooled, numerator_units, undefined_value "
    "FROM {definitions} WHERE metric = '{name}'"
)


# See docs/decisions/readings-are-queries.md.
class Reading(msgspec.Struct, frozen=True):
    """One reading other than ours: its title, the number of ours, their question, and the paper's words behind it.

    `replaces` is a relation; `moves` are the metrics that depend on it.
    """

    name: str
    title: str
    reading: str
    question: str
    why: str
    paper: str
    replaces: str
    moves: tuple[str, ...]


class _OfRuns(msgspec.Struct, frozen=True, kw_only=True):
    """The architecture and the runs of a metric. None: not recorded in the runs."""

    metric: str
    architecture: str | None
    configuration: str | None
    fleet_size: int | None
    seed: int | None
    kind: str
    source: str | None
    model_version: str | None
    constants: str | None


class Universe(_OfRuns, frozen=True, kw_only=True):
    """The mean of one metric for one architecture under these readings instead of ours.

    Runs whose source does not record what the metric rests on are left out. None: undefined or not observed.
    """

    readings: ReadingNames
    mean: float | None
    runs_not_observed: int


class Cell(_OfRuns, frozen=True, kw_only=True):
    """The range of one cell over all combinations of readings, and the reading that moves it most by itself.

    `paper`, `ours`, `lowest`, `highest`, `moved_by` are in the metric's unit; among combinations with the same mean the
    one of fewest readings is named.
    None: undefined or not observed; `paper` also unless the cell is of simulated runs of a full architecture with four
        robots, all in the paper's scenarios; `most_moving` where no reading alone moves the cell.
    """

    paper: float | None
    ours: float | None
    lowest: float | None
    highest: float | None
    combinations: int
    undefined: int
    most_moving: str | None
    moved_by: float | None
    lowest_under: ReadingNames | None
    highest_under: ReadingNames | None
    runs_not_observed: int


class Multiverse(msgspec.Struct, frozen=True):
    """The readings, the range of each cell, the rankings, and the mean in each universe."""

    readings: tuple[Reading, ...]
    cells: tuple[Cell, ...]
    rankings: tuple[OrderUnderReadings, ...]
    universes: tuple[Universe, ...]


@cache
def readings() -> tuple[Reading, ...]:
    """Return all readings other than ours, by name."""
    return tuple(_reading(query) for name, query in sorted(library().queries.items()) if name.startswith(READINGS))


def _reading(query: Query) -> Reading:
    header = query.header
    moves = tuple(name.strip() for name in header["Moves"].split(","))
    return Reading(
        query.relation,
        header["Title"],
        header["Reading"],
        header["Question"],
        header["Why"],
        header["Paper"],
        header["Replaces"],
        moves,
    )


def combinations(metric: str) -> tuple[ReadingNames, ...]:
    """Return every combination of the readings that move this metric: at most one for each question.

    Ours comes first, then those of fewer readings.
    """
    questions: dict[str, list[str]] = {}
    for reading in readings():
        if metric in reading.moves:
            questions.setdefault(reading.question, []).append(reading.name)
    chosen = (
        tuple(sorted(filter(None, choice))) for choice in product(*(("", *names) for names in questions.values()))
    )
    return tuple(sorted(chosen, key=lambda names: (len(names), names)))


class Relations:
    """The relations of a ledger under alternative readings.

    Each is made once and shared by all combinations that do not change it. Relations that readings replace or read are
    stored; those derived from them are not.
    """

    def __init__(self, database: Database, using: Sequence[Reading]):
        self._database = database
        self._replaced = {reading.name: reading.replaces for reading in using}
        sources = {source for name in self._replaced for source in database.library.relations[name].sources()}
        self._kept = (sources | set(self._replaced.values())) & database.library.relations.keys()
        self._readings_of: dict[str, frozenset[str]] = {}
        self._made: dict[tuple[str, frozenset[str]], tuple[str, bool]] = {}

    def under(self, relation: str, chosen: frozenset[str]) -> str:
        """Return the name of this relation under these readings. Raises: as `Database.define`."""
        query = self._database.library.relations.get(relation)
        if query is None:
            return relation  # the events, or a step of the query that reads it
        using = chosen & self._telling(relation)
        if not using and relation not in self._kept:
            self._database.prepare(relation)
            return relation
        if (relation, using) not in self._made:
            self._make(query, using)
        return self._made[relation, using][0]

    def _telling(self, relation: str) -> frozenset[str]:
        """Return the readings that replace this relation, or one that it is made of."""
        if relation not in self._readings_of:
            below = {query.relation for query in self._database.library.needs([relation])}
            self._readings_of[relation] = frozenset(
                name for name, replaced in self._replaced.items() if replaced in below
            )
        return self._readings_of[relation]

    def _make(self, query: Query, using: frozenset[str]) -> None:
        """Make the relation under these readings, all of which affect it.

        The last reading that replaces it reads it under the others.
        """
        last = max((name for name in using if self._replaced[name] == query.relation), default=None)
        source_query = query if last is None else self._database.library.relations[last]
        names = {source: self.under(source, using) for source in source_query.sources() - {query.relation}}
        if last is not None:
            names[query.relation] = self.under(query.relation, using - {last})
        is_stored = query.is_stored or (last is None and query.relation in self._kept) or source_query.is_stored
        name = f"{query.relation}_{len(self._made)}"
        self._database.define(name, source_query.reading_from(names), is_stored=is_stored)
        self._made[query.relation, using] = (name, is_stored)

    def measured(self, metric: str, combined: Sequence[ReadingNames]) -> pa.Table:
        """Return the metric's measurements of each run under each of these combinations. Raises: as `Database.rows`."""
        return self._database.table(
            " UNION ALL ".join(
                MEASURED.format(universe=universe, metric=self.under(metric, frozenset(chosen)))
                for universe, chosen in enumerate(combined)
            )
        )

    def means(
        self,
        metric: str,
        combined: Sequence[ReadingNames],
        measured: pa.Table | None = None,
        *,
        pools_seeds: bool = False,
    ) -> list[Universe]:
        """Return the mean of this metric for each architecture and setting under each of these combinations, in order.

        `measured` is the result of `measured`, which is called if None. Raises: as `Database.rows`.
        """
        self._database.hold("measured", self.measured(metric, combined) if measured is None else measured)
        sql = MEANS.format(
            definitions=" UNION ALL ".join(
                DEFINED.format(
                    universe=universe, definitions=self.under("metric_definitions", frozenset(chosen)), name=metric
                )
                for universe, chosen in enumerate(combined)
            ),
            seed="NULL::BIGINT" if pools_seeds else "runs.seed",
            order=SETTINGS,
        )
        rows = self._database.rows(sql)
        self._database.drop("measured")
        return typed(
            [{**row, "metric": metric, "readings": combined[row["universe"]]} for row in rows],
            Universe,
        )

    def forget(self) -> None:
        """Drop everything that was made here."""
        for name, is_stored in reversed(self._made.values()):
            self._database.undefine(name, is_stored=is_stored)
        self._made.clear()


def multiverse(
    database: Database, metrics: Sequence[str] = (), *, pools_seeds: bool = False, progress: Progress | None = None
) -> Multiverse:
    """Return the multiverse of these metrics (default: all), over the runs of each seed, or of all seeds.

    Raises: as `Database.rows`.
    """
    definitions = database.rows("SELECT metric, better FROM metric_definitions ORDER BY position")
    better = {
        row["metric"]: row["better"]
        for row in definitions
        if row["metric"] in (metrics or [row["metric"] for row in definitions])
    }
    found_universes = universes(database, list(better), pools_seeds=pools_seeds, progress=progress)
    used = tuple(reading for reading in readings() if set(reading.moves) & better.keys())
    scenarios = {
        row["scenario"] for row in database.rows("SELECT DISTINCT scenario FROM runs WHERE kind = 'simulated'")
    }
    ranges = cells(found_universes, is_of_paper=scenarios <= {*PAPER_SCENARIOS})
    return Multiverse(used, tuple(ranges), tuple(rankings(found_universes, better)), tuple(found_universes))


def universes(
    database: Database, metrics: Sequence[str], *, pools_seeds: bool = False, progress: Progress | None = None
) -> list[Universe]:
    """Return the mean of these metrics for each architecture and setting under every combination of their readings.

    `progress` is called with the number of combinations read, and the total over all metrics. Raises: as
    `Database.rows`.
    """
    total, done = sum(len(combinations(metric)) for metric in metrics), 0
    rows: list[Universe] = []
    queries = {(metric, part): _slice_query(metric, part) for metric in metrics for part in _parts(metric)}
    of_slices = database.slices.tables(queries, progress) if database.slices is not None else iter(())
    for metric in metrics:
        relations = Relations(database, _moving(metric))
        for part in _parts(metric):
            rows += relations.means(metric, part, next(of_slices, None), pools_seeds=pools_seeds)
            done += len(part)
            if progress is not None and database.slices is None:
                progress(done, total)
        relations.forget()
    return rows


def _moving(metric: str) -> list[Reading]:
    return [reading for reading in readings() if metric in reading.moves]


def _parts(metric: str) -> list[tuple[ReadingNames, ...]]:
    """Return the combinations of a metric's readings, in the batches of one statement each."""
    combined = combinations(metric)
    return [combined[begin : begin + AT_ONCE] for begin in range(0, len(combined), AT_ONCE)]


def _slice_query(metric: str, part: Sequence[ReadingNames]) -> SliceQuery:
    """Return the query of a slice for the metric's measurements under these combinations."""
    needs = library().needs([metric, *(reading.name for reading in _moving(metric))])
    return SliceQuery(f"{metric} {part} {[query.sha256 for query in needs]}", partial(_measured, metric, part))


def _measured(metric: str, part: Sequence[ReadingNames], database: Database) -> pa.Table:
    relations = Relations(database, _moving(metric))
    table = relations.measured(metric, part)
    relations.forget()
    return table


def cells(found: Iterable[Universe], *, is_of_paper: bool = True) -> Iterator[Cell]:
    """Return the range of each cell, in the order of the universes of our reading.

    Cells of the paper's configurations have its numbers, unless there are runs of other scenarios, too.
    """
    by_cell: dict[tuple[object, ...], list[Universe]] = {}
    for universe in found:
        by_cell.setdefault((universe.metric, setting_of(universe), universe.architecture), []).append(universe)
    for ours, *others in by_cell.values():
        means = [(universe.mean, universe.readings) for universe in (ours, *others) if universe.mean is not None]
        lowest = min(means, key=lambda pair: steady(pair[0]), default=(None, None))
        highest = max(means, key=lambda pair: steady(pair[0]), default=(None, None))
        alone = [
            (mean - ours.mean, names[0])
            for mean, names in means
            if len(names) == 1 and ours.mean is not None and steady(mean) != steady(ours.mean)
        ]
        moved_by, moving = max(alone, key=lambda pair: abs(pair[0]), default=(0.0, None))
        is_printed = is_of_paper and (ours.configuration, ours.fleet_size, ours.kind) == PRINTED
        printed = published().get((ours.metric, ours.architecture or "")) if is_printed else None
        yield Cell(
            metric=ours.metric,
            architecture=ours.architecture,
            **named_setting(ours),
            paper=None if printed is None else printed.value,
            ours=ours.mean,
            lowest=lowest[0],
            highest=highest[0],
            combinations=1 + len(others),
            undefined=1 + len(others) - len(means),
            most_moving=moving if moved_by else None,
            moved_by=moved_by or None,
            lowest_under=lowest[1],
            highest_under=highest[1],
            runs_not_observed=ours.runs_not_observed,
        )
