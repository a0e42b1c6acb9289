"""Open tasks and how far they are. Paper: sec:evaluation:metrics (fleet tasks)."""

from collections.abc import Container, Mapping
from typing import assert_never

import msgspec
from msgspec.structs import replace

from fsar_ledger.designs.constants import END_US
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot, recorded_robot
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.events.request import RequestIssued
from fsar_ledger.events.task import StepBegan, StepCompleted, TaskAbandoned, TaskCompleted, TaskPlanned
from fsar_ledger.events.world import TaskArrived

from . import put, without
from .fleet import NEVER_US, Fleet
from .request import Request

HANDLES = TaskArrived | TaskPlanned | StepBegan | StepCompleted | TaskCompleted | TaskAbandoned


class Task(msgspec.Struct, frozen=True, gc=False):
    """An open task.

    `step` counts the steps done, `attempt` the attempts at the present one, from 1; `checkpoints` as in `TaskArrived`.
    `action_id` is the last attempt, empty before the first. `has_arrived`: its arrival is on record; if not, nothing is
    known of its team, steps and times. `robot` is empty, and a number 0, where not on record. `plan`
    names one robot for each step, where a master has planned them all.
    """

    task_id: str
    robot: Robot
    team: int
    steps: tuple[str, ...]
    budget_us: int
    due_us: int
    step: int = 0
    attempt: int = 0
    action_id: str = ""
    checkpoints: tuple[str, ...] | None = None
    is_time_critical: bool = False
    has_arrived: bool = True
    plan: tuple[Robot, ...] = ()


Tasks = Mapping[str, Task]

INITIAL: Tasks = {}


def evolve(state: Tasks, event: HANDLES) -> Tasks:
    """Return the open tasks after the event."""
    match event:
        case StepBegan():
            opened = state.get(event.subject.task_id)
            if opened is None:  # another system's record may lack the arrival
                opened = Task(event.subject.task_id, event.robot, 0, (), 0, 0, event.step - 1, has_arrived=False)
            return put(
                state, event.subject.task_id, replace(opened, attempt=event.attempt, action_id=event.subject.action_id)
            )
        case StepCompleted():
            opened = state.get(event.subject.task_id)
            return (
                state
                if opened is None
                else put(state, event.subject.task_id, replace(opened, step=opened.step + 1, attempt=0, action_id=""))
            )
        case TaskArrived():
            task = Task(
                event.task_id,
                event.robot or recorded_robot(""),
                event.team or 0,
                event.steps,
                event.budget_us or 0,
                event.due_us or 0,
                checkpoints=event.checkpoints,
                is_time_critical=event.is_time_critical,
            )
            return put(state, event.task_id, task)
        case TaskPlanned():
            opened = state.get(event.task_id)
            return state if opened is None else put(state, event.task_id, replace(opened, plan=event.robots))
        case TaskCompleted() | TaskAbandoned():
            return without(state, event.task_id)
        case _:
            assert_never(event)


class RequestEnds(msgspec.Struct, frozen=True):
    """The requests of another system's run that are over without being closed: with their task, or their result.

    Requests are numbered as they are issued. `numbers` has the last one for each action; `ended`, by task, how many
    there were when the task was abandoned, or was completed where the source does not record that requests are closed.
    Our own runs close theirs.
    """

    is_foreign: bool = False
    tells_closings: bool = True
    requests: int = 0
    numbers: Mapping[str, int] = {}
    ended: Mapping[str, int] = {}

    def after(self, event: Event) -> "RequestEnds":
        """Return the ends after this event. The first event of a run declares what its source records."""
        if isinstance(event, RunStarted):
            tells = "request" in (event.observes or ()) or "RequestClosed" in (event.records or ())
            return RequestEnds(event.kind == "foreign", tells)
        if not self.is_foreign:
            return self
        if isinstance(event, RequestIssued):
            number = self.requests + 1
            return replace(self, requests=number, numbers=put(self.numbers, event.subject.action_id, number))
        if isinstance(event, TaskAbandoned) or (isinstance(event, TaskCompleted) and not self.tells_closings):
            return replace(self, ended=put(self.ended, event.task_id, self.requests))
        return self

    def is_over(self, request: Request, in_hand: Container[str]) -> bool:
        """Return whether the request is over; an unclosed one is open while its action is among those `in_hand`."""
        if request.is_over or request.action_id in in_hand:
            return request.is_over
        has_result = self.is_foreign and not self.tells_closings and request.result is not None
        number = self.numbers.get(request.action_id)
        return has_result or (number is not None and number <= self.ended.get(request.task_id, 0))


# See docs/decisions/late-tasks-are-given-up.md.
def given_up_us(task: TaskArrived | Task, fleet: Fleet) -> int:
    """Return the run time at which the task is given up, even while it waits.

    That is after a number of budgets, or when the run ends if that is earlier. A live run may take any time.
    """
    budgets = fleet.structure.expiry_budgets
    latest_us = NEVER_US if fleet.is_live else END_US
    return min((task.due_us or 0) + (budgets - 1) * (task.budget_us or 0), latest_us)


def checkpoint(state: Tasks, task_id: str, step: int) -> str | None:
    """Return the declared state before the step, from which another robot can resume, or None.

    Paper: sec:model:recovery, level 3.
    """
    task = state.get(task_id)
    if task is None or not 1 <= step <= len(task.steps):
        return None
    return f"{task_id}/{step}" if task.checkpoints is None or str(step) in task.checkpoints else None
