"""CFC's handlers: given events, when a command, then events."""

from functools import partial

import msgspec

from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import COORDINATOR, FLEET_SUPERVISOR, Subject
from fsar_ledger.events.knowledge import CopySynced, WorkQueued
from fsar_ledger.events.recovery import RecoveryAttempted, RecoveryAttemptFailed
from fsar_ledger.events.request import CommandIssued, GapDetected, RequestDenied
from fsar_ledger.events.world import ActuatorDegraded, ObstructionAppeared
from fsar_ledger.projections.fold import State, apply
from fsar_ledger.runtime.architectures.cfc import CFC, QueueOrdered, ReceiveCommand
from fsar_ledger.runtime.architectures.cfc.coordinator import ProcessWork, ReachCoordinator, Sync, until_next_sync_us
from fsar_ledger.runtime.architectures.cfc.execution import ReachHelper, SafeStop
from fsar_ledger.runtime.handlers.commands import (
    CloseExecution,
    DecideRoutine,
    DetectObstruction,
    EndAttempt,
    StartAction,
    TakeTurn,
)
from tests.runtime import live
from tests.runtime.histories import ARRIVED, DELEGATED_STEP, OWN_STEP, SECOND, A, B, C, D, given, happen, types, window
from tests.sure import only

decided, play = partial(live.decided, table=CFC), partial(live.play, table=CFC)
ACTION = "A1-1/2.1"
DELEGATED = (ARRIVED, DELEGATED_STEP)


def commanded(*before) -> State:  # type: ignore[no-untyped-def]
    state = given("cfc", *DELEGATED, *before)
    play(state, ProcessWork(ACTION, "step"))
    return state


def running(*before) -> State:  # type: ignore[no-untyped-def]
    state = commanded(*before)
    play(state, ReceiveCommand(ACTION, B), TakeTurn(ACTION), StartAction(ACTION, now_us=9_000_000, answer=2_000_000))
    return state


def test_the_coordinator_records_a_gap_without_saying_whose() -> None:
    gap, queued = decided(given("cfc", *DELEGATED), ReachCoordinator(ACTION, "step", now_us=1_000_000))
    assert isinstance(gap, GapDetected)
    assert (gap.subject.action_id, gap.principals.requested_by, gap.principals.executed_by) == (None, None, None)
    assert gap.principals.supervised_by == FLEET_SUPERVISOR
    assert isinstance(queued, WorkQueued)


def test_work_is_served_in_order_of_arrival_and_takes_longer_with_candidates() -> None:
    state = given("cfc", *DELEGATED)
    *_, first = decided(state, ReachCoordinator(ACTION, "step", now_us=1_000_000))
    apply(state, first)
    *_, second = decided(state, ReachCoordinator(ACTION, "completion", now_us=1_000_001))
    structure = state.fleet.structure
    assert (
        first.ready_us  # type: ignore[attr-defined]
        == 1_000_000 + structure.service_us + structure.service_us * structure.candidate_cost_ppm // 1_000_000
    )
    assert second.ready_us == first.ready_us + structure.service_us  # type: ignore[attr-defined]


def test_a_delegation_is_decided_committed_and_claimed_by_the_coordinator() -> None:
    events = decided(given("cfc", *DELEGATED), ProcessWork(ACTION, "step"))
    assert types(events) == [
        "RequestIssued",
        "CandidateMatched",
        "CommandIssued",
        "RequestAccepted",
        "AuthorityClaimed",
        "AuthorityClaimed",
    ]
    assert {event.claimant for event in events if isinstance(event, AuthorityClaimed)} == {COORDINATOR}


def test_the_gate_reads_the_copied_policy_and_not_the_true_one() -> None:
    unseen = given("cfc", *DELEGATED, window(B))
    assert "CommandIssued" in types(decided(unseen, ProcessWork(ACTION, "step")))
    seen = given("cfc", *DELEGATED, window(B), CopySynced(local_deny=(B,)))
    assert types(decided(seen, ProcessWork(ACTION, "step")))[-1] == "RequestDenied"


def test_the_gate_reads_the_fleet_rule_live_and_the_requesters_policy_not_at_all() -> None:
    found = types(decided(given("cfc", *DELEGATED, window(B, scope="fleet")), ProcessWork(ACTION, "step")))[-1]
    assert found == "RequestDenied"
    requester = given("cfc", *DELEGATED, window(A), CopySynced(local_deny=(A,)))
    assert "CommandIssued" in types(decided(requester, ProcessWork(ACTION, "step")))


def test_an_own_step_leaves_one_decision_without_requester() -> None:
    events = decided(given("cfc", ARRIVED, OWN_STEP), ProcessWork("A1-1/1.1", "step"))
    assert types(events) == ["OwnStepDecided", "AuthorityClaimed", "AuthorityClaimed"]
    assert events[0].principals.requested_by is None  # type: ignore[attr-defined]


def second_delegation(state: State) -> None:
    happen(state, *SECOND)
    play(state, ProcessWork("A1-2/2.1", "step"))


def test_a_second_command_for_a_robot_not_seen_busy_disputes_the_running_action() -> None:
    state = running()
    second_delegation(state)
    claim, called = decided(state, ReceiveCommand("A1-2/2.1", B))
    assert claim == AuthorityClaimed(
        subject=Subject("A1-1", ACTION), dimension="execution", claimant=A, reason="assigned again: A1-2/2.1"
    )
    assert called.purpose == "ordering"  # type: ignore[attr-defined]
    apply(state, claim)
    assert types(decided(state, QueueOrdered("A1-2/2.1"))) == ["AuthorityReleased", "ExecutionQueued"]


def test_a_second_command_for_a_robot_seen_busy_only_waits() -> None:
    state = running()
    apply(state, CopySynced(busy=(B,)))
    second_delegation(state)
    assert types(decided(state, ReceiveCommand("A1-2/2.1", B))) == ["ExecutionQueued"]


def test_the_command_says_whether_the_robot_was_seen_busy() -> None:
    events = decided(given("cfc", *DELEGATED, CopySynced(busy=(B,))), ProcessWork(ACTION, "step"))
    [issued] = [event for event in events if isinstance(event, CommandIssued)]
    assert issued.seen_busy
    assert "RequestDeferred" in types(events)


def test_a_context_change_of_either_party_claims_override_against_the_coordinator() -> None:
    state = running()
    for robot in (A, B):
        [claim] = decided(state, SafeStop(robot, None))
        assert claim == AuthorityClaimed(
            subject=Subject("A1-1", ACTION), dimension="override", claimant=robot, reason="safe stop"
        )
    assert decided(state, SafeStop(C, None)) == ()


def test_a_window_brings_both_supervisors_to_claim_supervision() -> None:
    claims = decided(running(), SafeStop(B, "local/B1/0"))
    assert {(event.dimension, event.claimant) for event in claims} == {  # type: ignore[attr-defined]
        ("override", "robot/B1"),
        ("audit", FLEET_SUPERVISOR),
        ("audit", "supervisor/B1"),
    }


def test_the_coordinator_keeps_override_until_it_has_processed_the_completion() -> None:
    state = running()
    [released] = decided(state, CloseExecution(ACTION))
    assert (released.dimension, released.claimant) == ("execution", COORDINATOR)  # type: ignore[attr-defined]
    closed, last = decided(state, ProcessWork(ACTION, "completion"))
    assert type(closed).__name__ == "RequestClosed"
    assert (last.dimension, last.claimant) == ("override", COORDINATOR)  # type: ignore[attr-defined]


def test_a_motion_is_withheld_by_the_copy_alone() -> None:
    unseen = given("cfc", window(A))
    assert types(decided(unseen, DecideRoutine(A, "motion"))) == ["RoutinePerformed"]
    seen = given("cfc", CopySynced(fleet_deny=(A,)))
    assert types(decided(seen, DecideRoutine(A, "motion"))) == ["RoutineWithheld"]


def failed(*before) -> State:  # type: ignore[no-untyped-def]
    state = running(*before, ObstructionAppeared(B, "o"))
    play(state, DetectObstruction(ACTION, now_us=9_500_000))
    return state


def test_a_failure_gets_one_ordered_retry() -> None:
    state = failed()
    [attempt] = decided(state, ProcessWork(ACTION, "failure", now_us=10_000_000))
    apply(state, attempt)
    [report] = decided(state, EndAttempt(ACTION, 1))
    assert type(report).__name__ == "RecoveryAttemptFailed"
    assert types(decided(state, ProcessWork(ACTION, "retry-failed"))) == ["AssistanceRequested"]


def test_a_retry_says_of_which_failure_it_is_also_when_it_has_failed() -> None:
    state = failed()
    state.recovery = {ACTION: msgspec.structs.replace(state.recovery[ACTION], failure=2)}
    attempt = only(RecoveryAttempted, decided(state, ProcessWork(ACTION, "failure", now_us=10_000_000)))
    assert (attempt.failure, attempt.number) == (2, 1)
    report = only(RecoveryAttemptFailed, decided(state, EndAttempt(ACTION, 1)))
    assert (report.failure, report.number) == (2, 1)


def test_a_robot_that_the_copy_shows_degraded_gets_no_retry() -> None:
    state = failed(ActuatorDegraded(B))
    apply(state, CopySynced(degraded=(B,)))
    assert types(decided(state, ProcessWork(ACTION, "failure"))) == ["AssistanceRequested"]


def test_a_busy_helper_declines_and_the_next_is_tried() -> None:
    state = failed()
    [order] = decided(state, ProcessWork(ACTION, "retry-failed"))
    apply(state, order)
    state.execution = msgspec.structs.replace(state.execution, current={order.helper: "something"})  # type: ignore[attr-defined]
    assert types(decided(state, ReachHelper(ACTION, order.helper))) == ["AssistanceDeclined"]  # type: ignore[attr-defined]
    [second] = decided(state, ProcessWork(ACTION, "declined"))
    assert second.helper != order.helper  # type: ignore[attr-defined]


def test_without_an_idle_helper_the_fleet_supervisor_is_called() -> None:
    state = failed()
    apply(state, CopySynced(busy=(A, D)))
    assert types(decided(state, ProcessWork(ACTION, "retry-failed"))) == ["RecoveryEscalated", "SupervisorCalled"]


def test_the_copy_shows_the_robots_as_they_are_at_the_sync() -> None:
    [copy] = play(running(window(C), window(D, "review", "fleet"), ActuatorDegraded(A)), Sync())
    assert (copy.local_deny, copy.fleet_review, copy.busy) == (("robot/C1",), ("robot/D1",), ("robot/B1",))
    assert copy.degraded == ("robot/A1",)


def test_the_next_sync_is_never_now() -> None:
    state = given("cfc")
    period = state.fleet.structure.sync_period_us
    assert until_next_sync_us(state.fleet, state.knowledge, period) == period + 1
    assert until_next_sync_us(state.fleet, state.knowledge, period - 1) == 2


def test_a_step_given_up_before_the_coordinator_comes_to_it_is_denied_by_the_coordinator() -> None:
    for begun in (DELEGATED_STEP, OWN_STEP):
        state = given("cfc", ARRIVED, begun, WorkQueued(Subject("A1-9", "A1-9/1.1"), "step", 900_000_000))
        made = decided(state, ReachCoordinator(begun.subject.action_id, "step", now_us=2_000_000))
        denied = [event for event in made if isinstance(event, RequestDenied)]
        assert len(denied) == 1
        assert (denied[0].principals.decided_by, denied[0].principals.path) == ("coordinator", ("coordinator",))
        assert denied[0].reason == "no time left"
        assert types(made)[-2:] == ["RequestDenied", "TaskAbandoned"]
        happen(state, *made)
        assert all(react(state, denied[0], 2_000_000) == () for react in CFC.reacts[RequestDenied]), (
            "nobody turns to it again"
        )
