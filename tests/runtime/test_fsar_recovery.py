"""FSAR's recovery, outsiders and ways: given events, when a command, then events."""

import msgspec

from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import Subject
from fsar_ledger.events.execution import ApproachStarted
from fsar_ledger.events.recovery import AssistanceEnded, FailureResolved
from fsar_ledger.events.registry import RegistryQueried
from fsar_ledger.events.world import ObstructionAppeared, ObstructionCleared, OutsiderRequestInjected
from fsar_ledger.projections.fold import apply
from fsar_ledger.runtime.architectures.fsar.authority import AnswerOutsider
from fsar_ledger.runtime.architectures.fsar.execution import DecideOwnStep
from fsar_ledger.runtime.architectures.fsar.recovery import AskPeers, ConsiderReassignment, StartRecovery
from fsar_ledger.runtime.handlers.commands import DetectObstruction, EndAttempt, StartAction
from fsar_ledger.runtime.handlers.execution import _on_running, start_after_approach
from tests import past
from tests.runtime.histories import ARRIVED, OWN_STEP, A, B, C, D, given, types, window
from tests.runtime.live import decided, play
from tests.runtime.test_fsar import executing


def failed(own: bool = False):  # type: ignore[no-untyped-def]
    state, action_id = executing(ObstructionAppeared(A if own else B, "o"), own=own)
    play(state, DetectObstruction(action_id, now_us=9_500_000))
    return state, action_id


def test_recovery_begins_at_the_robot_and_goes_outward_without_skipping() -> None:
    state, action_id = failed()
    play(state, StartRecovery(action_id), EndAttempt(action_id, 1, now_us=11_000_000))
    _, local = play(state, EndAttempt(action_id, 2, now_us=13_000_000))
    assert types(decided(state, AskPeers(action_id))) == ["AssistanceRequested", "AssistanceAdmitted"]
    apply(state, window(A))
    [peer] = play(state, AskPeers(action_id))
    reassigned, fleet, called = decided(state, ConsiderReassignment(action_id))
    assert (reassigned.helper, type(called).__name__) == (None, "SupervisorCalled")  # type: ignore[attr-defined]
    levels = [(one.level, one.to_level) for one in (local, peer, fleet)]  # type: ignore[union-attr]
    assert levels == [("local", "peer"), ("peer", "fleet"), ("fleet", "human")]


def test_a_failed_carry_is_reassigned_to_a_trusted_substitute() -> None:
    step = past.began(OWN_STEP.subject, A, 1, "carry.package")
    state = given("fsar", ARRIVED, step, ObstructionAppeared(A, "o"))
    play(state, DecideOwnStep("A1-1/1.1"), StartAction("A1-1/1.1", now_us=5, answer=7_000_000))
    play(state, DetectObstruction("A1-1/1.1", now_us=6))
    state.recovery = {"A1-1/1.1": msgspec.structs.replace(state.recovery["A1-1/1.1"], level="fleet")}
    reassigned = decided(state, ConsiderReassignment("A1-1/1.1"))
    assert reassigned[0].helper == "robot/D1"  # type: ignore[attr-defined]
    assert types(reassigned)[1:] == ["FailureResolved", "ExecutionWithdrawn", "TaskStateTransferred", "ExecutionQueued"]


def test_an_outsider_finds_nothing_and_is_denied_by_the_federation() -> None:
    injected = OutsiderRequestInjected(task_id="injected-1-1", robot=D, peer=C, capability="inspect.private_zone")
    query, denied = decided(given("fsar", injected), AnswerOutsider("injected-1-1"))
    assert isinstance(query, RegistryQueried)
    assert (query.candidates, query.principals.executed_by, query.rejected) == ((), "robot/C1", ("robot/C1",))
    assert query.rejected_by == ("visibility",)
    assert denied.principals.decided_by == "service/registry"  # type: ignore[attr-defined]


def test_without_trust_evaluation_the_outsider_runs_under_contested_audit() -> None:
    injected = OutsiderRequestInjected(task_id="injected-1-1", robot=D, peer=C, capability="inspect.private_zone")
    events = decided(given("fsar", injected, configuration="without-trust-evaluation"), AnswerOutsider("injected-1-1"))
    assert {
        event.claimant for event in events if isinstance(event, AuthorityClaimed) and event.dimension == "audit"
    } == {"robot/D1", "supervisor/fleet"}


def test_an_execution_that_starts_in_the_way_of_something_finishes_if_that_goes_at_once() -> None:
    state, action_id = executing(ObstructionAppeared(B, "o"))
    started = past.started(Subject("A1-1", action_id), B, A, "door.open.secure", 11_000_000, past.parties())
    scheduled = [type(one.command).__name__ for one in _on_running(state, started, 9_000_000)]
    assert scheduled == ["DetectObstruction", "FinishAttempt"]
    apply(state, ObstructionCleared(B, "o"))
    assert decided(state, DetectObstruction(action_id, now_us=9_000_001)) == ()


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


def test_a_second_approach_for_an_action_is_another_way() -> None:
    state, action_id = failed()
    way = ApproachStarted(Subject("A1-1", action_id), B)
    again = start_after_approach(state, way, 0)[0].waits[0].key
    first = start_after_approach(executing()[0], way, 0)[0].waits[0].key
    assert (first, again) == (action_id, f"{action_id}/1")
