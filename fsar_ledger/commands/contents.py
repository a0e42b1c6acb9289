"""What a ledger holds, in short: which worlds met which architectures, and what is missing for a fair comparison."""

from pathlib import Path
from typing import Any

import msgspec

from fsar_ledger import printable
from fsar_ledger.ledger.read import Head
from fsar_ledger.metrics.models import models

from .answering import answering

# Grain: one row per seed, fleet size, architecture and configuration.
# A scenario was meant to have the runs 0 to the highest run number that its seed and fleet size have in this ledger.
GROUPS = """
WITH meant AS (
    SELECT
        seed,
        fleet_size,
        count(DISTINCT scenario)::HUGEINT * (max(run)::HUGEINT + 1) AS run_count
    FROM runs
    GROUP BY seed, fleet_size
),

sizes AS (
    SELECT run_id, count(*) AS event_count FROM events GROUP BY run_id
)

SELECT
    runs.seed,
    runs.fleet_size,
    runs.architecture,
    runs.configuration,
    count(DISTINCT runs.scenario) AS scenarios,
    count(*) AS runs,
    any_value(meant.run_count) - count(*) AS runs_missing,
    sum(sizes.event_count)::BIGINT AS events
FROM runs
INNER JOIN meant ON runs.seed = meant.seed AND runs.fleet_size = meant.fleet_size
INNER JOIN sizes ON runs.run_id = sizes.run_id
GROUP BY runs.seed, runs.fleet_size, runs.architecture, runs.configuration
ORDER BY runs.seed, runs.fleet_size, runs.architecture, runs.configuration
"""


MODELS = 5
"""So many models are named to people; a ledger of one simulation has one."""


class Contents(msgspec.Struct, frozen=True):
    """The runs of a ledger: `groups` by seed, fleet size, architecture and configuration; `models` by model version and parameters.

    `rows_verified` is that of the `Database` they come from.
    """

    groups: list[dict[str, Any]]
    models: list[dict[str, Any]]
    rows_verified: bool | None = None

    @property
    def run_count(self) -> int:
        """All runs, whatever their group."""
        return sum(group["runs"] for group in self.groups)

    @property
    def is_complete(self) -> bool:
        """Whether every group has every run of every scenario that its worlds have; an empty ledger is not complete."""
        return bool(self.groups) and not any(group["runs_missing"] for group in self.groups)

    def summary(self) -> list[str]:
        """One or two lines for people; the parameters are too many for that."""
        if not self.groups:
            return ["no runs yet"]
        missing = sum(group["runs_missing"] for group in self.groups)
        state = "complete" if self.is_complete else f"not complete ({missing:,} missing; the `simulate` that began this ledger continues it)"
        models = "; ".join(f"{printable.value(model['kind'])}, model {printable.value(model['model_version'])}" for model in self.models[:MODELS])
        more = f"; and {len(self.models) - MODELS:,} more, --json names all" if len(self.models) > MODELS else ""
        return [f"{self.run_count:,} runs, {state}", f"{models}{more}"]


def contents(ledger: Path, *, verified: bool = False) -> tuple[Head, Contents]:
    """The head of the ledger and its runs, counted by SQL.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `answering`, and `models`.
    """
    with answering(ledger, verified=verified) as database:
        assert database.head is not None  # only a database over rows in memory has none
        found = sorted(models(database), key=lambda one: (-one.runs, one.model_version, one.text))
        shown = [{"kind": one.kind, "model_version": one.model_version, "parameters": one.parameters, "runs": one.runs} for one in found]
        return database.head, Contents(groups=database.rows(GROUPS), models=shown, rows_verified=database.rows_verified)
