"""Nobody is idle before the end of what was under way when the record of another system began; SQL says the same."""

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from fsar_ledger import open_ledger, record
from fsar_ledger.api.answers import Screen
from fsar_ledger.events import CONCERNS
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.view.spans import spans_of

BEGAN = datetime(2026, 3, 1, 10, tzinfo=UTC)
A = RobotJoined(robot="robot/a", role="cart", supervisor=None)  # type: ignore[arg-type]
OF: dict[str, Any] = {"task_id": "t", "action_id": "t/1", "robot": "robot/a"}
DONE: dict[str, Any] = {**OF, "result": "success"}
RESOLVED: dict[str, Any] = {**OF, "failure": 1, "level": "fleet"}
STEP: dict[str, Any] = {**OF, "failed_action": "t/1", "failure": 1, "level": "local", "to_level": "peer"}


@pytest.mark.parametrize(
    ("events", "idle"),
    [
        ([(5, "ExecutionFinished", DONE)], [False, False, True]),
        (
            [(2, "RecoveryEscalated", STEP), (3, "FailureResolved", RESOLVED), (5, "ExecutionFinished", DONE)],
            [False, False, True],
        ),
        ([(5, "RobotCameBack", {"robot": "robot/a"})], [False, False, True]),
        ([(5, "AssistanceEnded", {**OF, "robot": "robot/b", "helper": "robot/a", "failure": 1})], [False, False, True]),
        ([(2, "ExecutionStarted", {**OF, "capability": "carry"}), (5, "ExecutionWithdrawn", OF)], [True, False, True]),
        ([(2, "RobotWentOff", {"robot": "robot/a"}), (5, "RobotCameBack", {"robot": "robot/a"})], [True, None, True]),
    ],
)
def test_a_robot_is_idle_from_the_end_of_what_it_was_in_before(
    tmp_path: Path, events: list[tuple[int, str, dict[str, Any]]], idle: list[bool | None]
) -> None:
    other = (9, "SupervisorLeft", {"supervisor": "supervisor/x"})
    with record(tmp_path / "ledger", run="day", fleet=[A], observes=CONCERNS, epoch=BEGAN) as recorder:
        for at_s, name, columns in (*events, other):
            recorder.event(name, at=BEGAN + timedelta(seconds=at_s), **columns)
    ledger = open_ledger(tmp_path / "ledger")
    for at, expected in zip((1, 4, 6), idle, strict=True):
        robots = ledger.state("day", at=at).standing.robots
        assert robots is not None
        (told,) = [one for one in robots if one.robot == "robot/a"]
        (row,) = ledger.query("audit/robot_state_at", run="day", robot="robot/a", at=at)
        if expected is None:
            assert (told.is_on, row["state"]) == (False, "off")
        else:
            assert (told.is_idle is True, row["state"] == "idle") == (expected, expected), at


def test_state_says_who_has_left_the_fleet(tmp_path: Path) -> None:
    with record(tmp_path / "ledger", run="day", fleet=[A], observes=CONCERNS, epoch=BEGAN) as recorder:
        for at_s, name, columns in (
            (2, "RobotDeparted", {"reason": "silent", "fence": 1}),
            (5, "RobotReturned", {"fence": 1}),
            (6, "RobotDeparted", {"reason": "announced", "fence": 2}),
            (8, "RobotJoined", {"role": "cart"}),
        ):
            recorder.event(name, at=BEGAN + timedelta(seconds=at_s), robot="robot/a", **columns)
    ledger = open_ledger(tmp_path / "ledger")
    found = [[one.departed for one in ledger.state("day", at=at).standing.robots or ()] for at in (1, 3, 5, 7, 8)]
    assert found == [[None], ["silent"], [None], ["announced"], [None]]
    assert "DEPARTED (silent)" in "\n".join(ledger.state("day", at=3).text(Screen()))


def test_a_robot_that_does_another_action_meanwhile_helps_on_beside_and_after_it(tmp_path: Path) -> None:
    helps: dict[str, Any] = {**OF, "robot": "robot/b", "helper": "robot/a", "failure": 1}
    own: dict[str, Any] = {"task_id": "u", "action_id": "u/1", "robot": "robot/a"}
    queued: dict[str, Any] = {
        "on_behalf_of": "robot/a",
        "capability": "carry",
        "step": 0,
        "attempt": 0,
        "is_delegated": False,
        "has_approach": False,
        "is_supervised": False,
        "override": "hard-preempt",
    }
    with record(tmp_path / "ledger", run="day", fleet=[A], observes=CONCERNS, epoch=BEGAN) as recorder:
        for at_s, name, columns in (
            (1, "AssistanceAdmitted", {**helps, "level": "peer"}),
            (2, "ExecutionStarted", {**own, "capability": "carry"}),
            (3, "ExecutionQueued", {**own, "action_id": "u/2", **queued}),
            (4, "ExecutionWithdrawn", {**own, "action_id": "u/2"}),
            (5, "ExecutionFinished", {**own, "result": "success"}),
            (7, "ExecutionStarted", {**own, "capability": "carry"}),
            (8, "AssistanceEnded", helps),
            (9, "ExecutionFinished", {**own, "result": "success"}),
            (10, "SupervisorLeft", {"supervisor": "supervisor/x"}),
        ):
            recorder.event(name, at=BEGAN + timedelta(seconds=at_s), **columns)
    ledger = open_ledger(tmp_path / "ledger")
    helping, serving = ("helping", "t/1"), ("running", "u/1")
    for at, expected, waits in (
        (1, (helping,), ()),
        (2, (serving, helping), ()),  # nobody says that the help was interrupted
        (3, (serving, helping), ("u/2",)),
        (6, (helping,), ()),
        (7, (serving, helping), ()),
        (8, (serving,), ()),
        (9, (), ()),
    ):
        robots = ledger.state("day", at=at).standing.robots
        assert robots is not None
        (told,) = [one for one in robots if one.robot == "robot/a"]
        assert (tuple((one.stage, one.action_id) for one in told.work), told.queue) == (expected, waits), at
        assert told.is_idle is (expected == ())


def test_a_robot_does_all_that_it_has_begun_until_something_ends_it(tmp_path: Path) -> None:
    follow = {**OF, "action_id": "t/1/follow"}  # as a robot follows a path while it navigates
    with record(tmp_path / "ledger", run="day", fleet=[A], observes=CONCERNS, epoch=BEGAN) as recorder:
        for at_s, name, columns in (
            (1, "ExecutionStarted", {**OF, "capability": "navigate"}),
            (2, "ExecutionStarted", {**follow, "capability": "follow"}),
            (3, "ExecutionFinished", {**follow, "result": "success"}),
        ):
            recorder.event(name, at=BEGAN + timedelta(seconds=at_s), **columns)
    ledger = open_ledger(tmp_path / "ledger")
    for at, expected in ((1, ["t/1"]), (2, ["t/1/follow", "t/1"]), (3, ["t/1"])):
        (told,) = ledger.state("day", at=at).standing.robots or ()
        assert ([one.action_id for one in told.work], told.queue) == (expected, ())
    rows = ledger.query("audit/robot_activity", run="day", at=2).rows()
    assert {row["action_id"] for row in rows} == {"t/1", "t/1/follow"}


def test_a_robot_goes_on_with_what_another_one_has_ended_for_itself(tmp_path: Path) -> None:
    begun, b = {**OF, "capability": "carry"}, {"robot": "robot/b"}
    fleet = [A, RobotJoined(robot="robot/b", role="cart", supervisor=None)]  # type: ignore[arg-type]
    with record(tmp_path / "ledger", run="day", fleet=fleet, observes=CONCERNS, epoch=BEGAN) as recorder:
        for at_s, name, columns in (
            (1, "ExecutionStarted", begun),
            (2, "ExecutionStarted", begun | b),
            (3, "ExecutionFinished", DONE),
            (4, "ExecutionFinished", DONE | b),
        ):
            recorder.event(name, at=BEGAN + timedelta(seconds=at_s), **columns)
    ledger = open_ledger(tmp_path / "ledger")
    for at, expected in ((3, ["robot/b"]), (4, [])):
        robots = ledger.state("day", at=at).standing.robots or ()
        assert [f"{one.robot}" for one in robots if one.work] == expected
        told = ledger.query("audit/robot_activity", run="day", at=at).rows()
        assert [row["robot"] for row in told if row["action_id"]] == expected


@pytest.mark.parametrize(("ends", "doing"), [((), []), (("ExecutionFinished", "ExecutionWithdrawn"), ["t/1"])])
def test_what_a_robot_does_is_told_where_its_source_records_how_that_ends(
    tmp_path: Path, ends: tuple[str, ...], doing: list[str]
) -> None:
    observes = ("fleet", "ExecutionStarted", *ends)
    with record(tmp_path / "ledger", run="day", fleet=[A], observes=observes, epoch=BEGAN) as recorder:
        recorder.event("ExecutionStarted", at=BEGAN, capability="carry", **OF)
    ledger = open_ledger(tmp_path / "ledger")
    robots = ledger.state("day").standing.robots or ()
    assert [work.action_id for one in robots for work in one.work] == doing
    assert [row["action_id"] for row in ledger.query("audit/robot_activity", run="day") if row["action_id"]] == doing


@pytest.mark.parametrize(
    ("event", "closes", "is_open"),
    [
        ("TaskCompleted", (), False),
        ("TaskCompleted", ("RequestClosed",), True),
        ("TaskAbandoned", (), False),
        ("TaskAbandoned", ("RequestClosed",), False),
        ("ExecutionFinished", (), False),
        ("ExecutionFinished", ("RequestClosed",), True),
    ],
)
def test_a_request_that_nobody_closes_is_over_with_its_task_or_its_result(
    tmp_path: Path, event: str, closes: tuple[str, ...], is_open: bool
) -> None:
    ends = {**OF, "result": "success"} if event == "ExecutionFinished" else {"task_id": "t"}
    asked = {"task_id": "t", "action_id": "t/1", "requested_by": "coordinator", "executed_by": "robot/a"}
    told: list[tuple[int, str, dict[str, Any]]] = [
        (1, "RequestIssued", {**asked, "decided_by": "coordinator", "capability": "order"}),
        (2, "RequestAccepted", {**asked, "decided_by": "robot/a"}),
        *([(3, "ExecutionStarted", {**OF, "capability": "order"})] if event == "ExecutionFinished" else []),
        (5, event, ends),
    ]
    observes = [*closes, *(name for _, name, _ in told)]
    with record(tmp_path / "ledger", run="day", fleet=[A], observes=observes, epoch=BEGAN) as recorder:
        for at_s, name, columns in told:
            recorder.event(name, at=BEGAN + timedelta(seconds=at_s), **columns)
    ledger = open_ledger(tmp_path / "ledger")
    assert [len(ledger.state("day", at=at).standing.requests or ()) for at in (4, 5)] == [1, int(is_open)]
    spans = [one for one in spans_of(ledger.record("day")) if one.fact.kind == "accepted"]
    assert [(one.start_us, one.end_us) for one in spans] == [(2_000_000, None if is_open else 5_000_000)]


_ROBOT, _ACTION = {"robot": "robot/a"}, {"task_id": "t", "action_id": "t/1"}
_CLAIM, _CALL = {"dimension": "audit", "claimant": "robot/a", "reason": "x"}, {"purpose": "review"}


@pytest.mark.parametrize(
    ("begins", "ends", "part", "columns"),
    [
        ("SupervisorLeft", "SupervisorReturned", "off_shift", {"supervisor": "supervisor/a"}),
        ("SupervisorCalled", "SupervisorResponded", "calls", {**_ACTION, **_CALL, "supervisor": "supervisor/a"}),
        ("AuthorityClaimed", "AuthorityReleased", "claims", {**_ACTION, **_CLAIM}),
        ("ExecutionFailed", "FailureResolved", "recoveries", {**_ACTION, **_ROBOT, "failure": 1, "cause": "worn"}),
        ("TaskArrived", "TaskCompleted", "tasks", {**_ROBOT, "task_id": "t"}),
        (
            "PolicyWindowOpened",
            "PolicyWindowClosed",
            "windows",
            {**_ROBOT, "scope": "local", "window": "w", "outcome": "deny"},
        ),
        ("RobotDeparted", "RobotReturned", "departed", {**_ROBOT, "reason": "silent", "fence": 1}),
    ],
)
def test_what_began_is_not_said_to_go_on_where_its_source_does_not_record_its_end(
    tmp_path: Path, begins: str, ends: str, part: str, columns: dict[str, Any]
) -> None:
    for observes, is_told in (([begins], False), ([begins, ends], True)):
        place = tmp_path / f"{part} {is_told}"
        with record(place, run="day", fleet=[A], observes=["RobotJoined", *observes], epoch=BEGAN) as recorder:
            recorder.event(begins, at=BEGAN + timedelta(seconds=1), **columns)
        now = open_ledger(place).state("day").standing
        robot = next(iter(now.robots or ()))
        assert bool(getattr(robot if part in ("windows", "departed") else now, part)) == is_told
