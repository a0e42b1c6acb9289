"""DHMA's handlers: given events, when a command, then events."""

from functools import partial

from fsar_ledger.designs.constants import Constants
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import Subject
from fsar_ledger.events.execution import ExecutionStarted
from fsar_ledger.events.knowledge import BidReceived, PlannerEngaged, SnapshotTaken
from fsar_ledger.events.request import AwardMade
from fsar_ledger.events.world import ObstructionAppeared, OutsiderRequestInjected
from fsar_ledger.projections.fold import State, apply
from fsar_ledger.runtime.architectures.dhma import DHMA, Dispute, Escalate, StartRecovery
from fsar_ledger.runtime.architectures.dhma.agents import EngagePlanner, TakeSnapshot
from fsar_ledger.runtime.architectures.dhma.execution import (
    AcknowledgeExecution,
    PassExecution,
    PlanOwnStep,
    RunOutsider,
    SettleBooking,
)
from fsar_ledger.runtime.architectures.dhma.request import AcceptAward, Award, CallForProposals, EvaluateBid
from fsar_ledger.runtime.handlers.commands import (
    CloseExecution,
    DecideRoutine,
    DetectObstruction,
    EndAttempt,
    StartAction,
    TakeTurn,
)
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from tests import past
from tests.runtime import live
from tests.runtime.histories import ARRIVED, DELEGATED_STEP, OWN_STEP, SECOND, A, B, C, D, given, happen, types, window

decided, play = partial(live.decided, table=DHMA), partial(live.play, table=DHMA)
ACTION = "A1-1/2.1"
CALLED = (ARRIVED, DELEGATED_STEP, past.queried(Subject("A1-1", ACTION), past.parties(A), "door.open.secure", B))
AWARDED = (*CALLED, BidReceived(Subject("A1-1", ACTION), B, "allow"), AwardMade("A1-1", past.parties(A), B))


def accepted(*before) -> State:  # type: ignore[no-untyped-def]
    state = given("dhma", *AWARDED, *before)
    play(state, AcceptAward(ACTION))
    return state


def running(*before) -> State:  # type: ignore[no-untyped-def]
    state = accepted(*before)
    play(state, TakeTurn(ACTION), StartAction(ACTION, now_us=9_000_000, answer=2_000_000))
    return state


def claimants(state: State, dimension: str) -> set[str]:
    return {claim.claimant for claim in state.authority.claims.get(ACTION, ()) if claim.dimension == dimension}


def test_a_call_names_no_executor_before_the_award() -> None:
    events = decided(given("dhma", ARRIVED, DELEGATED_STEP), CallForProposals(ACTION))
    assert types(events) == ["RegistryQueried", "RequestIssued"]
    assert [event.principals.executed_by for event in events] == [None, None]  # type: ignore[attr-defined]


def test_a_bid_follows_the_planners_snapshot_and_not_the_true_policy() -> None:
    unseen = given("dhma", *CALLED, window(B))
    assert types(decided(unseen, EvaluateBid(ACTION, B))) == ["RequestAdmitted", "BidSubmitted"]
    seen = given("dhma", *CALLED, SnapshotTaken(B, "deny"))
    assert types(decided(seen, EvaluateBid(ACTION, B))) == ["RequestDenied", "BidSubmitted"]


def test_a_snapshot_is_the_policy_of_its_moment() -> None:
    assert decided(given("dhma", window(B, "review")), TakeSnapshot(B)) == (SnapshotTaken(B, "review"),)


def test_a_bid_under_review_goes_to_the_fleet_supervisor_first() -> None:
    state = given("dhma", *CALLED, BidReceived(Subject("A1-1", ACTION), B, "review"))
    assert types(decided(state, Award(ACTION))) == ["SupervisorCalled"]


def test_execution_goes_from_agent_to_agent_and_overlaps_until_acknowledged() -> None:
    state = accepted()
    assert claimants(state, "execution") == {"agent/B1/communication"}
    play(state, PassExecution(ACTION, 0, "communication", "planning"))
    assert claimants(state, "execution") == {"agent/B1/communication", "agent/B1/planning"}
    play(state, AcknowledgeExecution(ACTION, 0, "communication"))
    assert claimants(state, "execution") == {"agent/B1/planning"}
    assert decided(state, PassExecution(ACTION, 1, "planning", "execution")) == ()


def test_another_tasks_action_at_the_executor_is_double_booking_until_settled() -> None:
    state = running()
    other = "A1-2/2.1"
    for event in (*SECOND, AwardMade("A1-2", past.parties(A), B)):
        apply(state, event)
    booked = decided(state, AcceptAward(other))
    assert "RequestDeferred" in types(booked)
    assert {
        event.claimant for event in booked if isinstance(event, AuthorityClaimed) and event.dimension == "override"
    } == {"agent/B1/communication", "agent/B1/execution"}
    happen(state, *booked)
    assert len(decided(state, SettleBooking(other))) == 2


def test_a_context_change_questions_a_contract_that_has_not_started() -> None:
    state = accepted()
    questioned = decided(state, EngagePlanner(A, now_us=5_000_000))
    assert types(questioned) == ["PlannerEngaged", "AuthorityClaimed", "AuthorityClaimed", "ContractQuestioned"]
    found = {event.claimant for event in questioned if isinstance(event, AuthorityClaimed)}
    assert found == {"agent/A1/planning", "agent/B1/planning"}
    happen(state, *questioned, *decided(state, TakeTurn(ACTION)))
    voided = decided(state, StartAction(ACTION, now_us=9_000_000, answer=1))
    assert "ContractVoided" in types(voided)


def test_a_context_change_during_execution_leaves_the_contract_standing() -> None:
    assert "ContractQuestioned" not in types(decided(running(), EngagePlanner(B, now_us=9_500_000)))


def test_an_own_step_is_the_planners_decision() -> None:
    [own] = decided(given("dhma", ARRIVED, OWN_STEP), PlanOwnStep("A1-1/1.1"))
    assert own.principals.path == ("agent/A1/planning",)  # type: ignore[attr-defined]


def test_a_motion_is_two_half_records_and_engages_the_planner() -> None:
    performed, reported, engaged = decided(given("dhma"), DecideRoutine(A, "motion", now_us=1_000_000))
    assert (performed.principals.requested_by, performed.principals.executed_by) == ("robot/A1", None)  # type: ignore[attr-defined]
    assert (reported.principals.requested_by, reported.principals.executed_by) == (None, "robot/A1")  # type: ignore[attr-defined]
    assert isinstance(engaged, PlannerEngaged)


def test_sensing_is_one_agents_and_completely_recorded() -> None:
    [performed] = decided(given("dhma"), DecideRoutine(A, "sensing"))
    assert performed.principals.path == ("robot/A1",)  # type: ignore[attr-defined]


def failed() -> State:
    state = running(ObstructionAppeared(B, "o"))
    play(state, DetectObstruction(ACTION, now_us=9_500_000), StartRecovery(ACTION))
    return state


def test_an_undisputed_recovery_has_two_attempts() -> None:
    state = failed()
    again = decided(state, EndAttempt(ACTION, 1))
    assert types(again)[-1] == "RecoveryAttempted"
    happen(state, *again)
    assert types(decided(state, EndAttempt(ACTION, 2)))[-2:] == ["RecoveryEscalated", "SupervisorCalled"]


def test_a_disputed_recovery_has_one_attempt_and_then_loops() -> None:
    state = failed()
    claims = decided(state, Dispute(ACTION))
    assert {event.claimant for event in claims} == {"agent/B1/recovery", "agent/B1/planning"}  # type: ignore[attr-defined]
    happen(state, *claims)
    assert types(decided(state, EndAttempt(ACTION, 1)))[0] == "RecoveryAttemptFailed"
    assert types(decided(state, Escalate(ACTION)))[:2] == ["RecoveryEscalated", "SupervisorCalled"]


def test_an_outsider_runs_unchecked_and_nobody_is_on_record() -> None:
    injected = OutsiderRequestInjected(task_id="injected-1-1", robot=D, peer=C, capability="inspect.private_zone")
    events = decided(given("dhma", injected), RunOutsider("injected-1-1"))
    assert types(events) == ["RequestIssued", "RequestAdmitted", "ExecutionQueued"]
    assert all(event.principals.executed_by is None and event.principals.supervised_by is None for event in events)  # type: ignore[attr-defined]


def test_an_outsider_has_no_contract_to_be_questioned_or_voided() -> None:
    state = given(
        "dhma", OutsiderRequestInjected(task_id="injected-1-1", robot=D, peer=C, capability="inspect.private_zone")
    )
    play(state, RunOutsider("injected-1-1"))
    for robot in (C, D):
        assert types(decided(state, EngagePlanner(robot, now_us=5_000_000))) == ["PlannerEngaged"]


def test_every_outsider_runs_in_every_world() -> None:
    """Paper: sec:evaluation:qualitative, case 1 (all 20 runs proceed)."""
    for seed in range(3):
        for run in range(20):
            events = simulate_run(RunSpec(seed, "dhma", "full", "mixed-trust-inspection", 4, run), Constants()).events
            injected = {event.task_id for event in events if isinstance(event, OutsiderRequestInjected)}
            assert (
                injected
                == {event.subject.action_id for event in events if isinstance(event, ExecutionStarted)} & injected
            )


def test_claims_end_with_the_execution() -> None:
    state = running()
    assert "AuthorityReleased" in types(decided(state, CloseExecution(ACTION)))
