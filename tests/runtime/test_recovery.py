"""Recovery: given events, when a command, then events. Paper: eq:recovery, app:foundations."""

import pytest

from fsar_ledger.constants import Constants
from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityRevoked
from fsar_ledger.events.envelope import Parties, Robot, Subject, Supervisor
from fsar_ledger.events.execution import ExecutionQueued
from fsar_ledger.events.policy import PolicyRuleSet
from fsar_ledger.events.recovery import (
    AssistanceAdmitted,
    AssistanceRequested,
    FailureResolved,
    ReassignmentDecided,
    RecoveryAttempted,
    RecoveryBudgetSet,
    RecoveryEscalated,
    TaskStateTransferred,
)
from fsar_ledger.events.registry import (
    AvailabilityChanged,
    CapabilityAdvertised,
    CapabilityInstalled,
    CapabilityWithdrawn,
    RegistryQueried,
)
from fsar_ledger.events.supervision import SupervisorCalled
from fsar_ledger.events.trust import TrustSet
from fsar_ledger.events.world import ObstructionAppeared, SupervisorLeft, SupervisorReturned
from fsar_ledger.projections.fold import State, apply
from fsar_ledger.runtime.architectures.fsar.recovery import (
    AskPeers,
    CallNext,
    ConsiderReassignment,
    StartRecovery,
    ask_peers,
    call_next,
    consider_reassignment,
    end_attempt,
    start_recovery,
)
from fsar_ledger.runtime.handler_tables import handler_table_of
from fsar_ledger.runtime.handlers.commands import Command, EndAttempt
from fsar_ledger.runtime.handlers.recovery import budget
from fsar_ledger.runtime.handlers.trust import trusts
from tests.runtime.failures import ACTION, A, B, C, D, executing, failed, taken
from tests.runtime.histories import types, window


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
    [first] = taken(state, start_recovery(state, StartRecovery(ACTION, now_us=2_000_001)))
    assert isinstance(first, RecoveryAttempted)
    assert (first.number, first.deadline_us) == (1, 32_000_000)
    assert types(taken(state, end_attempt(state, EndAttempt(ACTION, 1, now_us=4_000_000)))) == [
        "RecoveryAttemptFailed",
        "RecoveryAttempted",
    ]
    assert escalation(end_attempt(state, EndAttempt(ACTION, 2, now_us=6_000_000))) == (
        "local",
        "peer",
        "budget exhausted",
    )


def test_a_robots_own_budget_replaces_the_fleets() -> None:
    state = failed(
        executing(
            A,
            "carry.package",
            ObstructionAppeared(A, "o"),
            RecoveryBudgetSet(
                robot=A, level="local", t_max_us=30_000_000, n_max=1, decided_by=Supervisor("supervisor/A1")
            ),
        )
    )
    taken(state, start_recovery(state, StartRecovery(ACTION, now_us=2_000_001)))
    assert escalation(end_attempt(state, EndAttempt(ACTION, 1, now_us=4_000_000))) == (
        "local",
        "peer",
        "budget exhausted",
    )
    assert budget(state, A, "local").n_max == 1
    assert budget(state, B, "local").n_max == Constants().structure.local_attempts


@pytest.mark.parametrize("spent", [(0, 2), (30_000_000, 0)])
def test_a_level_without_budget_is_recorded_and_left_at_once(spent: tuple[int, int]) -> None:
    state = failed(
        executing(
            A,
            "carry.package",
            RecoveryBudgetSet(
                robot=A, level="local", t_max_us=spent[0], n_max=spent[1], decided_by=Supervisor("supervisor/A1")
            ),
        )
    )
    outward = start_recovery(state, StartRecovery(ACTION, now_us=2_000_001))
    assert types(outward) == ["RecoveryEscalated"]
    assert escalation(outward) == ("local", "peer", "budget exhausted")


def test_without_layered_recovery_the_one_escalation_says_so() -> None:
    state = failed(executing(configuration="without-layered-recovery"))
    found = start_recovery(state, StartRecovery(ACTION))
    assert escalation(found) == ("local", "human", "no layered recovery")
    assert called(found) == "supervisor/fleet"


# Level 2: peers


def asked(state: State, now_us: int = 3_000_000) -> tuple[Event, ...]:
    return ask_peers(state, AskPeers(ACTION, 2_500_000, now_us=now_us))


def test_a_peer_with_a_task_scope_clears_the_way() -> None:
    requested, admitted = asked(failed(executing(B, "door.open.basic"), "peer"))
    assert isinstance(requested, AssistanceRequested)
    assert isinstance(admitted, AssistanceAdmitted)
    assert (requested.principals.decided_by, admitted.principals.decided_by, admitted.helper) == (B, A, A)


@pytest.mark.parametrize(
    ("robot", "capability", "before", "reason"),
    [
        (D, "carry.heavy", (), "no trusted peer"),  # capability scope does not cover assistance
        (
            B,
            "door.open.basic",
            (
                AuthorityRevoked(
                    requested_by=B,
                    executed_by=None,
                    capability=None,
                    context=None,
                    reason="human override",
                    decided_by=Supervisor("supervisor/B1"),
                ),
            ),
            "authority",
        ),
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
    busy = ExecutionQueued(
        subject=Subject("A1-2", "A1-2/1.1"),
        principals=Parties(requested_by=A, executed_by=A, supervised_by=None),
        robot=A,
        on_behalf_of=A,
        capability="carry.package",
        step=1,
        attempt=1,
        is_delegated=False,
        has_approach=False,
        is_supervised=True,
    )
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
    untrusting = (
        CapabilityInstalled(robot=C, capability="carry.heavy", version="1.0.0"),
        CapabilityAdvertised(robot=C, capability="carry.heavy"),
    )
    query, outward = asked(failed(executing(D, "carry.heavy", *untrusting), "peer", "degradation"))
    assert isinstance(query, RegistryQueried)
    assert (query.rejected, query.rejected_by) == ((A, C), ("contract", "trust"))
    assert escalation((outward,)) == ("peer", "fleet", "no trusted peer")


def test_a_robot_that_is_offline_neither_helps_nor_takes_over() -> None:
    offline = AvailabilityChanged(robot=D, capability=None, availability="offline", reason="charging")
    query, outward = asked(failed(executing(A, "carry.package", offline), "peer", "degradation"))
    assert isinstance(query, RegistryQueried)
    assert (query.rejected, query.rejected_by) == ((D,), ("availability",))
    assert escalation((outward,)) == ("peer", "fleet", "no capable peer")
    assert (
        escalation(considered(failed(executing(A, "carry.package", offline), "fleet")))[2]
        == "no feasible reassignment: no capable robot"
    )


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
    assert escalation(asked(failed(executing(B, "door.open.basic"), "peer"), now_us=40_000_000)) == (
        "peer",
        "fleet",
        "budget exhausted",
    )
    closed = RecoveryBudgetSet(
        robot=B, level="peer", t_max_us=30_000_000, n_max=0, decided_by=Supervisor("supervisor/B1")
    )
    assert escalation(asked(failed(executing(B, "door.open.basic", closed), "peer"))) == (
        "peer",
        "fleet",
        "budget exhausted",
    )


def test_without_a_registry_no_peer_can_be_found() -> None:
    state = failed(executing(B, "door.open.basic", configuration="without-shared-registry"), "peer", "degradation")
    found = asked(state)
    assert types(found) == ["RecoveryEscalated"]
    assert escalation(found) == ("peer", "fleet", "no shared registry")


# Level 3: reassignment


def considered(state: State, now_us: int = 3_000_000) -> tuple[Event, ...]:
    return consider_reassignment(state, ConsiderReassignment(ACTION, 2_500_000, now_us=now_us))


def test_a_step_is_handed_over_at_its_checkpoint_with_the_state_of_the_task() -> None:
    events = considered(failed(executing(checkpoints=("2",)), "fleet"))
    assert types(events) == [
        "ReassignmentDecided",
        "FailureResolved",
        "ExecutionWithdrawn",
        "TaskStateTransferred",
        "ExecutionQueued",
    ]
    decided, _, _, transferred, queued = events
    assert isinstance(decided, ReassignmentDecided)
    assert (decided.helper, decided.checkpoint, decided.reason) == (D, "A1-1/2", None)
    assert transferred == TaskStateTransferred(
        subject=Subject("A1-1", ACTION), robot=A, helper=D, checkpoint="A1-1/2", completed=("A navigate.indoor",)
    )
    assert isinstance(queued, ExecutionQueued)
    assert (queued.robot, queued.on_behalf_of, queued.principals.requested_by) == (D, A, A)


def test_without_a_declared_checkpoint_nobody_takes_over() -> None:
    decided, *outward = considered(failed(executing(checkpoints=("1",)), "fleet"))
    assert isinstance(decided, ReassignmentDecided)
    assert (decided.helper, decided.checkpoint, decided.reason) == (None, None, "no checkpoint")
    assert escalation(tuple(outward)) == ("fleet", "human", "no feasible reassignment: no checkpoint")


@pytest.mark.parametrize(
    ("robot", "capability", "before", "reason"),
    [
        (D, "grasp.robust", (), "no capable robot"),
        (A, "navigate.indoor", (), "the robot's own way"),
        (A, "carry.package", (TrustSet(robot=D, peer=A, scope="none"),), "no trusted robot"),
        (
            A,
            "carry.package",
            (
                AuthorityRevoked(
                    requested_by=A,
                    executed_by=D,
                    capability=None,
                    context=None,
                    reason="human override",
                    decided_by=Supervisor("supervisor/fleet"),
                ),
            ),
            "authority",
        ),
        (
            A,
            "carry.package",
            (
                AuthorityRevoked(
                    requested_by=D,
                    executed_by=A,
                    capability=None,
                    context=None,
                    reason="human override",
                    decided_by=Supervisor("supervisor/fleet"),
                ),
            ),
            "",
        ),  # the other way round
        (A, "carry.package", (window(D),), "policy"),
        (A, "carry.package", (window(A, "review"),), "policy"),
        (A, "carry.package", (window(D, "deny", "fleet"),), ""),  # D has not heard of it
    ],
)
def test_a_robot_takes_over_nothing_that_it_may_not_do(
    robot: Robot, capability: str, before: tuple[Event, ...], reason: str
) -> None:
    decided, *_ = considered(failed(executing(robot, capability, *before), "fleet"))
    assert isinstance(decided, ReassignmentDecided)
    assert (decided.reason or "", decided.helper is None) == (reason, bool(reason))


def test_a_busy_robot_takes_nothing_over() -> None:
    state = failed(executing(), "fleet")
    apply(
        state,
        ExecutionQueued(
            subject=Subject("D1-2", "D1-2/1.1"),
            principals=Parties(requested_by=D, executed_by=D, supervised_by=None),
            robot=D,
            on_behalf_of=D,
            capability="carry.heavy",
            step=1,
            attempt=1,
            is_delegated=False,
            has_approach=False,
            is_supervised=True,
        ),
    )
    assert escalation(considered(state)) == ("fleet", "human", "no feasible reassignment: robot busy")


def test_a_spent_fleet_budget_ends_the_fleet_level() -> None:
    closed = RecoveryBudgetSet(
        robot=A, level="fleet", t_max_us=30_000_000, n_max=0, decided_by=Supervisor("supervisor/A1")
    )
    events = considered(failed(executing(A, "carry.package", closed), "fleet"))
    assert types(events) == ["RecoveryEscalated", "SupervisorCalled"]
    assert escalation(events) == ("fleet", "human", "budget exhausted")
    assert escalation(considered(failed(executing(), "fleet"), now_us=40_000_000))[2] == "budget exhausted"


HEAVY = (D, "carry.heavy")


@pytest.mark.parametrize(
    ("before", "reason", "left_out_by"),
    [
        (CapabilityAdvertised(robot=D, capability="carry.heavy", trust_required="persistent"), "no trusted", "trust"),
        (CapabilityAdvertised(robot=D, capability="carry.heavy", visible_to=("Z",)), "no capable", "visibility"),
        (CapabilityAdvertised(robot=D, capability="carry.heavy", visibility="trust-gated"), "", None),
        (CapabilityAdvertised(robot=D, capability="carry.heavy", policy_required=("other",)), "policy", "policy"),
        (CapabilityAdvertised(robot=D, capability="carry.heavy", policy_required=("A1-1",)), "", None),
        (CapabilityWithdrawn(D, "carry.heavy", "jammed"), "no capable", None),
        (
            AvailabilityChanged(robot=D, capability="carry.heavy", availability="restricted", reason="inspection"),
            "no capable",
            "availability",
        ),
        (TrustSet(robot=D, peer=A, scope="none", capability="carry.heavy"), "no trusted", "trust"),
        (TrustSet(robot=D, peer=A, scope="none", capability="carry.package"), "no trusted", "trust"),
        (
            PolicyRuleSet(
                scope="local",
                robot=D,
                capability="carry.heavy",
                context=None,
                outcome="deny",
                decided_by=Supervisor("supervisor/D1"),
            ),
            "policy",
            "policy",
        ),
        (
            PolicyRuleSet(
                scope="local",
                robot=A,
                capability="carry.heavy",
                context=None,
                outcome="review",
                decided_by=Supervisor("supervisor/A1"),
            ),
            "policy",
            None,
        ),
        (
            PolicyRuleSet(
                scope="fleet",
                robot=None,
                capability="carry.heavy",
                context=None,
                outcome="deny",
                decided_by=Supervisor("supervisor/fleet"),
            ),
            "policy",
            None,
        ),
        (
            AuthorityRevoked(
                requested_by=A,
                executed_by=D,
                capability="carry.heavy",
                context=None,
                reason="human override",
                decided_by=Supervisor("supervisor/fleet"),
            ),
            "authority",
            None,
        ),
    ],
)
def test_a_substitute_is_asked_for_its_own_capability_on_its_own_terms(
    before: Event, reason: str, left_out_by: str | None
) -> None:
    query, *helped = asked(failed(executing(A, "carry.package", before), "peer", "degradation"))
    assert isinstance(query, RegistryQueried)
    assert dict(zip(query.rejected, query.rejected_by, strict=True)).get(D) == left_out_by
    found = escalation(tuple(helped))[2] if reason else ""
    assert (found or "").removesuffix(" peer") == reason
    assert ("AssistanceAdmitted" in types(tuple(helped))) is not bool(reason)
    decided, *_ = considered(failed(executing(A, "carry.package", before), "fleet"))
    assert isinstance(decided, ReassignmentDecided)
    assert (decided.reason or "").removesuffix(" robot") == reason


def test_a_robot_with_the_same_capability_is_asked_on_the_terms_of_its_advertisement() -> None:
    for terms, reason in (
        ({"trust_required": "persistent"}, "no trusted peer"),
        ({"visible_to": ("Z",)}, "no capable peer"),
        ({"policy_required": ("other",)}, "policy"),
    ):
        owned = (
            CapabilityInstalled(robot=B, capability="carry.heavy", version="1.0.0"),
            CapabilityAdvertised(robot=B, capability="carry.heavy", **terms),
            TrustSet(robot=B, peer=D, scope="session"),
        )
        assert escalation(asked(failed(executing(D, "carry.heavy", *owned), "peer", "degradation")))[2] == reason


def test_where_one_capability_does_not_suit_another_of_the_same_robot_may() -> None:
    owned = (
        CapabilityInstalled(robot=D, capability="carry.package", version="1.0.0"),
        CapabilityAdvertised(robot=D, capability="carry.package", trust_required="persistent"),
    )
    query, *helped = asked(failed(executing(A, "carry.package", *owned), "peer", "degradation"))
    assert isinstance(query, RegistryQueried)
    assert (query.candidates, query.rejected) == ((D,), ())
    assert types(tuple(helped)) == ["AssistanceRequested", "AssistanceAdmitted"]


# Level 4: people


def test_a_failure_of_the_robots_own_step_goes_to_its_own_supervisor() -> None:
    assert called(considered(failed(executing(D, "grasp.robust", owner=D), "fleet"))) == "supervisor/D1"


def test_a_failure_that_concerns_others_goes_to_the_fleet_supervisor() -> None:
    own_step_in_anothers_task = failed(executing(D, "grasp.robust", owner=A), "fleet")
    for_another = failed(executing(D, "grasp.robust", owner=A, behalf=A), "fleet")
    assert [called(considered(state)) for state in (own_step_in_anothers_task, for_another)] == ["supervisor/fleet"] * 2


def test_a_supervisor_who_is_off_shift_is_not_called() -> None:
    left, back = SupervisorLeft(Supervisor("supervisor/D1")), SupervisorReturned(Supervisor("supervisor/D1"))
    assert called(considered(failed(executing(D, "grasp.robust", left, owner=D), "fleet"))) == "supervisor/fleet"
    assert called(considered(failed(executing(D, "grasp.robust", left, back, owner=D), "fleet"))) == "supervisor/D1"


def test_a_supervisor_who_does_not_answer_in_time_is_followed_by_the_fleets_once() -> None:
    state = failed(executing(D, "grasp.robust", owner=D), "human")
    apply(
        state,
        SupervisorCalled(subject=Subject("A1-1", ACTION), supervisor=Supervisor("supervisor/D1"), purpose="recovery"),
    )
    late = [
        one
        for react in handler_table_of("fsar").reacts[SupervisorCalled]
        for one in react(
            state, SupervisorCalled(subject=Subject("A1-1", ACTION), supervisor=Supervisor(""), purpose="recovery"), 0
        )
    ]
    assert [(one.command, one.after_us) for one in late if isinstance(one.command, CallNext)] == [
        (CallNext(ACTION, 1, 1), 120_000_000)
    ]
    assert called(taken(state, call_next(state, CallNext(ACTION, 1, 1)))) == "supervisor/fleet"
    assert call_next(state, CallNext(ACTION, 1, 1)) == ()
    assert call_next(state, CallNext(ACTION, 1, 2)) == ()
    apply(state, FailureResolved(Subject("A1-1", ACTION), D, 1, "human"))
    assert call_next(state, CallNext(ACTION, 1, 2)) == ()


def test_a_failure_creates_no_authority() -> None:
    state = failed(
        executing(
            D,
            "carry.heavy",
            CapabilityInstalled(robot=C, capability="carry.heavy", version="1.0.0"),
            CapabilityAdvertised(robot=C, capability="carry.heavy"),
        )
    )
    trust, rights = state.trust, state.authority
    commands: tuple[Command, ...] = (
        StartRecovery(ACTION, now_us=2_000_001),
        EndAttempt(ACTION, 1, now_us=4_000_000),
        EndAttempt(ACTION, 2, now_us=6_000_000),
        AskPeers(ACTION, 6_000_000, now_us=6_100_000),
        ConsiderReassignment(ACTION, 6_100_000, now_us=6_900_000),
    )
    apply(state, ObstructionAppeared(D, "o"))
    for command in commands:
        taken(state, handler_table_of("fsar").decides[type(command)](state, command))
    assert state.recovery[ACTION].level == "human"
    assert not trusts(state, C, D, "carry.heavy", "A1-1")
    assert (state.trust, state.authority) == (trust, rights)


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
