"""Centralized fleet controller: one coordinator decides everything on synced copies; robots only execute.

This module takes a step through the coordinator, which matches, gates and commands. Paper: sec:evaluation:baselines.
"""

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed, AuthorityReleased
from fsar_ledger.events.envelope import (
    COORDINATOR,
    FLEET_SUPERVISOR,
    Parties,
    PolicyOutcome,
    Principals,
    RequestSubject,
    Robot,
    Subject,
)
from fsar_ledger.events.execution import ExecutionFinished, ExecutionQueued, OwnStepDecided
from fsar_ledger.events.request import (
    CandidateMatched,
    CommandIssued,
    RequestAccepted,
    RequestClosed,
    RequestDeferred,
    RequestDenied,
    RequestIssued,
    RequestUnanswered,
)
from fsar_ledger.events.supervision import SupervisorCalled, SupervisorResponded
from fsar_ledger.events.task import StepBegan
from fsar_ledger.events.world import OutsiderRequestInjected
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.request import Request, Requests
from fsar_ledger.projections.world import in_force, stricter
from fsar_ledger.runtime.architectures import COMMON, HandlerTable
from fsar_ledger.runtime.handlers import assistance
from fsar_ledger.runtime.handlers.attribution import pending_of_other_task
from fsar_ledger.runtime.handlers.authority import made_for, release, released
from fsar_ledger.runtime.handlers.commands import (
    ActionCommand,
    CloseExecution,
    CompleteStep,
    Handlers,
    Scheduled,
    at_once,
    commanded_robot,
    message,
    nobody,
    open_request,
    target,
)
from fsar_ledger.runtime.handlers.execution import queued

from . import coordinator, execution
from .coordinator import (
    NO_TIME,
    ProcessWork,
    ReachCoordinator,
    by_coordinator,
    candidates_of,
    copied_policy,
    declared,
    gap_of,
    to_coordinator,
    until_next_sync_us,
)

AGAIN = "assigned again: "

HANDLERS = Handlers()


class CommandReviewed(ActionCommand):
    """Act on H_F's decision about a step under review."""


class ReceiveCommand(ActionCommand):
    """Deliver the command to the robot."""

    robot: Robot


class GoOnWithout(ActionCommand):
    """Stop waiting for the robot to confirm the command."""

    robot: Robot


class QueueOrdered(ActionCommand):
    """Apply the order that H_F chose for two commands."""


class DenyOutsider(ActionCommand):
    """Deny an out-of-trust request that has reached the coordinator."""


@HANDLERS.decide(ProcessWork, nobody)
def process(state: State, command: ProcessWork) -> tuple[Event, ...]:
    """Process one item of the coordinator's work."""
    match command.item:
        case "step" | "again":
            return _match(state, command)
        case "completion":
            return _complete(state.request, command)
        case _:
            return execution.process(state, command)


def _match(state: State, command: ProcessWork) -> tuple[Event, ...]:
    """Pick a robot from the coordinator's copy, then gate the step on the policy and the fleet rule known there."""
    request = state.request.open.get(command.action_id)
    if request is None or request.task_id not in state.task:
        return ()
    considered = candidates_of(state.fleet, state.registry, request)
    candidates = tuple(robot for robot in considered if robot not in request.silent) or considered
    idle = [robot for robot in candidates if robot not in state.knowledge.copy.busy]
    robot = idle[0] if idle else candidates[0]
    unnamed = RequestSubject(request.task_id, None, None)
    records: list[Event] = []
    if request.is_delegated and command.item == "step":
        records.append(RequestIssued(subject=unnamed, principals=by_coordinator(robot), capability=request.capability))
        records += [CandidateMatched(request.task_id, by_coordinator(None), request.capability) for _ in considered]
    outcome = _known_policy(state, request, robot)
    if outcome == "deny":
        return (*records, RequestDenied(unnamed, by_coordinator(robot), "policy"))
    if outcome == "review" and command.action_id not in state.supervision.approved:
        call = SupervisorCalled(subject=request.subject, supervisor=FLEET_SUPERVISOR, purpose="review", robot=robot)
        return (*records, call)
    return (*records, *_commanded(request, robot, not idle))


def _known_policy(state: State, request: Request, robot: Robot) -> PolicyOutcome:
    """Return what the coordinator knows of policy: the executor's as copied, the fleet's rule, and declared rules."""
    window = stricter(copied_policy(state.knowledge.copy, robot), in_force(state.world.fleet, robot))
    return stricter(window, declared(state.policy, robot, request.capability, request.task_id))


@HANDLERS.decide_on(open_request, CommandReviewed, nobody)
def command_reviewed(state: State, command: CommandReviewed, request: Request) -> tuple[Event, ...]:
    """Command the approved step; deny one that was not approved, or that the policy known by now denies."""
    robot = request.target or request.requester
    is_approved = command.action_id in state.supervision.approved
    if not is_approved or _known_policy(state, request, robot) == "deny":
        reason = "policy" if is_approved else "review"
        return (RequestDenied(RequestSubject(request.task_id, None, None), by_coordinator(robot), reason),)
    return _commanded(request, robot, robot in state.knowledge.copy.busy)


def _commanded(request: Request, robot: Robot, seen_busy: bool) -> tuple[Event, ...]:
    claims = (
        AuthorityClaimed(subject=request.subject, dimension="execution", claimant=COORDINATOR, reason="command"),
        AuthorityClaimed(subject=request.subject, dimension="override", claimant=COORDINATOR, reason="command"),
    )
    if not request.is_delegated:
        decided = OwnStepDecided(Subject(request.task_id, None), by_coordinator(robot), request.capability)
        return (decided, *claims)
    subject, principals = request.request_subject, _commanding(robot)
    deferred = (RequestDeferred(subject, principals),) if seen_busy else ()
    return (
        *deferred,
        CommandIssued(subject, principals, robot, seen_busy),
        RequestAccepted(subject, principals),
        *claims,
    )


def _commanding(executor: Robot | None) -> Principals:
    """Return the principals of a delegation, which the coordinator requests in its own name."""
    parties = Parties(requested_by=COORDINATOR, executed_by=executor, supervised_by=FLEET_SUPERVISOR)
    return parties.decided(COORDINATOR)


@HANDLERS.decide(ReceiveCommand, commanded_robot)
def receive_command(state: State, command: ReceiveCommand) -> tuple[Event, ...]:
    """Queue the command at the robot, or call H_F for the order if it would be a second delegation.

    H_F is called only when the coordinator's copy did not show the robot as busy.
    """
    request, robot = state.request.open.get(command.action_id), command.robot
    if request is None or request.is_received or robot != (request.target or request.requester):
        return ()  # taken back, or a duplicate
    # See docs/decisions/only-delegated-commands-are-disputed.md.
    is_second = request.is_delegated and not request.seen_busy
    running = pending_of_other_task(state.execution, robot, request.task_id) if is_second else None
    if running is None:
        return (_queued(request, robot),)
    other = state.execution.actions[running].subject
    return (
        AuthorityClaimed(
            subject=other, dimension="execution", claimant=request.requester, reason=AGAIN + request.action_id
        ),
        SupervisorCalled(subject=request.subject, supervisor=FLEET_SUPERVISOR, purpose="ordering"),
    )


@HANDLERS.decide_on(open_request, GoOnWithout, nobody)
def go_on_without(state: State, command: GoOnWithout, request: Request) -> tuple[Event, ...]:
    """Take back a command that no robot confirmed in time, and match its step again. Reading: R44."""
    if request.target != command.robot or request.is_received:
        return ()
    return (
        RequestUnanswered(request.subject, by_coordinator(command.robot), request.capability),
        *release(state.authority, request.action_id),
    )


@HANDLERS.decide_on(open_request, QueueOrdered, target)
def queue_ordered(state: State, _command: QueueOrdered, request: Request) -> tuple[Event, ...]:
    """Queue the second command and release its claim on the running action."""
    releases = released(made_for(state.authority, AGAIN + request.action_id))
    if request.task_id not in state.task:  # given up meanwhile
        return (*releases, *release(state.authority, request.action_id))
    return (*releases, _queued(request, request.target or request.requester))


def _queued(request: Request, robot: Robot) -> ExecutionQueued:
    parties = Parties(requested_by=COORDINATOR, executed_by=robot, supervised_by=FLEET_SUPERVISOR)
    return queued(request, parties, robot)


@HANDLERS.decide(CloseExecution, nobody)
def close_execution(state: State, command: CloseExecution) -> tuple[Event, ...]:
    """End every claim on the execution, except the coordinator's override, which ends with the completion."""
    claims = state.authority.claims.get(command.action_id, ())
    return released(claim for claim in claims if (claim.dimension, claim.claimant) != ("override", COORDINATOR))


def _complete(requests: Requests, command: ProcessWork) -> tuple[Event, ...]:
    """Close the step at the coordinator."""
    request = requests.open.get(command.action_id)
    if request is None:
        return ()
    closed = AuthorityReleased(request.subject, "override", COORDINATOR, "command")
    if not request.is_delegated:
        return (closed,)
    return (RequestClosed(request.request_subject, _commanding(request.target)), closed)


@HANDLERS.decide(DenyOutsider, nobody)
def deny_outsider(state: State, command: DenyOutsider) -> tuple[Event, ...]:
    """Deny the outsider's request for lack of trust."""
    request = state.request.open[command.action_id]
    return (
        gap_of(request),
        RequestDenied(RequestSubject(request.task_id, None, None), by_coordinator(None), "no trust"),
    )


@HANDLERS.react(StepBegan)
def _on_step(_state: State, event: StepBegan, _now_us: int) -> tuple[Scheduled, ...]:
    return (to_coordinator(event.subject.action_id, "step", message(event.robot, event.subject.action_id, 0)),)


@HANDLERS.react(RequestDenied, RequestUnanswered)
def _on_denial(state: State, event: RequestDenied | RequestUnanswered, now_us: int) -> tuple[Scheduled, ...]:
    task = state.task.get(event.subject.task_id or "")
    if task is None or (isinstance(event, RequestDenied) and event.reason == NO_TIME):
        return ()
    return (
        Scheduled(ReachCoordinator(task.action_id, "again"), until_next_sync_us(state.fleet, state.knowledge, now_us)),
    )


@HANDLERS.react(SupervisorResponded)
def _on_response(_state: State, event: SupervisorResponded, _now_us: int) -> tuple[Scheduled, ...]:
    if event.purpose == "review":
        return (Scheduled(CommandReviewed(event.subject.action_id)),)
    if event.purpose != "ordering":
        return ()
    return (Scheduled(QueueOrdered(event.subject.action_id), 1, (at_once(event.principals.decided_by),)),)


@HANDLERS.react(CommandIssued)
def _on_command(state: State, event: CommandIssued, _now_us: int) -> tuple[Scheduled, ...]:
    delivery = Scheduled(
        ReceiveCommand(event.subject.action_id, event.robot), 0, (message(COORDINATOR, event.subject.action_id, 1),)
    )
    return (delivery, Scheduled(GoOnWithout(event.subject.action_id, event.robot), state.fleet.answer_us))


@HANDLERS.react(OwnStepDecided)
def _on_own_step(state: State, event: OwnStepDecided, _now_us: int) -> tuple[Scheduled, ...]:
    task = state.task.get(event.subject.task_id)
    if task is None:  # given up meanwhile
        return ()
    action_id = task.action_id
    return (
        Scheduled(
            ReceiveCommand(action_id, state.request.open[action_id].requester),
            0,
            (message(COORDINATOR, action_id, 1),),
        ),
    )


@HANDLERS.react(ExecutionFinished)
def _on_finish(_state: State, event: ExecutionFinished, _now_us: int) -> tuple[Scheduled, ...]:
    close = Scheduled(CloseExecution(event.subject.action_id))
    return (
        close,
        to_coordinator(event.subject.action_id, "completion", message(event.robot, event.subject.action_id, 4)),
    )


@HANDLERS.react(AuthorityReleased)
def _on_release(state: State, event: AuthorityReleased, _now_us: int) -> tuple[Scheduled, ...]:
    """Schedule the completion of the step, unless its command was taken back."""
    request = state.request.open.get(event.subject.action_id)
    is_taken_back = request is not None and request.is_delegated and request.target is None
    if (event.dimension, event.claimant) != ("override", COORDINATOR) or is_taken_back:
        return ()
    return (Scheduled(CompleteStep(event.subject.action_id), 1, (at_once(COORDINATOR),)),)


@HANDLERS.react(OutsiderRequestInjected)
def _on_outsider(_state: State, event: OutsiderRequestInjected, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(DenyOutsider(event.task_id), 0, (message(event.robot, event.task_id, 0),)),)


CFC: HandlerTable = HandlerTable.of(
    *COMMON,
    assistance,
    coordinator,
    HANDLERS,
    execution,
    own=coordinator.OWN,
    instead=coordinator.INSTEAD,
)
