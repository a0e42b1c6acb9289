"""Decomposition-heavy multi-agent fleet: every robot is four fleet-visible agents that negotiate.

This module holds recovery: its agent must agree with planning and execution, and may dispute ownership.
Paper: sec:evaluation:baselines.
"""

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import FLEET_SUPERVISOR, Principals, agent
from fsar_ledger.events.execution import ExecutionFailed
from fsar_ledger.events.knowledge import PlannerEngaged
from fsar_ledger.events.recovery import FailureResolved, RecoveryAttempted, RecoveryAttemptFailed
from fsar_ledger.events.supervision import SupervisorCalled
from fsar_ledger.projections.execution import Action
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.recovery import Recovery
from fsar_ledger.runtime.architectures import COMMON, HandlerTable
from fsar_ledger.runtime.handlers.attribution import parties
from fsar_ledger.runtime.handlers.authority import release
from fsar_ledger.runtime.handlers.commands import (
    ActionCommand,
    EndAttempt,
    Failure,
    Handlers,
    Scheduled,
    body,
    holds,
    lasts,
    open_failure,
)
from fsar_ledger.runtime.handlers.recovery import attempt_succeeds, attempted, escalated

from . import agents, execution, request
from .agents import RECOVERY, Talk, claims, path, planner, talk

DISPUTE = "dispute"

HANDLERS = Handlers()


class Dispute(ActionCommand):
    """Dispute a recovery while the robot's planner is engaged, or was just before."""


class StartRecovery(ActionCommand):
    """Start recovery once the recovery agent has heard of the failure and consulted the others."""


class Escalate(ActionCommand):
    """Escalate a failure that the robot's agents have given up on."""


def _heard_by(state: State, action: Action, heard: Talk = RECOVERY) -> Principals:
    return parties(state, action).decided(*path(action.robot, heard))


@HANDLERS.decide_on(open_failure, Dispute, body)
def dispute(state: State, _command: Dispute, failure: Failure) -> tuple[Event, ...]:
    """Let the recovery and the planning agent both claim override until the failure is over."""
    action, recovery = failure
    if recovery.level != "local":
        return ()
    claimants = (agent(action.robot, "recovery"), planner(action.robot))
    return tuple(claims(state.authority, action, "override", claimants, DISPUTE))


@HANDLERS.decide_on(open_failure, StartRecovery, body)
def start_recovery(state: State, _command: StartRecovery, failure: Failure) -> tuple[Event, ...]:
    """Start the first attempt to recover, or call H_F if the budget allows none."""
    action, recovery = failure
    if state.fleet.structure.local_attempts == 0:
        return (*_escalated(state, action, recovery), *release(state.authority, action.action_id, DISPUTE))
    return (_attempted(state, action, recovery),)


def _attempted(state: State, action: Action, recovery: Recovery) -> RecoveryAttempted:
    deadline_us = recovery.detected_us + state.fleet.structure.local_budget_us
    return attempted(action, recovery, _heard_by(state, action), deadline_us)


@HANDLERS.decide_on(open_failure, EndAttempt, body)
def end_attempt(state: State, command: EndAttempt, failure: Failure) -> tuple[Event, ...]:
    """Resolve the failure or start the next attempt.

    A disputed failure gets one attempt only and then loops.
    """
    action, recovery = failure
    if recovery.level != "local" or recovery.number != command.number:
        return ()
    if attempt_succeeds(state.world, recovery, command):
        resolved = FailureResolved(action.subject, action.robot, recovery.failure, "local")
        return (resolved, *release(state.authority, action.action_id, DISPUTE))
    if any(claim.reason == DISPUTE for claim in state.authority.claims.get(action.action_id, ())):
        return (
            RecoveryAttemptFailed(
                subject=action.subject, robot=action.robot, failure=recovery.failure, number=command.number
            ),
        )
    if recovery.number < state.fleet.structure.local_attempts:
        return (_attempted(state, action, recovery),)
    return _escalated(state, action, recovery)


@HANDLERS.decide_on(open_failure, Escalate, body)
def escalate(state: State, _command: Escalate, failure: Failure) -> tuple[Event, ...]:
    """Call H_F."""
    action, recovery = failure
    if recovery.level != "local":
        return ()
    return (
        *_escalated(state, action, recovery, ("recovery",)),
        *release(state.authority, action.action_id, DISPUTE),
    )


def _escalated(state: State, action: Action, recovery: Recovery, heard: Talk = RECOVERY) -> tuple[Event, ...]:
    return (
        escalated(action, recovery, _heard_by(state, action, heard), "human"),
        SupervisorCalled(subject=action.subject, supervisor=FLEET_SUPERVISOR, purpose="recovery"),
    )


@HANDLERS.react(ExecutionFailed)
def _on_failure(state: State, event: ExecutionFailed, now_us: int) -> tuple[Scheduled, ...]:
    key = f"{event.subject.action_id}/{event.failure}"
    start = Scheduled(StartRecovery(event.subject.action_id), 0, talk(state.fleet, RECOVERY, key, "told"))
    if state.knowledge.engaged_until_us.get(event.robot, -1) >= now_us:
        return (Scheduled(Dispute(event.subject.action_id)), start)
    return (start,)


@HANDLERS.react(PlannerEngaged)
def _on_engagement(state: State, event: PlannerEngaged, _now_us: int) -> tuple[Scheduled, ...]:
    engagement_us = state.fleet.structure.engagement_us
    return tuple(
        Scheduled(Dispute(action_id))
        for action_id, recovery in state.recovery.items()
        if recovery.robot == event.robot and event.until_us - engagement_us <= recovery.detected_us + engagement_us
    )


@HANDLERS.react(RecoveryAttempted)
def _on_attempt(state: State, event: RecoveryAttempted, _now_us: int) -> tuple[Scheduled, ...]:
    key = f"{event.failed_action}/{event.failure}/{event.number}"
    end = EndAttempt(event.failed_action, event.number)
    preparation_us = state.fleet.structure.retry_preparation_us
    length = (lasts("retry", key), *talk(state.fleet, RECOVERY, key, "report"))
    return (Scheduled(end, preparation_us, length, holds("retry/" + key)),)


@HANDLERS.react(RecoveryAttemptFailed)
def _on_attempt_failed(state: State, event: RecoveryAttemptFailed, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(Escalate(event.subject.action_id), state.fleet.structure.dispute_timeout_us),)


DHMA: HandlerTable = HandlerTable.of(
    *COMMON, agents, request, execution, HANDLERS, own=request.OWN, instead=request.INSTEAD
)
