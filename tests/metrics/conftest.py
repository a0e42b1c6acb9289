"""Small ledgers on disk."""

from pathlib import Path

import pytest

from fsar_ledger.events import CONCERNS
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.events.task import TaskAbandoned, TaskCompleted
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage


def record(architecture: str, number: int) -> LedgerRun:
    """A run of three events."""
    started = RunStarted(
        kind="simulated",
        observes=CONCERNS,
        seed=42,
        architecture=architecture,
        configuration="full",
        scenario="door-relay",
        fleet_size=4,
        run=number,
        model_version="test",
        parameters="{}",
    )
    return LedgerRun(
        f"run-{number}-{architecture}",
        [0, 5, 9],
        [None, 0, 1],
        [started, TaskCompleted(task_id="t1"), TaskAbandoned(task_id="t2")],
    )


@pytest.fixture
def ledger(tmp_path: Path) -> Path:
    """Two commits of three runs each; its path has a quote and a space."""
    path = tmp_path / "the auditor's ledger"
    with Writer(path, "test") as writer:
        for number in range(2):
            writer.append(stage(path, [record(architecture, number) for architecture in ("fsar", "cfc", "dhma")]))
    return path


@pytest.fixture
def empty_ledger(tmp_path: Path) -> Path:
    """A ledger without commits."""
    path = tmp_path / "empty"
    with Writer(path, "test"):
        pass
    return path
