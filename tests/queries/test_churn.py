"""What came of robots that left: counted from events that each test writes down."""

from typing import Any

import pytest

from fsar_ledger.events import CONCERNS
from tests.queries.histories import Row, S, act, answer, event, run

B, T = "robot/B1", "t1"
ARRIVED = event("TaskArrived", 1 * S, task_id=T, robot="robot/A1", team=1, steps=["A x.y", "B door.open"])
DEPARTED = event("RobotDeparted", 5 * S, robot=B, reason="silent", fence=1)
JOINED = event("RobotJoined", 8 * S, robot=B, role="B")
RETURNED = event("RobotReturned", 8 * S, robot=B, fence=1)
FAILED = act("RequestClosed", 5 * S, "t1/2.1", request_id="t1/2.1", result="failure", cause="departed")
COMPLETED, ABANDONED = (event(name, 9 * S, task_id=T) for name in ("TaskCompleted", "TaskAbandoned"))
COUNTS = ("away", "announced", "found_out", "suspected", "cleared", "returned", "requests_failed")


def fate(*events: Row) -> list[Any]:
    return answer("facts/tasks_of_departed", run(ARRIVED, *events), columns=("task_id", "outcome"))


def test_departures_suspicions_and_returns_are_counted_by_run() -> None:
    events = (
        event("RobotWentOff", 1 * S, robot=B),
        event("RobotSuspected", 2 * S, robot="robot/C1"),
        event("RobotCleared", 3 * S, robot="robot/C1"),
        event("RobotSuspected", 4 * S, robot=B),
        DEPARTED,
        FAILED,
        event("RobotDeparted", 6 * S, robot="robot/D1", reason="announced", fence=1),
        RETURNED,
    )
    quiet = run(event("TaskArrived", 1 * S, task_id=T), run_id="r2")
    assert answer("audit/churn", run(*events), quiet, columns=COUNTS) == [(1, 1, 1, 2, 1, 1, 1)]
    anew = (JOINED, *events[:-1], event("RobotJoined", 8 * S, robot="robot/E1"), JOINED)
    assert answer("audit/churn", run(*anew), columns=COUNTS) == [(1, 1, 1, 2, 1, 1, 1)]


@pytest.mark.parametrize(
    "cut_off",
    [
        FAILED,
        act("ExecutionFailed", 5 * S, "t1/2.1", robot=B, failure=1, cause="departed"),
        act(
            "RecoveryEscalated", 5 * S, "t1/2.1", robot=B, failure=1, level="local", to_level="peer", reason="departed"
        ),
        act("AssistanceFailed", 5 * S, "t1/2.1", robot="robot/A1", helper=B, failure=1, cause="departed"),
    ],
    ids=lambda row: str(row["type"]),
)
def test_a_task_that_a_departure_cut_off_is_recovered_given_up_or_open(cut_off: Row) -> None:
    assert fate(DEPARTED, cut_off, COMPLETED) == [(T, "completed")]
    assert fate(DEPARTED, cut_off, RETURNED, ABANDONED) == [(T, "abandoned")]
    assert fate(DEPARTED, cut_off) == [(T, None)]


def test_a_task_is_given_up_for_a_departure_only_while_a_robot_of_its_steps_is_gone() -> None:
    assert fate(DEPARTED, ABANDONED) == [(T, "abandoned")]
    assert fate(DEPARTED, RETURNED, ABANDONED) == []
    assert fate(DEPARTED, JOINED, ABANDONED) == []
    assert fate(JOINED, DEPARTED, ABANDONED) == [(T, "abandoned")]
    assert fate(ABANDONED, DEPARTED) == []
    assert fate({**DEPARTED, "robot": "robot/D1"}, ABANDONED) == []
    assert fate({**DEPARTED, "robot": "robot/B2"}, ABANDONED) == []
    assert fate(DEPARTED, COMPLETED) == []


def test_a_task_without_steps_on_record_is_of_the_robot_that_received_it_and_of_those_that_executed_for_it() -> None:
    received = event("TaskArrived", 1 * S, task_id=T, robot=B)
    for arrived in (received, {**received, "steps": []}):
        columns = ("task_id", "outcome")
        assert answer("facts/tasks_of_departed", run(arrived, DEPARTED, ABANDONED), columns=columns) == [
            (T, "abandoned")
        ]
        assert answer("facts/tasks_of_departed", run(arrived, DEPARTED, RETURNED, ABANDONED)) == []
        assert answer("audit/churn", run(arrived, DEPARTED, ABANDONED), columns=("tasks_abandoned",)) == [(1,)]
    of_another = {**received, "robot": "robot/A1"}
    begun = act("ExecutionStarted", 2 * S, "t1/1", robot=B, on_behalf_of="robot/A1")
    assert len(answer("facts/tasks_of_departed", run(of_another, begun, DEPARTED, ABANDONED))) == 1
    assert answer("facts/tasks_of_departed", run(of_another, DEPARTED, ABANDONED)) == []
    assert fate(begun, {**DEPARTED, "robot": "robot/A2"}, ABANDONED) == []


def test_a_task_that_is_told_of_twice_is_one() -> None:
    assert fate(ARRIVED, DEPARTED, FAILED, FAILED, COMPLETED, COMPLETED) == [(T, "completed")]
    assert fate(ARRIVED, DEPARTED, FAILED, ABANDONED, COMPLETED) == [(T, "completed")]


def test_other_failures_are_none_of_a_departure() -> None:
    other = act("ExecutionFailed", 5 * S, "t1/2.1", robot=B, failure=1, cause="obstruction")
    closed = act("RequestClosed", 5 * S, "t1/2.1", request_id="t1/2.1", result="failure", cause="obstruction")
    assert fate(other, closed, COMPLETED) == []
    assert answer("audit/churn", run(ARRIVED, other, closed), columns=COUNTS) == []


def test_an_act_of_a_departed_robot_is_counted() -> None:
    acts = act("ExecutionStarted", 6 * S, "t1/2.1", robot=B, executed_by=B)
    assert answer("audit/churn", run(ARRIVED, DEPARTED, acts), columns=("found_out", "acts")) == [(1, 1)]
    assert answer("audit/churn", run(ARRIVED, DEPARTED, RETURNED, acts), columns=("acts",)) == [(0,)]
    partly = run(ARRIVED, DEPARTED, RETURNED, kind="foreign", observes=["fleet", "execution"])
    assert answer("audit/churn", partly, columns=("returned", "acts")) == [(1, None)]


def test_what_came_of_departures_is_unknown_where_they_or_returns_are_not_recorded() -> None:
    observes = [concern for concern in CONCERNS if concern != "fleet"]
    columns = ("away", "tasks_abandoned", "acts")

    def counts(*records: str) -> list[tuple[Any, ...]]:
        off = event("RobotWentOff", 1 * S, robot=B)
        rows = run(ARRIVED, off, ABANDONED, kind="foreign", observes=observes, records=list(records))
        return answer("audit/churn", rows, columns=columns)

    assert counts() == counts("RobotDeparted") == counts("RobotReturned") == [(1, None, None)]
    assert counts("RobotDeparted", "RobotReturned") == [(1, 0, 0)]


def test_no_request_failed_for_a_departure_only_where_the_causes_of_closings_are_recorded() -> None:
    records = ["RobotDeparted", "RequestClosed"]
    for lists, failed in ((records, None), ([*records, "RequestClosed.cause"], 0)):
        rows = run(ARRIVED, DEPARTED, {**FAILED, "cause": None}, kind="foreign", observes=[], records=lists)
        assert answer("audit/churn", rows, columns=("found_out", "requests_failed")) == [(1, failed)]
