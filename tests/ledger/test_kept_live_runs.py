"""Every version replays, judges and goes on with the live run that each release keeps, cut once, since 0.13.0.

The ledger that today's code would keep is one of them.
"""

import shutil
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fsar_ledger.designs.constants import Constants
from fsar_ledger.events.command import CommandGiven
from fsar_ledger.events.execution import ExecutionFailed
from fsar_ledger.events.fleet import RunContinued
from fsar_ledger.events.recovery import FailureResolved
from fsar_ledger.events.request import RequestIssued
from fsar_ledger.events.task import TaskAbandoned, TaskCompleted
from fsar_ledger.events.world import TaskArrived
from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.store.keys import read_verifier
from fsar_ledger.ledger.store.locations import record_of
from fsar_ledger.ledger.verify import verify
from fsar_ledger.ledger.verify.report import VerifyOptions
from fsar_ledger.metrics.database import connect
from fsar_ledger.runtime.federation import Federation
from fsar_ledger.runtime.replay import replay
from fsar_ledger.runtime.run_replay import ForeignDigest, replay_run
from tests.ledger.keep_release import EPOCH_S, LEDGERS, ORIGIN, SECRET, Kept, kept_of, write_ledger
from tests.ledger.test_released_ledgers import VERSIONS, number

TODAY = "today"
FIRST = (0, 13, 0)


@pytest.fixture(scope="module", params=[TODAY, *(one for one in VERSIONS if number(one) >= FIRST)])
def case(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Kept]:
    if request.param != TODAY:
        return LEDGERS / request.param / "ledger", kept_of(request.param)
    path = tmp_path_factory.mktemp("today") / "ledger"
    return path, write_ledger(path)


def test_no_release_before_kept_one() -> None:
    assert [one for one in VERSIONS if kept_of(one).continued] == [one for one in VERSIONS if number(one) >= FIRST]


def test_the_ledger_verifies_and_nothing_else_is_left(case: tuple[Path, Kept]) -> None:
    path, kept = case
    report = verify(path, asked=VerifyOptions(trusted=read_verifier(kept.key)))
    assert report.problems == ()
    assert (report.root, report.events, report.signed) == (kept.root, kept.events, kept.commits)
    assert (report.runs, kept.runs[-2:], kept.continued) == (len(kept.runs), ("live", "live.2"), ("live",))
    assert {one.name for one in path.parent.iterdir()} <= {"ledger", "log", "kept.json", "events.jsonl"}


def test_it_was_cut_while_work_was_open_that_ended_after(case: tuple[Path, Kept]) -> None:
    events = record_of(open_ledger(case[0]), "live.2").events
    [cut] = [seq for seq, event in enumerate(events) if isinstance(event, RunContinued)]

    def among(kind: type, part: slice) -> int:
        return sum(isinstance(event, kind) for event in events[part])

    before, after = slice(0, cut), slice(cut, None)
    assert (among(CommandGiven, before), among(CommandGiven, after)) == (6, 5)
    assert (among(TaskArrived, before), among(TaskArrived, after)) == (3, 0)
    assert (among(ExecutionFailed, before), among(FailureResolved, after)) == (1, 1)
    assert among(RequestIssued, before) == 2
    assert [among(kind, after) for kind in (TaskCompleted, TaskAbandoned)] == [2, 1]


def test_both_parts_replay_with_the_digest_at_the_cut_or_a_remark_that_it_was_not_compared(
    case: tuple[Path, Kept],
) -> None:
    report, digests = replay(case[0]), list[ForeignDigest]()
    assert {"live", "live.2"}.isdisjoint(f"{one.run}" for one in report.differences)
    assert replay_run(record_of(open_ledger(case[0]), "live.2"), digests=digests) is None
    assert len(digests) == len([one for one in report.remarks if one.startswith("state at cuts")])


def test_a_cut_run_that_was_changed_is_found(case: tuple[Path, Kept]) -> None:
    record = record_of(open_ledger(case[0]), "live.2")
    [seq] = [seq for seq, event in enumerate(record.events) if isinstance(event, FailureResolved)]
    changed = msgspec.structs.replace(record.events[seq], level="fleet")
    found = replay_run(
        msgspec.structs.replace(record, events=[*record.events[:seq], changed, *record.events[seq + 1 :]])
    )
    assert found is not None
    assert (found.seq, found.field) == (seq, "level")


def test_both_parts_are_judged_as_one(case: tuple[Path, Kept]) -> None:
    with connect(case[0]) as database:
        rows = database.rows("SELECT * FROM coordination_success WHERE run_id LIKE 'live%'")
    assert [(row["run_id"], row["denominator"]) for row in rows] == [("live.2", 3)]


def test_it_goes_on(case: tuple[Path, Kept], tmp_path: Path) -> None:
    shutil.copytree(case[0], tmp_path / "ledger")
    size = len(record_of(open_ledger(case[0]), "live.2").events)
    task: dict[str, Any] = {"task_id": "t1", "steps": ("A navigate.indoor",), "budget_us": 60_000_000}
    signer, now_s = Signer(ORIGIN, SECRET), EPOCH_S + 3_600
    with Federation(tmp_path / "ledger", "live", Constants(), 4, lambda: now_s * 10**9, signer=signer) as hall:
        assert (hall.run, hall.size) == ("live.2", size)
        given = hall.give("SubmitTask", "robot/A1", robot="robot/A1", **task)
        assert given.rejected == "the name t1 is taken, expected a new one"
