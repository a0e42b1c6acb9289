"""Recovery by the robot and its peers: given events, when a command, then events.

Paper: eq:recovery, app:foundations.
"""

import pytest

from fsar_ledger.designs.constants import Constants
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot, Subject, Supervisor
from fsar_ledger.events.recovery import AssistanceAdmitted, AssistanceRequested, RecoveryAttempted, RecoveryEscalated
from fsar_ledger.events.registry import RegistryQueried
from fsar_ledger.events.supervision import SupervisorCalled
from fsar_ledger.events.world import ObstructionAppeared
from fsar_ledger.projections.fold import State, apply
from fsar_ledger.runtime.architectures.fsar.recovery import AskPeers, CallNext, ConsiderReassignment, StartRecovery
from fsar_ledger.runtime.handlers.commands import EndAttempt
from fsar_ledger.runtime.handlers.recovery import budget
from fsar_ledger.runtime.simulation import handler_table_of
from tests import past
from tests.runtime.failures import ACTION, A, B, C, D, executing, failed, taken
from tests.runtime.histories import types, window
from tests.runtime.live import decided
from tests.sure import only


def escalation(events: tuple[Event, ...]) -> tuple[str, str, str | None]:
    """From which level to which, and why."""
    [found] = [event for event in events if isinstance(event, RecoveryEscalated)]
    return found.level, found.to_level, found.reason


def called(events: tuple[Event, ...]) -> str:
    """The supervisor who is called."""
    [call] = [event for event in events if isinstance(event, SupervisorCalled)]
    return call.supervisor


# Level 1: local


def test_local_recovery_is_left_when_its_attempts_are_spent() -> None:
    state = failed(executing(A, "carry.package", ObstructionAppeared(A, "o")))
    first = only(RecoveryAttempted, taken(state, decided(state, StartRecovery(ACTION, now_us=2_000_001))))
    assert (first.number, first.deadline_us) == (1, 32_000_000)
    assert escalation(decided(state, EndAttempt(ACTION, 1, now_us=60_000_000)))[2] == "budget exhausted"
    found = types(taken(state, decided(state, EndAttempt(ACTION, 1, now_us=4_000_000))))
    assert found == ["RecoveryAttemptFailed", "RecoveryAttempted"]
    assert escalation(decided(state, EndAttempt(ACTION, 2, now_us=6_000_000))) == ("local", "peer", "budget exhausted")


def test_a_robots_own_budget_replaces_the_fleets() -> None:
    state = failed(executing(A, "carry.package", ObstructionAppeared(A, "o"), past.budget(A, "local", 1)))
    taken(state, decided(state, StartRecovery(ACTION, now_us=2_000_001)))
    assert escalation(decided(state, EndAttempt(ACTION, 1, now_us=4_000_000))) == ("local", "peer", "budget exhausted")
    assert budget(state.budget, state.fleet, A, "local").n_max == 1
    assert budget(state.budget, state.fleet, B, "local").n_max == Constants().structure.local_attempts


@pytest.mark.parametrize("spent", [(0, 2), (30_000_000, 0)])
def test_a_level_without_budget_is_recorded_and_left_at_once(spent: tuple[int, int]) -> None:
    state = failed(executing(A, "carry.package", past.budget(A, "local", spent[1], spent[0])))
    outward = decided(state, StartRecovery(ACTION, now_us=2_000_001))
    assert types(outward) == ["RecoveryEscalated"]
    assert escalation(outward) == ("local", "peer", "budget exhausted")


def test_without_layered_recovery_the_one_escalation_says_so() -> None:
    state = failed(executing(configuration="without-layered-recovery"))
    found = decided(state, StartRecovery(ACTION))
    assert escalation(found) == ("local", "human", "no layered recovery")
    assert called(found) == "supervisor/fleet"


# Level 2: peers


def asked(state: State, now_us: int = 3_000_000) -> tuple[Event, ...]:
    return decided(state, AskPeers(ACTION, 2_500_000, now_us=now_us))


def test_a_peer_with_a_task_scope_clears_the_way() -> None:
    requested, admitted = asked(failed(executing(B, "door.open.basic"), "peer"))
    assert isinstance(requested, AssistanceRequested)
    assert isinstance(admitted, AssistanceAdmitted)
    assert (requested.principals.decided_by, admitted.principals.decided_by, admitted.helper) == (B, A, A)


@pytest.mark.parametrize(
    ("robot", "capability", "before", "reason"),
    [
        (D, "carry.heavy", (), "no trusted peer"),  # capability scope does not cover assistance
        (B, "door.open.basic", (past.revoked(B, decided_by=Supervisor("supervisor/B1")),), "authority"),
        (B, "door.open.basic", (window(A),), "policy"),
        (B, "door.open.basic", (window(B),), "policy"),
    ],
)
def test_a_peer_level_that_has_nothing_to_try_says_why(
    robot: Robot, capability: str, before: tuple[Event, ...], reason: str
) -> None:
    assert escalation(asked(failed(executing(robot, capability, *before), "peer"))) == ("peer", "fleet", reason)


def test_a_busy_peer_does_not_help() -> None:
    state = failed(executing(B, "door.open.basic"), "peer")
    busy = past.queued(Subject("A1-2", "A1-2/1.1"), A, A, "carry.package")
    apply(state, busy)
    assert escalation(asked(state)) == ("peer", "fleet", "peer busy")


def test_a_degraded_robot_asks_the_registry_for_the_family_of_its_capability() -> None:
    query, outward = asked(failed(executing(D, "grasp.robust"), "peer", "degradation"))
    assert isinstance(query, RegistryQueried)
    assert (query.principals.requested_by, query.capability, query.candidates, query.rejected) == (D, "grasp.*", (), ())
    assert escalation((outward,)) == ("peer", "fleet", "no capable peer")


def test_the_answer_says_why_a_peer_of_the_family_is_no_help() -> None:
    query, _ = asked(failed(executing(D, "carry.heavy"), "peer", "degradation"))
    assert isinstance(query, RegistryQueried)
    assert (query.rejected, query.rejected_by) == ((A,), ("contract",))
    untrusting = (past.installed(C, "carry.heavy"), past.advertised(C, "carry.heavy"))
    query, outward = asked(failed(executing(D, "carry.heavy", *untrusting), "peer", "degradation"))
    assert isinstance(query, RegistryQueried)
    assert (query.rejected, query.rejected_by) == ((A, C), ("contract", "trust"))
    assert escalation((outward,)) == ("peer", "fleet", "no trusted peer")


def test_a_robot_that_is_offline_neither_helps_nor_takes_over() -> None:
    offline = past.available(D, None, "offline", "charging")
    query, outward = asked(failed(executing(A, "carry.package", offline), "peer", "degradation"))
    assert isinstance(query, RegistryQueried)
    assert (query.rejected, query.rejected_by) == ((D,), ("availability",))
    assert escalation((outward,)) == ("peer", "fleet", "no capable peer")
    found = escalation(considered(failed(executing(A, "carry.package", offline), "fleet")))[2]
    assert found == "no feasible reassignment: no capable robot"


def test_a_substitute_stands_in_for_a_degraded_robot() -> None:
    query, requested, admitted = asked(failed(executing(A, "carry.package"), "peer", "degradation"))
    assert isinstance(query, RegistryQueried)
    assert query.candidates == (D,)
    assert isinstance(admitted, AssistanceAdmitted)
    assert (types((requested,)), admitted.helper) == (["AssistanceRequested"], D)


def test_the_query_of_a_recovery_starts_no_request() -> None:
    state = failed(executing(D, "grasp.robust"), "peer", "degradation")
    before = state.request
    query = asked(state)[0]
    apply(state, query)
    assert state.request == before
    assert [react(state, query, 3_000_000) for react in handler_table_of("fsar").reacts[RegistryQueried]] == [()]


def test_a_spent_peer_budget_ends_the_peer_level() -> None:
    found = escalation(asked(failed(executing(B, "door.open.basic"), "peer"), now_us=40_000_000))
    assert found == ("peer", "fleet", "budget exhausted")
    closed = past.budget(B, "peer", 0)
    told = escalation(asked(failed(executing(B, "door.open.basic", closed), "peer")))
    assert told == ("peer", "fleet", "budget exhausted")


def test_without_a_registry_no_peer_can_be_found() -> None:
    state = failed(executing(B, "door.open.basic", configuration="without-shared-registry"), "peer", "degradation")
    found = asked(state)
    assert types(found) == ["RecoveryEscalated"]
    assert escalation(found) == ("peer", "fleet", "no shared registry")


# Level 3: reassignment


def considered(state: State, now_us: int = 3_000_000) -> tuple[Event, ...]:
    return decided(state, ConsiderReassignment(ACTION, 2_500_000, now_us=now_us))


# Actuators


def test_stale_commands_do_nothing() -> None:
    state = failed(executing(), "human")
    for command in (
        StartRecovery("gone"),
        StartRecovery(ACTION),
        EndAttempt(ACTION, 1),
        AskPeers(ACTION),
        ConsiderReassignment(ACTION),
        CallNext(ACTION, 2, 0),
    ):
        assert handler_table_of("fsar").decides[type(command)](state, command) == ()
