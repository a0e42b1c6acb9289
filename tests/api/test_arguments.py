"""An argument of another kind than is asked for is an error that names it, and nothing is written."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

import fsar_ledger
from fsar_ledger.base.errors import UsageError

STARTED: dict[str, Any] = {"task_id": "t", "action_id": "t/1", "robot": "robot/a", "capability": "carry"}
EPOCH = datetime(2026, 3, 1, 10, tzinfo=UTC)
COUNTS = ("runs", "first_run", "seed", "fleet_size", "teams_working", "task_sets", "workers")


@pytest.mark.parametrize("name", COUNTS)
@pytest.mark.parametrize("found", [1.5, "3", True], ids=repr)
def test_what_is_no_whole_number_is_an_error_that_names_the_argument(tmp_path: Path, name: str, found: Any) -> None:
    with pytest.raises(UsageError, match=rf"^{name}: found {found!r}, expected a whole number$"):
        fsar_ledger.simulate(tmp_path / "ledger", **{"runs": 1, "scenario": "door-relay", name: found})
    assert not (tmp_path / "ledger").exists()


@pytest.mark.parametrize("found", [None, 7, [None]], ids=repr)
def test_what_is_no_change_is_an_error_that_names_the_argument(ledger: fsar_ledger.Ledger, found: Any) -> None:
    with pytest.raises(UsageError, match=r"^changes: found .*, expected a text, or a list of texts"):
        ledger.fork(1, found)


def test_a_time_of_the_recorder_that_is_a_text_is_an_error_that_names_it(tmp_path: Path) -> None:
    text: Any = "2026-03-01T10:00:01Z"
    with pytest.raises(UsageError, match=r"^epoch: found '2026-03-01T10:00:01Z', expected a datetime"):
        fsar_ledger.record(tmp_path / "none", epoch=text)
    with fsar_ledger.record(tmp_path / "ledger", run="r", observes=["ExecutionStarted"], epoch=EPOCH) as one:
        with pytest.raises(UsageError, match=r"^at: found '2026-03-01T10:00:01Z', expected a datetime"):
            one.event("ExecutionStarted", at=text, **STARTED)
        with pytest.raises(UsageError, match=r"^source_time: found '2026-03-01T10:00:01Z', expected a datetime"):
            one.observed("battery", source_time=text)
        one.event("ExecutionStarted", at=datetime.fromisoformat(text), **STARTED)
    assert not (tmp_path / "none").exists()
    assert len(fsar_ledger.Ledger(tmp_path / "ledger").record("r").events) == 4
