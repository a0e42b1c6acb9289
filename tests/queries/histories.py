"""Given rows, expect rows: short histories, and what a packaged query says of them."""

from collections.abc import Mapping, Sequence
from typing import Any

from fsar_ledger.events import CONCERNS
from fsar_ledger.metrics.database import Value
from tests.recycled import from_rows

Row = Mapping[str, Value]
S = 1_000_000
"""Microseconds of a second."""


def event(name: str, time_us: int = 0, /, **fields: Any) -> dict[str, Value]:
    """One event of version 1; fields that are not given are NULL."""
    return {"type": f"{name}.v1", "time_us": time_us, **fields}


def act(name: str, time_us: int, action_id: str, /, **fields: Any) -> dict[str, Value]:
    """One event about this action of its task."""
    return event(name, time_us, task_id=action_id.partition("/")[0], action_id=action_id, **fields)


def run(*events: Row, run_id: str = "r1", **dimensions: Value) -> list[Row]:
    """The rows of one run: RunStarted, then these events in this order."""
    started: dict[str, Value] = {
        "kind": "simulated",
        "observes": list(CONCERNS),
        "seed": 42,
        "architecture": "fsar",
        "configuration": "full",
        "scenario": "door-relay",
        "fleet_size": 4,
        "run": 0,
        "model_version": "test",
        "parameters": "{}",
    }
    rows = [{"type": "RunStarted.v2", "time_us": 0, **started, **dimensions}, *events]
    return [
        {"run_id": run_id, "seq": seq, "caused_by": seq - 1 if seq else None, **row} for seq, row in enumerate(rows)
    ]


def answer(name: str, *runs: Sequence[Row], columns: Sequence[str] = ()) -> list[tuple[Any, ...]]:
    """The rows of a query over these runs as tuples, with these columns (all: none named), sorted as the query sorts
    them."""
    with from_rows([row for rows in runs for row in rows]) as database:
        return [tuple(row[column] for column in columns or row) for row in database.query(name).to_pylist()]


def measured(name: str, *events: Row) -> tuple[int, int, float | None]:
    """Numerator, denominator and value of a metric for one run with these events."""
    ((numerator, denominator, value),) = answer(
        f"metrics/{name}", run(*events), columns=("numerator", "denominator", "value")
    )
    return numerator, denominator, value
