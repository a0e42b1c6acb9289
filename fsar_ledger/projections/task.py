"""Open tasks and how far they are. Paper: sec:evaluation:metrics (fleet tasks)."""

from typing import assert_never

import msgspec

from fsar_ledger.events.task import StepBegan, StepCompleted, TaskAbandoned, TaskCompleted
from fsar_ledger.events.world import TaskArrived

HANDLES = TaskArrived | StepBegan | StepCompleted | TaskCompleted | TaskAbandoned


class Task(msgspec.Struct, frozen=True, gc=False):
    """An open task. `step` counts the steps done; `attempt` the attempts of the present one, from 1."""

    task_id: str
    robot: str
    team: int
    steps: tuple[str, ...]
    budget_us: int
    due_us: int
    step: int = 0
    attempt: int = 0
    action_id: str = ""


Tasks = dict[str, Task]

INITIAL: Tasks = {}


def evolve(state: Tasks, event: HANDLES) -> Tasks:
    """The open tasks after the event."""
    match event:
        case StepBegan():
            task = state[event.task_id]
            begun = Task(task.task_id, task.robot, task.team, task.steps, task.budget_us, task.due_us, task.step, event.attempt, event.action_id)
            return {**state, event.task_id: begun}
        case StepCompleted():
            task = state[event.task_id]
            done = Task(task.task_id, task.robot, task.team, task.steps, task.budget_us, task.due_us, task.step + 1, 0)
            return {**state, event.task_id: done}
        case TaskArrived():
            return {**state, event.task_id: Task(event.task_id, event.robot, event.team, event.steps, event.budget_us, event.due_us)}
        case TaskCompleted() | TaskAbandoned():
            return {task_id: task for task_id, task in state.items() if task_id != event.task_id}
        case _:
            assert_never(event)
