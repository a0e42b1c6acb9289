"""FSAR's handlers: given events, when a command, then events."""

import msgspec

from fsar_ledger.constants import Constants
from fsar_ledger.events.authority import AuthorityClaimed, AuthorityReleased
from fsar_ledger.events.envelope import Parties, Robot, Subject, Supervisor
from fsar_ledger.events.execution import ApproachStarted, ExecutionHeld, ExecutionStarted
from fsar_ledger.events.knowledge import FleetRuleLearned
from fsar_ledger.events.recovery import AssistanceEnded, FailureResolved
from fsar_ledger.events.registry import RegistryQueried
from fsar_ledger.events.request import RequestAccepted, RequestAdmitted, RequestDenied, RequestIssued, RequestUnanswered
from fsar_ledger.events.task import StepBegan
from fsar_ledger.events.world import (
    ObstructionAppeared,
    ObstructionCleared,
    OutsiderRequestInjected,
    SupervisorLeft,
    TaskArrived,
)
from fsar_ledger.projections.fold import apply, fold
from fsar_ledger.runtime.architectures.fsar.authority import (
    AnswerOutsider,
    Revoke,
    answer_outsider,
    close_execution,
    revoke,
)
from fsar_ledger.runtime.architectures.fsar.discovery import DetectGap, QueryRegistry, detect_gap, query_registry
from fsar_ledger.runtime.architectures.fsar.execution import DecideOwnStep, decide_own_step, decide_routine, start
from fsar_ledger.runtime.architectures.fsar.recovery import (
    AskPeers,
    ConsiderReassignment,
    StartRecovery,
    ask_peers,
    consider_reassignment,
    end_attempt,
    start_recovery,
)
from fsar_ledger.runtime.architectures.fsar.request import (
    EvaluateRequest,
    IssueRequest,
    evaluate_request,
    issue_request,
    take_turn,
)
from fsar_ledger.runtime.handlers.commands import (
    CloseExecution,
    DecideRoutine,
    DetectObstruction,
    EndAttempt,
    StartAction,
    TakeTurn,
)
from fsar_ledger.runtime.handlers.execution import _on_running, detect_obstruction, start_after_approach
from fsar_ledger.runtime.simulation import RunSpec, run_started
from fsar_ledger.runtime.world.founding import founding
from tests.runtime.histories import ARRIVED, DELEGATED_STEP, OWN_STEP, SECOND, given, types, window

A, B, C, D = Robot("robot/A1"), Robot("robot/B1"), Robot("robot/C1"), Robot("robot/D1")

REQUESTED = (
    ARRIVED,
    DELEGATED_STEP,
    RegistryQueried(
        subject=Subject("A1-1", "A1-1/2.1"),
        principals=Parties(requested_by=A, executed_by=B, supervised_by=None),
        capability="door.open.secure",
        candidates=(B,),
    ),
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
    for event in events:
        apply(state, event)
    if not own:
        for event in take_turn(state, TakeTurn(action_id)):
            apply(state, event)
    for event in start(state, StartAction(action_id, now_us=9_000_000, drawn=2_000_000)):
        apply(state, event)
    return state, action_id


def test_a_gap_is_on_record_with_its_requester_and_supervisor() -> None:
    [gap] = detect_gap(given("fsar", ARRIVED, DELEGATED_STEP), DetectGap("A1-1/2.1"))
    assert (gap.principals.requested_by, gap.principals.supervised_by) == ("robot/A1", "supervisor/A1")  # type: ignore[attr-defined]


def test_a_supervisor_who_is_off_shift_is_not_named() -> None:
    [gap] = detect_gap(
        given("fsar", ARRIVED, DELEGATED_STEP, SupervisorLeft(Supervisor("supervisor/A1"))), DetectGap("A1-1/2.1")
    )
    assert gap.principals.supervised_by is None  # type: ignore[attr-defined]


def test_the_registry_shows_only_trusted_robots() -> None:
    [answer] = query_registry(given("fsar", ARRIVED, DELEGATED_STEP), QueryRegistry("A1-1/2.1"))
    assert isinstance(answer, RegistryQueried)
    assert (answer.candidates, answer.relay) == (("robot/B1",), None)


def test_a_robot_without_direct_trust_is_reached_through_a_doubly_trusted_peer() -> None:
    step = StepBegan(
        subject=DELEGATED_STEP.subject,
        robot=D,
        step=2,
        attempt=1,
        capability="door.open.secure",
        target_role="B",
    )
    [answer] = query_registry(given("fsar", ARRIVED, step), QueryRegistry("A1-1/2.1"))
    assert isinstance(answer, RegistryQueried)
    assert (answer.candidates, answer.relay) == (("robot/B1",), "robot/A1")


def test_a_private_zone_is_hidden_from_those_who_may_not_see_it() -> None:
    step = StepBegan(
        subject=DELEGATED_STEP.subject,
        robot=D,
        step=2,
        attempt=1,
        capability="inspect.private_zone",
        target_role="C",
    )
    [answer] = query_registry(given("fsar", ARRIVED, step), QueryRegistry("A1-1/2.1"))
    assert isinstance(answer, RegistryQueried)
    assert answer.candidates == ()


def test_an_empty_answer_leads_to_no_request() -> None:
    state = given("fsar", ARRIVED, DELEGATED_STEP)
    assert isinstance(issue_request(state, IssueRequest("A1-1/2.1"))[0], RequestUnanswered)


def test_the_request_carries_the_requesters_policy() -> None:
    [issued] = issue_request(given("fsar", *REQUESTED, window(A, "review")), IssueRequest("A1-1/2.1"))
    assert isinstance(issued, RequestIssued)
    assert issued.carried_policy == "review"


def test_an_admissible_request_is_admitted_and_queued() -> None:
    assert types(evaluate_request(given("fsar", *REQUESTED), EvaluateRequest("A1-1/2.1"))) == [
        "RequestAdmitted",
        "ExecutionQueued",
    ]


def test_the_executors_own_denial_rejects_the_request() -> None:
    [denied] = evaluate_request(given("fsar", *REQUESTED, window(B)), EvaluateRequest("A1-1/2.1"))
    assert isinstance(denied, RequestDenied)
    assert (denied.principals.decided_by, denied.principals.path) == ("robot/B1", ("robot/B1",))


def test_the_fleet_rule_counts_as_it_was_heard() -> None:
    open_rule = given("fsar", *REQUESTED, window(B, scope="fleet"))
    assert isinstance(evaluate_request(open_rule, EvaluateRequest("A1-1/2.1"))[0], RequestAdmitted)
    heard = given("fsar", *REQUESTED, window(B, scope="fleet"), FleetRuleLearned(B, "deny", 1))
    assert isinstance(evaluate_request(heard, EvaluateRequest("A1-1/2.1"))[0], RequestDenied)


def test_without_policy_composition_only_the_executors_policy_counts() -> None:
    state = given("fsar", *REQUESTED, FleetRuleLearned(B, "deny", 1), configuration="without-policy-composition")
    assert isinstance(evaluate_request(state, EvaluateRequest("A1-1/2.1"))[0], RequestAdmitted)


def test_without_policy_composition_a_robots_own_steps_and_routine_keep_the_fleet_rule() -> None:
    heard = (ARRIVED, OWN_STEP, FleetRuleLearned(A, "deny", 1))
    for configuration in ("full", "without-policy-composition"):
        state = given("fsar", *heard, configuration=configuration)
        assert types(decide_routine(state, DecideRoutine(A, "motion"))) == ["RoutineWithheld"]
        for event in decide_own_step(state, DecideOwnStep("A1-1/1.1")):
            apply(state, event)
        [held] = start(state, StartAction("A1-1/1.1", now_us=5, drawn=7))
        assert isinstance(held, ExecutionHeld)
        assert held.reason == "fleet-rule"


def test_a_review_goes_to_the_fleet_supervisor() -> None:
    assert types(evaluate_request(given("fsar", *REQUESTED, window(B, "review")), EvaluateRequest("A1-1/2.1"))) == [
        "SupervisorCalled"
    ]


def test_a_busy_executor_defers() -> None:
    state, _ = executing()
    for event in (
        *SECOND,
        RegistryQueried(
            subject=Subject("A1-2", "A1-2/2.1"),
            principals=Parties(requested_by=A, executed_by=B, supervised_by=None),
            capability="door.open.secure",
            candidates=(B,),
        ),
    ):
        apply(state, event)
    assert types(evaluate_request(state, EvaluateRequest("A1-2/2.1"))) == [
        "RequestAdmitted",
        "RequestDeferred",
        "ExecutionQueued",
    ]


def test_acceptance_claims_execution_and_override_for_the_executor() -> None:
    state = given("fsar", *REQUESTED)
    for event in evaluate_request(state, EvaluateRequest("A1-1/2.1")):
        apply(state, event)
    accepted = take_turn(state, TakeTurn("A1-1/2.1"))
    assert isinstance(accepted[0], RequestAccepted)
    assert [(event.dimension, event.claimant) for event in accepted if isinstance(event, AuthorityClaimed)] == [
        ("execution", "robot/B1"),
        ("override", "robot/B1"),
    ]
    for event in accepted:
        apply(state, event)
    assert take_turn(state, TakeTurn("A1-1/2.1")) == ()


def test_a_revocation_claims_override_once_until_the_boundary() -> None:
    state, action_id = executing()
    [claim] = revoke(state, Revoke(A))
    assert claim == AuthorityClaimed(Subject("A1-1", action_id), "override", A, "revocation")
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
    for event in decide_own_step(queued, DecideOwnStep("A1-1/1.1")):
        apply(queued, event)
    apply(queued, window(A))
    [held] = start(queued, StartAction("A1-1/1.1", now_us=5, drawn=7))
    assert isinstance(held, ExecutionHeld)
    assert held.principals.path == ("robot/A1",)
    apply(queued, held)
    [again] = start(queued, StartAction("A1-1/1.1", now_us=9, drawn=7))
    assert again.principals.path == ()  # type: ignore[attr-defined]
    assert state.execution.actions["A1-1/1.1"].stage == "running"


def test_a_start_takes_as_long_as_the_world_says() -> None:
    queued = given("fsar", ARRIVED, OWN_STEP)
    for event in decide_own_step(queued, DecideOwnStep("A1-1/1.1")):
        apply(queued, event)
    [began] = start(queued, StartAction("A1-1/1.1", now_us=5, drawn=7))
    assert isinstance(began, ExecutionStarted)
    assert began.ends_us == 12


def test_a_motion_is_withheld_while_policy_forbids_it_and_sensing_is_not() -> None:
    state = given("fsar", window(A))
    assert types(decide_routine(state, DecideRoutine(A, "motion"))) == ["RoutineWithheld"]
    assert types(decide_routine(state, DecideRoutine(A, "sensing"))) == ["RoutinePerformed"]


def failed(own: bool = False):  # type: ignore[no-untyped-def]
    state, action_id = executing(ObstructionAppeared(A if own else B, "o"), own=own)
    for event in detect_obstruction(state, DetectObstruction(action_id, now_us=9_500_000)):
        apply(state, event)
    return state, action_id


def test_recovery_begins_at_the_robot_and_goes_outward_without_skipping() -> None:
    state, action_id = failed()
    levels = []
    for event in start_recovery(state, StartRecovery(action_id)):
        apply(state, event)
    _, second = end_attempt(state, EndAttempt(action_id, 1, now_us=11_000_000))
    assert (type(second).__name__, second.number) == ("RecoveryAttempted", 2)  # type: ignore[attr-defined]
    apply(state, second)
    _, outward = end_attempt(state, EndAttempt(action_id, 2, now_us=13_000_000))
    levels.append((outward.level, outward.to_level))  # type: ignore[attr-defined]
    apply(state, outward)
    assert types(ask_peers(state, AskPeers(action_id))) == ["AssistanceRequested", "AssistanceAdmitted"]
    apply(state, window(A))
    [onward] = ask_peers(state, AskPeers(action_id))
    levels.append((onward.level, onward.to_level))  # type: ignore[attr-defined]
    apply(state, onward)
    decided, human, called = consider_reassignment(state, ConsiderReassignment(action_id))
    levels.append((human.level, human.to_level))  # type: ignore[attr-defined]
    assert (decided.helper, type(called).__name__) == (None, "SupervisorCalled")  # type: ignore[attr-defined]
    assert levels == [("local", "peer"), ("peer", "fleet"), ("fleet", "human")]


def test_a_spent_time_budget_ends_local_recovery() -> None:
    state, action_id = failed()
    for event in start_recovery(state, StartRecovery(action_id)):
        apply(state, event)
    _, outward = end_attempt(state, EndAttempt(action_id, 1, now_us=60_000_000))
    assert outward.to_level == "peer"  # type: ignore[attr-defined]


def test_a_failed_carry_is_reassigned_to_a_trusted_substitute() -> None:
    step = StepBegan(subject=OWN_STEP.subject, robot=A, step=1, attempt=1, capability="carry.package")
    state = given("fsar", ARRIVED, step, ObstructionAppeared(A, "o"))
    for event in decide_own_step(state, DecideOwnStep("A1-1/1.1")):
        apply(state, event)
    for event in start(state, StartAction("A1-1/1.1", now_us=5, drawn=7_000_000)):
        apply(state, event)
    for event in detect_obstruction(state, DetectObstruction("A1-1/1.1", now_us=6)):
        apply(state, event)
    state.recovery = {"A1-1/1.1": msgspec.structs.replace(state.recovery["A1-1/1.1"], level="fleet")}
    reassigned = consider_reassignment(state, ConsiderReassignment("A1-1/1.1"))
    assert types(reassigned) == [
        "ReassignmentDecided",
        "FailureResolved",
        "ExecutionWithdrawn",
        "TaskStateTransferred",
        "ExecutionQueued",
    ]
    assert reassigned[0].helper == "robot/D1"  # type: ignore[attr-defined]


def test_without_layered_recovery_the_fleet_supervisor_is_called_at_once() -> None:
    state, action_id = failed()
    state.fleet = given("fsar", configuration="without-layered-recovery").fleet
    assert types(start_recovery(state, StartRecovery(action_id))) == ["RecoveryEscalated", "SupervisorCalled"]


def test_an_outsider_finds_nothing_and_is_denied_by_the_federation() -> None:
    injected = OutsiderRequestInjected(task_id="injected-1-1", robot=D, peer=C, capability="inspect.private_zone")
    query, denied = answer_outsider(given("fsar", injected), AnswerOutsider("injected-1-1"))
    assert isinstance(query, RegistryQueried)
    assert (query.candidates, query.principals.executed_by, query.rejected, query.rejected_by) == (
        (),
        "robot/C1",
        ("robot/C1",),
        ("visibility",),
    )
    assert denied.principals.decided_by == "service/registry"  # type: ignore[attr-defined]


def test_without_trust_evaluation_the_outsider_runs_under_contested_audit() -> None:
    injected = OutsiderRequestInjected(task_id="injected-1-1", robot=D, peer=C, capability="inspect.private_zone")
    events = answer_outsider(
        given("fsar", injected, configuration="without-trust-evaluation"), AnswerOutsider("injected-1-1")
    )
    assert {
        event.claimant for event in events if isinstance(event, AuthorityClaimed) and event.dimension == "audit"
    } == {"robot/D1", "supervisor/fleet"}


def test_an_execution_that_starts_in_the_way_of_something_finishes_if_that_goes_at_once() -> None:
    state, action_id = executing(ObstructionAppeared(B, "o"))
    started = ExecutionStarted(
        subject=Subject("A1-1", action_id),
        principals=Parties(requested_by=None, executed_by=None, supervised_by=None),
        robot=B,
        on_behalf_of=A,
        capability="door.open.secure",
        ends_us=11_000_000,
    )
    scheduled = [type(one.command).__name__ for one in _on_running(state, started, 9_000_000)]
    assert scheduled == ["DetectObstruction", "FinishAttempt"]
    apply(state, ObstructionCleared(B, "o"))
    assert detect_obstruction(state, DetectObstruction(action_id, now_us=9_000_001)) == ()


def test_a_local_recovery_clears_nothing_but_what_was_clear() -> None:
    resolved = FailureResolved(Subject("A1-1", "A1-1/1.1"), A, 1, "local")
    taken_over = FailureResolved(Subject("A1-1", "A1-1/1.1"), A, 1, "fleet")
    helped = AssistanceEnded(Subject("A1-1", "A1-1/1.1"), A, B, 1)
    cleared_by_hand = FailureResolved(Subject("A1-1", "A1-1/1.1"), A, 1, "human")
    in_the_way = ObstructionAppeared(A, "o")
    assert given("fsar", in_the_way, resolved).world.obstructions[A] == ("o",)
    assert given("fsar", in_the_way, taken_over).world.obstructions[A] == ("o",)
    assert given("fsar", in_the_way, helped).world.obstructions[A] == ()
    assert given("fsar", in_the_way, cleared_by_hand).world.obstructions[A] == ()


def test_the_relay_is_the_nearest_teams() -> None:
    spec = RunSpec(1, "fsar", "full", "door-relay", 8, 0)
    step = StepBegan(
        subject=Subject("D2-1", "D2-1/1.1"),
        robot=Robot("robot/D2"),
        step=1,
        attempt=1,
        capability="door.open.secure",
        target_role="B",
    )
    arrived = TaskArrived(
        task_id="D2-1", robot=Robot("robot/D2"), team=2, steps=("D door.open.secure B",), budget_us=1, due_us=1
    )
    state = fold((run_started(spec, Constants()), *founding(8), arrived, step))
    [answer] = query_registry(state, QueryRegistry("D2-1/1.1"))
    assert (answer.candidates, answer.relay) == (("robot/B2",), "robot/A2")  # type: ignore[attr-defined]


def test_a_second_approach_for_an_action_is_another_way() -> None:
    state, action_id = failed()
    way = ApproachStarted(Subject("A1-1", action_id), B)
    again = start_after_approach(state, way, 0)[0].draws[0].key
    first = start_after_approach(executing()[0], way, 0)[0].draws[0].key
    assert (first, again) == (action_id, f"{action_id}/1")
