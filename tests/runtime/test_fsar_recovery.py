"""FSAR's recovery, outsiders and ways: given events, when a command, then events."""

from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import Subject
from fsar_ledger.events.execution import ApproachStarted
from fsar_ledger.events.recovery import AssistanceEnded, FailureResolved
from fsar_ledger.events.registry import RegistryQueried
from fsar_ledger.events.world import ObstructionAppeared, ObstructionCleared, OutsiderRequestInjected
from fsar_ledger.projections.fold import apply
from fsar_ledger.runtime.architectures.fsar.authority import AnswerOutsider
from fsar_ledger.runtime.handlers.commands import DetectObstruction
from fsar_ledger.runtime.handlers.execution import _on_running, start_after_approach
from tests import past
from tests.runtime.histories import given
from tests.runtime.live import decided, play
from tests.runtime.test_fsar import A, B, C, D, executing


def failed(own: bool = False):  # type: ignore[no-untyped-def]
    state, action_id = executing(ObstructionAppeared(A if own else B, "o"), own=own)
    play(state, DetectObstruction(action_id, now_us=9_500_000))
    return state, action_id


def test_an_outsider_finds_nothing_and_is_denied_by_the_federation() -> None:
    injected = OutsiderRequestInjected(task_id="injected-1-1", robot=D, peer=C, capability="inspect.private_zone")
    query, denied = decided(given("fsar", injected), AnswerOutsider("injected-1-1"))
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
