"""Several requests for one robot, one of them time-critical: H_F's order is kept among all that wait.

Paper: sec:prototype:workflows (Workflow 3).
"""

from itertools import permutations

import pytest

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot, Subject
from fsar_ledger.events.execution import ExecutionStarted
from fsar_ledger.events.request import RequestAdmitted, RequestDenied
from fsar_ledger.events.supervision import SupervisorCalled, SupervisorResponded
from fsar_ledger.events.task import TaskCompleted
from fsar_ledger.projections.fold import State, apply, fold
from fsar_ledger.runtime.architectures.fsar import FSAR
from fsar_ledger.runtime.architectures.fsar.request import EvaluateRequest
from fsar_ledger.runtime.handlers.commands import CloseRequest, Respond, StartAction, TakeTurn
from fsar_ledger.runtime.handlers.request import ReportResult, RequestCapability
from tests import past
from tests.runtime.histories import DOOR, B, given, happen, types, window
from tests.runtime.live import decided, of, played

TRUSTED = tuple(past.trusted(B, Robot(f"robot/{name}1"), "session") for name in "ACD")
ARRIVED = tuple(
    past.arrived(
        f"{name}-1",
        Robot(f"robot/{name}1"),
        (f"{name} {DOOR} B",),
        budget_us=600_000_000,
        due_us=900_000_000,
        is_time_critical=name == "D",
    )
    for name in "ACD"
)
NAMES = [f"{name}-1/1.1" for name in "ACD"]
URGENT = "D-1/1.1"


def competing() -> State:
    """A, C and D have all asked B for its door; D's task is time-critical, and no request has been evaluated."""
    began = [past.began(Subject(f"{name}-1", f"{name}-1/1.1"), Robot(f"robot/{name}1"), 1, DOOR, "B") for name in "ACD"]
    shown = [
        past.queried(Subject(f"{name}-1", f"{name}-1/1.1"), past.parties(Robot(f"robot/{name}1"), B), DOOR, B)
        for name in "ACD"
    ]
    return given("fsar", *TRUSTED, *ARRIVED, *began, *shown)


def evaluated(state: State, *actions: str) -> list[str]:
    """The types of what B decides about these requests, one after the other, all of it taken in."""
    found: list[str] = []
    for action_id in actions:
        events = decided(state, EvaluateRequest(action_id))
        happen(state, *events)
        found += types(events)
    return found


def again(state: State, *events: Event) -> list[str]:
    """The requests that are judged again after these events, which the state has taken in."""
    scheduled = []
    happen(state, *events)
    for event in events:
        scheduled += [one for react in FSAR.reacts.get(type(event), ()) for one in react(state, event, 0)]
    return [
        one.command.action_id
        for one in sorted(scheduled, key=lambda one: one.after_us)
        if isinstance(one.command, EvaluateRequest)
    ]


def answered(state: State, action_id: str) -> list[str]:
    [number] = [number for number, call in state.supervision.calls.items() if call.subject.action_id == action_id]
    return again(state, *decided(state, Respond(number)))


def test_whoever_is_to_wait_for_the_urgent_one_waits_until_it_is_admitted_whichever_call_is_answered_first() -> None:
    state = competing()
    assert evaluated(state, *NAMES) == ["SupervisorCalled", "SupervisorCalled", "RequestDeferred"]
    assert answered(state, "C-1/1.1") == [URGENT, "C-1/1.1"]
    assert evaluated(state, URGENT, "C-1/1.1") == ["RequestDeferred", "RequestDeferred"], "A's call is open still"
    assert answered(state, "A-1/1.1") == [URGENT, "A-1/1.1"]
    admitted = decided(state, EvaluateRequest(URGENT))
    assert types(admitted) == ["RequestAdmitted", "ExecutionQueued"]
    assert sorted(again(state, *admitted)) == ["A-1/1.1", "C-1/1.1"]
    assert evaluated(state, "A-1/1.1", "C-1/1.1") == ["RequestAdmitted", "RequestDeferred", "ExecutionQueued"] * 2


def test_a_denial_of_the_one_that_goes_first_lets_the_others_go_on() -> None:
    state = competing()
    evaluated(state, *NAMES)
    answered(state, "A-1/1.1")
    answered(state, "C-1/1.1")
    apply(state, past.trusted(B, Robot("robot/D1"), "none"))
    denied = decided(state, EvaluateRequest(URGENT))
    assert isinstance(denied[0], RequestDenied)
    assert sorted(again(state, *denied)) == ["A-1/1.1", "C-1/1.1"]
    assert evaluated(state, "A-1/1.1")[0] == "RequestAdmitted"


@pytest.mark.parametrize("order", [*permutations("ACD")])
def test_in_a_run_with_three_rivals_the_urgent_one_is_executed_before_all_that_competed_with_it(
    order: tuple[str, ...],
) -> None:
    arrived = {task.robot: task for task in ARRIVED}
    tasks = [(number * 100_000, arrived[Robot(f"robot/{name}1")]) for number, name in enumerate(order, start=1)]
    run = played([], *TRUSTED, facts=tasks)
    rivals = {event.subject.action_id for _, event in of(run, SupervisorCalled) if event.purpose == "ordering"}
    preferred = {event.preferred for _, event in of(run, SupervisorResponded)}
    admitted = [event.subject.action_id for _, event in of(run, RequestAdmitted)]
    assert preferred == {URGENT}
    assert all(admitted.index(URGENT) < admitted.index(name) for name in rivals - {URGENT})
    assert len(of(run, TaskCompleted)) == 3
    assert len(of(run, ExecutionStarted)) == 3
    assert run.state == fold(run.events)


@pytest.mark.parametrize("is_closed", [False, True])
def test_a_request_that_has_its_result_is_no_rival(is_closed: bool) -> None:
    """A asks by itself in the context of D's urgent task, and is served; C's step comes afterwards."""
    state = given("fsar", *TRUSTED, *ARRIVED)
    served = [
        RequestCapability(Robot("robot/A1"), B, DOOR, "D-1", "q1"),
        EvaluateRequest("q1"),
        TakeTurn("q1"),
        StartAction("q1", answer=5),
    ]
    for command in (*served, ReportResult(B, "q1", "success"), *([CloseRequest("q1")] if is_closed else [])):
        events = decided(state, command)
        assert "CommandRejected" not in types(events)
        happen(state, *events)
    apply(state, past.began(Subject("C-1", "C-1/1.1"), Robot("robot/C1"), 1, DOOR, "B"))
    apply(state, past.queried(Subject("C-1", "C-1/1.1"), past.parties(Robot("robot/C1"), B), DOOR, B))
    assert evaluated(state, "C-1/1.1") == ["RequestAdmitted", "ExecutionQueued"]


def test_a_request_is_not_put_before_a_supervisor_twice() -> None:
    state = competing()
    apply(state, window(B, "review"))
    assert evaluated(state, "A-1/1.1", "A-1/1.1") == ["SupervisorCalled"]
