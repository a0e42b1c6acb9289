"""ALLIANCE: what a robot does while it is active; routine; and how a task goes to the robot of its next step."""

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Principals, Robot
from fsar_ledger.events.execution import (
    ApproachStarted,
    ExecutionPaused,
    RoutinePerformed,
    RoutineWithheld,
)
from fsar_ledger.events.world import ContextChanged
from fsar_ledger.projections.execution import Action
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.motivation import action_of
from fsar_ledger.runtime.handlers import execution as bodies
from fsar_ledger.runtime.handlers.commands import (
    Command,
    Decide,
    DecideRoutine,
    Handlers,
    React,
    ResumeAction,
    Scheduled,
    StartAction,
    TakeTurn,
    body,
    known_action,
    lasts,
    named,
)
from fsar_ledger.runtime.handlers.execution import approach, pause_running, resumed, started, waiting
from fsar_ledger.runtime.handlers.policy import own_policy
from fsar_ledger.runtime.handlers.task import TransferSegment, transferred

from .activity import by_robot

HANDLERS = Handlers()


class StartWork(StartAction, kw_only=True):
    """Start the action on arrival; nothing if the robot has left the action since, even if it has come back to it."""

    robot: Robot
    since_us: int


@HANDLERS.decide(StartAction, body)
def start(state: State, command: StartAction) -> tuple[Event, ...]:
    """Start the execution: a robot that is active, and has no further to go, acts."""
    action = waiting(state.execution, command.action_id)
    return () if action is None else (started(state, action, command),)


@HANDLERS.decide(StartWork, body)
def start_work(state: State, command: StartWork) -> tuple[Event, ...]:
    """Start the execution of the robot that has arrived."""
    active, action = state.motivation.active.get(command.robot), state.execution.actions.get(command.action_id)
    if active is None or action is None or (action.robot, active.since_us) != (command.robot, command.since_us):
        return ()
    return start(state, command)


def _resume(state: State, command: ResumeAction) -> tuple[Event, ...]:
    """Go on with the rest, unless it has just failed; a robot that has given up once and tries anew goes on as well."""
    action = known_action(state, command.action_id)
    if action is None or (action.stage == "failed" and command.action_id in state.recovery):
        return ()
    return resumed(state, command, action)


@HANDLERS.decide(DecideRoutine, named)
def decide_routine(state: State, command: DecideRoutine) -> tuple[Event, ...]:
    """Perform the routine operation; withhold a motion that the robot's own policy, if it is sensed, does not allow."""
    robot, operation = command.robot, command.operation
    principals = by_robot(robot).decided(robot)
    is_sensed = operation == "motion" and state.fleet.alliance.senses_policy
    if is_sensed and own_policy(state.policy, state.world, robot, None, None) != "allow":
        return (RoutineWithheld(principals, robot, operation),)
    return (RoutinePerformed(principals, robot, operation),)


def _transfer(state: State, command: TransferSegment) -> tuple[Event, ...]:
    """Give the next segment to its robot; the record names who executes it, and nobody who asked."""

    def by_it(before: Robot, then: Robot) -> Principals:
        return by_robot(then).decided(before)

    return transferred(state, command, by_it)


def _on_approach(state: State, event: ApproachStarted, now_us: int) -> tuple[Scheduled, ...]:
    """Start the work on arrival. The first way to an action is the same under every architecture."""
    action: Action = state.execution.actions[event.subject.action_id]
    active = state.motivation.active.get(event.robot)
    if active is None:
        return bodies.start_after_approach(state, event, now_us)
    again = state.motivation.spells[action_of(action.action_id)] - 1
    way = lasts("approach", f"{action.action_id}/{again}" if again else action.action_id)
    work = StartWork(action.action_id, robot=event.robot, since_us=active.since_us)
    return (Scheduled(work, 0, (way,), lasts(action.capability, action.action_id)),)


@HANDLERS.react(ExecutionPaused)
def _on_pause(state: State, event: ExecutionPaused, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(ResumeAction(event.subject.action_id), state.fleet.structure.replan_us),)


HANDLERS.decide(TakeTurn, body)(approach)
HANDLERS.react(ContextChanged)(pause_running)

INSTEAD: dict[React, React] = {bodies.start_after_approach: _on_approach}
OWN: dict[type[Command], Decide] = {ResumeAction: _resume, TransferSegment: _transfer}
