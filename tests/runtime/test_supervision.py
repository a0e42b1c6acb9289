"""Supervision: whom a matter goes to, who may answer, and how often supervisors are asked."""

import pytest
from hypothesis import given as for_all
from hypothesis import settings
from hypothesis import strategies as st

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import RequestSubject, Robot, Subject, Supervisor
from fsar_ledger.events.recovery import FailureResolved
from fsar_ledger.events.request import RequestAdmitted, RequestDenied
from fsar_ledger.events.supervision import (
    ActuatorServiced,
    SupervisionDensitySet,
    SupervisorCalled,
    SupervisorResponded,
)
from fsar_ledger.events.world import ActuatorDegraded, SupervisorLeft, SupervisorReturned
from fsar_ledger.projections.fold import State, apply, fold
from fsar_ledger.runtime.architectures.cfc import CFC
from fsar_ledger.runtime.architectures.fsar import FSAR
from fsar_ledger.runtime.architectures.fsar.request import AdmitReviewed, EvaluateRequest, admit_reviewed
from fsar_ledger.runtime.handlers.commands import Respond
from fsar_ledger.runtime.handlers.supervision import (
    RespondToCall,
    SetSupervisionDensity,
    is_due_for_review,
    respond_to_call,
    set_supervision_density,
    supervisor_for,
)
from tests import past
from tests.runtime.governed import H_F, governed
from tests.runtime.histories import ARRIVED, DELEGATED_STEP, A, B, given, types, window
from tests.runtime.live import decided, play, refusal
from tests.sure import only

H_A, H_B = Supervisor("supervisor/A1"), Supervisor("supervisor/B1")
ACTION = "A1-1/2.1"
REQUESTED = (ARRIVED, DELEGATED_STEP, past.queried(Subject("A1-1", ACTION), past.parties(A, B), "door.open.secure", B))
REVIEW = past.called(Subject("A1-1", ACTION), H_F, "review")
ORDERING = past.called(Subject("A1-1", ACTION), H_F, "ordering", robot=B, competing="A1-2/2.1")
LOCAL = past.called(Subject("A1-1", ACTION), H_B, "recovery")
FLEETS = past.called(Subject("A1-1", ACTION), H_F, "recovery")


def admitted(robot: Robot, ordinal: int = 0) -> RequestAdmitted:
    return RequestAdmitted(
        subject=RequestSubject("t1", f"t1/{ordinal}", f"t1/{ordinal}"),
        principals=past.principals(robot, A, robot),
        outcome="allow",
    )


def failing(*before: Event) -> State:
    """A state in which B's execution for A has failed."""
    queued = past.queued(Subject("A1-1", ACTION), B, A, "door.open.secure", step=2, principals=past.parties(A, B, H_B))
    started = past.started(Subject("A1-1", ACTION), B, A, "door.open.secure", 9, past.parties(A, B, H_B))
    return given(
        "fsar", *REQUESTED, queued, started, past.failed(Subject("A1-1", ACTION), B, "degradation", 1, 8), *before
    )


def test_what_concerns_one_robot_goes_to_its_own_supervisor_and_the_rest_to_the_fleets() -> None:
    state = given("fsar")
    assert supervisor_for(state, B, is_cross_robot=False) == H_B
    assert supervisor_for(state, B, is_cross_robot=True) == H_F


def test_off_shift_or_without_an_own_supervisor_it_goes_to_the_fleets() -> None:
    state = given("fsar", SupervisorLeft(H_B), past.joined(Robot("robot/X1"), "A"))
    assert supervisor_for(state, B, is_cross_robot=False) == H_F
    assert supervisor_for(state, Robot("robot/X1"), is_cross_robot=False) == H_F
    apply(state, SupervisorReturned(H_B))
    assert supervisor_for(state, B, is_cross_robot=False) == H_B


@pytest.mark.parametrize("approves", [True, False])
def test_the_supervisor_who_was_called_approves_a_review_or_not(approves: bool) -> None:
    state = given("fsar", *REQUESTED, REVIEW)
    [response] = decided(state, RespondToCall(H_F, ACTION, approves))
    assert response == SupervisorResponded(
        Subject("A1-1", ACTION), past.principals(H_F, A, None, H_F), "review", approves
    )
    apply(state, response)
    assert (ACTION in state.supervision.approved, state.supervision.calls) == (approves, {})
    [scheduled] = [one for react in FSAR.reacts[SupervisorResponded] for one in react(state, response, 0)]
    assert types(admit_reviewed(state, scheduled.command)) == (  # type: ignore[arg-type]
        ["RequestAdmitted", "ExecutionQueued"] if approves else ["RequestDenied"]
    )


def test_a_disapproved_request_is_denied_by_the_executor_for_the_review() -> None:
    denied = only(RequestDenied, decided(given("fsar", *REQUESTED), AdmitReviewed(ACTION, False)))
    assert (denied.principals.decided_by, denied.reason) == (B, "review")


def test_a_coordinator_too_does_not_command_what_was_disapproved() -> None:
    state = given("cfc", ARRIVED, DELEGATED_STEP, past.called(Subject("A1-1", ACTION), H_F, "review", robot=B))
    [response] = decided(state, RespondToCall(H_F, ACTION, False))
    apply(state, response)
    [scheduled] = [one for react in CFC.reacts[SupervisorResponded] for one in react(state, response, 0)]
    [denied] = CFC.decides[type(scheduled.command)](state, scheduled.command)
    assert (type(denied).__name__, denied.reason) == ("RequestDenied", "review")  # type: ignore[attr-defined]


def test_the_order_of_two_commands_names_the_one_that_goes_first() -> None:
    [response] = decided(given("fsar", *REQUESTED, ORDERING), RespondToCall(H_F, ACTION, True, preferred="A1-2/2.1"))
    assert response.preferred == "A1-2/2.1"  # type: ignore[attr-defined]


@pytest.mark.parametrize("is_degraded", [True, False])
def test_a_robots_own_supervisor_resolves_its_failure_and_has_it_serviced(is_degraded: bool) -> None:
    state = failing(LOCAL, *([ActuatorDegraded(B)] if is_degraded else []))
    for events in (decided(state, RespondToCall(H_B, ACTION, True)), decided(state, Respond(1))):
        assert events[0] == SupervisorResponded(Subject("A1-1", ACTION), past.principals(H_B, A, B, H_B), "recovery")
        assert events[1:] == ((ActuatorServiced(B),) if is_degraded else ()) + (
            FailureResolved(Subject("A1-1", ACTION), B, 1, "human"),
        )


@pytest.mark.parametrize(
    ("call", "command", "reason"),
    [
        (REVIEW, RespondToCall(Supervisor("supervisor/X9"), ACTION, True), "unknown supervisor supervisor/X9"),
        (REVIEW, RespondToCall(H_B, ACTION, True), "the call went to supervisor/fleet"),
        (LOCAL, RespondToCall(H_F, ACTION, True), "the call went to supervisor/B1"),
        (REVIEW, RespondToCall(H_F, "A1-1/9.9", True), "no open call"),
        (REVIEW, RespondToCall(H_F, ACTION, True, preferred=ACTION), f"{ACTION} does not compete"),
        (ORDERING, RespondToCall(H_F, ACTION, True, preferred="A1-3/1.1"), "A1-3/1.1 does not compete"),
        (ORDERING, RespondToCall(H_F, ACTION, False), "found a disapproval of ordering"),
        (LOCAL, RespondToCall(H_B, ACTION, False), "found a disapproval of recovery"),
    ],
)
def test_an_answer_that_does_not_fit_is_rejected(call: SupervisorCalled, command: RespondToCall, reason: str) -> None:
    assert refusal(respond_to_call(failing(call), command)).startswith(reason)


def test_an_answer_about_what_has_ended_is_rejected_as_it_would_name_nobody() -> None:
    state = given("fsar", REVIEW)
    refused = refusal(decided(state, RespondToCall(H_F, ACTION, True)))
    assert refused == "what the call was about has ended, expected an action or a request under way"
    assert decided(state, Respond(1)) == ()


def test_a_call_is_answered_once() -> None:
    state = given("fsar", *REQUESTED, REVIEW)
    play(state, RespondToCall(H_F, ACTION, True))
    assert refusal(decided(state, RespondToCall(H_F, ACTION, True))).startswith("no open call")
    assert decided(state, Respond(1)) == ()


def test_an_answer_to_one_call_leaves_another_about_the_same_action_open() -> None:
    state = failing(REVIEW, LOCAL)
    play(state, RespondToCall(H_F, ACTION, True))
    assert list(state.supervision.calls.values()) == [LOCAL]


def test_an_answer_is_that_of_the_supervisor_who_gave_it_even_when_another_was_called_meanwhile() -> None:
    state = failing(LOCAL, FLEETS)
    first, *_ = decided(state, Respond(1))
    second, *_ = decided(state, Respond(2))
    answers = [event.principals for event in (first, second) if isinstance(event, SupervisorResponded)]
    assert [(one.decided_by, one.supervised_by) for one in answers] == [(H_B, H_B), (H_F, H_F)]
    play(state, Respond(1))
    assert decided(state, Respond(2)) == ()


def test_a_late_answer_about_one_failure_does_not_resolve_the_next() -> None:
    state = failing(LOCAL)
    play(state, RespondToCall(H_B, ACTION, True))
    apply(state, past.failed(Subject("A1-1", ACTION), B, "degradation", 1, 9, 2))
    apply(state, LOCAL)
    assert decided(state, Respond(1)) == ()
    assert types(decided(state, Respond(2))) == ["SupervisorResponded", "FailureResolved"]


def test_a_failure_that_is_over_leaves_no_call_about_it() -> None:
    state = failing(REVIEW, LOCAL, FailureResolved(Subject("A1-1", ACTION), B, 1, "human"))
    assert list(state.supervision.calls.values()) == [REVIEW]


def test_a_supervisor_who_answers_says_whether_they_approve() -> None:
    with pytest.raises(TypeError):
        RespondToCall(H_F, ACTION)  # type: ignore[call-arg]


@pytest.mark.parametrize(("issued_by", "robot"), [(H_B, B), (H_F, B), (H_F, None)])
def test_density_is_set_by_the_robots_own_supervisor_or_the_fleets(issued_by: Supervisor, robot: Robot | None) -> None:
    [event] = decided(given("fsar"), SetSupervisionDensity(issued_by, robot, 3, "night shift"))
    assert event == SupervisionDensitySet(robot=robot, review_every=3, decided_by=issued_by, reason="night shift")


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (SetSupervisionDensity(H_A, B, 3, ""), "supervisor/A1 does not supervise robot/B1"),
        (SetSupervisionDensity(H_A, None, 3, ""), "supervisor/A1 supervises one robot"),
        (SetSupervisionDensity(Supervisor("supervisor/X9"), B, 3, ""), "unknown supervisor supervisor/X9"),
        (SetSupervisionDensity(H_F, Robot("robot/X9"), 3, ""), "unknown robot robot/X9"),
        (SetSupervisionDensity(H_F, B, -1, ""), "density -1"),
    ],
)
def test_density_that_cannot_be_set_is_rejected(command: SetSupervisionDensity, reason: str) -> None:
    assert refusal(set_supervision_density(given("fsar"), command)).startswith(reason)


def test_nobody_speaks_for_a_robot_without_a_supervisor_but_the_fleets() -> None:
    state = given("fsar", past.joined(Robot("robot/X1"), "A"))
    nobody: Supervisor = None  # type: ignore[assignment]
    assert refusal(decided(state, SetSupervisionDensity(nobody, Robot("robot/X1"), 3, ""))).startswith(
        "unknown supervisor"
    )
    assert types(decided(state, SetSupervisionDensity(H_F, Robot("robot/X1"), 3, ""))) == ["SupervisionDensitySet"]


@for_all(st.integers(0, 5), st.integers(0, 5), st.integers(0, 14))
@settings(max_examples=60)
def test_exactly_every_nth_admission_is_due_and_a_robots_own_density_comes_before_every_robots(
    own: int, every: int, count: int
) -> None:
    state = given(
        "fsar",
        SupervisionDensitySet(robot=None, review_every=every, decided_by=H_F, reason=""),
        SupervisionDensitySet(robot=B, review_every=own, decided_by=H_F, reason=""),
    )
    due = {A: [], B: []}  # type: dict[str, list[int]]
    for ordinal in range(1, count + 1):
        for robot in (A, B):
            if is_due_for_review(state.supervision, robot):
                due[robot].append(ordinal)
            apply(state, admitted(robot, ordinal))
    assert due == {
        robot: [ordinal for ordinal in range(1, count + 1) if n and ordinal % n == 0]
        for robot, n in ((A, every), (B, own))
    }


def test_an_admission_that_is_due_goes_to_review_and_a_denial_stays_a_denial() -> None:
    dense = SupervisionDensitySet(robot=B, review_every=2, decided_by=H_B, reason="")
    assert types(decided(given("fsar", *REQUESTED, dense, admitted(B)), EvaluateRequest(ACTION))) == [
        "SupervisorCalled"
    ]
    found = types(decided(given("fsar", *REQUESTED, dense), EvaluateRequest(ACTION)))
    assert found == ["RequestAdmitted", "ExecutionQueued"]
    assert types(decided(given("fsar", *REQUESTED, dense, admitted(B), window(B)), EvaluateRequest(ACTION))) == [
        "RequestDenied"
    ]


def test_density_changes_while_a_run_goes_on() -> None:
    one = governed(
        "door-relay",
        (2, SupervisionDensitySet(robot=None, review_every=1, decided_by=H_F, reason="start-up")),
        (60_000_000, SupervisionDensitySet(robot=None, review_every=0, decided_by=H_F, reason="settled")),
    )
    timed = list(zip(one.times_us, one.events, strict=True))
    reviewed = {
        event.subject.action_id
        for event in one.events
        if isinstance(event, SupervisorCalled) and event.purpose == "review"
    }
    early = {
        event.subject.action_id
        for _, event in timed
        if isinstance(event, RequestAdmitted) and event.subject.action_id in reviewed
    }
    unreviewed = [
        time for time, event in timed if isinstance(event, RequestAdmitted) and event.subject.action_id not in reviewed
    ]
    assert early
    assert unreviewed
    assert min(unreviewed) > 60_000_000
    assert fold(one.events) == one.state
