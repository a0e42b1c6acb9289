"""Compare the architectures of a ledger in pairs, with remarks on what the rows leave out."""

from collections.abc import Sequence
from typing import Any

import msgspec
from msgspec import structs

from fsar_ledger.metrics.comparability import (
    DifferingWorlds,
    differing_worlds,
    imputed,
    left_over,
    not_compared,
    remarks_on,
    too_few,
)
from fsar_ledger.metrics.database import Database
from fsar_ledger.metrics.definitions import published_metrics
from fsar_ledger.metrics.results import StatisticRow, statistic_rows

from .provenance import Provenance, of_judgement

PUBLISHED = frozenset(one.name for one in published_metrics())
NOTHING = (
    "nothing to compare; that takes runs of two architectures, or of one with and without a mechanism, that met "
    "the same world"
)


class Statistics(msgspec.Struct, frozen=True):
    """The answer of `statistics`: rows, differing worlds, why some comparisons have no pairs, and remarks."""

    rows: list[dict[str, Any]]
    columns: list[str]
    differing: list[DifferingWorlds]
    not_compared: list[str]
    remarks: list[str]
    provenance: Provenance
    notes: list[str]
    """How to read the rows; none of them is a warning."""

    @property
    def before(self) -> list[str]:
        """Return the lines above the numbers: which worlds differ, or that nothing is compared."""
        return [*map(str, self.differing), *([] if self.rows else [NOTHING, *self.not_compared])]

    @property
    def after(self) -> list[str]:
        """Return the lines below the numbers: how Holm adjusts several families, and what is missing."""
        families = {
            (row["family"], row["family_tests"])
            for row in self.rows
            if row["family_tests"] is not None and row["metric"] in PUBLISHED
        }
        told = (
            [f"Holm adjusts together: {'; '.join(f'{count} tests of {name}' for name, count in sorted(families))}"]
            if len(families) > 1
            else []
        )
        return [*told, *(f"not compared: {why}" for why in self.not_compared), *self.remarks] if self.rows else []


def _alone(rows: Sequence[StatisticRow]) -> list[str]:
    """Return a note on metrics that the paper does not print; Holm adjusts each by itself."""
    names = sorted({row.metric for row in rows} - PUBLISHED)
    return [f"Holm adjusts each metric that the paper does not print by itself: {', '.join(names)}"] if names else []


def compute_statistics(database: Database, *, pooled: bool) -> Statistics:
    """Compare everything in pairs that the ledger allows. Raises: As `Database.rows`."""
    found = statistic_rows(database, pools_seeds=pooled)
    metrics = [row["metric"] for row in database.rows("SELECT metric FROM metric_definitions ORDER BY position")]
    columns = list(StatisticRow.__struct_fields__)
    remarks = [*remarks_on(found, metrics), *left_over(database)]
    notes = [*too_few(found), *imputed(database, found), *_alone(found)]
    return Statistics(
        [structs.asdict(row) for row in found],
        columns,
        differing_worlds(database),
        not_compared(database),
        remarks,
        of_judgement(database),
        notes,
    )
