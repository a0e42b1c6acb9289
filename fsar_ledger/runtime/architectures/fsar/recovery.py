"""FSAR: recovery starts at the robot and goes outward level by level. Paper: eq:recovery, sec:model:recovery.

A failure creates no authority: the trust and the policy from before it decide who helps or takes over.
"""

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import DEPARTED, FLEET_SUPERVISOR, RECOVERY, Principals, RecoveryLevel, Robot
from fsar_ledger.events.execution import ExecutionFailed, ExecutionQueued, ExecutionWithdrawn
from fsar_ledger.events.recovery import (
    AssistanceAdmitted,
    AssistanceDeclined,
    AssistanceFailed,
    AssistanceRequested,
    AttemptRolledBack,
    FailureResolved,
    ReassignmentDecided,
    RecoveryAttempted,
    RecoveryAttemptFailed,
    RecoveryEscalated,
    TaskStateTransferred,
)
from fsar_ledger.events.supervision import SupervisorCalled
from fsar_ledger.projections.budget import Budgets
from fsar_ledger.projections.execution import Action
from fsar_ledger.projections.fleet import Fleet
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.recovery import Recoveries, Recovery
from fsar_ledger.projections.task import checkpoint
from fsar_ledger.runtime.handlers import assistance
from fsar_ledger.runtime.handlers.attribution import is_cross_robot, parties, recorded_by, supervisor_of
from fsar_ledger.runtime.handlers.authority import release
from fsar_ledger.runtime.handlers.commands import (
    ActionCommand,
    EndAssistance,
    EndAttempt,
    Failure,
    Handlers,
    Scheduled,
    body,
    helping,
    lasts,
    message,
    nobody,
    open_failure,
    speaker,
)
from fsar_ledger.runtime.handlers.isolation import outward_alone
from fsar_ledger.runtime.handlers.recovery import (
    attempt_failed,
    attempt_succeeds,
    attempted,
    budget,
    end_of_attempt,
    escalated,
)
from fsar_ledger.runtime.handlers.supervision import supervisor_for
from fsar_ledger.runtime.ports import ANSWERS_LATER, Ask

from .availability import found_silent
from .helpers import HelperChoice, agreed_to_help, peer, peer_query, reassignee

EXHAUSTED = "budget exhausted"

HANDLERS = Handlers()


class StartRecovery(ActionCommand):
    """Start recovery from a failure that was detected."""


class RollBack(ActionCommand):
    """Undo what this attempt has achieved."""

    failure: int
    number: int
    undone: tuple[str, ...]


class AskPeers(ActionCommand):
    """Deliver the request for help to the peers, after `asked` of them were asked.

    `is_last`: the time to answer about this `failure` is over. Units: `since_us` run time at which recovery turned to
    them.
    """

    since_us: int = 0
    asked: int = 0
    failure: int = 0
    is_last: bool = False


class ConsiderReassignment(ActionCommand):
    """Deliver the failure to the recovery orchestrator, and to the robots it asks.

    `is_last`: the time to answer about this `failure` is over. Units: `since_us` run time at which recovery turned to
    it.
    """

    since_us: int = 0
    failure: int = 0
    is_last: bool = False


class CallNext(ActionCommand):
    """End the time in which the called supervisor should have resolved the failure.

    `calls` counts the calls until then.
    """

    failure: int
    calls: int


@HANDLERS.decide_on(open_failure, StartRecovery, body)
def start_recovery(state: State, command: StartRecovery, failure: Failure) -> tuple[Event, ...]:
    """Start the robot's own recovery, if it may; without layered recovery, call H_F at once.

    Paper: sec:model:recovery, level 1.
    """
    action, recovery = failure
    if recovery.level != "local" or recovery.number > 0:
        return ()
    by_robot = parties(state, action).decided(action.robot)
    if "layered-recovery" in state.fleet.without:
        call = SupervisorCalled(subject=action.subject, supervisor=FLEET_SUPERVISOR, purpose="recovery")
        return (escalated(action, recovery, by_robot, "human", "no layered recovery"), call)
    if action.stage == "withdrawn":
        return (escalated(action, recovery, parties(state, action).decided(RECOVERY), "peer", DEPARTED),)
    limits = budget(state.budget, state.fleet, action.robot, "local")
    deadline_us = recovery.detected_us + limits.t_max_us
    if limits.n_max == 0 or command.now_us >= deadline_us:
        return (escalated(action, recovery, by_robot, "peer", EXHAUSTED),)
    return (attempted(action, recovery, by_robot, deadline_us),)


@HANDLERS.decide_on(open_failure, EndAttempt, body)
def end_attempt(state: State, command: EndAttempt, failure: Failure) -> tuple[Event, ...]:
    """Resolve the failure, or continue; the results of a partial attempt are undone before the next one."""
    action, recovery = failure
    if recovery.level != "local" or recovery.number != command.number:
        return ()
    if attempt_succeeds(state.world, recovery, command):
        return (FailureResolved(action.subject, action.robot, recovery.failure, "local"),)
    failed = attempt_failed(state.registry, state.world, action, recovery)
    if failed.achieved and _may_retry(state, action, recovery, command.now_us):
        return (failed,)
    return (failed, _next_attempt(state, action, recovery, command.now_us))


@HANDLERS.decide_on(open_failure, RollBack, body)
def roll_back(state: State, command: RollBack, failure: Failure) -> tuple[Event, ...]:
    """Record that the robot is back where the failure began, and continue. Paper: fig:recovery."""
    action, recovery = failure
    failed, number = command.failure, command.number
    if (recovery.level, recovery.failure, recovery.number) != ("local", failed, number):
        return ()
    rollback = AttemptRolledBack(
        subject=action.subject, robot=action.robot, failure=failed, number=number, undone=command.undone
    )
    return (rollback, _next_attempt(state, action, recovery, command.now_us))


def _may_retry(state: State, action: Action, recovery: Recovery, now_us: int) -> bool:
    limits = budget(state.budget, state.fleet, action.robot, "local")
    return recovery.number < limits.n_max and now_us < recovery.deadline_us


def _next_attempt(
    state: State, action: Action, recovery: Recovery, now_us: int
) -> RecoveryAttempted | RecoveryEscalated:
    """Return the robot's next own attempt, or the escalation to the peers once the budget is spent."""
    by_robot = parties(state, action).decided(action.robot)
    if _may_retry(state, action, recovery, now_us):
        return attempted(action, recovery, by_robot, recovery.deadline_us)
    return escalated(action, recovery, by_robot, "peer", EXHAUSTED)


def _is_exhausted(
    budgets: Budgets, fleet: Fleet, action: Action, level: RecoveryLevel, spent_us: int, spent: int
) -> bool:
    limits = budget(budgets, fleet, action.robot, level)
    return spent_us > limits.t_max_us or spent >= limits.n_max


@HANDLERS.decide_on(open_failure, AskPeers, nobody)
def ask_peers(state: State, command: AskPeers, failure: Failure) -> tuple[Event, ...]:
    """Let a trusted idle peer help, or escalate to the fleet. Paper: sec:model:recovery, level 2.

    A live peer is asked, and is admitted by its own answer.
    """
    action, recovery = failure
    if not (
        recovery.level == "peer"
        and not (command.is_last and (command.failure, command.asked) != (recovery.failure, len(recovery.tried)))
        and not (recovery.tried and assistance.helped(state, action.action_id, recovery.tried[-1]))
    ):
        return ()
    named = parties(state, action)
    if action.robot == state.fleet.isolated:
        return outward_alone(state, action, recovery)
    by_service = named.decided(RECOVERY)
    if _is_exhausted(state.budget, state.fleet, action, "peer", command.now_us - command.since_us, len(recovery.tried)):
        return (escalated(action, recovery, by_service, "fleet", EXHAUSTED),)
    helper, reason, silent = peer(state, action, recovery)
    if silent and not command.is_last:
        return ()
    query = peer_query(state, action, recovery)
    if helper is None:
        return (
            *query,
            escalated(action, recovery, by_service, "fleet", reason),
            *found_silent(state.fleet, state.registry, silent),
        )
    requested = AssistanceRequested(
        subject=action.subject,
        principals=named.decided(action.robot),
        robot=action.robot,
        helper=helper,
        failure=recovery.failure,
        level="peer",
        failed_action=action.action_id,
        since_us=command.since_us,
    )
    agreed = () if command.answer == ANSWERS_LATER else (agreed_to_help(state, action, recovery, helper),)
    return (*query, requested, *agreed, *found_silent(state.fleet, state.registry, silent))


@HANDLERS.decide(EndAssistance, helping)
def end_assistance(state: State, command: EndAssistance) -> tuple[Event, ...]:
    """Free the peer, whether or not it resolved the failure."""
    return assistance.end_assistance(state, command, "peer")


@HANDLERS.decide_on(open_failure, ConsiderReassignment, nobody)
def consider_reassignment(state: State, command: ConsiderReassignment, failure: Failure) -> tuple[Event, ...]:
    """Hand the step to another robot from a declared checkpoint, or call a supervisor.

    Paper: sec:model:recovery, level 3.
    """
    action, recovery = failure
    if not (recovery.level == "fleet" and not (command.is_last and command.failure != recovery.failure)):
        return ()
    if _is_exhausted(state.budget, state.fleet, action, "fleet", command.now_us - command.since_us, 0):
        return _to_human(state, action, recovery, EXHAUSTED)
    resume_at = checkpoint(state.task, action.task_id, action.step)
    helper, reason, silent = reassignee(state, action) if resume_at is not None else HelperChoice(None, "no checkpoint")
    if silent and not command.is_last:
        return ()
    decided = ReassignmentDecided(
        subject=action.subject,
        principals=parties(state, action).decided(RECOVERY),
        robot=action.robot,
        helper=helper,
        failure=recovery.failure,
        checkpoint=resume_at,
        reason=None if helper is not None else reason,
    )
    if helper is None or resume_at is None:
        return (
            decided,
            *_to_human(state, action, recovery, f"no feasible reassignment: {reason}"),
            *found_silent(state.fleet, state.registry, silent),
        )
    return (
        decided,
        *_handed_over(state, action, recovery, helper, resume_at),
        *found_silent(state.fleet, state.registry, silent),
    )


def _handed_over(state: State, action: Action, recovery: Recovery, helper: Robot, resume_at: str) -> tuple[Event, ...]:
    """Transfer the task's state to the helper, queue the step there, and free the robot that failed."""
    completed = state.task[action.task_id].steps[: action.step - 1]
    return (
        FailureResolved(action.subject, action.robot, recovery.failure, "fleet"),
        *release(state.authority, action.action_id),
        *(() if action.stage == "withdrawn" else (ExecutionWithdrawn(action.subject, action.robot),)),
        TaskStateTransferred(
            subject=action.subject, robot=action.robot, helper=helper, checkpoint=resume_at, completed=completed
        ),
        ExecutionQueued(
            subject=action.subject,
            principals=recorded_by(state, helper, requested_by=action.on_behalf_of, executed_by=helper),
            robot=helper,
            on_behalf_of=action.on_behalf_of,
            capability=action.capability,
            step=action.step,
            attempt=action.attempt,
            is_delegated=True,
            has_approach=True,
            is_supervised=True,
        ),
    )


def _to_human(state: State, action: Action, recovery: Recovery, reason: str) -> tuple[Event, ...]:
    """Call H_i if only the robot is concerned, else H_F. Paper: sec:model:recovery, level 4."""
    # See docs/decisions/level-4-goes-by-scope.md.
    supervisor = supervisor_for(state, action.robot, is_cross_robot(state.task, action))
    call = SupervisorCalled(subject=action.subject, supervisor=supervisor, purpose="recovery")
    principals = Principals(  # the service does not decide here, it passes the failure on
        decided_by=RECOVERY,
        requested_by=action.requested_by,
        executed_by=action.executed_by,
        supervised_by=supervisor_of(state, action),
        path=(),
    )
    return (escalated(action, recovery, principals, "human", reason), call)


@HANDLERS.decide_on(open_failure, CallNext, nobody)
def call_next(state: State, command: CallNext, failure: Failure) -> tuple[Event, ...]:
    """Call H_F after a supervisor who has not resolved the failure in time, while the level's budget lasts."""
    action, recovery = failure
    limit = budget(state.budget, state.fleet, action.robot, "human").n_max
    if (recovery.failure, recovery.calls) != (command.failure, command.calls) or recovery.calls >= limit:
        return ()
    supervisor = supervisor_for(state, action.robot, is_cross_robot=True)
    return (SupervisorCalled(subject=action.subject, supervisor=supervisor, purpose="recovery"),)


@HANDLERS.react(ExecutionFailed)
def _on_failure(_state: State, event: ExecutionFailed, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(StartRecovery(event.subject.action_id)),)


@HANDLERS.react(RecoveryAttempted)
def _on_attempt(state: State, event: RecoveryAttempted, _now_us: int) -> tuple[Scheduled, ...]:
    return (end_of_attempt(state.fleet, event),)


@HANDLERS.react(RecoveryAttemptFailed)
def _on_attempt_failed(state: State, event: RecoveryAttemptFailed, now_us: int) -> tuple[Scheduled, ...]:
    """Schedule the end of the rollback, where a partial attempt is followed by another."""
    match open_failure(state, event.subject.action_id):
        case action, recovery if event.achieved and _may_retry(state, action, recovery, now_us):
            rollback = RollBack(action.action_id, event.failure, event.number, event.achieved)
            return (
                Scheduled(rollback, 0, (lasts("retry", f"{action.action_id}/{event.failure}/{event.number}/back"),)),
            )
        case _:
            return ()


@HANDLERS.react(RecoveryEscalated)
def _on_escalation(state: State, event: RecoveryEscalated, now_us: int) -> tuple[Scheduled, ...]:
    key, sender = f"{event.failed_action}/{event.failure}", speaker(state.fleet, event.robot)
    if event.to_level == "peer":
        return _asking(state.fleet, state.recovery, event.failed_action, now_us, (message(sender, key, "peer"),))
    if event.to_level == "fleet":  # the peers' refusals come back before the orchestrator is asked
        waits = (message(sender, key, "answer"), message(sender, key, "fleet"))
        last = Scheduled(
            ConsiderReassignment(event.failed_action, now_us, event.failure, is_last=True), state.fleet.answer_us, waits
        )
        return (Scheduled(ConsiderReassignment(event.failed_action, now_us), 0, waits), last)
    return ()


def _asking(
    fleet: Fleet, recoveries: Recoveries, action_id: str, since_us: int, waits: tuple[Ask, ...]
) -> tuple[Scheduled, ...]:
    """Schedule the request to the peers, and the end of their answer time."""
    recovery, asked = recoveries[action_id], len(recoveries[action_id].tried)
    help_ = Ask("decision", "help", f"{action_id}/{recovery.failure}/{asked}")
    last = Scheduled(
        AskPeers(action_id, since_us, asked, recovery.failure, is_last=True), fleet.answer_us, waits, help_
    )
    return (Scheduled(AskPeers(action_id, since_us, asked), 0, waits, help_), last)


HANDLERS.react(AssistanceAdmitted)(assistance.end_once_answered)


@HANDLERS.react(AssistanceFailed, AssistanceDeclined)
def _on_no_help(state: State, event: AssistanceFailed | AssistanceDeclined, _now_us: int) -> tuple[Scheduled, ...]:
    """Tell the robot, which turns to the next peer while the level's budget lasts."""
    recovery, key = state.recovery[event.subject.action_id], f"{event.subject.action_id}/{event.failure}"
    waits = (
        message(speaker(state.fleet, event.helper), key, f"no help/{event.helper}"),
        message(speaker(state.fleet, event.robot), key, f"peer/{len(recovery.tried)}"),
    )
    return _asking(state.fleet, state.recovery, event.subject.action_id, recovery.since_us, waits)


@HANDLERS.react(SupervisorCalled)
def _on_call(state: State, event: SupervisorCalled, _now_us: int) -> tuple[Scheduled, ...]:
    match open_failure(state, event.subject.action_id):
        case action, recovery if event.purpose == "recovery":
            delay_us = budget(state.budget, state.fleet, action.robot, "human").t_max_us
            return (Scheduled(CallNext(event.subject.action_id, recovery.failure, recovery.calls), delay_us),)
        case _:
            return ()
