"""CFC: robots are thin endpoints that execute what they are told, without a local check; every failure goes upwards.

The coordinator retries, sends a helper, or calls H_F. Paper: sec:evaluation:baselines.
"""

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import (
    COORDINATOR,
    FLEET_SUPERVISOR,
    Dimension,
    Parties,
    Principal,
    Robot,
    Subject,
)
from fsar_ledger.events.execution import (
    ExecutionFailed,
    ExecutionPaused,
    ReplanOrdered,
    RoutinePerformed,
    RoutineWithheld,
)
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
from fsar_ledger.events.world import ContextChanged, PolicyWindowClosed
from fsar_ledger.projections.authority import Authority
from fsar_ledger.projections.execution import Action
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.policy import standing
from fsar_ledger.projections.recovery import Recovery
from fsar_ledger.projections.registry import NO_ANSWER
from fsar_ledger.projections.request import Requests
from fsar_ledger.projections.world import stricter
from fsar_ledger.runtime.handlers import assistance
from fsar_ledger.runtime.handlers.attribution import helpers, on_shift
from fsar_ledger.runtime.handlers.authority import made_for, released
from fsar_ledger.runtime.handlers.commands import (
    Command,
    DecideRoutine,
    EndAssistance,
    EndAttempt,
    Failure,
    Handlers,
    HelpCommand,
    ResumeAction,
    RobotCommand,
    Scheduled,
    StartAction,
    TakeTurn,
    at_once,
    body,
    commanded_robot,
    helping,
    holds,
    lasts,
    message,
    nobody,
    open_failure,
)
from fsar_ledger.runtime.handlers.execution import approach, pause_running, start
from fsar_ledger.runtime.handlers.recovery import attempt_succeeds

from .coordinator import (
    ProcessWork,
    ReachCoordinator,
    by_coordinator,
    copied_policy,
    copied_rule,
    declared,
    reach_coordinator,
    to_coordinator,
    until_next_sync_us,
)

HANDLERS = Handlers()


class SafeStop(RobotCommand):
    """Make a robot safe after a context change, while the coordinator claims actions of it or for it."""

    window: str | None


class EndWatch(Command):
    """End a local supervisor's watch over a policy window that has closed."""

    window: str


@HANDLERS.decide(SafeStop, commanded_robot)
def safe_stop(state: State, command: SafeStop) -> tuple[Event, ...]:
    """Let the robot claim override over its actions, and its supervisor and H_F supervision where a window opened."""
    claimed: list[Event] = []
    for action_id in _claimed_actions(state.authority, state.request, command.robot):
        task_id = state.request.open[action_id].task_id
        claims: list[tuple[Dimension, Principal, str]] = [("override", command.robot, "safe stop")]
        if command.window is not None:
            claims.append(("audit", FLEET_SUPERVISOR, "policy window"))
            supervisor = on_shift(state, command.robot)
            if supervisor not in (None, FLEET_SUPERVISOR):
                claims.append(("audit", supervisor, command.window))
        existing = {(claim.dimension, claim.claimant, claim.reason) for claim in state.authority.claims[action_id]}
        claimed += [
            AuthorityClaimed(subject=Subject(task_id, action_id), dimension=dimension, claimant=claimant, reason=reason)
            for dimension, claimant, reason in claims
            if (dimension, claimant, reason) not in existing
        ]
    return tuple(claimed)


def _claimed_actions(authority: Authority, requests: Requests, robot: Robot) -> list[str]:
    """Return the robot's actions whose execution the coordinator claims."""
    action_ids = []
    for action_id, claims in authority.claims.items():
        request = requests.open.get(action_id)
        if request is None or robot not in (request.requester, request.target or request.requester):
            continue
        if any(claim.dimension == "execution" and claim.claimant == COORDINATOR for claim in claims):
            action_ids.append(action_id)
    return action_ids


@HANDLERS.decide(EndWatch, nobody)
def end_watch(state: State, command: EndWatch) -> tuple[Event, ...]:
    """Release the local supervisor's claims from this window."""
    return released(made_for(state.authority, command.window))


@HANDLERS.decide(DecideRoutine, commanded_robot)
def decide_routine(state: State, command: DecideRoutine) -> tuple[Event, ...]:
    """Perform the routine operation; withhold a motion that the last copy of policy or rule forbids."""
    robot = command.robot
    principals = Parties(requested_by=robot, executed_by=robot, supervised_by=FLEET_SUPERVISOR).decided(robot)
    copy = state.knowledge.copy
    outcomes = (copied_policy(copy, robot), copied_rule(copy, robot), declared(state.policy, robot, None, None))
    if command.operation == "motion" and "deny" in outcomes:
        return (RoutineWithheld(principals, robot, command.operation),)
    return (RoutinePerformed(principals, robot, command.operation),)


@HANDLERS.react(ContextChanged)
def _on_context(state: State, event: ContextChanged, now_us: int) -> tuple[Scheduled, ...]:
    paused = pause_running(state, event, now_us)
    if not _claimed_actions(state.authority, state.request, event.robot):
        return paused
    return (*paused, Scheduled(SafeStop(event.robot, event.window)))


@HANDLERS.react(PolicyWindowClosed)
def _on_window_closed(state: State, event: PolicyWindowClosed, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(EndWatch(event.window)),) if made_for(state.authority, event.window) else ()


@HANDLERS.react(ExecutionPaused)
def _on_pause(state: State, event: ExecutionPaused, now_us: int) -> tuple[Scheduled, ...]:
    """Tell the coordinator about the pause at the next sync."""
    return (
        Scheduled(
            ReachCoordinator(event.subject.action_id, "replan"),
            until_next_sync_us(state.fleet, state.knowledge, now_us),
            (at_once(event.robot),),
        ),
    )


@HANDLERS.react(ReplanOrdered)
def _on_replan(state: State, event: ReplanOrdered, _now_us: int) -> tuple[Scheduled, ...]:
    task = state.task.get(event.task_id)
    if task is None:  # given up meanwhile
        return ()
    segment = state.execution.actions[task.action_id].segments
    plan = message(COORDINATOR, task.action_id, f"replan{segment}")
    return (Scheduled(ResumeAction(task.action_id), state.fleet.structure.replan_us, (plan,)),)


HANDLERS.decide(TakeTurn, body)(approach)
HANDLERS.decide(StartAction, body)(start)


class ReachHelper(HelpCommand):
    """Deliver the order to help to the helper."""


class GoOnWithoutHelp(HelpCommand):
    """Stop waiting for the helper's answer."""

    failure: int


def process(state: State, command: ProcessWork) -> tuple[Event, ...]:
    """Process one item of recovery or replanning at the coordinator."""
    action = state.execution.actions.get(command.action_id)
    if action is None:
        return ()
    if command.item == "replan":
        return (ReplanOrdered(action.task_id, by_coordinator(action.robot)),) if action.stage == "paused" else ()
    recovery = state.recovery.get(command.action_id)
    if recovery is None:
        return ()
    if command.item == NO_ANSWER and recovery.awaited is None:  # the helper has answered meanwhile
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
    """End the ordered retry: resolve the failure, or record that the attempt failed."""
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
    return assistance.ordered(state, command, failure, "fleet", COORDINATOR, FLEET_SUPERVISOR)


@HANDLERS.decide(GoOnWithoutHelp, nobody)
def go_on_without_help(state: State, command: GoOnWithoutHelp) -> tuple[Event, ...]:
    """Return the failure to the coordinator when the helper has not answered in time. Reading: R44."""
    failure = open_failure(state, command.action_id)
    if failure is None or (failure[1].failure, failure[1].awaited) != (command.failure, command.helper):
        return ()
    return reach_coordinator(state, ReachCoordinator(command.action_id, NO_ANSWER, now_us=command.now_us))


@HANDLERS.decide(EndAssistance, helping)
def end_assistance(state: State, command: EndAssistance) -> tuple[Event, ...]:
    """Free the helper, whether or not it resolved the failure."""
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
    timeout = GoOnWithoutHelp(event.failed_action, event.helper, event.failure)
    return (
        Scheduled(ReachHelper(event.failed_action, event.helper), 0, (order,)),
        Scheduled(timeout, state.fleet.answer_us),
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
