"""A ledger in slices: whole runs, each once, and the same verdicts as from the whole ledger."""

from pathlib import Path

import pytest

from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.metrics.database import Slices, connect
from fsar_ledger.metrics.invariants import audit_rows, invariants
from fsar_ledger.runtime import simulation
from fsar_ledger.runtime.experiment import Experiment, run_experiment
from tests.quick import few

WHOLE = Experiment(("fsar", "cfc", "dhma"), ("door-relay", "fleet-contention"), 2, 7)
EVENTS = "SELECT run_id, seq, type FROM events ORDER BY ALL"


@pytest.fixture(scope="module")
def ledger(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("slices") / "ledger"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulation, "COMMIT_EVENTS", 300)  # most runs are in several segments
        run_experiment(path, WHOLE, 1)
    return path


def test_slices_hold_whole_runs_and_each_event_once(ledger: Path) -> None:
    view = open_for_answers(ledger)
    slices = Slices(view, most=1_500)
    with connect(ledger) as whole:
        expected, runs = whole.rows(EVENTS), whole.rows("SELECT run_id FROM runs ORDER BY ALL")
    found, known = [], []
    for database in slices:
        found += database.rows(EVENTS)
        known += database.rows("SELECT run_id FROM runs ORDER BY ALL")
    assert len(slices) > 3
    assert sorted(found, key=str) == sorted(expected, key=str)
    assert sorted(known, key=str) == sorted(runs, key=str)
    assert [extent.rows for extent in view.extents()] == [
        sum(row["run_id"] == extent.run for row in expected) for extent in view.extents()
    ]


@pytest.mark.parametrize("most", few([1, 2_000, 1_000_000], [2_000], [1_000_000]))
def test_the_verdicts_of_slices_are_those_of_the_whole_ledger(ledger: Path, most: int) -> None:
    told: list[tuple[int, int]] = []
    with connect(ledger) as whole:
        expected = audit_rows([whole], invariants())
    slices = Slices(open_for_answers(ledger), most=most)
    assert audit_rows(slices, invariants(), (), lambda done, total: told.append((done, total))) == expected
    assert told[-1] == (len(slices) * 10, len(slices) * 10)
    assert any(row.events for row in expected)
    assert any(row.holds for row in expected)
