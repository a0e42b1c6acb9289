"""Recovery by another robot or by people: given events, when a command, then events.

Paper: eq:recovery, app:foundations.
"""

import pytest

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityRevoked
from fsar_ledger.events.envelope import Parties, Robot, Subject, Supervisor
from fsar_ledger.events.execution import ExecutionQueued
from fsar_ledger.events.policy import PolicyRuleSet
from fsar_ledger.events.recovery import FailureResolved, ReassignmentDecided, RecoveryBudgetSet, TaskStateTransferred
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
from fsar_ledger.projections.fold import apply
from fsar_ledger.runtime.architectures.fsar.recovery import (
    AskPeers,
    CallNext,
    ConsiderReassignment,
    StartRecovery,
    call_next,
)
from fsar_ledger.runtime.handlers.commands import Command, EndAttempt
from fsar_ledger.runtime.handlers.trust import trusts
from fsar_ledger.runtime.simulation import handler_table_of
from tests.runtime.failures import ACTION, A, B, C, D, executing, failed, taken
from tests.runtime.histories import types, window
from tests.runtime.test_recovery import asked, called, considered, escalation


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
