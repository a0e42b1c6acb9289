"""CFC: every failure goes to the coordinator, which retries, sends a helper, or calls H_F.

Paper: sec:evaluation:baselines.
"""

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import COORDINATOR, FLEET_SUPERVISOR, Principals, Robot, Subject
from fsar_ledger.events.execution import ExecutionFailed, ReplanOrdered
from fsar_ledger.events.recovery import (
    AssistanceAdmitted,
    AssistanceDeclined,
    AssistanceFailed,
    AssistanceRequested,
    FailureResolved,
    RecoveryAttempted,
    RecoveryAttemptFailed,
    RecoveryEscalated,
)
from fsar_ledger.events.supervision import SupervisorCalled
from fsar_ledger.projections.execution import Action
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.policy import standing
from fsar_ledger.projections.recovery import Recovery
from fsar_ledger.projections.registry import NO_ANSWER
from fsar_ledger.projections.world import stricter
from fsar_ledger.runtime.handlers import assistance
from fsar_ledger.runtime.handlers.attribution import helpers, is_idle
from fsar_ledger.runtime.handlers.commands import (
    EndAssistance,
    EndAttempt,
    Failure,
    Handlers,
    HelpCommand,
    Scheduled,
    body,
    helping,
    holds,
    lasts,
    message,
    nobody,
    open_failure,
)
from fsar_ledger.runtime.handlers.recovery import attempt_succeeds

from .coordinator import ProcessWork, ReachCoordinator, by_coordinator, copied_policy, reach_coordinator, to_coordinator

HANDLERS = Handlers()


class ReachHelper(HelpCommand):
    """Deliver the order to help to the helper."""


class GoOnWithoutHelp(HelpCommand):
    """Stop waiting for the helper's answer."""

    failure: int


def process(state: State, command: ProcessWork) -> tuple[Event, ...]:
    """Take one turn of recovery or replanning at the coordinator."""
    action = state.execution.actions.get(command.action_id)
    if action is None:
        return ()
    if command.item == "replan":
        return (ReplanOrdered(action.task_id, by_coordinator(action.robot)),) if action.stage == "paused" else ()
    recovery = state.recovery.get(command.action_id)
    if recovery is None:
        return ()
    if command.item == NO_ANSWER and recovery.awaited is None:  # it has answered at last
        return ()
    copy, robot = state.knowledge.copy, action.robot
    is_first = command.item == "failure" and state.fleet.structure.local_attempts > 0
    rules = standing(state.policy, "local", robot, action.capability, action.task_id)
    if is_first and robot not in copy.degraded and stricter(copied_policy(copy, robot), rules) == "allow":
        return (
            RecoveryAttempted(
                subject=Subject(action.task_id, None),
                principals=by_coordinator(action.robot),
                robot=action.robot,
                failure=recovery.failure,
                number=1,
                level="local",
                deadline_us=command.now_us + state.fleet.structure.local_budget_us,
                failed_action=action.action_id,
            ),
        )
    return _order_help(state, action, recovery)


def _order_help(state: State, action: Action, recovery: Recovery) -> tuple[Event, ...]:
    """Send a helper that the copy shows idle, trusted or not; call H_F where there is none."""
    subject, principals = Subject(action.task_id, None), by_coordinator(action.robot)
    for helper in helpers(state.fleet, state.registry, action, recovery.cause):
        if helper not in state.knowledge.copy.busy and helper not in recovery.tried:
            return (
                AssistanceRequested(
                    subject=subject,
                    principals=principals,
                    robot=action.robot,
                    helper=helper,
                    failure=recovery.failure,
                    level="fleet",
                    failed_action=action.action_id,
                ),
            )
    return (
        RecoveryEscalated(
            subject=subject,
            principals=principals,
            robot=action.robot,
            failure=recovery.failure,
            level="local",
            to_level="human",
            failed_action=action.action_id,
        ),
        SupervisorCalled(subject=action.subject, supervisor=FLEET_SUPERVISOR, purpose="recovery"),
    )


@HANDLERS.decide_on(open_failure, EndAttempt, body)
def end_attempt(state: State, command: EndAttempt, failure: Failure) -> tuple[Event, ...]:
    """End the ordered retry, which resolved the failure or did not."""
    action, recovery = failure
    if attempt_succeeds(state.world, recovery, command):
        return (FailureResolved(action.subject, action.robot, recovery.failure, "local"),)
    return (
        RecoveryAttemptFailed(
            subject=action.subject, robot=action.robot, failure=recovery.failure, number=command.number
        ),
    )


@HANDLERS.decide_on(open_failure, ReachHelper, helping)
def reach_helper(state: State, command: ReachHelper, failure: Failure) -> tuple[Event, ...]:
    """Admit the request for help, or decline it while the helper is busy."""
    action, recovery = failure
    if recovery.awaited != command.helper:  # another was asked meanwhile, or H_F
        return ()
    if not is_idle(state.execution, command.helper):
        return (AssistanceDeclined(action.subject, action.robot, command.helper, recovery.failure),)
    return (
        AssistanceAdmitted(
            subject=action.subject,
            principals=Principals(
                decided_by=None,
                requested_by=COORDINATOR,
                executed_by=action.executed_by,
                supervised_by=FLEET_SUPERVISOR,
                path=(),
            ),
            robot=action.robot,
            helper=command.helper,
            failure=recovery.failure,
            level="fleet",
        ),
    )


@HANDLERS.decide(GoOnWithoutHelp, nobody)
def go_on_without_help(state: State, command: GoOnWithoutHelp) -> tuple[Event, ...]:
    """Give the coordinator the failure again when the helper has not answered in time. Reading: R44."""
    failure = open_failure(state, command.action_id)
    if failure is None or (failure[1].failure, failure[1].awaited) != (command.failure, command.helper):
        return ()
    return reach_coordinator(state, ReachCoordinator(command.action_id, NO_ANSWER, now_us=command.now_us))


@HANDLERS.decide(EndAssistance, helping)
def end_assistance(state: State, command: EndAssistance) -> tuple[Event, ...]:
    """Free the helper, which resolved the failure or could not."""
    return assistance.end_assistance(state, command, "fleet")


def _report(
    event: ExecutionFailed | RecoveryAttemptFailed | AssistanceDeclined | AssistanceFailed,
    sender: Robot,
    item: str,
    hop: str,
) -> tuple[Scheduled, ...]:
    """Send the coordinator the robot's message about this failure."""
    action_id = event.subject.action_id
    return (to_coordinator(action_id, item, message(sender, f"{action_id}/{event.failure}", hop)),)


@HANDLERS.react(ExecutionFailed)
def _on_failure(_state: State, event: ExecutionFailed, _now_us: int) -> tuple[Scheduled, ...]:
    return _report(event, event.robot, "failure", "report")


@HANDLERS.react(RecoveryAttempted)
def _on_attempt(_state: State, event: RecoveryAttempted, _now_us: int) -> tuple[Scheduled, ...]:
    key = f"{event.failed_action}/{event.failure}/{event.number}"
    order = (message(COORDINATOR, key, "order"), lasts("retry", key))
    return (Scheduled(EndAttempt(event.failed_action, event.number), 0, order, holds("retry/" + key)),)


@HANDLERS.react(RecoveryAttemptFailed)
def _on_attempt_failed(_state: State, event: RecoveryAttemptFailed, _now_us: int) -> tuple[Scheduled, ...]:
    return _report(event, event.robot, "retry-failed", "retry-report")


@HANDLERS.react(AssistanceRequested)
def _on_order(state: State, event: AssistanceRequested, _now_us: int) -> tuple[Scheduled, ...]:
    order = message(COORDINATOR, f"{event.failed_action}/{event.failure}", f"order/{event.helper}")
    late = GoOnWithoutHelp(event.failed_action, event.helper, event.failure)
    return (
        Scheduled(ReachHelper(event.failed_action, event.helper), 0, (order,)),
        Scheduled(late, state.fleet.answer_us),
    )


@HANDLERS.react(AssistanceDeclined)
def _on_decline(_state: State, event: AssistanceDeclined, _now_us: int) -> tuple[Scheduled, ...]:
    return _report(event, event.helper, "declined", f"decline/{event.helper}")


@HANDLERS.react(AssistanceAdmitted)
def _on_assistance(state: State, event: AssistanceAdmitted, _now_us: int) -> tuple[Scheduled, ...]:
    return (assistance.end_of(event, state.fleet.structure.assistance_us),)


@HANDLERS.react(AssistanceFailed)
def _on_no_help(_state: State, event: AssistanceFailed, _now_us: int) -> tuple[Scheduled, ...]:
    return _report(event, event.helper, "no help", f"no help/{event.helper}")
