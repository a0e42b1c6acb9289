"""Recovery by another robot or by people: given events, when a command, then events.

Paper: eq:recovery, app:foundations.
"""

import pytest

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot, Subject, Supervisor
from fsar_ledger.events.execution import ExecutionQueued
from fsar_ledger.events.recovery import FailureResolved, ReassignmentDecided, TaskStateTransferred
from fsar_ledger.events.registry import CapabilityAdvertised, CapabilityWithdrawn, RegistryQueried
from fsar_ledger.events.supervision import SupervisorCalled
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
from tests import past
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
        (A, "carry.package", (past.trusted(D, A, "none"),), "no trusted robot"),
        (A, "carry.package", (past.revoked(A, D),), "authority"),
        (A, "carry.package", (past.revoked(D, A),), ""),  # the other way round
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
    apply(state, past.queued(Subject("D1-2", "D1-2/1.1"), D, D, "carry.heavy"))
    assert escalation(considered(state)) == ("fleet", "human", "no feasible reassignment: robot busy")


def test_a_spent_fleet_budget_ends_the_fleet_level() -> None:
    closed = past.budget(A, "fleet", 0)
    events = considered(failed(executing(A, "carry.package", closed), "fleet"))
    assert types(events) == ["RecoveryEscalated", "SupervisorCalled"]
    assert escalation(events) == ("fleet", "human", "budget exhausted")
    assert escalation(considered(failed(executing(), "fleet"), now_us=40_000_000))[2] == "budget exhausted"


HEAVY = (D, "carry.heavy")


@pytest.mark.parametrize(
    ("before", "reason", "left_out_by"),
    [
        (past.advertised(D, "carry.heavy", trust_required="persistent"), "no trusted", "trust"),
        (past.advertised(D, "carry.heavy", visible_to=("Z",)), "no capable", "visibility"),
        (past.advertised(D, "carry.heavy", visibility="trust-gated"), "", None),
        (past.advertised(D, "carry.heavy", policy_required=("other",)), "policy", "policy"),
        (past.advertised(D, "carry.heavy", policy_required=("A1-1",)), "", None),
        (CapabilityWithdrawn(D, "carry.heavy", "jammed"), "no capable", None),
        (past.available(D, "carry.heavy", "restricted", "inspection"), "no capable", "availability"),
        (past.trusted(D, A, "none", "carry.heavy"), "no trusted", "trust"),
        (past.trusted(D, A, "none", "carry.package"), "no trusted", "trust"),
        (past.ruled("deny", D, "carry.heavy"), "policy", "policy"),
        (past.ruled("review", A, "carry.heavy"), "policy", None),
        (past.ruled_for_all("deny", None, "carry.heavy"), "policy", None),
        (past.revoked(A, D, "carry.heavy"), "authority", None),
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
            past.installed(B, "carry.heavy"),
            CapabilityAdvertised(robot=B, capability="carry.heavy", **terms),
            past.trusted(B, D, "session"),
        )
        assert escalation(asked(failed(executing(D, "carry.heavy", *owned), "peer", "degradation")))[2] == reason


def test_where_one_capability_does_not_suit_another_of_the_same_robot_may() -> None:
    owned = (past.installed(D, "carry.package"), past.advertised(D, "carry.package", trust_required="persistent"))
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
    apply(state, past.called(Subject("A1-1", ACTION), Supervisor("supervisor/D1"), "recovery"))
    late = [
        one
        for react in handler_table_of("fsar").reacts[SupervisorCalled]
        for one in react(state, past.called(Subject("A1-1", ACTION), Supervisor(""), "recovery"), 0)
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
    state = failed(executing(D, "carry.heavy", past.installed(C, "carry.heavy"), past.advertised(C, "carry.heavy")))
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
