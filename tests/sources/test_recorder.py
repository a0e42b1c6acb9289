"""A recorder keeps every event that it took, durably and once, and refuses what is wrong before anything is on disk."""

import errno
import json
import os
import signal
import subprocess
import sys
import threading
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsar_ledger.base.errors import FsarLedgerError, InvalidRun, UsageError, WriteFailed
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.events.task import TaskCompleted
from fsar_ledger.events.world import LinkWentDown, TaskArrived
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.store.append import SEAL_ROWS
from fsar_ledger.sources import recorder as recorders
from fsar_ledger.sources.columns import storable_text
from fsar_ledger.sources.recorder import Recorder
from tests.sources.importing import is_good, kinds, rows

TASKS = ("TaskArrived", "TaskCompleted")
JOINED = [RobotJoined(robot=Robot("robot/a"), role="agv", supervisor=None)]
BEGINS = datetime(2026, 3, 1, 10, tzinfo=UTC)
COMMAND = (sys.executable, "-m", "fsar_ledger")


def recorder(ledger: Path, **others: Any) -> Recorder:
    return Recorder(ledger, **{"run": "night", "observes": TASKS, **others})


def arrived(name: str) -> Event:
    return TaskArrived(task_id=name, robot=None)


def tasks(ledger: Path) -> list[str]:
    return [row["task_id"] for row in rows(ledger) if row["type"] == "TaskArrived.v1"]


def broken(one: Recorder, name: str) -> None:
    """Record a batch of which the second event is wrong."""
    with one.batch():
        one.event(arrived(name))
        one.event(arrived("\n"))


def test_an_event_is_on_disk_when_the_call_returns(tmp_path: Path) -> None:
    with recorder(tmp_path / "ledger") as one:
        for name in "abc":
            number = one.event(arrived(name))
            assert rows(tmp_path / "ledger")[-1]["seq"] == number
            assert tasks(tmp_path / "ledger")[-1] == name


def test_a_run_goes_on_after_its_process_was_killed(tmp_path: Path) -> None:
    program = (
        "import os, sys; from pathlib import Path; from tests.sources.test_recorder import arrived, recorder\n"
        "one = recorder(Path(sys.argv[1])); one.event(arrived('a')); one.event(arrived('b'))\n"
        "os.kill(os.getpid(), 9)"
    )
    killed = subprocess.run([sys.executable, "-c", program, str(tmp_path / "ledger")], check=False)
    assert killed.returncode == -signal.SIGKILL
    with recorder(tmp_path / "ledger") as one:
        one.event(arrived("c"))
    assert tasks(tmp_path / "ledger") == ["a", "b", "c"]
    types = [row["type"] for row in rows(tmp_path / "ledger")]
    assert types == [
        *("RunStarted.v2", "SourceOpened.v1", "TaskArrived.v1", "TaskArrived.v1"),
        *("SourceOpened.v1", "TaskArrived.v1", "SourceClosed.v1"),
    ]
    assert is_good(tmp_path / "ledger")


def test_a_batch_is_one_commit_or_none(tmp_path: Path) -> None:
    ledger = tmp_path / "ledger"
    with recorder(ledger) as one:
        commits = open_ledger(ledger).head.commits
        with one.batch():
            first = one.event(arrived("a"))
            one.event(TaskCompleted("a"), caused_by=first)
            assert tasks(ledger) == []
        assert open_ledger(ledger).head.commits == commits + 1
        with pytest.raises(InvalidRun):
            broken(one, "b")
        one.event(arrived("d"))
    assert tasks(ledger) == ["a", "d"]
    assert [row["seq"] for row in rows(ledger)] == list(range(len(rows(ledger))))


def test_a_batch_of_more_than_a_journal_takes_is_one_commit_all_the_same(tmp_path: Path) -> None:
    ledger = tmp_path / "ledger"
    with recorder(ledger) as one:
        with one.batch():
            for number in range(SEAL_ROWS + 1):
                one.event(arrived(f"{number}"))
            assert tasks(ledger) == []
        one.event(arrived("last"))
    assert tasks(ledger) == [*map(str, range(SEAL_ROWS + 1)), "last"]
    sizes = {part.block.rows for part in open_ledger(ledger).parts("night")}
    assert max(sizes) == SEAL_ROWS + 1
    assert is_good(ledger)


def test_an_empty_batch_and_one_within_another(tmp_path: Path) -> None:
    with recorder(tmp_path / "ledger") as one:
        with one.batch():
            pass
        with pytest.raises(UsageError, match="batch within a batch"), one.batch(), one.batch():
            pass
        one.event(arrived("a"))
    assert tasks(tmp_path / "ledger") == ["a"]


def test_eight_threads_at_once_lose_and_double_nothing(tmp_path: Path) -> None:
    ledger = tmp_path / "ledger"
    with recorder(ledger) as one:

        def some(thread: int) -> None:
            for number in range(0, 40, 2):
                one.event(arrived(f"{thread}-{number}"))
                with one.batch():
                    first = one.event(arrived(f"{thread}-{number + 1}"))
                    one.event(TaskCompleted(f"{thread}-{number + 1}"), caused_by=first)

        threads = [threading.Thread(target=some, args=(thread,)) for thread in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    found = tasks(ledger)
    assert sorted(found) == sorted(f"{thread}-{number}" for thread in range(8) for number in range(40))
    for at_once in range(8):
        assert [name for name in found if name.startswith(f"{at_once}-")] == [f"{at_once}-{at}" for at in range(40)]
    run = rows(ledger)
    done = [row for row in run if row["type"] == "TaskCompleted.v1"]
    assert all(run[row["caused_by"]]["task_id"] == row["task_id"] for row in done)
    assert is_good(ledger)


@pytest.mark.parametrize(
    ("event", "field"),
    [
        (arrived("\x1b[2J"), "task_id"),
        (arrived(7), "task_id"),  # type: ignore[arg-type]
        (arrived("\ud800"), "task_id"),
        (TaskArrived(task_id="a", robot=7), "robot"),  # type: ignore[arg-type]
        (TaskArrived(task_id="a", robot=None, budget_us=1 << 60), "budget_us"),
        (LinkWentDown(Robot("robot/a")), "type"),
    ],
    ids=["unprintable", "no text", "half a character", "no robot", "too large", "not recorded"],
)
def test_a_wrong_event_is_refused_with_its_field_and_the_record_goes_on(
    tmp_path: Path, event: Event, field: str
) -> None:
    with recorder(tmp_path / "ledger") as one:
        before = open_ledger(tmp_path / "ledger").head
        with pytest.raises(InvalidRun, match=rf"run night, seq 2, field {field}: found .*nothing was written"):
            one.event(event)
        assert open_ledger(tmp_path / "ledger").head == before
        one.event(arrived("a"))
    assert tasks(tmp_path / "ledger") == ["a"]


def test_a_cause_is_an_earlier_event(tmp_path: Path) -> None:
    with recorder(tmp_path / "ledger") as one:
        for number in (2, 99, -1):
            with pytest.raises(InvalidRun, match=f"field caused_by: found {number}"):
                one.event(arrived("a"), caused_by=number)
        one.event(arrived("a"), caused_by=1)
    assert tasks(tmp_path / "ledger") == ["a"]


def test_a_run_that_was_declared_otherwise_is_refused_and_stays(tmp_path: Path) -> None:
    with recorder(tmp_path / "ledger", observes=["TaskArrived"]):
        pass
    with pytest.raises(UsageError, match="found a run that records TaskArrived, expected TaskArrived, TaskCompleted"):
        recorder(tmp_path / "ledger")
    with recorder(tmp_path / "ledger", observes=["TaskArrived"]) as one:
        one.event(arrived("a"))
    assert tasks(tmp_path / "ledger") == ["a"]


def test_a_time_before_the_last_event_is_refused_and_says_what_to_do(tmp_path: Path) -> None:
    with recorder(tmp_path / "ledger", epoch=BEGINS) as one:
        one.event(arrived("a"), at=BEGINS + timedelta(seconds=5))
        with pytest.raises(UsageError, match=r"5\.000000 s before the event before it.*source_time"):
            one.event(arrived("b"), at=BEGINS)
        one.event(arrived("c"), at=BEGINS + timedelta(seconds=5))
    assert tasks(tmp_path / "ledger") == ["a", "c"]


def test_an_event_may_be_told_by_its_type_and_columns(tmp_path: Path) -> None:
    with recorder(tmp_path / "ledger") as one:
        one.event("TaskArrived", task_id="a", robot="robot/A1", caused_by=1)
        for told, said in (
            ({"event": "TaskArived"}, "found TaskArived, expected an event type; did you mean TaskArrived?"),
            ({"event": "TaskArrived", "taskid": "b"}, "field taskid: .* did you mean task_id?"),
            ({"event": "TaskArrived"}, "field task_id: found none, expected one in TaskArrived"),
            ({"event": arrived("b"), "task_id": "c"}, "found TaskArrived and columns of it"),
        ):
            with pytest.raises(UsageError, match=said):
                one.event(**told)
        one.event("TaskCompleted", task_id="a")
    assert [(row["type"], row.get("caused_by")) for row in rows(tmp_path / "ledger")[2:4]] == [
        ("TaskArrived.v1", 1),
        ("TaskCompleted.v1", None),
    ]


def test_a_moment_without_a_zone_is_utc(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TZ", "Asia/Tokyo")
    time.tzset()
    try:
        with recorder(tmp_path / "ledger", epoch=BEGINS.replace(tzinfo=None)) as one:
            one.event(arrived("a"), at=BEGINS + timedelta(seconds=5))
            one.event(arrived("b"), at=(BEGINS + timedelta(seconds=7)).replace(tzinfo=None))
    finally:
        monkeypatch.undo()
        time.tzset()
    assert rows(tmp_path / "ledger")[0]["epoch"].startswith("2026-03-01T10:00:00")
    assert [row["time_us"] for row in rows(tmp_path / "ledger")[2:4]] == [5_000_000, 7_000_000]


def test_a_run_of_the_past_goes_on_in_the_past(tmp_path: Path) -> None:
    for at, name in enumerate("abc"):
        with recorder(tmp_path / "ledger", epoch=BEGINS) as one:
            one.event(arrived(name), at=BEGINS + timedelta(seconds=at))
    times = [row["time_us"] for row in rows(tmp_path / "ledger") if row["type"] == "SourceClosed.v1"]
    assert (tasks(tmp_path / "ledger"), times) == (["a", "b", "c"], [0, 1_000_000, 2_000_000])


def test_a_run_that_is_told_as_it_happens_says_until_when_it_was_observed(tmp_path: Path) -> None:
    with recorder(tmp_path / "ledger") as one:
        one.event(arrived("a"))
        time.sleep(0.05)
    last, closed = rows(tmp_path / "ledger")[-2:]
    assert closed["until_us"] >= last["time_us"] + 50_000


def test_a_clock_that_jumps_back_stands_still_on_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Clock(datetime):
        moments = iter([20, 10, 5, 21, 22])

        @classmethod
        def now(cls, tz: object = None) -> "Clock":
            return BEGINS + timedelta(seconds=next(cls.moments))  # type: ignore[return-value]

    with recorder(tmp_path / "ledger", epoch=BEGINS) as one:
        monkeypatch.setattr(recorders, "datetime", Clock)
        for name in "abcd":
            one.event(arrived(name))
    times = [row["time_us"] for row in rows(tmp_path / "ledger") if row["type"] == "TaskArrived.v1"]
    assert times == [20_000_000, 20_000_000, 20_000_000, 21_000_000]


def test_what_was_seen_is_escaped_where_it_cannot_be_printed(tmp_path: Path) -> None:
    with recorder(tmp_path / "ledger") as one:
        one.observed("a\n", {"b\t": "\x1b[2J", "c": {"d": 1}}, objects={"robot/\x00": "\x07"}, body="\ud800")
        one.observed("ok", {"wort": "Straße משימה"}, source_time=BEGINS)
    seen, plain = (row for row in rows(tmp_path / "ledger") if row["type"] == "Observed.v1")
    assert (seen["kind"], seen["names"], seen["texts"][0]) == ("a\\n", ["b\\t", "c"], "\\x1b[2J")
    assert (seen["objects"], seen["qualifiers"], seen["body"]) == (["robot/\\x00"], ["\\x07"], "\\ud800")
    assert plain["texts"] == ["Straße משימה"]
    assert is_good(tmp_path / "ledger")


def test_a_fleet_joins_when_the_run_begins_and_not_again(tmp_path: Path) -> None:
    for fleet in ({"a": "agv"}, JOINED, ()):
        with recorder(tmp_path / "ledger", fleet=fleet) as one:
            one.event(arrived("x"))
    assert kinds(tmp_path / "ledger") == ["RobotJoined", *["TaskArrived"] * 3]


@pytest.mark.parametrize(
    ("otherwise", "said"),
    [
        ({"fleet": {"b": "agv"}}, r"1 robot with which it began \(robot/a\), expected the same as now \(robot/b\)"),
        ({"fleet": {"a": "lift"}}, "found 1 robot with which it began"),
        (
            {"epoch": BEGINS + timedelta(seconds=1)},
            "found a run that began 2026-03-01T10:00:00Z, expected 2026-03-01T10:00:01Z",
        ),
        ({"origin": "example.org/other"}, "found a ledger of origin 'fsar-ledger/recorded'"),
    ],
)
def test_a_run_goes_on_as_it_began_or_not_at_all(tmp_path: Path, otherwise: dict[str, Any], said: str) -> None:
    recorder(tmp_path / "ledger", fleet={"a": "agv"}, epoch=BEGINS).close()
    before = [*rows(tmp_path / "ledger")]
    with pytest.raises(UsageError, match=said):
        recorder(tmp_path / "ledger", **otherwise)
    assert [*rows(tmp_path / "ledger")] == before
    recorder(tmp_path / "ledger", fleet={"a": "agv"}, epoch=BEGINS, origin="fsar-ledger/recorded").close()


@pytest.mark.parametrize("observes", ["fleet", "RobotJoined.supervisor"])
def test_roles_alone_do_not_say_completely_who_supervises_whom(tmp_path: Path, observes: str) -> None:
    with pytest.raises(UsageError, match=f"observes={observes}: found a fleet with only the roles"):
        recorder(tmp_path / "ledger", fleet={"a": "agv"}, observes=[observes])
    recorder(tmp_path / "ledger", fleet=JOINED, observes=[observes]).close()


def test_two_recorders_of_one_run_at_once_lose_nothing(tmp_path: Path) -> None:
    with recorder(tmp_path / "ledger") as one:
        other = recorder(tmp_path / "ledger")
        other.event(arrived("theirs"))
        with pytest.raises(UsageError, match="another process adds to this run"):
            one.event(arrived("ours"))
        other.close()
        with pytest.raises(UsageError, match="another process adds to this run"):
            one.close()
    assert tasks(tmp_path / "ledger") == ["theirs"]
    assert is_good(tmp_path / "ledger")


def test_a_full_disk_is_told_and_the_run_goes_on_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one = recorder(tmp_path / "ledger")
    one.event(arrived("a"))

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr("fsar_ledger.ledger.store.journal.JournalFile.write", full)
        with pytest.raises(WriteFailed, match="No space left"):
            one.event(arrived("b"))
    with pytest.raises(FsarLedgerError):
        one.close()
    with recorder(tmp_path / "ledger") as again:
        again.event(arrived("c"))
    assert tasks(tmp_path / "ledger") == ["a", "c"]
    assert is_good(tmp_path / "ledger")


def test_what_went_wrong_first_is_what_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    def recorded() -> None:
        with recorder(tmp_path / "ledger") as one:
            monkeypatch.setattr("fsar_ledger.ledger.store.journal.JournalFile.write", stopped)
            one.event(arrived("a"))

    with pytest.raises(KeyboardInterrupt):
        recorded()


def test_after_its_close_a_recorder_takes_nothing(tmp_path: Path) -> None:
    one = recorder(tmp_path / "ledger")
    one.close()
    one.close()
    with pytest.raises(FsarLedgerError):
        one.event(arrived("a"))
    assert tasks(tmp_path / "ledger") == []


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(["event", "wrong", "batch", "broken batch", "reopen"]), st.text(max_size=4))))
def test_any_calls_leave_what_was_taken_and_nothing_else(
    tmp_path_factory: pytest.TempPathFactory, calls: list[tuple[str, str]]
) -> None:
    ledger = tmp_path_factory.mktemp("any") / "ledger"
    one, taken = recorder(ledger), list[str]()
    for what, text in calls:
        name = f"t{storable_text(text)}"
        if what == "reopen":
            one.close()
            one = recorder(ledger)
        elif what == "event":
            one.event(arrived(name))
            taken.append(name)
        elif what == "wrong":
            with pytest.raises(InvalidRun):
                one.event(arrived(name + "\n"))
        elif what == "batch":
            with one.batch():
                one.event(arrived(name))
                one.event(arrived(name + "2"))
            taken += [name, name + "2"]
        else:
            with pytest.raises(InvalidRun):
                broken(one, name)
    one.close()
    assert tasks(ledger) == taken
    assert is_good(ledger)


def test_a_run_that_was_simulated_is_not_recorded_on(ledger: Path) -> None:
    name = json.loads(next(iter(open_ledger(ledger).rows(1, 2))))["run_id"]
    with pytest.raises(UsageError, match="was not recorded from outside"):
        Recorder(ledger, run=name)
