"""Who carries out a command.

A robot that is off does nothing, so the kernel keeps its commands until it is back; see `runtime/kernel.py`.
"""

from typing import Protocol

from fsar_ledger.events.envelope import Robot, robot_named
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.task import Task

from .commands import BeginStep, Command


class _OfAction(Protocol):
    @property
    def action_id(self) -> str: ...


class _OfRobot(Protocol):
    @property
    def robot(self) -> Robot: ...


class _OfHelper(Protocol):
    @property
    def helper(self) -> Robot: ...


def nobody(_state: State, _command: Command) -> None:
    """Return None: a world, service, coordinator or human command has no actor that could be off."""


def named(_state: State, command: _OfRobot) -> Robot:
    """Return the robot that the command names."""
    return command.robot


def helping(_state: State, command: _OfHelper) -> Robot:
    """Return the robot that helps."""
    return command.helper


def body(state: State, command: _OfAction) -> Robot | None:
    """Return the robot that has the action."""
    action = state.execution.actions.get(command.action_id)
    return None if action is None else action.robot


def requester(state: State, command: _OfAction) -> Robot | None:
    """Return the robot whose step it is."""
    request = state.request.open.get(command.action_id)
    return None if request is None else request.requester


def target(state: State, command: _OfAction) -> Robot | None:
    """Return the robot picked to execute; for a step of its own, the robot whose step it is."""
    request = state.request.open.get(command.action_id)
    return None if request is None else request.target or request.requester


def asked(state: State, command: _OfAction) -> Robot | None:
    """Return the robot that the request goes to."""
    request = state.request.open.get(command.action_id)
    return request.candidates[0] if request is not None and request.candidates else None


def relay(state: State, command: _OfAction) -> Robot | None:
    """Return the peer that passes the request on."""
    request = state.request.open.get(command.action_id)
    return None if request is None else request.relay


def next_in_task(state: State, command: BeginStep) -> Robot | None:
    """Return the robot that acts in the next step of the task, if there is one left."""
    task = state.task.get(command.task_id)
    return None if task is None or task.step == len(task.steps) else acting(task, task.step)


def acting(task: Task, step: int) -> Robot:
    """Return the robot that acts in the step, counted from 0."""
    return robot_named(task.steps[step].partition(" ")[0], task.team)
