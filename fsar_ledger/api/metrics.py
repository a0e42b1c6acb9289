"""The verbs `metrics` and `statistics`: each architecture by itself, and in pairs with what the rows leave out."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import msgspec
from msgspec import structs

from fsar_ledger.base import printable

from .answers import Answer, Screen
from .names import by_scenario, pools_seeds
from .verbs import ROWS, ByOption, PoolOption, verb

if TYPE_CHECKING:
    from fsar_ledger.metrics.comparability import DifferingWorlds
    from fsar_ledger.metrics.provenance import Provenance
    from fsar_ledger.metrics.results import StatisticRow

    from .ledger import Ledger
    from .table import Table


NOTHING = (
    "nothing to compare; that takes runs of two architectures, or of one with and without a mechanism, that met "
    "the same world"
)


@verb(
    "metrics out/ledger",
    "metrics out/ledger --by scenario",
    "metrics out/ledger --pool seeds",
    "metrics out/ledger --verified --json",
    takes=ROWS,
)
def metrics(ledger: "Ledger", by: ByOption = None, pool: PoolOption = None) -> "Table":
    """Judge a ledger by the metrics: the eight of the paper, then any that were added.

    Shows mean, SD, 95 % interval and denominator for each architecture, configuration and fleet size; runs of different
    seeds, constants, models or kinds have rows of their own. Shares are in [0,1], latency is in seconds. Where a metric
    is not defined, a table shows `-` and JSON null.
    """
    from fsar_ledger.metrics.provenance import of_judgement
    from fsar_ledger.metrics.results import MetricRow, metric_rows

    from .table import MetricTable, of_structs

    per_scenario, pooled = by_scenario(by), pools_seeds(pool)
    with ledger.database() as database:
        rows = of_structs(metric_rows(database, by_scenario=per_scenario, pools_seeds=pooled), MetricRow)
        return MetricTable(rows if per_scenario else rows.drop_columns(["scenario"]), of_judgement(database))


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
        told = (
            [f"Holm adjusts together: {'; '.join(f'{count} tests of {name}' for name, count in sorted(families))}"]
            if len(families) > 1
            else []
        )
        return [*told, *(f"not compared: {why}" for why in self.not_compared), *self.remarks] if self.rows else []

    @property
    def exit_code(self) -> int:
        """1 where facts differ that an experiment keeps alike."""
        return int(any(one.is_fault for one in self.differing))

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


@verb("statistics out/ledger", "statistics out/ledger --csv", takes=ROWS)
def statistics(ledger: "Ledger", pool: PoolOption = None) -> Statistics:
    """Compare the architectures of a ledger in pairs, and FSAR with itself without a mechanism.

    For each metric and pair: paired t, Wilcoxon signed-rank, effect sizes, exact McNemar for human intervention, and
    Holm over the 24 tests of the architectures, or over those of all ablations. Runs that did not meet the same world
    are named first and left out; exit code 1 where facts differ that an experiment keeps alike. The answer says what
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
    from fsar_ledger.metrics.provenance import of_judgement
    from fsar_ledger.metrics.results import StatisticRow, statistic_rows

    pooled = pools_seeds(pool)
    with ledger.database() as database:
        found = statistic_rows(database, pools_seeds=pooled)
        metrics = [row["metric"] for row in database.rows("SELECT metric FROM metric_definitions ORDER BY position")]
        return Statistics(
            [structs.asdict(row) for row in found],
            list(StatisticRow.__struct_fields__),
            differing_worlds(database),
            not_compared(database),
            [*remarks_on(found, metrics), *left_over(database)],
            of_judgement(database),
            [*too_few(found), *imputed(database, found), *_alone(found)],
        )


def _published() -> frozenset[str]:
    from fsar_ledger.metrics.definitions import published_metrics

    return frozenset(one.name for one in published_metrics())


def _alone(rows: "Sequence[StatisticRow]") -> list[str]:
    """Return a note on metrics that the paper does not print; Holm adjusts each by itself."""
    names = sorted({row.metric for row in rows} - _published())
    return [f"Holm adjusts each metric that the paper does not print by itself: {', '.join(names)}"] if names else []
