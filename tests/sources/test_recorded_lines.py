"""Lines from standard input: each is on disk before the next is read, and a wrong one is refused by its number."""

import json
import os
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

import fsar_ledger
from fsar_ledger.api.answers import Screen
from fsar_ledger.base.errors import UsageError
from fsar_ledger.events import CONCERNS
from fsar_ledger.events.envelope import Robot
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.events.world import TaskArrived
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.metrics.database import connect
from fsar_ledger.metrics.invariants import verdict_kinds
from tests.cli.conftest import Call, Called, one_message
from tests.sources.importing import rows
from tests.sources.test_recorder import COMMAND, tasks

STARTED = {"task_id": "t", "action_id": "t/1", "robot": "robot/a", "capability": "carry"}


def told(ledger: Path, lines: bytes, *options: object) -> Called:
    command = [*COMMAND, "record", ledger, "--run", "night", *options]
    done = subprocess.run([*map(str, command)], input=lines, capture_output=True, check=False)
    return Called(done.returncode, done.stdout.decode(), done.stderr.decode())


LINE = b'{"type": "TaskArrived", "task_id": "%s", "time": "2090-01-01T00:00:0%d"}\n'


def test_lines_that_are_wrong_are_refused_by_number_and_the_others_are_recorded(tmp_path: Path) -> None:
    wrong = [
        b"\xff\n",
        b"[]\n",
        b"{" * 9 + b"\n",
        b'{"type": "TaskArived"}\n',
        b'{"type": "TaskArrived", "task_id": "x", "sped": 1}\n',
        b'{"type": "TaskArrived", "task_id": "x", "time": "0001-01-01T00:00:00+14:00"}\n',
        b'{"type": "TaskArrived", "task_id": "x", "time": "9999-12-31T23:59:59-14:00"}\n',
        b'{"type": "TaskArrived", "task_id": "x", "caused_by": 99}\n',
        b'{"type": "TaskArrived", "task_id": "x\\u001b"}\n',
        b'{"type": "RunStarted"}\n',
        b'{"type": {}}\n',
    ]
    lines = b"\xef\xbb\xbf" + LINE % (b"a", 1) + b"\r\n" + b"".join(wrong) + (LINE % (b"b", 2)).replace(b"\n", b"\r\n")
    said = told(tmp_path / "ledger", lines, "--observes", "TaskArrived", "--json")
    assert (said.code, "Traceback" in said.err) == (1, False), said.err
    answer = json.loads(said.out)
    assert list(map(int, answer["refused"])) == list(range(3, 3 + len(wrong))), answer
    assert tasks(tmp_path / "ledger") == ["a", "b"]


def test_what_is_recorded_may_be_listed_with_commas(tmp_path: Path) -> None:
    """As in `log --about requests,policy`."""
    lines = LINE % (b"a", 1) + b'{"type": "TaskCompleted", "task_id": "a"}\n'
    told(tmp_path / "ledger", lines, "--observes", "TaskArrived, TaskCompleted").good()
    assert tasks(tmp_path / "ledger") == ["a"]


def test_each_line_is_on_disk_before_the_next_is_read_and_ctrl_c_is_quiet(tmp_path: Path) -> None:
    command = [*COMMAND, "record", str(tmp_path / "ledger"), "--run", "night", "--observes", "TaskArrived"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdin is not None
        for number, name in enumerate((b"a", b"b"), 1):
            process.stdin.write(LINE % (name, number))
            process.stdin.flush()
            deadline = time.monotonic() + 30
            while not (is_begun(tmp_path / "ledger") and len(tasks(tmp_path / "ledger")) == number):
                assert time.monotonic() < deadline
                time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=30)
    assert (process.returncode, b"Traceback" in said) == (130, False), said
    told(tmp_path / "ledger", LINE % (b"c", 3), "--observes", "TaskArrived").good()
    assert tasks(tmp_path / "ledger") == ["a", "b", "c"]


def test_a_refused_line_is_said_when_it_is_refused_and_an_interruption_says_how_many_were(tmp_path: Path) -> None:
    command = [*COMMAND, "record", str(tmp_path / "ledger"), "--run", "night", "--observes", "TaskArrived"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stderr is not None
        process.stdin.write(LINE % (b"a", 1) + b"no\n")
        process.stdin.flush()
        assert process.stderr.readline().startswith(b"fsar-ledger: line 2: Input data was truncated")
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=30)
    assert process.returncode == 130
    assert b"1 line was refused and not recorded" in said
    assert b"every accepted event is on disk" in said


def test_a_flood_of_refused_lines_is_said_in_few_lines_and_none_is_left_out_of_the_count(tmp_path: Path) -> None:
    said = told(tmp_path / "ledger", b"no\n" * 100, "--observes", "TaskArrived")
    assert said.code == 1
    assert said.out.splitlines()[-1] == "and 95 more"
    lines = said.err.splitlines()
    assert [line.partition(":")[2][:8] for line in lines[:20]] == [f" line {one}:"[:8] for one in range(1, 21)]
    assert [line.partition(", ")[0] for line in lines[20:]] == [
        f"fsar-ledger: {one} lines refused so far" for one in (40, 80)
    ]


def is_begun(ledger: Path) -> bool:
    return (ledger / "ledger.json").exists() and open_ledger(ledger).has_run("night")


@pytest.mark.parametrize(
    ("robot", "said"),
    [
        ("robot/", "field robot: found 'robot/' in TaskArrived, expected a name"),
        ("/A1", "field robot: found '/A1' in TaskArrived, expected a name"),
        ("robot/ ", "field robot: found 'robot/ ' in TaskArrived, expected a name"),
        ("A1", "field robot: found A1 in TaskArrived, expected a kind and a name, such as robot/A1"),
    ],
)
def test_nobody_acts_without_a_kind_and_a_name_in_whatever_way_it_is_said(
    tmp_path: Path, robot: str, said: str
) -> None:
    with fsar_ledger.record(tmp_path / "ledger", observes="TaskArrived", run="night") as one:
        with pytest.raises(UsageError, match=said):
            one.event("TaskArrived", task_id="t", robot=robot)
        with pytest.raises(UsageError, match=said):
            one.event(TaskArrived(task_id="t", robot=Robot(robot)))
    assert tasks(tmp_path / "ledger") == []


@pytest.mark.parametrize(
    ("fleet", "said"),
    [
        ({"": "agv"}, "field robot: found 'robot/' in RobotJoined, expected a name"),
        ({"A1": "agv", "robot/A1": "arm"}, "fleet: found robot/A1 twice, expected each robot once"),
        ([RobotJoined(robot=Robot("A1"), role="agv", supervisor=None)], "expected a kind and a name"),
        (["A1"], r"fleet: found \['A1'\], expected a mapping of names or a list of RobotJoined"),
    ],
)
def test_a_fleet_names_each_of_its_robots_once(tmp_path: Path, fleet: Any, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        fsar_ledger.record(tmp_path / "ledger", fleet=fleet)


def test_the_fleet_of_a_file_may_have_dotted_names(tmp_path: Path) -> None:
    (tmp_path / "fleet.toml").write_text('[robots]\nKIT.0001 = "agv"\n"KIT.0002" = "agv"\n')
    told(tmp_path / "ledger", b"", "--fleet", tmp_path / "fleet.toml").good()
    joined = [row["robot"] for row in rows(tmp_path / "ledger") if row["type"] == "RobotJoined.v1"]
    assert joined == ["robot/KIT.0001", "robot/KIT.0002"]


@pytest.mark.slow
def test_an_action_whose_beginning_is_not_on_record_is_marked(tmp_path: Path, call: Call) -> None:
    action = {"task_id": "t", "action_id": "t/1", "robot": "robot/door", "time": "2090-01-01T00:00:01"}
    lines = json.dumps({"type": "ExecutionResumed", **action}).encode()
    told(tmp_path / "ledger", lines, "--observes", "execution").good()
    late = "running t/1; its beginning is not on record"
    assert late in call("state", tmp_path / "ledger", "--run", "night").good().out
    lines = json.dumps({"type": "ExecutionStarted", **action, "capability": "open", "robot": "robot/lift"}).encode()
    told(tmp_path / "ledger", lines.replace(b"t/1", b"t/2"), "--observes", "execution").good()
    assert "running t/2 open\n" in call("state", tmp_path / "ledger", "--run", "night").good().out


ENDED = ["ExecutionStarted", "ExecutionFinished", "ExecutionWithdrawn"]


def test_the_state_invents_neither_for_whom_a_robot_works_nor_that_nobody_supervises_it(tmp_path: Path) -> None:
    with fsar_ledger.record(tmp_path / "ledger", run="r", observes=ENDED) as one:
        for name in ("a", "b"):
            about: dict[str, Any] = {"task_id": "t", "action_id": "t/1", "robot": f"robot/{name}"}
            one.event("ExecutionStarted", capability="carry", **about)
            one.event("ExecutionWithdrawn", **about) if name == "a" else None
    found = "\n".join(fsar_ledger.open_ledger(tmp_path / "ledger").state(run=1).text(Screen()))
    assert "robot/b  role ?, team ?; supervisor ?" in found
    assert "running t/1 carry" in found
    assert "for robot/a" not in found


def test_the_state_invents_no_recovery_and_nothing_of_a_fleet_of_roles_alone(tmp_path: Path) -> None:
    observes = ["ExecutionStarted", "ExecutionFailed", "FailureResolved"]
    with fsar_ledger.record(tmp_path / "ledger", run="r", fleet={"a": "agv"}, observes=observes) as one:
        one.event("ExecutionFailed", task_id="t", action_id="t/1", robot="robot/a", failure=1, cause="jam")
    found = "\n".join(fsar_ledger.open_ledger(tmp_path / "ledger").state(run=1).text(Screen()))
    assert "robot/a  role agv, team ?; supervisor ?" in found
    assert "t/1 at robot/a: jam, how is not observed" in found


def test_who_recovers_from_a_failure_before_the_record_is_not_idle(tmp_path: Path) -> None:
    fleet = [RobotJoined(robot=Robot(f"robot/{name}"), role="agv", supervisor=None) for name in ("a", "b")]
    with fsar_ledger.record(tmp_path / "ledger", run="r", fleet=fleet, observes=CONCERNS) as one:
        about: dict[str, Any] = {"task_id": "t", "action_id": "t/1", "failed_action": "t/1", "robot": "robot/a"}
        one.event("RecoveryAttempted", **about, failure=1, number=1, level="local", deadline_us=9, decided_by="robot/a")
    found = fsar_ledger.open_ledger(tmp_path / "ledger").state(run=1).standing
    assert [(robot.robot, robot.is_idle) for robot in found.robots or ()] == [("robot/a", None), ("robot/b", True)]


@pytest.mark.parametrize(
    ("observes", "kind", "columns"),
    [
        (["TaskArrived", "TaskArrived.budget_us"], "late", {"task_id": "t", "budget_us": 1}),
        (["ExecutionStarted"], "unattributed", STARTED),
        (["ExecutionStarted"], "i1", STARTED),
    ],
)
def test_no_verdict_is_listed_where_the_metric_or_invariant_cannot_judge(
    tmp_path: Path, observes: list[str], kind: str, columns: dict[str, Any]
) -> None:
    with fsar_ledger.record(tmp_path / "ledger", run="r", observes=observes) as one:
        one.event(observes[0], **columns)
    with connect(tmp_path / "ledger") as database:
        judge = verdict_kinds()[kind]
        assert database.rows("SELECT 1 AS is_hidden FROM unobservable WHERE judge = $judge", {"judge": judge})
    assert fsar_ledger.open_ledger(tmp_path / "ledger").verdicts("r", kind).rows() == []


ASKED = {"task_id": "t", "action_id": "t/1", "capability": "open", "decided_by": "robot/a"}
BETWEEN = {"requested_by": "robot/a", "executed_by": "robot/b"}


def requests_of(ledger: Path, *events: tuple[str, dict[str, Any]]) -> list[tuple[str, str | None, str]]:
    """The open requests after these events: action, who is asked, how far it is."""
    with fsar_ledger.record(ledger, run="r", observes=["request", "task", "execution"]) as one:
        for kind, columns in events:
            one.event(kind, **columns)
    found = fsar_ledger.open_ledger(ledger).state(run=1).standing.requests
    return [(each.action_id, each.target, each.phase) for each in found or ()]


def test_a_request_that_was_recorded_is_asked_of_whom_the_record_says(tmp_path: Path) -> None:
    issued = ("RequestIssued", {**ASKED, **BETWEEN})
    assert requests_of(tmp_path / "asked", issued) == [("t/1", "robot/b", "asked")]
    accepted = ("RequestAccepted", {"task_id": "t", "action_id": "t/1", "decided_by": "robot/b", **BETWEEN})
    assert requests_of(tmp_path / "accepted", issued, accepted) == [("t/1", "robot/b", "accepted")]


def test_a_recorded_request_is_not_open_after_its_task_was_abandoned_but_while_it_is_executed(tmp_path: Path) -> None:
    issued, abandoned = ("RequestIssued", {**ASKED, **BETWEEN}), ("TaskAbandoned", {"task_id": "t"})
    other = ("TaskAbandoned", {"task_id": "u"})
    started = ("ExecutionStarted", {**STARTED, "robot": "robot/b", **BETWEEN})
    assert requests_of(tmp_path / "abandoned", issued, abandoned) == []
    assert requests_of(tmp_path / "other", issued, other) == [("t/1", "robot/b", "asked")]
    assert [one[0] for one in requests_of(tmp_path / "executed", issued, started, abandoned)] == ["t/1"]


def test_a_recorder_that_records_less_than_its_run_says_is_refused(tmp_path: Path) -> None:
    """What it would leave out would count as what did not happen."""
    declared, fleet = ["TaskArrived", "TaskCompleted"], {"a": "agv"}
    with fsar_ledger.record(tmp_path / "ledger", run="night", observes=declared, fleet=fleet):
        pass
    for less in (["TaskArrived"], ["RobotJoined"]):
        with pytest.raises(UsageError, match=f"RobotJoined, .*TaskCompleted.*, expected {less[0]}; declare the same"):
            fsar_ledger.record(tmp_path / "ledger", run="night", observes=less, fleet=fleet)
    for same in (declared, [*declared, "RobotJoined"], []):
        with fsar_ledger.record(tmp_path / "ledger", run="night", observes=same, fleet=fleet) as one:
            one.event("TaskArrived", task_id="a")
    assert tasks(tmp_path / "ledger") == ["a", "a", "a"]


def test_a_name_that_no_ledger_can_have_is_refused_before_there_is_one(tmp_path: Path, call: Call) -> None:
    log, said = tmp_path / "log.jsonl", "--origin 'a b': expected a printable name without spaces and plus signs"
    log.write_text('{"type": "dispatch_task_request", "request": {}}\n')
    out = tmp_path / "out"
    for words in (("record", out), ("import", out, log, "--as", "rmf"), ("federate", out, "run")):
        one_message(call(*words, "--origin", "a b"), 2, said)
    with pytest.raises(UsageError, match=r"^origin='a b': expected a printable name"):
        fsar_ledger.record(out, origin="a b")
    assert not out.exists()


def test_a_call_within_a_call_is_refused_and_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As where the handler of a signal records while the program does: both would have the same number."""
    synced, within = os.fdatasync, list[str]()

    def interrupted(handle: int) -> None:
        for call in (lambda: recorder.event("TaskArrived", task_id="b"), recorder.close):
            with pytest.raises(UsageError, match="found a call within a call, as by the handler of a signal") as raised:
                call()
            within.append(f"{raised.value}")
        synced(handle)

    with fsar_ledger.record(tmp_path / "ledger", run="night", observes=["TaskArrived"]) as recorder:
        with monkeypatch.context() as patched:
            patched.setattr(os, "fdatasync", interrupted)
            assert recorder.event("TaskArrived", task_id="a") == 2
        assert recorder.event("TaskArrived", task_id="c") == 3
    assert len(within) >= 2
    assert tasks(tmp_path / "ledger") == ["a", "c"]
