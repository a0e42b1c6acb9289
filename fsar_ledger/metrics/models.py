"""The models of a ledger: with which constants its runs were played, as they record it."""

from typing import Any

import msgspec

from fsar_ledger.constants import BadParameters, read_parameters
from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.metrics.database import Database

MODELS = """
    SELECT kind, model_version, parameters, count(*) AS runs, min(run_id) AS first
    FROM run_started
    GROUP BY kind, model_version, parameters
    ORDER BY first
"""


class Model(msgspec.Struct, frozen=True):
    """The runs of one kind and model version under the same constants: their text as recorded and what it says, their number, the first one's name."""

    kind: str
    model_version: str | None
    text: str | None
    parameters: dict[str, Any]
    runs: int
    first: str


def models(database: Database) -> tuple[Model, ...]:
    """All models, in the order of the names of their first runs. Raises: LedgerCorrupted if a run records something else as its parameters."""
    return tuple(
        Model(row["kind"], row["model_version"], row["parameters"], _read(row["first"], row["parameters"]), row["runs"], row["first"])
        for row in database.rows(MODELS)
    )


def _read(run: str, parameters: str | None) -> dict[str, Any]:
    if parameters is None:
        return {}
    try:
        return read_parameters(parameters)
    except BadParameters as error:
        raise LedgerCorrupted(f"run {run!r:.300}, seq 0, field parameters: {error}; do not rely on this ledger, run fsar-ledger verify --replay") from error
