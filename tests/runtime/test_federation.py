"""A live federation has on disk what it decided before anybody can act on it, and goes on after anything."""

import errno
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import msgspec
import pytest

import fsar_ledger
from fsar_ledger.base.errors import FsarLedgerError, UsageError, WriteFailed
from fsar_ledger.events.command import CommandGiven
from fsar_ledger.events.envelope import Robot
from fsar_ledger.events.execution import ExecutionStarted
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.runtime.architectures.fsar import FSAR
from fsar_ledger.runtime.architectures.fsar.reports import ReportStart
from fsar_ledger.runtime.federation import Federation
from fsar_ledger.runtime.live import Decision, LiveRun
from fsar_ledger.sources.adapter import MAX_LINE

S = 1_000_000_000
TICKS = count(1_772_359_200)
A = Robot("robot/A1")
TASK: dict[str, Any] = {"robot": A, "task_id": "t", "steps": ("A navigate.indoor",), "budget_us": 600_000_000}


def federate(ledger: Path, **others: Any) -> Federation:
    """A federation whose clock ticks by a second with each look at it."""
    return fsar_ledger.federate(ledger, run="day", clock=lambda: next(TICKS) * S, **others)


def given(ledger: Path) -> list[CommandGiven]:
    """The commands on record."""
    [record] = open_ledger(ledger).runs()
    return [event for event in record.events if isinstance(event, CommandGiven)]


def is_good(ledger: Path) -> bool:
    return fsar_ledger.Ledger(ledger).verify(replay=True).ok


def test_a_decision_is_on_disk_when_the_call_returns(tmp_path: Path) -> None:
    with federate(tmp_path / "ledger") as one:
        for number, (name, fields) in enumerate(
            [("SubmitTask", TASK), ("ReportStart", {"robot": A, "action_id": "t/1.1"})], start=1
        ):
            decision = one.give(name, A, **fields)
            assert decision.rejected is None
            [record] = open_ledger(tmp_path / "ledger").runs()
            assert record.events[decision.seq].command == name  # type: ignore[attr-defined]
            assert set(decision.events) <= set(record.events)
            assert len(given(tmp_path / "ledger")) == number
            one.advance()
    assert is_good(tmp_path / "ledger")


def test_a_run_goes_on_where_it_was(tmp_path: Path) -> None:
    with federate(tmp_path / "ledger") as one:
        one.give("SubmitTask", A, **TASK)
    with federate(tmp_path / "ledger") as one:
        one.advance()
        assert one.give("ReportStart", A, robot=A, action_id="t/1.1").rejected is None
    with federate(tmp_path / "ledger") as one:
        assert one.give("ReportResult", A, executor=A, action_id="t/1.1", result="success").rejected is None
    assert is_good(tmp_path / "ledger")
    assert len(given(tmp_path / "ledger")) == 3


def test_the_same_command_again_is_decided_once_even_after_a_restart(tmp_path: Path) -> None:
    with federate(tmp_path / "ledger") as one:
        first = msgspec.structs.replace(one.give("SubmitTask", A, key="k1", **TASK), followed=())
        assert one.give("SubmitTask", A, key="k1", **TASK) == first
        assert one.give("SubmitTask", "robot/B1", key="k1", **TASK) != first  # another's key
    with federate(tmp_path / "ledger") as one:
        assert one.give("SubmitTask", A, key="k1", **TASK) == first
    assert len(given(tmp_path / "ledger")) == 2


@pytest.mark.parametrize(
    ("name", "fields", "said"),
    [
        ("ReportStat", {}, "there is no such command; did you mean ReportStart?"),
        ("ReportStart", {"robot": A}, "required field `action_id`"),
        ("ReportStart", {"robot": A, "action_id": 7}, r"Expected `str`, got `int` - at `\$.action_id`"),
        ("ReportStart", {"robot": A, "action_id": "t", "now_us": 1}, "found now_us"),
        (
            "ReportStart",
            {"robot": A, "action_id": "t", "speed": 1},
            "found speed, expected some of robot, action_id",
        ),
        ("ReportStart", {"robot": A, "action_id": "t\x1b"}, "expected characters that can be printed"),
        (
            "SubmitTask",
            {**TASK, "checkpoints": ["1\u202e"]},
            r"found '1\\u202e', expected characters that can be printed",
        ),
        (
            "ConsultRegistry",
            {"query": {"requester": A, "capability": "x\n"}},
            r"found 'x\\n', expected characters that",
        ),
        ("ConsultRegistry", {"query": {"requester": A, "capability": "x", "verson": "1"}}, "unknown field `verson`"),
        ("ReportStart", {"robot": A, "action_id": "t\ud800"}, "surrogates not allowed"),
        ("SubmitTask", {**TASK, "budget_us": float("nan")}, "budget_us"),
    ],
)
def test_what_is_no_command_is_refused_and_not_on_record(
    tmp_path: Path, name: str, fields: dict[str, Any], said: str
) -> None:
    with federate(tmp_path / "ledger") as one:
        with pytest.raises(UsageError, match=said):
            one.give(name, A, **fields)
        one.give("SubmitTask", A, **TASK)
    assert [event.command for event in given(tmp_path / "ledger")] == ["SubmitTask"]


def test_a_rejected_command_is_on_record_with_its_reason(tmp_path: Path) -> None:
    with federate(tmp_path / "ledger") as one:
        decision = one.give("ReportStart", A, robot=A, action_id="t/1.1")
    assert decision.rejected == "unknown or finished action t/1.1, expected one of robot/A1"
    assert is_good(tmp_path / "ledger")


def test_many_threads_give_commands_and_none_is_lost(tmp_path: Path) -> None:
    def play(name: str) -> None:
        seqs.extend(one.give("SubmitTask", A, **{**TASK, "task_id": f"{name}{number}"}).seq for number in range(20))

    seqs: list[int] = []
    with federate(tmp_path / "ledger") as one:
        threads = [threading.Thread(target=play, args=(name,)) for name in "abcd"]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert len(set(seqs)) == len(given(tmp_path / "ledger")) == 80
    assert is_good(tmp_path / "ledger")


def test_after_a_write_that_failed_nothing_is_decided_and_the_next_federation_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with federate(tmp_path / "ledger") as one:
        one.give("SubmitTask", A, **TASK)
        with monkeypatch.context() as patch:
            for name in ("write", "pwrite", "writev"):
                patch.setattr(os, name, refused)
            patch.setattr(os, "fsync", refused)
            patch.setattr(os, "fdatasync", refused, raising=False)
            with pytest.raises(FsarLedgerError):
                one.give("ReportStart", A, robot=A, action_id="t/1.1")
        with pytest.raises(WriteFailed, match="an earlier decision or write failed"):
            one.give("ReportStart", A, robot=A, action_id="t/1.1")
    with federate(tmp_path / "ledger") as one:
        one.advance()
        assert one.give("ReportStart", A, robot=A, action_id="t/1.1", key="again").rejected is None
    assert is_good(tmp_path / "ledger")


def test_a_run_whose_ledger_could_not_be_closed_is_free_for_another_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    one = federate(tmp_path / "ledger")
    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", refused)
        with pytest.raises(WriteFailed, match="every commit is safe, but the disk refused the checkpoint"):
            one.close()
    lines = [sys.executable, "-m", "fsar_ledger", "federate", str(tmp_path / "ledger"), "day"]
    other = subprocess.run(lines, input=b"", capture_output=True, check=False)
    assert (other.returncode, other.stderr) == (0, b"")


@pytest.mark.parametrize(
    "kills", [1, pytest.param(8, marks=pytest.mark.slow), pytest.param(100, marks=pytest.mark.soak)]
)
def test_no_acknowledged_command_is_lost_or_there_twice_however_often_the_process_is_killed(
    tmp_path: Path, kills: int
) -> None:
    program = (
        "import sys, fsar_ledger\n"
        "with fsar_ledger.federate(sys.argv[1], run='day') as one:\n"
        "    for number in range(10**9):\n"
        "        name = f'{sys.argv[2]}-{number}'\n"
        "        one.give('SubmitTask', 'robot/A1', key=name, robot='robot/A1', task_id=name,\n"
        "                 steps=['A navigate.indoor'], budget_us=600_000_000)\n"
        "        print(name, flush=True)\n"
    )
    moments, acknowledged = random.Random(kills), list[str]()
    for round in range(kills):
        arguments = [sys.executable, "-c", program, str(tmp_path / "ledger"), f"{round}"]
        with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            acknowledged.append(process.stdout.readline().strip())
            time.sleep(moments.uniform(0, 0.1))
            process.send_signal(signal.SIGKILL)
            acknowledged += [line.strip() for line in process.stdout if line.endswith("\n")]
    keys = [event.key for event in given(tmp_path / "ledger")]
    assert len(keys) == len(set(keys))
    assert set(acknowledged) <= set(keys)
    assert is_good(tmp_path / "ledger")


def test_a_run_that_is_not_live_is_refused(tmp_path: Path) -> None:
    fsar_ledger.record(tmp_path / "ledger", run="day").close()
    with pytest.raises(UsageError, match="found a run that is not live"):
        federate(tmp_path / "ledger")


def test_a_run_that_would_go_on_otherwise_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with federate(tmp_path / "ledger") as one:
        one.give("SubmitTask", A, **TASK)
        one.advance()
        one.give("ReportStart", A, robot=A, action_id="t/1.1")
    monkeypatch.setitem(FSAR.decides, ReportStart, lambda *_: ())  # type: ignore[misc]
    with pytest.raises(UsageError, match=r"run day cannot continue.*found ExecutionStarted"):
        federate(tmp_path / "ledger")


@pytest.mark.parametrize("robots", [0, 3, -4])
def test_a_number_of_robots_that_is_no_team_is_refused(tmp_path: Path, robots: int) -> None:
    with pytest.raises(UsageError, match=f"robots: found {robots}, expected a multiple of 4"):
        federate(tmp_path / "ledger", robots=robots)
    assert not (tmp_path / "ledger").exists()


@pytest.mark.parametrize(
    "given", [{"robots": 8}, {"settings": ["structure.fleet_budget_us=1000000"]}, {"origin": "other/name"}]
)
def test_a_run_that_goes_on_keeps_what_it_was_begun_with(tmp_path: Path, given: dict[str, Any]) -> None:
    begun: dict[str, Any] = {"robots": 4, "settings": ["membership.heartbeat_us=5000000"], "origin": "my/name"}
    fsar_ledger.federate(tmp_path / "ledger", run="morning", **begun).close()
    fsar_ledger.federate(tmp_path / "ledger", run="morning", **begun).close()
    with pytest.raises(UsageError, match=r"expected (the same or none|'other/name')"):
        fsar_ledger.federate(tmp_path / "ledger", run="morning", **given)
    fsar_ledger.federate(tmp_path / "ledger", run="morning").close()


def test_a_run_has_a_name_that_is_no_word_for_every_run(tmp_path: Path) -> None:
    out, log = tmp_path / "ledger", tmp_path / "all.jsonl"
    log.write_text("{}\n", "utf-8")
    with pytest.raises(UsageError, match="found an empty name"):
        fsar_ledger.federate(out, run="")
    with pytest.raises(UsageError, match="found all, by which queries mean every run"):
        fsar_ledger.federate(out, run="all")
    with pytest.raises(UsageError, match="found all, by which queries mean every run"):
        fsar_ledger.record(out, run="all", fleet={"a": "agv"}, observes=["ExecutionStarted"])
    with pytest.raises(UsageError, match="found all, by which queries mean every run"):
        fsar_ledger.import_records(out, [log], format="vda5050")
    assert not out.exists()


def test_a_number_that_no_event_could_hold_is_refused_and_holds_up_nobody(tmp_path: Path) -> None:
    with fsar_ledger.federate(tmp_path / "ledger", run="morning") as one:
        task: dict[str, Any] = {"robot": A, "steps": ["A navigate.indoor"]}
        with pytest.raises(UsageError, match=r"SubmitTask: field budget_us: found 9007199254740991, expected at most"):
            one.give("SubmitTask", A, task_id="t1", budget_us=2**53 - 1, **task)
        assert one.give("SubmitTask", A, task_id="t2", budget_us=2**50, **task).rejected is None


def test_a_clock_that_jumps_back_stands_still_on_record(tmp_path: Path) -> None:
    moments = iter([100, 110, 90, 80, 120])
    with fsar_ledger.federate(tmp_path / "ledger", run="day", clock=lambda: next(moments) * S) as one:
        for number in range(4):
            one.give("SubmitTask", A, **{**TASK, "task_id": f"t{number}"})
    [record] = open_ledger(tmp_path / "ledger").runs()
    assert list(record.times_us) == sorted(record.times_us)
    assert not [event for event in record.events if isinstance(event, ExecutionStarted)]
    assert is_good(tmp_path / "ledger")


def test_nothing_more_is_decided_once_a_handler_has_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def give(live: LiveRun, time_us: int, command: CommandGiven) -> Decision:
        live.kernel.happen(time_us, command)
        raise RuntimeError

    with federate(tmp_path / "ledger") as one:
        with monkeypatch.context() as patch:
            patch.setattr(LiveRun, "give", give)
            with pytest.raises(RuntimeError):
                one.give("SubmitTask", A, **TASK)
        ways: list[Callable[[], object]] = [one.advance, one.cut, partial(one.give, "SubmitTask", A, **TASK)]
        for decide in ways:
            with pytest.raises(WriteFailed, match="an earlier decision or write failed"):
                decide()
    assert given(tmp_path / "ledger") == []
    with federate(tmp_path / "ledger") as one:
        assert one.give("SubmitTask", A, **TASK).rejected is None
    assert is_good(tmp_path / "ledger")


def lines(ledger: Path, *told: Any) -> tuple[int, list[dict[str, Any]]]:
    """The exit code, and what is answered to these lines, by a process of its own."""
    data = b"".join(one if isinstance(one, bytes) else json.dumps(one).encode() + b"\n" for one in told)
    command = [sys.executable, "-m", "fsar_ledger", "federate", str(ledger), "day"]
    done = subprocess.run(command, input=data, capture_output=True, check=False)
    assert b"Traceback" not in done.stderr, done.stderr
    return done.returncode, [json.loads(line) for line in done.stdout.splitlines()]


def test_lines_of_commands_are_answered_by_lines_of_decisions(tmp_path: Path) -> None:
    submit = {"command": "SubmitTask", "by": A, "key": "k", **TASK}
    code, (first, again) = lines(tmp_path / "ledger", b"\xef\xbb\xbf", submit, b"\n", submit)  # as an editor saves it
    assert (code, first["seq"], first["rejected"]) == (0, again["seq"], None)
    assert [event["type"] for event in first["events"]] == ["TaskArrived"]
    assert first["followed"][0]["type"] == "StepBegan"
    code, (started,) = lines(tmp_path / "ledger", {"command": "ReportStart", "by": A, "robot": A, "action_id": "t/1.1"})
    assert (code, started["events"][0]["type"]) == (0, "ExecutionStarted")
    assert is_good(tmp_path / "ledger")


NO_COMMANDS: tuple[tuple[Any, str], ...] = (
    (b"nonsense\n", "JSON is malformed"),
    (b"\xff\xfe\n", "expected a JSON object"),
    (b"[" * 100_000 + b"\n", "expected a JSON object"),
    (b" " * MAX_LINE + b' {"command": "ReportContext", "by": "A", "robot": "A"}\n', "expected one command per line"),
    (b'{"command": "ReportContext", "by": "robot/B1", "by": "robot/A1"}\n', "field by: found it more than once"),
    ({"by": A}, "field command: found None, expected text"),
    ({"command": "ReportStart", "by": 7}, "field by: found 7, expected text"),
    ({"command": "ReportStart", "by": A, "key": 7}, "field key: found 7, expected text"),
    ({"command": "ReportStart", "by": A, "self": 1}, "found self, expected some of robot, action_id"),
)


def test_a_line_that_is_no_command_is_told_and_the_next_is_decided(tmp_path: Path) -> None:
    written = []
    for number, (line, _) in enumerate(NO_COMMANDS):
        written += [line, {"command": "SubmitTask", "by": A, **TASK, "task_id": f"t{number}"}]
    code, answers = lines(tmp_path / "ledger", *written)
    told, decided = answers[::2], answers[1::2]
    assert (code, len(answers)) == (1, len(written)), answers
    for number, ((_, said), wrong, right) in enumerate(zip(NO_COMMANDS, told, decided, strict=True)):
        assert (wrong["line"], right.get("line"), right["rejected"]) == (2 * number + 1, None, None), answers
        assert said in wrong["error"]
    assert len(given(tmp_path / "ledger")) == len(NO_COMMANDS)


@pytest.mark.slow
def test_what_becomes_due_by_itself_is_told_while_no_command_comes(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "fsar_ledger", "federate", str(tmp_path / "ledger"), "day"]
    steps = ["A door.open.secure B"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps({"command": "SubmitTask", "by": A, **TASK, "steps": steps}).encode() + b"\n")
        process.stdin.flush()
        said = [json.loads(process.stdout.readline()) for _ in range(2)]
        process.stdin.close()
    assert [event["type"] for event in said[0]["followed"]][-1] == "RequestIssued"
    assert "RequestUnanswered" in [event["type"] for event in said[1]["events"]]  # nobody judged it
    assert is_good(tmp_path / "ledger")


def test_a_clock_that_jumps_back_stops_run_time_and_nothing_else(tmp_path: Path) -> None:
    now = [1_772_359_200]
    with fsar_ledger.federate(tmp_path / "ledger", run="day", clock=lambda: now[0] * S) as one:
        now[0] += 100
        first = one.give("SubmitTask", A, **TASK)
        now[0] -= 90
        second = one.give("ReportStart", A, robot=A, action_id="t/1.1")
        assert second.rejected is None
        now[0] -= 1_000
    with fsar_ledger.federate(tmp_path / "ledger", run="day", clock=lambda: now[0] * S) as one:
        third = one.give("ReportResult", A, executor=A, action_id="t/1.1", result="success")
    [record] = open_ledger(tmp_path / "ledger").runs()
    times = [record.times_us[one.seq] for one in (first, second, third)]
    assert times[0] == 100 * 1_000_000
    assert times[0] < times[1] < times[2] < times[0] + 1_000
    assert is_good(tmp_path / "ledger")


def test_what_had_its_turn_before_the_clock_jumped_back_is_not_due_again_in_the_replay(tmp_path: Path) -> None:
    now = [1_772_359_200]
    with fsar_ledger.federate(tmp_path / "ledger", run="day", clock=lambda: now[0] * S) as one:
        one.give("SubmitTask", A, **{**TASK, "steps": ("A door.open.secure B",)})
        now[0] += 1
        one.give("JudgeRequest", "robot/B1", robot="robot/B1", action_id="t/1.1", accepts=False)
        one.give("LeaveFleet", A, robot=A)
        now[0] += 60
        assert one.advance() == ()  # the next attempt has been due, and its task is over
        now[0] -= 59
        assert one.cut() == "day.2"
    assert is_good(tmp_path / "ledger")
