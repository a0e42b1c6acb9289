"""Progress of a task (sigma) through its steps."""

from .envelope import ActionId, Event, Robot, Subject, TaskId


class StepBegan(Event, frozen=True, kw_only=True):
    """The acting robot has turned to a step: its own when `target_role` is None, else one to delegate.

    A step that was denied begins again under a new `action_id`; `step` and `attempt` count from 1.
    """

    subject: Subject[TaskId, ActionId]
    robot: Robot
    step: int
    attempt: int
    capability: str
    target_role: str | None = None


class StepCompleted(Event, frozen=True):
    """The acting robot knows that the step is done."""

    subject: Subject[TaskId, ActionId]


class TaskCompleted(Event, frozen=True):
    """All steps are done; SQL judges whether in time."""

    task_id: TaskId


class TaskAbandoned(Event, frozen=True):
    """The task has taken twice its budget and is given up before its next step."""

    task_id: TaskId


class TaskPlanned(Event, frozen=True, kw_only=True):
    """A master has named one robot for each step of the task, in order; empty when it has found no plan.

    Units: `ready_us` microseconds of run time at which the planning ends.
    """

    task_id: TaskId
    robots: tuple[Robot, ...]
    ready_us: int
