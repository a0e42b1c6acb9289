"""Motivations: what each robot senses as needed, which teammates it hears working on it, and its own activity.

An action has one name, and several robots can be active on it at once. The first one executes it under that name, any
other one under a name of its own (`execution_name`). So both robots move, both starts are on record, and their claims
are claims to the same action.
"""

from collections.abc import Mapping
from typing import assert_never

import msgspec

from fsar_ledger.events.envelope import Robot
from fsar_ledger.events.execution import ApproachStarted, ExecutionFinished, ExecutionStarted, ExecutionWithdrawn
from fsar_ledger.events.knowledge import ActivityBroadcast, ActivityHeard, MotivationBegan, NeedEnded
from fsar_ledger.events.task import TaskAbandoned

from . import put, without
from .execution import Execution

HANDLES = (
    MotivationBegan
    | ActivityHeard
    | ActivityBroadcast
    | NeedEnded
    | ApproachStarted
    | ExecutionStarted
    | ExecutionFinished
    | ExecutionWithdrawn
    | TaskAbandoned
)
BY = ":"  # between the name of an action, which has none, and that of another robot that executes it as well


class Heard(msgspec.Struct, frozen=True, gc=False):
    """When a teammate was heard to be active on an action. Units: run time; `patience_us` as in `ActivityHeard`."""

    first_us: int
    last_us: int
    patience_us: int


class Motivation(msgspec.Struct, frozen=True, gc=False):
    """A robot's motivation to do one action: its level at a time from which it grows by itself.

    `as_of_us` is None while the robot has only heard of a teammate's activity, and does not sense the need.
    Units: `level_us` microseconds of growth at the fast rate; `as_of_us` run time.
    """

    level_us: int = 0
    as_of_us: int | None = None
    heard: Mapping[Robot, Heard] = {}


class Activity(msgspec.Struct, frozen=True, gc=False):
    """What a robot is active on, since when (run time), and how often it has broadcast that."""

    action_id: str
    since_us: int
    broadcasts: int = 1


class Motivations(msgspec.Struct, frozen=True, gc=False):
    """Motivations and activities.

    `of`: action -> robot -> its motivation; `active`: robot -> its activity; `at`: robot -> the action whose place it
    was last at; `spells`: action -> how often some robot became active on it; `times_us`: robot, teammate,
    capability -> how long the teammate took, each time that the robot heard begin and end.
    """

    of: Mapping[str, Mapping[Robot, Motivation]] = {}
    active: Mapping[Robot, Activity] = {}
    at: Mapping[Robot, str] = {}
    spells: Mapping[str, int] = {}
    times_us: Mapping[tuple[Robot, Robot, str], tuple[int, ...]] = {}


INITIAL = Motivations()


def action_of(execution_id: str) -> str:
    """Return the action that is executed under this name."""
    return execution_id.partition(BY)[0]


def task_of(action_id: str) -> str:
    """Return the task of the action; an outsider's request is named after its task."""
    return action_id.rpartition("/")[0] or action_id


def execution_name(state: Execution, action_id: str, robot: Robot) -> str:
    """Return the name under which the robot executes the action, or would.

    That of the action, unless another robot has it under that name; a robot keeps a name of its own.
    """
    own_name = action_id + BY + robot[6:]
    action = state.actions.get(action_id)
    if own_name in state.actions or (action is not None and action.robot != robot and action.stage != "withdrawn"):
        return own_name
    return action_id


def motivation_of(state: Motivations, action_id: str, robot: Robot) -> Motivation | None:
    """Return the robot's motivation to do the action, or None if it knows nothing of it."""
    return state.of.get(action_id, {}).get(robot)


def evolve(state: Motivations, event: HANDLES) -> Motivations:
    """Return the motivations after the event."""
    replace = msgspec.structs.replace
    match event:
        case MotivationBegan():
            motivation = motivation_of(state, event.subject.action_id, event.robot) or Motivation()
            return _with(state, event, replace(motivation, level_us=0, as_of_us=event.since_us))
        case ActivityHeard():
            return _heard(state, event)
        case ActivityBroadcast():
            return _broadcast(state, event)
        case NeedEnded():
            return _over(state, event)
        case ApproachStarted():
            return replace(state, at=without(state.at, event.robot)) if event.robot in state.active else state
        case ExecutionStarted():
            if event.robot not in state.active:
                return state
            return replace(state, at=put(state.at, event.robot, action_of(event.subject.action_id)))
        case ExecutionFinished() | ExecutionWithdrawn():
            return replace(state, active=without(state.active, event.robot)) if event.robot in state.active else state
        case TaskAbandoned():
            left = {name: of for name, of in state.of.items() if task_of(name) != event.task_id}
            return state if len(left) == len(state.of) else replace(state, of=left)
        case _:
            assert_never(event)


def _with(state: Motivations, event: MotivationBegan | ActivityHeard, motivation: Motivation) -> Motivations:
    robots = put(state.of.get(event.subject.action_id, {}), event.robot, motivation)
    return msgspec.structs.replace(state, of=put(state.of, event.subject.action_id, robots))


def _heard(state: Motivations, event: ActivityHeard) -> Motivations:
    motivation = motivation_of(state, event.subject.action_id, event.robot) or Motivation()
    earlier = motivation.heard.get(event.peer)
    first_us = event.as_of_us if earlier is None else earlier.first_us
    heard = put(motivation.heard, event.peer, Heard(first_us, event.as_of_us, event.patience_us))
    as_of_us = None if motivation.as_of_us is None else event.as_of_us
    return _with(state, event, Motivation(event.level_us, as_of_us, heard))


def _broadcast(state: Motivations, event: ActivityBroadcast) -> Motivations:
    replace, action_id, activity = msgspec.structs.replace, event.subject.action_id, state.active.get(event.robot)
    if activity is not None and (activity.action_id, activity.since_us) == (action_id, event.since_us):
        repeated = replace(activity, broadcasts=activity.broadcasts + 1)
        return replace(state, active=put(state.active, event.robot, repeated))
    spells = put(state.spells, action_id, state.spells.get(action_id, 0) + 1)
    active = put(state.active, event.robot, Activity(action_id, event.since_us))
    return replace(state, active=active, spells=spells)


def _over(state: Motivations, event: NeedEnded) -> Motivations:
    action_id, of, times_us = event.subject.action_id, state.of, state.times_us
    left = without(of.get(action_id, {}), event.robot)
    of = put(of, action_id, left) if left else without(of, action_id)
    if event.took_us is not None:
        key = (event.robot, event.peer, event.capability)
        times_us = put(times_us, key, (*times_us.get(key, ()), event.took_us))
    return msgspec.structs.replace(state, of=of, times_us=times_us)
