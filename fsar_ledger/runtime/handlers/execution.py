"""What bodies do under every architecture: turns, starts, obstructions, ends. Paper: sec:evaluation:simulator."""

from collections.abc import Callable

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import OverrideLevel, Parties, Robot
from fsar_ledger.events.execution import (
    ApproachStarted,
    ExecutionFinished,
    ExecutionHalted,
    ExecutionPaused,
    ExecutionQueued,
    ExecutionResumed,
    ExecutionStarted,
    ExecutionWithdrawn,
)
from fsar_ledger.events.recovery import FailureResolved
from fsar_ledger.events.world import ContextChanged, ObstructionAppeared, RobotCameBack, RobotWentOff, RoutineDue
from fsar_ledger.projections.execution import Action, Execution, Stage, in_hand, left_us
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.request import Request
from fsar_ledger.runtime.ports import UNKNOWN_US, Ask

from .attribution import is_injected, parties
from .commands import (
    Command,
    DecideRoutine,
    DetectObstruction,
    FinishAttempt,
    HaltAction,
    Handlers,
    PauseAction,
    ResumeAction,
    Scheduled,
    StartAction,
    TakeTurn,
    body,
    holds,
    known_action,
    lasts,
    nobody,
)
from .recovery import actuator_holds, failed

NAVIGATION = "navigate.indoor"

HANDLERS = Handlers()


def start_action(
    action_id: str, capability: str, after_us: int = 1, waits: tuple[Ask, ...] = (), *, was_held: bool = False
) -> Scheduled:
    """Start the action when the robot is ready; its duration is the world's."""
    return Scheduled(StartAction(action_id, was_held), after_us, waits, lasts(capability, action_id))


@HANDLERS.react(ApproachStarted)
def start_after_approach(state: State, event: ApproachStarted, _now_us: int) -> tuple[Scheduled, ...]:
    """Start the action when the robot has arrived.

    A second approach for the same action takes a way of its own.
    """
    action = state.execution.actions[event.subject.action_id]
    request = state.request.open.get(event.subject.action_id)
    repeats = action.failures + action.preemptions + (request.round if request is not None else 0)
    travel = lasts("approach", f"{event.subject.action_id}/{repeats}" if repeats else event.subject.action_id)
    return (start_action(event.subject.action_id, action.capability, 0, (travel,)),)


def queued(
    request: Request, parties: Parties, robot: Robot, override: OverrideLevel = "none", *, is_supervised: bool = True
) -> ExecutionQueued:
    """Return the event that queues the step at the robot; a delegated step has an approach first."""
    return ExecutionQueued(
        subject=request.subject,
        principals=parties,
        robot=robot,
        on_behalf_of=request.requester,
        capability=request.capability,
        step=request.step,
        attempt=request.attempt,
        is_delegated=request.is_delegated,
        has_approach=request.is_delegated,
        is_supervised=is_supervised,
        override=override,
    )


def waiting(execution: Execution, action_id: str) -> Action | None:
    """Return the action if it waits for its turn or for its robot's approach, else None."""
    action = execution.actions.get(action_id)
    return action if action is not None and action.stage in ("queued", "approaching") else None


def started(state: State, action: Action, command: StartAction) -> ExecutionStarted:
    """Return the event that the action runs from now to its planned end."""
    lasts_us = state.fleet.structure.injected_execution_us if is_injected(action) else command.answer
    return ExecutionStarted(
        subject=action.subject,
        principals=parties(state, action),
        robot=action.robot,
        on_behalf_of=action.on_behalf_of,
        capability=action.capability,
        ends_us=None if lasts_us == UNKNOWN_US else command.now_us + lasts_us,
    )


def start(state: State, command: StartAction) -> tuple[Event, ...]:
    """Start the waiting action, whatever any policy says by now."""
    action = waiting(state.execution, command.action_id)
    return () if action is None else (started(state, action, command),)


def approach(state: State, command: TakeTurn) -> tuple[Event, ...]:
    """Start the robot's approach, which needs no further consent."""
    action = state.execution.actions.get(command.action_id)
    if action is None or action.stage != "queued":
        return ()
    return (ApproachStarted(action.subject, action.robot),)


@HANDLERS.decide_on(known_action, FinishAttempt, body)
def finish_attempt(state: State, command: FinishAttempt, action: Action) -> tuple[Event, ...]:
    """Finish the execution, or fail it at its end where the degraded actuator does not hold."""
    if action.stage != "running" or action.ends_us != command.ends_us:
        return ()
    if action.capability != NAVIGATION and not actuator_holds(state.world, action.robot, command.answer):
        return (failed(action, "degradation", command.now_us),)
    return (_finished(state, action),)


@HANDLERS.decide_on(known_action, DetectObstruction, body)
def detect_obstruction(state: State, command: DetectObstruction, action: Action) -> tuple[Event, ...]:
    """Fail the running attempt because something is in the way."""
    if action.stage != "running" or not state.world.obstructions.get(action.robot):
        return ()
    return (failed(action, "obstruction", command.now_us),)


@HANDLERS.decide_on(known_action, PauseAction, body)
def pause_action(_state: State, command: PauseAction, action: Action) -> tuple[Event, ...]:
    """Stop the robot to replan, if it still executes."""
    remaining_us = left_us(action, command.now_us)
    if action.stage != "running" or remaining_us == 0:
        return ()
    return (ExecutionPaused(action.subject, action.robot, remaining_us),)


@HANDLERS.decide_on(known_action, HaltAction, nobody)
def halt_action(state: State, command: HaltAction, action: Action) -> tuple[Event, ...]:
    """Halt the execution of a robot that is off.

    A robot that was off for a moment and is back continues.
    """
    if action.stage != "running" or action.robot not in state.world.off:
        return ()
    return (ExecutionHalted(action.subject, action.robot, left_us(action, command.now_us)),)


@HANDLERS.decide_on(known_action, ResumeAction, body)
def resume_action(state: State, command: ResumeAction, action: Action) -> tuple[Event, ...]:
    """Resume the rest of the execution once no failure of it is open; with no rest left it has finished."""
    return () if command.action_id in state.recovery else resumed(state, command, action)


def resumed(state: State, command: ResumeAction, action: Action) -> tuple[Event, ...]:
    """Return the events of `resume_action`, whatever failure is open."""
    if action.stage not in ("paused", "halted", "failed", "preempted"):
        return ()
    if action.stage == "preempted" and not (action.has_begun and holds_robot(state.execution, action)):
        return ()
    if action.remaining_us == 0:
        return (_finished(state, action),)
    ends_us = None if action.remaining_us is None else command.now_us + action.remaining_us
    return (ExecutionResumed(action.subject, action.robot, ends_us),)


def _finished(state: State, action: Action) -> ExecutionFinished:
    return ExecutionFinished(action.subject, parties(state, action), action.robot)


def holds_robot(execution: Execution, action: Action) -> bool:
    """Return whether the robot serves this action and no other."""
    return execution.current.get(action.robot) == action.action_id


def next_turn(execution: Execution, robot: Robot) -> tuple[Scheduled, ...]:
    """Schedule the turn of the action that now holds the robot, or resume one that was preempted.

    Paper: eq:override.
    """
    action = in_hand(execution, robot)
    if action is None or action.stage not in ("queued", "preempted"):
        return ()
    if action.stage == "preempted" and action.has_begun:
        return (Scheduled(ResumeAction(action.action_id)),)
    if action.has_approach:
        return (Scheduled(TakeTurn(action.action_id)),)
    return (start_action(action.action_id, action.capability),)


@HANDLERS.react(ExecutionQueued, ExecutionFinished, ExecutionWithdrawn)
def _on_queue(
    state: State, event: ExecutionQueued | ExecutionFinished | ExecutionWithdrawn, _now_us: int
) -> tuple[Scheduled, ...]:
    if isinstance(event, ExecutionQueued) and state.execution.current.get(event.robot) != event.subject.action_id:
        return ()
    return next_turn(state.execution, event.robot)


@HANDLERS.react(ExecutionStarted, ExecutionResumed)
def _on_running(state: State, event: ExecutionStarted | ExecutionResumed, now_us: int) -> tuple[Scheduled, ...]:
    """Schedule the planned end; without one the robot reports when it has finished."""
    if event.ends_us is None:
        return ()
    segment = state.execution.actions[event.subject.action_id].segments
    ask = holds(f"{event.subject.action_id}/{segment}")
    finish = Scheduled(FinishAttempt(event.subject.action_id, event.ends_us), max(1, event.ends_us - now_us), ask=ask)
    if state.world.obstructions.get(event.robot):
        return (Scheduled(DetectObstruction(event.subject.action_id)), finish)
    return (finish,)


def _in_stage(
    execution: Execution, robot: Robot, stage: Stage, command: Callable[[str], Command]
) -> tuple[Scheduled, ...]:
    """Schedule the command for the action that the robot has in hand, if it is in this stage."""
    action = in_hand(execution, robot)
    return (Scheduled(command(action.action_id)),) if action is not None and action.stage == stage else ()


@HANDLERS.react(ObstructionAppeared)
def _on_obstruction(state: State, event: ObstructionAppeared, _now_us: int) -> tuple[Scheduled, ...]:
    return _in_stage(state.execution, event.robot, "running", DetectObstruction)


def pause_running(state: State, event: ContextChanged, _now_us: int) -> tuple[Scheduled, ...]:
    """Schedule a pause for a robot whose context changes while it executes."""
    return _in_stage(state.execution, event.robot, "running", PauseAction)


def resume_when_replanned(state: State, event: ExecutionPaused, _now_us: int) -> tuple[Scheduled, ...]:
    """Resume a robot that plans alone once it has replanned."""
    return (Scheduled(ResumeAction(event.subject.action_id), state.fleet.structure.replan_us),)


@HANDLERS.react(FailureResolved)
def _on_resolved(_state: State, event: FailureResolved, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(ResumeAction(event.subject.action_id)),)


@HANDLERS.react(RoutineDue)
def _on_routine(state: State, event: RoutineDue, _now_us: int) -> tuple[Scheduled, ...]:
    """Schedule the routine operation; a robot that is off misses it."""
    return () if event.robot in state.world.off else (Scheduled(DecideRoutine(event.robot, event.operation)),)


@HANDLERS.react(RobotWentOff)
def _on_off(state: State, event: RobotWentOff, _now_us: int) -> tuple[Scheduled, ...]:
    return _in_stage(state.execution, event.robot, "running", HaltAction)


@HANDLERS.react(RobotCameBack)
def _on_back(state: State, event: RobotCameBack, _now_us: int) -> tuple[Scheduled, ...]:
    return _in_stage(state.execution, event.robot, "halted", ResumeAction)
