"""Ledgers to export: a whole one, and one whose last events are still in its journal."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import fsar_ledger
from fsar_ledger.events.envelope import flat
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from tests import recycled
from tests.ledger.keep_release import LEDGERS

Rows = list[dict[str, Any]]
Asked = Callable[[str], Rows]


@pytest.fixture(scope="session")
def ledger(tmp_path_factory: pytest.TempPathFactory) -> fsar_ledger.Ledger:
    """Two scenarios under each architecture, and the plan; for reading only."""
    path = tmp_path_factory.mktemp("exports") / "ledger"
    scenarios = ["door-relay", "failure-recovery-chain"]
    return fsar_ledger.simulate(path, scenario=scenarios, runs=1, seed=7, workers=1).ledger


@pytest.fixture
def asked(ledger: fsar_ledger.Ledger) -> Asked:
    """Answers SQL about the ledger."""
    return lambda sql: recycled.asked(ledger.path, sql)


@pytest.fixture(scope="session")
def runs(ledger: fsar_ledger.Ledger) -> list[LedgerRun]:
    return [run for run in open_for_answers(ledger.path).runs() if isinstance(run.events[0], RunStarted)]


@pytest.fixture(scope="session")
def growing(runs: list[LedgerRun], tmp_path_factory: pytest.TempPathFactory) -> fsar_ledger.Ledger:
    """The same runs: four in two segments, two in the journal."""
    path = tmp_path_factory.mktemp("growing") / "ledger"
    with Writer(path, "example.org/growing") as writer:
        writer.append(stage(path, runs[:2]))
        writer.append(stage(path, runs[2:4]))
        for run in runs[4:]:
            writer.add([run])
    return fsar_ledger.open_ledger(path)


@pytest.fixture
def older(tmp_path: Path) -> fsar_ledger.Ledger:
    """A ledger that an earlier release kept, whose events have fewer columns."""
    return fsar_ledger.open_ledger(Path(shutil.copytree(LEDGERS / "0.9.0" / "ledger", tmp_path / "older")))


class StartedAtNoon(RunStarted, frozen=True, kw_only=True, tag="StartedAtNoon.v1"):
    """Event 0 of a run that says when it began."""

    epoch: str | None = "2026-03-01T12:00:00Z"


@pytest.fixture
def at_noon(runs: list[LedgerRun]) -> LedgerRun:
    """A run that began at noon, up to the first event after the first start of an execution that is not about it."""
    run = runs[0]
    start = [type(event).__name__ for event in run.events].index("ExecutionStarted")
    beside = (seq for seq in range(start, len(run.events)) if flat(run.events[seq]).get("action_id") is None)
    end = next(seq for seq in beside if run.times_us[seq] > run.times_us[start]) + 1
    assert "ExecutionFinished" not in [type(event).__name__ for event in run.events[:end]]
    noon = StartedAtNoon(kind="live", observes=())
    return LedgerRun(run.run_id, run.times_us[:end], run.caused_by[:end], [noon, *run.events[1:end]])
