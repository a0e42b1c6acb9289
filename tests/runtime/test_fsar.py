"""FSAR's handlers: given events, when a command, then events."""

import pytest

from fsar_ledger.events.authority import AuthorityClaimed, AuthorityReleased
from fsar_ledger.events.envelope import Subject, Supervisor
from fsar_ledger.events.execution import ExecutionHeld, ExecutionStarted
from fsar_ledger.events.knowledge import FleetRuleLearned
from fsar_ledger.events.request import RequestAccepted, RequestAdmitted, RequestDenied, RequestIssued, RequestUnanswered
from fsar_ledger.events.world import SupervisorLeft
from fsar_ledger.projections.fold import apply
from fsar_ledger.runtime.architectures.fsar.authority import Revoke, revoke
from fsar_ledger.runtime.architectures.fsar.discovery import DetectGap, IssueRequest, detect_gap, issue_request
from fsar_ledger.runtime.architectures.fsar.execution import (
    DecideOwnStep,
    decide_own_step,
    decide_routine,
    start,
    take_turn,
)
from fsar_ledger.runtime.architectures.fsar.request import EvaluateRequest, evaluate_request
from fsar_ledger.runtime.handlers.authority import close_execution
from fsar_ledger.runtime.handlers.commands import CloseExecution, DecideRoutine, StartAction, TakeTurn
from tests import past
from tests.runtime.histories import ARRIVED, DELEGATED_STEP, OWN_STEP, A, B, given, happen, types, window
from tests.runtime.live import play
from tests.sure import only

REQUESTED = (
    ARRIVED,
    DELEGATED_STEP,
    past.queried(Subject("A1-1", "A1-1/2.1"), past.parties(A, B), "door.open.secure", B),
)


def executing(*before, own: bool = False):  # type: ignore[no-untyped-def]
    """A state in which the action runs, and its id."""
    state = given("fsar", ARRIVED, *(() if own else REQUESTED[1:]), *before)
    if own:
        apply(state, OWN_STEP)
        events = decide_own_step(state, DecideOwnStep("A1-1/1.1"))
    else:
        events = evaluate_request(state, EvaluateRequest("A1-1/2.1"))
    action_id = "A1-1/1.1" if own else "A1-1/2.1"
    happen(state, *events)
    if not own:
        happen(state, *take_turn(state, TakeTurn(action_id)))
    happen(state, *start(state, StartAction(action_id, now_us=9_000_000, answer=2_000_000)))
    return state, action_id


def test_a_gap_is_on_record_with_its_requester_and_the_supervisor_who_is_there() -> None:
    for left, supervisor in (((), "supervisor/A1"), ((SupervisorLeft(Supervisor("supervisor/A1")),), None)):
        [gap] = detect_gap(given("fsar", ARRIVED, DELEGATED_STEP, *left), DetectGap("A1-1/2.1"))
        assert (gap.principals.requested_by, gap.principals.supervised_by) == ("robot/A1", supervisor)  # type: ignore[attr-defined]


def test_an_empty_answer_leads_to_no_request() -> None:
    state = given("fsar", ARRIVED, DELEGATED_STEP)
    assert isinstance(issue_request(state, IssueRequest("A1-1/2.1"))[0], RequestUnanswered)


def test_the_request_carries_the_requesters_policy() -> None:
    issued = only(
        RequestIssued, issue_request(given("fsar", *REQUESTED, window(A, "review")), IssueRequest("A1-1/2.1"))
    )
    assert issued.carried_policy == "review"


def test_the_fleet_rule_counts_as_it_was_heard() -> None:
    open_rule = given("fsar", *REQUESTED, window(B, scope="fleet"))
    assert isinstance(evaluate_request(open_rule, EvaluateRequest("A1-1/2.1"))[0], RequestAdmitted)
    heard = given("fsar", *REQUESTED, window(B, scope="fleet"), FleetRuleLearned(B, "deny", 1))
    assert isinstance(evaluate_request(heard, EvaluateRequest("A1-1/2.1"))[0], RequestDenied)


@pytest.mark.parametrize(
    ("configuration", "expected"),
    [("full", ["ExecutionHeld"]), ("without-policy-composition", ["ExecutionStarted"])],
)
def test_policy_is_composed_again_when_delegated_work_starts(configuration: str, expected: list[str]) -> None:
    """I3 speaks of execution: a fleet rule that was heard after the admission holds the start. Reading: R34."""
    state = given("fsar", *REQUESTED, configuration=configuration)
    happen(state, *evaluate_request(state, EvaluateRequest("A1-1/2.1")))
    play(state, TakeTurn("A1-1/2.1"))
    happen(state, FleetRuleLearned(B, "deny", 1))
    assert types(play(state, StartAction("A1-1/2.1"))) == expected
    happen(state, FleetRuleLearned(B, "allow", 2))
    if configuration == "full":
        assert types(play(state, StartAction("A1-1/2.1"))) == ["ExecutionStarted"]


def test_without_policy_composition_only_the_executors_policy_counts() -> None:
    state = given("fsar", *REQUESTED, FleetRuleLearned(B, "deny", 1), configuration="without-policy-composition")
    assert isinstance(evaluate_request(state, EvaluateRequest("A1-1/2.1"))[0], RequestAdmitted)


def test_without_policy_composition_a_robots_own_steps_and_routine_keep_the_fleet_rule() -> None:
    heard = (ARRIVED, OWN_STEP, FleetRuleLearned(A, "deny", 1))
    for configuration in ("full", "without-policy-composition"):
        state = given("fsar", *heard, configuration=configuration)
        assert types(decide_routine(state, DecideRoutine(A, "motion"))) == ["RoutineWithheld"]
        happen(state, *decide_own_step(state, DecideOwnStep("A1-1/1.1")))
        held = only(ExecutionHeld, start(state, StartAction("A1-1/1.1", now_us=5, answer=7)))
        assert held.reason == "fleet-rule"


def test_a_review_goes_to_the_fleet_supervisor() -> None:
    [called] = evaluate_request(given("fsar", *REQUESTED, window(B, "review")), EvaluateRequest("A1-1/2.1"))
    assert (type(called).__name__, called.supervisor) == ("SupervisorCalled", "supervisor/fleet")  # type: ignore[attr-defined]


def test_acceptance_claims_execution_and_override_for_the_executor() -> None:
    state = given("fsar", *REQUESTED)
    happen(state, *evaluate_request(state, EvaluateRequest("A1-1/2.1")))
    accepted = take_turn(state, TakeTurn("A1-1/2.1"))
    assert isinstance(accepted[0], RequestAccepted)
    found = [(event.dimension, event.claimant) for event in accepted if isinstance(event, AuthorityClaimed)]
    assert found == [("execution", "robot/B1"), ("override", "robot/B1")]
    happen(state, *accepted)
    assert take_turn(state, TakeTurn("A1-1/2.1")) == ()


def test_a_revocation_claims_override_once_until_the_boundary() -> None:
    state, action_id = executing()
    [claim] = revoke(state, Revoke(A))
    assert claim == AuthorityClaimed(
        subject=Subject("A1-1", action_id), dimension="override", claimant=A, reason="revocation"
    )
    apply(state, claim)
    assert revoke(state, Revoke(A)) == ()
    assert {
        event.claimant
        for event in close_execution(state, CloseExecution(action_id))
        if isinstance(event, AuthorityReleased)
    } == {"robot/A1", "robot/B1"}


def test_an_own_step_is_the_robots_own_decision() -> None:
    [decided, queued] = decide_own_step(given("fsar", ARRIVED, OWN_STEP), DecideOwnStep("A1-1/1.1"))
    assert decided.principals.path == ("robot/A1",)  # type: ignore[attr-defined]
    assert not queued.is_delegated  # type: ignore[attr-defined]


def test_a_start_waits_for_the_robots_own_policy() -> None:
    state, _ = executing(own=True)
    queued = given("fsar", ARRIVED, OWN_STEP)
    happen(queued, *decide_own_step(queued, DecideOwnStep("A1-1/1.1")))
    apply(queued, window(A))
    held = only(ExecutionHeld, start(queued, StartAction("A1-1/1.1", now_us=5, answer=7)))
    assert held.principals.path == ("robot/A1",)
    apply(queued, held)
    [again] = start(queued, StartAction("A1-1/1.1", now_us=9, answer=7))
    assert again.principals.path == ()  # type: ignore[attr-defined]
    assert state.execution.actions["A1-1/1.1"].stage == "running"


def test_a_start_takes_as_long_as_the_world_says() -> None:
    queued = given("fsar", ARRIVED, OWN_STEP)
    happen(queued, *decide_own_step(queued, DecideOwnStep("A1-1/1.1")))
    began = only(ExecutionStarted, start(queued, StartAction("A1-1/1.1", now_us=5, answer=7)))
    assert began.ends_us == 12


def test_a_motion_is_withheld_while_policy_forbids_it_and_sensing_is_not() -> None:
    state = given("fsar", window(A))
    assert types(decide_routine(state, DecideRoutine(A, "motion"))) == ["RoutineWithheld"]
    assert types(decide_routine(state, DecideRoutine(A, "sensing"))) == ["RoutinePerformed"]
