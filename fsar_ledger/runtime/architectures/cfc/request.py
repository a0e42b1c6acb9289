"""CFC: every step goes through the coordinator, which matches, gates and commands. Paper: sec:evaluation:baselines."""

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed, AuthorityReleased
from fsar_ledger.events.envelope import COORDINATOR, FLEET_SUPERVISOR
from fsar_ledger.events.execution import ExecutionFinished, ExecutionQueued, OwnStepDecided
from fsar_ledger.events.request import (
    CandidateMatched,
    CommandIssued,
    GapDetected,
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
from fsar_ledger.projections.request import Request
from fsar_ledger.projections.world import in_force, stricter
from fsar_ledger.runtime.handlers.actors import named, nobody, target
from fsar_ledger.runtime.handlers.attribution import pending_of_other_task
from fsar_ledger.runtime.handlers.authority import released
from fsar_ledger.runtime.handlers.commands import (
    Actors,
    CloseExecution,
    Command,
    CompleteStep,
    Decides,
    Reacts,
    Scheduled,
    at_once,
    message,
)

from . import recovery
from .coordinator import (
    NO_TIME,
    ProcessWork,
    ReachCoordinator,
    by_coordinator,
    candidates_of,
    copied_policy,
    to_coordinator,
    until_next_sync_us,
)

AGAIN = "assigned again: "


class CommandReviewed(Command):
    """H_F has decided on what policy wanted reviewed."""

    action_id: str


class ReceiveCommand(Command):
    """The command has reached the robot."""

    action_id: str
    robot: str


class GoOnWithout(Command):
    """The coordinator has waited long enough for the robot's word that it has the command."""

    action_id: str
    robot: str


class QueueOrdered(Command):
    """H_F has put two commands in order."""

    action_id: str


class DenyOutsider(Command):
    """An out-of-trust request has reached the coordinator."""

    action_id: str


def process(state: State, command: ProcessWork) -> tuple[Event, ...]:
    """The coordinator has dealt with one item of its work."""
    match command.item:
        case "step" | "again":
            return _match(state, command)
        case "completion":
            return _complete(state, command)
        case _:
            return recovery.process(state, command)


def _match(state: State, command: ProcessWork) -> tuple[Event, ...]:
    """The coordinator has picked a robot by its copy and gated the step on the executor's copied policy and the fleet's rule."""
    request = state.request.get(command.action_id)
    if request is None or request.task_id not in state.task:
        return ()
    asked = candidates_of(state, command.action_id)
    candidates = tuple(robot for robot in asked if robot not in request.silent) or asked
    idle = [robot for robot in candidates if robot not in state.knowledge.copy.busy]
    robot = idle[0] if idle else candidates[0]
    records: list[Event] = []
    if request.is_delegated and command.item == "step":
        records.append(
            RequestIssued(
                request.task_id, None, None, **by_coordinator(), executed_by=robot, capability=request.capability
            )
        )
        records += [
            CandidateMatched(request.task_id, **by_coordinator(), executed_by=None, capability=request.capability)
            for _ in asked
        ]
    outcome = stricter(copied_policy(state, robot), in_force(state.world.fleet, robot))
    if outcome == "deny":
        return (
            *records,
            RequestDenied(request.task_id, None, None, **by_coordinator(), executed_by=robot, reason="policy"),
        )
    if outcome == "review" and command.action_id not in state.supervision.approved:
        return (*records, SupervisorCalled(request.task_id, command.action_id, FLEET_SUPERVISOR, "review", robot))
    return (*records, *_commanded(request, robot, not idle))


def command_reviewed(state: State, command: CommandReviewed) -> tuple[Event, ...]:
    """The approved step is commanded; one that was not approved is denied."""
    request = state.request.get(command.action_id)
    if request is None:
        return ()
    robot = request.target or request.requester
    if command.action_id not in state.supervision.approved:
        return (RequestDenied(request.task_id, None, None, **by_coordinator(), executed_by=robot, reason="review"),)
    return _commanded(request, robot, robot in state.knowledge.copy.busy)


def _commanded(request: Request, robot: str, seen_busy: bool) -> tuple[Event, ...]:
    task_id, action_id = request.task_id, request.action_id
    claims = (
        AuthorityClaimed(task_id, action_id, "execution", COORDINATOR, "command"),
        AuthorityClaimed(task_id, action_id, "override", COORDINATOR, "command"),
    )
    if not request.is_delegated:
        decided = OwnStepDecided(task_id, None, **by_coordinator(), executed_by=robot, capability=request.capability)
        return (decided, *claims)
    context = (task_id, action_id, action_id, COORDINATOR, COORDINATOR, robot, FLEET_SUPERVISOR, (COORDINATOR,))
    deferred = (RequestDeferred(*context),) if seen_busy else ()
    return (*deferred, CommandIssued(*context, robot=robot, seen_busy=seen_busy), RequestAccepted(*context), *claims)


def receive_command(state: State, command: ReceiveCommand) -> tuple[Event, ...]:
    """The command waits in the robot's queue; a second delegation to a robot not seen to be taken is first put in order by H_F."""
    request = state.request.get(command.action_id)
    robot = command.robot
    if (
        request is None or request.is_received or robot != (request.target or request.requester)
    ):  # taken back, or a second one
        return ()
    is_second = request.is_delegated and not request.seen_busy
    running = pending_of_other_task(state, robot, request.task_id) if is_second else None
    if running is None:
        return (_queued(request, robot),)
    task_id = state.execution.actions[running].task_id
    return (
        AuthorityClaimed(task_id, running, "execution", request.requester, AGAIN + request.action_id),
        SupervisorCalled(request.task_id, request.action_id, FLEET_SUPERVISOR, "ordering"),
    )


def go_on_without(state: State, command: GoOnWithout) -> tuple[Event, ...]:
    """A command that no robot has confirmed in time is taken back, and its step is matched again. Reading: R44."""
    request = state.request.get(command.action_id)
    if request is None or request.target != command.robot or request.is_received:
        return ()
    task_id, action_id = request.task_id, request.action_id
    by = {**by_coordinator(), "executed_by": command.robot, "capability": request.capability}
    return (RequestUnanswered(task_id, action_id, **by), *released(state.authority.claims.get(action_id, ())))


def queue_ordered(state: State, command: QueueOrdered) -> tuple[Event, ...]:
    """The second command waits its turn and no longer claims the running action."""
    request = state.request.get(command.action_id)
    if request is None:
        return ()
    ended = released(
        claim
        for claims in state.authority.claims.values()
        for claim in claims
        if claim.reason == AGAIN + request.action_id
    )
    if request.task_id not in state.task:  # given up meanwhile
        return (*ended, *released(state.authority.claims.get(request.action_id, ())))
    return (*ended, _queued(request, request.target or request.requester))


def _queued(request: Request, robot: str) -> ExecutionQueued:
    return ExecutionQueued(
        request.task_id,
        request.action_id,
        COORDINATOR,
        robot,
        FLEET_SUPERVISOR,
        robot,
        request.requester,
        request.capability,
        request.step,
        request.attempt,
        request.is_delegated,
        request.is_delegated,
        True,
    )


def close_execution(state: State, command: CloseExecution) -> tuple[Event, ...]:
    """Every claim on the execution has ended, but the coordinator's override until it has processed the completion."""
    claims = state.authority.claims.get(command.action_id, ())
    return released(claim for claim in claims if (claim.dimension, claim.claimant) != ("override", COORDINATOR))


def _complete(state: State, command: ProcessWork) -> tuple[Event, ...]:
    """The coordinator has closed the step."""
    request = state.request.get(command.action_id)
    if request is None:
        return ()
    task_id, action_id = request.task_id, request.action_id
    closed = AuthorityReleased(task_id, action_id, "override", COORDINATOR, "command")
    if not request.is_delegated:
        return (closed,)
    context = (task_id, action_id, action_id, COORDINATOR, COORDINATOR, request.target, FLEET_SUPERVISOR)
    return (RequestClosed(*context, (COORDINATOR,)), closed)


def deny_outsider(state: State, command: DenyOutsider) -> tuple[Event, ...]:
    """The coordinator has denied a request without trust."""
    request = state.request[command.action_id]
    return (
        GapDetected(request.task_id, None, None, None, FLEET_SUPERVISOR, request.capability),
        RequestDenied(request.task_id, None, None, **by_coordinator(), executed_by=None, reason="no trust"),
    )


def _on_step(_state: State, event: StepBegan, _now_us: int) -> tuple[Scheduled, ...]:
    return (to_coordinator(event.action_id, "step", message(event.robot, event.action_id, 0)),)


def _on_denial(state: State, event: RequestDenied | RequestUnanswered, now_us: int) -> tuple[Scheduled, ...]:
    task = state.task.get(event.task_id or "")
    if task is None or (isinstance(event, RequestDenied) and event.reason == NO_TIME):
        return ()
    return (Scheduled(ReachCoordinator(task.action_id, "again"), until_next_sync_us(state, now_us)),)


def _on_response(_state: State, event: SupervisorResponded, _now_us: int) -> tuple[Scheduled, ...]:
    if event.purpose == "review":
        return (Scheduled(CommandReviewed(event.action_id)),)
    return (
        (Scheduled(QueueOrdered(event.action_id), 1, (at_once(event.decided_by),)),)
        if event.purpose == "ordering"
        else ()
    )


def _on_command(state: State, event: CommandIssued, _now_us: int) -> tuple[Scheduled, ...]:
    received = Scheduled(ReceiveCommand(event.action_id, event.robot), 0, (message(COORDINATOR, event.action_id, 1),))
    return (received, Scheduled(GoOnWithout(event.action_id, event.robot), state.fleet.answer_us))


def _on_own_step(state: State, event: OwnStepDecided, _now_us: int) -> tuple[Scheduled, ...]:
    task = state.task.get(event.task_id)
    if task is None:  # given up meanwhile
        return ()
    action_id = task.action_id
    return (
        Scheduled(
            ReceiveCommand(action_id, state.request[action_id].requester), 0, (message(COORDINATOR, action_id, 1),)
        ),
    )


def _on_finish(_state: State, event: ExecutionFinished, _now_us: int) -> tuple[Scheduled, ...]:
    close = Scheduled(CloseExecution(event.action_id))
    return (close, to_coordinator(event.action_id, "completion", message(event.robot, event.action_id, 4)))


def _on_release(state: State, event: AuthorityReleased, _now_us: int) -> tuple[Scheduled, ...]:
    """Nothing is completed by taking a command back."""
    request = state.request.get(event.action_id)
    is_taken_back = request is not None and request.is_delegated and request.target is None
    if (event.dimension, event.claimant) != ("override", COORDINATOR) or is_taken_back:
        return ()
    return (Scheduled(CompleteStep(event.action_id), 1, (at_once(COORDINATOR),)),)


def _on_outsider(_state: State, event: OutsiderRequestInjected, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(DenyOutsider(event.task_id), 0, (message(event.robot, event.task_id, 0),)),)


DECIDES: Decides = {
    ProcessWork: process,
    CommandReviewed: command_reviewed,
    ReceiveCommand: receive_command,
    GoOnWithout: go_on_without,
    QueueOrdered: queue_ordered,
    CloseExecution: close_execution,
    DenyOutsider: deny_outsider,
}
ACTORS: Actors = {
    CommandReviewed: nobody,
    ReceiveCommand: named,
    GoOnWithout: nobody,
    QueueOrdered: target,
    CloseExecution: nobody,
    DenyOutsider: nobody,
}
REACTS: Reacts = {
    StepBegan: _on_step,
    RequestDenied: _on_denial,
    RequestUnanswered: _on_denial,
    SupervisorResponded: _on_response,
    CommandIssued: _on_command,
    OwnStepDecided: _on_own_step,
    ExecutionFinished: _on_finish,
    AuthorityReleased: _on_release,
    OutsiderRequestInjected: _on_outsider,
}
