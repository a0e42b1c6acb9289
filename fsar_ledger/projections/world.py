"""The state of the world: policy windows, obstructions, actuators, absent robots, links and supervisors."""

from collections.abc import Mapping
from typing import assert_never, get_args

import msgspec

from fsar_ledger.events.envelope import PolicyOutcome, Robot, Supervisor
from fsar_ledger.events.recovery import AssistanceEnded, FailureResolved, RecoveryAttemptFailed
from fsar_ledger.events.supervision import ActuatorServiced
from fsar_ledger.events.world import (
    ActuatorDegraded,
    Grade,
    LinkCameUp,
    LinkWentDown,
    ObstructionAppeared,
    ObstructionCleared,
    PolicyWindowClosed,
    PolicyWindowOpened,
    RobotCameBack,
    RobotWentOff,
    SupervisorLeft,
    SupervisorReturned,
)

from . import put, without

HANDLES = (
    PolicyWindowOpened
    | PolicyWindowClosed
    | ObstructionAppeared
    | ObstructionCleared
    | ActuatorDegraded
    | ActuatorServiced
    | RobotWentOff
    | RobotCameBack
    | LinkWentDown
    | LinkCameUp
    | SupervisorLeft
    | SupervisorReturned
    | AssistanceEnded
    | FailureResolved
    | RecoveryAttemptFailed
)

GRADES: tuple[Grade, ...] = get_args(Grade)  # from better to worse
Windows = Mapping[Robot, tuple[tuple[str, PolicyOutcome], ...]]  # robot -> open windows (id, outcome)


class World(msgspec.Struct, frozen=True, gc=False):
    """The true state of the world; deciders may read only what is local to them or what they were told.

    `degraded`: robot -> grade of its actuator; `off`: robots that are off; `unlinked`: robots whose link is down;
    `returns`: robot -> how often messages could reach it again.
    """

    local: Windows = {}
    fleet: Windows = {}
    obstructions: Mapping[Robot, tuple[str, ...]] = {}
    degraded: Mapping[Robot, Grade] = {}
    off_shift: frozenset[Supervisor] = frozenset()
    off: frozenset[Robot] = frozenset()
    unlinked: frozenset[Robot] = frozenset()
    returns: Mapping[Robot, int] = {}


INITIAL = World()


def stricter(one: PolicyOutcome, other: PolicyOutcome) -> PolicyOutcome:
    """Return the stricter of two outcomes: deny over review over allow. Paper: eq:policy."""
    if one == "deny" or other == "deny":
        return "deny"
    return "review" if one == "review" or other == "review" else "allow"


def in_force(windows: Windows, robot: Robot) -> PolicyOutcome:
    """Return the strictest outcome of the robot's open windows."""
    outcome: PolicyOutcome = "allow"
    for _, window_outcome in windows.get(robot, ()):
        outcome = stricter(outcome, window_outcome)
    return outcome


def is_linked(state: World, principal: str) -> bool:
    """Return whether messages reach and leave the principal.

    A robot must be on and its link up; any other principal is always linked.
    """
    return principal not in state.off and principal not in state.unlinked


def evolve(state: World, event: HANDLES) -> World:
    """Return the world after the event."""
    match event:
        case PolicyWindowOpened():
            windows = state.local if event.scope == "local" else state.fleet
            opened = put(windows, event.robot, (*windows.get(event.robot, ()), (event.window, event.outcome)))
            return msgspec.structs.replace(state, **{event.scope: opened})
        case PolicyWindowClosed():
            windows = state.local if event.scope == "local" else state.fleet
            left = tuple(entry for entry in windows.get(event.robot, ()) if entry[0] != event.window)
            return msgspec.structs.replace(state, **{event.scope: put(windows, event.robot, left)})
        case ObstructionAppeared():
            names = (*state.obstructions.get(event.robot, ()), event.obstruction)
            return msgspec.structs.replace(state, obstructions=put(state.obstructions, event.robot, names))
        case ObstructionCleared():
            names = tuple(name for name in state.obstructions.get(event.robot, ()) if name != event.obstruction)
            return msgspec.structs.replace(state, obstructions=put(state.obstructions, event.robot, names))
        case AssistanceEnded():  # the helper has cleared the way
            return _cleared(state, event.robot)
        case FailureResolved():
            # A supervisor also clears the way. A robot that recovered by itself found it clear; one whose step another
            # robot took over stays where it is.
            return _cleared(state, event.robot) if event.level == "human" else state
        case ActuatorDegraded():
            return _graded(state, event.robot, event.grade)
        case ActuatorServiced():
            return msgspec.structs.replace(state, degraded=without(state.degraded, event.robot))
        case RecoveryAttemptFailed():  # wear: a retry grips with full force, and a load that slips wears the pads off
            if event.result != "partial" or state.degraded.get(event.robot) != "slipping":
                return state
            return _graded(state, event.robot, "lost")
        case RobotWentOff():
            return msgspec.structs.replace(state, off=state.off | {event.robot})
        case RobotCameBack():
            return _returned(msgspec.structs.replace(state, off=state.off - {event.robot}), event.robot)
        case LinkWentDown():
            return msgspec.structs.replace(state, unlinked=state.unlinked | {event.robot})
        case LinkCameUp():
            return _returned(msgspec.structs.replace(state, unlinked=state.unlinked - {event.robot}), event.robot)
        case SupervisorLeft():
            return msgspec.structs.replace(state, off_shift=state.off_shift | {event.supervisor})
        case SupervisorReturned():
            return msgspec.structs.replace(state, off_shift=state.off_shift - {event.supervisor})
        case _:
            assert_never(event)


def _graded(state: World, robot: Robot, grade: Grade) -> World:
    """Degrade the actuator, unless it is already worse: only a service improves it."""
    worst = max(state.degraded.get(robot, grade), grade, key=GRADES.index)
    return msgspec.structs.replace(state, degraded=put(state.degraded, robot, worst))


def _returned(state: World, robot: Robot) -> World:
    if not is_linked(state, robot):
        return state
    return msgspec.structs.replace(state, returns=put(state.returns, robot, state.returns.get(robot, 0) + 1))


def _cleared(state: World, robot: Robot) -> World:
    return msgspec.structs.replace(state, obstructions=put(state.obstructions, robot, ()))
