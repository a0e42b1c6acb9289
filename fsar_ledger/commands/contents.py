"""What a ledger holds, in short: which worlds met which architectures, and what is missing for a fair comparison."""

from pathlib import Path
from typing import Any

import msgspec

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.read import Head

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

PARAMETERS = """
SELECT kind, model_version, parameters, count(*) AS runs
FROM events
WHERE type = 'RunStarted.v1'
GROUP BY kind, model_version, parameters
ORDER BY runs DESC, model_version, parameters
"""


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

    def summary(self) -> str:
        """One or two lines for people; the parameters are too many for that."""
        if not self.groups:
            return "no runs yet"
        missing = sum(group["runs_missing"] for group in self.groups)
        state = "complete" if self.is_complete else f"not complete ({missing:,} missing; the `simulate` that began this ledger continues it)"
        models = "; ".join(f"{model['kind']}, model {model['model_version']}" for model in self.models)
        return f"{self.run_count:,} runs, {state}\n{models}"


def contents(ledger: Path, *, verified: bool = False) -> tuple[Head, Contents]:
    """The head of the ledger and its runs, counted by SQL.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `answering`.
    """
    with answering(ledger, verified=verified) as database:
        assert database.head is not None  # only a database over rows in memory has none
        models = [{**row, "parameters": _parameters(ledger, row["parameters"])} for row in database.rows(PARAMETERS)]
        return database.head, Contents(groups=database.rows(GROUPS), models=models, rows_verified=database.rows_verified)


def _parameters(ledger: Path, text: str) -> Any:
    try:
        return msgspec.json.decode(text)
    except (msgspec.DecodeError, RecursionError) as error:
        raise LedgerCorrupted(f"{ledger}: field parameters of a RunStarted: found {text!r:.80}, expected JSON ({error}); run fsar-ledger verify") from error
