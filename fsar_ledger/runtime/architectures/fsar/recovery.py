"""FSAR: recovery starts at the robot and goes outward level by level. Paper: eq:recovery, sec:model:recovery."""

from typing import Any

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import FLEET_SUPERVISOR, RECOVERY
from fsar_ledger.events.execution import ExecutionFailed, ExecutionQueued, ExecutionWithdrawn
from fsar_ledger.events.recovery import (
    AssistanceAdmitted,
    AssistanceEnded,
    AssistanceRequested,
    FailureResolved,
    ReassignmentDecided,
    RecoveryAttempted,
    RecoveryEscalated,
)
from fsar_ledger.events.supervision import SupervisorCalled
from fsar_ledger.projections.execution import Action
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.recovery import Recovery
from fsar_ledger.projections.trust import scope_of
from fsar_ledger.projections.world import stricter
from fsar_ledger.runtime.handlers.attribution import helpers, is_idle, on_shift, principals, stand_ins
from fsar_ledger.runtime.handlers.commands import Command, Decides, Draw, EndAssistance, EndAttempt, Reacts, Scheduled, message
from fsar_ledger.runtime.handlers.execution import NAVIGATION
from fsar_ledger.runtime.handlers.policy import compose, own_policy
from fsar_ledger.runtime.handlers.recovery import attempt_succeeds, open_failure

from .authority import released

ASSISTING_SCOPES = ("task", "session", "persistent")  # capability scope does not cover assistance


class StartRecovery(Command):
    """A failure was detected."""

    action_id: str


class AskPeers(Command):
    """The question for help has reached the peers."""

    action_id: str


class ConsiderReassignment(Command):
    """The failure has reached the recovery orchestrator."""

    action_id: str


def _context(state: State, action: Action, decided_by: str, is_decision: bool = True) -> dict[str, Any]:
    path = (decided_by,) if is_decision else ()
    return {"task_id": action.task_id, "action_id": action.action_id, "decided_by": decided_by, **principals(state, action), "path": path}


def _escalated(state: State, action: Action, recovery: Recovery, to_level: Any, decided_by: str, is_decision: bool = True) -> RecoveryEscalated:
    return RecoveryEscalated(
        **_context(state, action, decided_by, is_decision),
        robot=action.robot,
        failure=recovery.failure,
        level=recovery.level,
        to_level=to_level,
        failed_action=action.action_id,
    )


def _attempted(state: State, action: Action, recovery: Recovery, deadline_us: int) -> RecoveryAttempted:
    return RecoveryAttempted(
        **_context(state, action, action.robot),
        robot=action.robot,
        failure=recovery.failure,
        number=recovery.number + 1,
        level="local",
        deadline_us=deadline_us,
        failed_action=action.action_id,
    )


def start_recovery(state: State, command: StartRecovery) -> tuple[Event, ...]:
    """The robot has begun to recover by itself; without layered recovery H_F is called at once."""
    match open_failure(state, command.action_id):
        case None:
            return ()
        case action, recovery:
            if state.fleet.configuration == "without-layered-recovery":
                called = SupervisorCalled(action.task_id, action.action_id, FLEET_SUPERVISOR, "recovery")
                return (_escalated(state, action, recovery, "human", action.robot), called)
            deadline_us = recovery.detected_us + state.fleet.structure.local_budget_us
            return (_attempted(state, action, recovery, deadline_us),)


def end_attempt(state: State, command: EndAttempt) -> tuple[Event, ...]:
    """The failure is resolved, or the next attempt has begun, or the budget is spent and recovery goes to the peers."""
    match open_failure(state, command.action_id):
        case action, recovery if recovery.number == command.number and recovery.level == "local":
            if attempt_succeeds(state, recovery, command):
                return (FailureResolved(action.task_id, action.action_id, action.robot, recovery.failure, "local"),)
            structure = state.fleet.structure
            if recovery.number < structure.local_attempts and command.now_us < recovery.deadline_us:
                return (_attempted(state, action, recovery, recovery.deadline_us),)
            return (_escalated(state, action, recovery, "peer", action.robot),)
        case _:
            return ()


def ask_peers(state: State, command: AskPeers) -> tuple[Event, ...]:
    """A trusted idle peer helps, or recovery goes to the fleet. Paper: sec:model:recovery, level 2."""
    match open_failure(state, command.action_id):
        case None:
            return ()
        case action, recovery:
            helper = _peer(state, action, recovery)
            if helper is None:
                return (_escalated(state, action, recovery, "fleet", RECOVERY),)
            about: dict[str, Any] = {"robot": action.robot, "helper": helper, "failure": recovery.failure}
            admitting = {**_context(state, action, helper), "supervised_by": on_shift(state, helper)}
            return (
                AssistanceRequested(**_context(state, action, action.robot), **about, level="peer", failed_action=action.action_id),
                AssistanceAdmitted(**admitting, **about, level="peer"),
            )


def _peer(state: State, action: Action, recovery: Recovery) -> str | None:
    if state.fleet.configuration == "without-shared-registry":
        return None
    for name in helpers(state, action, recovery.cause):
        scope = scope_of(state.trust, name, action.robot, action.capability, action.task_id)
        is_trusted = scope in ASSISTING_SCOPES if recovery.cause == "obstruction" else scope != "none"
        if is_trusted and is_idle(state, name) and own_policy(state, name, action.capability, action.task_id) == "allow":
            return name
    return None


def end_assistance(state: State, command: EndAssistance) -> tuple[Event, ...]:
    """The peer has resolved the failure and is free again."""
    match open_failure(state, command.action_id):
        case action, recovery:
            about = (action.task_id, action.action_id, action.robot)
            return (AssistanceEnded(*about, command.helper, recovery.failure), FailureResolved(*about, recovery.failure, "peer"))
        case _:
            return ()


def consider_reassignment(state: State, command: ConsiderReassignment) -> tuple[Event, ...]:
    """Another robot takes the step over from its checkpoint, or H_F is called. Paper: sec:model:recovery, level 3."""
    match open_failure(state, command.action_id):
        case None:
            return ()
        case action, recovery:
            helper = _reassignee(state, action)
            decided = ReassignmentDecided(**_context(state, action, RECOVERY), robot=action.robot, helper=helper, failure=recovery.failure)
            if helper is None:
                called = SupervisorCalled(action.task_id, action.action_id, FLEET_SUPERVISOR, "recovery")
                return (decided, _escalated(state, action, recovery, "human", RECOVERY, is_decision=False), called)
            return (
                decided,
                FailureResolved(action.task_id, action.action_id, action.robot, recovery.failure, "fleet"),
                *released(state, action.action_id),
                ExecutionWithdrawn(action.task_id, action.action_id, action.robot),
                ExecutionQueued(
                    action.task_id,
                    action.action_id,
                    action.on_behalf_of,
                    helper,
                    on_shift(state, helper),
                    helper,
                    action.on_behalf_of,
                    action.capability,
                    action.step,
                    action.attempt,
                    True,
                    True,
                    True,
                ),
            )


def _reassignee(state: State, action: Action) -> str | None:
    request = state.request.get(action.action_id)
    if action.capability == NAVIGATION or request is None:
        return None
    asking = own_policy(state, action.on_behalf_of, action.capability, action.task_id)
    about = (action.capability, action.task_id)
    for name in stand_ins(state, action):
        is_trusted = scope_of(state.trust, name, action.on_behalf_of, *about) != "none"  # recovery keeps its trust gate
        is_admissible = name != action.on_behalf_of and is_trusted and stricter(asking, compose(state, request.carried, name, *about)) == "allow"
        if is_admissible and is_idle(state, name):
            return name
    return None


def _on_failure(_state: State, event: ExecutionFailed, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(StartRecovery(event.action_id)),)


def _on_attempt(state: State, event: RecoveryAttempted, _now_us: int) -> tuple[Scheduled, ...]:
    key = f"{event.failed_action}/{event.failure}/{event.number}"
    end = EndAttempt(event.failed_action, event.number)
    return (Scheduled(end, state.fleet.structure.retry_preparation_us, (Draw("retry", key),), Draw("reliability", "retry/" + key)),)


def _on_escalation(_state: State, event: RecoveryEscalated, _now_us: int) -> tuple[Scheduled, ...]:
    key = f"{event.failed_action}/{event.failure}"
    if event.to_level == "peer":
        return (Scheduled(AskPeers(event.failed_action), 0, (message(key, "peer"),)),)
    if event.to_level == "fleet":  # the peers' refusals come back before the orchestrator is asked
        return (Scheduled(ConsiderReassignment(event.failed_action), 0, (message(key, "answer"), message(key, "fleet"))),)
    return ()


def _on_assistance(state: State, event: AssistanceAdmitted, _now_us: int) -> tuple[Scheduled, ...]:
    answer = message(f"{event.action_id}/{event.failure}", "answer")
    return (Scheduled(EndAssistance(event.action_id, event.helper), state.fleet.structure.assistance_us, (answer,)),)


DECIDES: Decides = {
    StartRecovery: start_recovery,
    EndAttempt: end_attempt,
    AskPeers: ask_peers,
    EndAssistance: end_assistance,
    ConsiderReassignment: consider_reassignment,
}
REACTS: Reacts = {
    ExecutionFailed: _on_failure,
    RecoveryAttempted: _on_attempt,
    RecoveryEscalated: _on_escalation,
    AssistanceAdmitted: _on_assistance,
}
