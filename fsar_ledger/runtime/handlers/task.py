"""How tasks go through their steps under every architecture. Paper: sec:evaluation:scenarios."""

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot, Subject, robot_named
from fsar_ledger.events.supervision import SupervisorCalled
from fsar_ledger.events.task import StepBegan, StepCompleted, TaskAbandoned, TaskCompleted
from fsar_ledger.events.world import TaskArrived
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.registry import possesses
from fsar_ledger.projections.request import Requests
from fsar_ledger.projections.task import Tasks, given_up_us

from .commands import (
    BeginStep,
    CompleteStep,
    ExpireTask,
    Handlers,
    Scheduled,
    acting,
    at_once,
    next_in_task,
    nobody,
    requester,
)
from .public import PublicCommand, made_from, rejected, unknown_capability, unknown_robot

HANDLERS = Handlers()


class SubmitTask(PublicCommand):
    """Give the robot a task, with steps as in `TaskArrived`. Units: `budget_us` microseconds from now."""

    robot: Robot
    task_id: str
    steps: tuple[str, ...]
    budget_us: int
    checkpoints: tuple[str, ...] | None = None
    is_time_critical: bool = False


@HANDLERS.decide(SubmitTask)
def submit_task(state: State, command: SubmitTask) -> tuple[Event, ...]:
    """Record the task, whose first step will begin."""
    reason = unknown_robot(state.fleet, command.robot) or _impossible(state, command)
    if reason is not None:
        return rejected(command, command.task_id, reason, command.robot)
    team, due_us = state.fleet.robots[command.robot].team, command.now_us + command.budget_us
    return (made_from(TaskArrived, command, team=team, due_us=due_us),)


def _impossible(state: State, command: SubmitTask) -> str | None:
    """Return why nobody could do the task, or None."""
    if not command.task_id or "/" in command.task_id or ":" in command.task_id:
        return f"task name {command.task_id!r}, expected a name without a slash or a colon"
    if command.task_id in state.task or command.task_id in state.context or _is_named(state.request, command.task_id):
        return f"the name {command.task_id} is taken, expected a new one"
    if command.budget_us <= 0 or not command.steps:
        return (
            f"{len(command.steps)} steps in {command.budget_us} microseconds, expected at least one step and some time"
        )
    places = [str(number) for number in range(1, len(command.steps) + 1)]
    unknown = [place for place in command.checkpoints or () if place not in places]
    if unknown:
        return f"checkpoint {unknown[0]!r}, expected the numbers of steps, 1 to {len(places)}"
    team = state.fleet.robots[command.robot].team
    for step in command.steps:
        match step.split(" "):
            case [actor, capability]:
                able = possesses(state.registry, robot_named(actor, team), capability)
            case [actor, capability, target] if target:
                able = (
                    robot_named(actor, team) in state.fleet.robots
                    and unknown_capability(state.registry, capability) is None
                )
            case _:
                able = False
        if not able:
            return (
                f"step {step!r}, "
                "expected ACTOR CAPABILITY [TARGET] of the robot's team, with a capability that somebody possesses"
            )
    return None


def _is_named(requests: Requests, task_id: str) -> bool:
    """Tell whether a request has that context, or the name that a step of such a task would have."""
    return any(request.task_id == task_id or name.startswith(task_id + "/") for name, request in requests.open.items())


@HANDLERS.decide(BeginStep, next_in_task)
def begin_step(state: State, command: BeginStep) -> tuple[Event, ...]:
    """Begin the task's next step, complete the task, or give it up after so many budgets.

    Nothing if the task has moved on by another way.
    """
    task = state.task.get(command.task_id)
    if task is None or task.action_id != command.after:
        return ()
    if task.step == len(task.steps):
        return (TaskCompleted(task.task_id),)
    if command.now_us > given_up_us(task, state.fleet.structure.expiry_budgets):
        return (TaskAbandoned(task.task_id),)
    actor, capability, *target = task.steps[task.step].split(" ")
    attempt = task.attempt + 1
    return (
        StepBegan(
            subject=Subject(task.task_id, f"{task.task_id}/{task.step + 1}.{attempt}"),
            robot=robot_named(actor, task.team),
            step=task.step + 1,
            attempt=attempt,
            capability=capability,
            target_role=target[0] if target else None,
        ),
    )


@HANDLERS.decide(ExpireTask, nobody)
def expire_task(state: State, command: ExpireTask) -> tuple[Event, ...]:
    """Give up the task, if it is still open."""
    return () if state.task.get(command.task_id) is None else (TaskAbandoned(command.task_id),)


@HANDLERS.decide(CompleteStep, requester)
def complete_step(state: State, command: CompleteStep) -> tuple[Event, ...]:
    """Complete the step, unless it was already or its task was given up."""
    request = state.request.open.get(command.action_id)
    return () if request is None or request.task_id not in state.task else (StepCompleted(request.subject),)


def is_critical(tasks: Tasks, task_id: str) -> bool:
    """Tell whether the task is open and time-critical."""
    task = tasks.get(task_id)
    return task is not None and task.is_time_critical


def first_in_order(requests: Requests, tasks: Tasks, call: SupervisorCalled) -> str | None:
    """Return which of two competing actions H_F lets go first: the time-critical one, else the earlier one.

    Paper: sec:prototype:workflows.
    """
    if call.competing is None:
        return None
    other = requests.open.get(call.competing)
    comes_before = (
        other is not None and is_critical(tasks, other.task_id) and not is_critical(tasks, call.subject.task_id)
    )
    return call.competing if comes_before else call.subject.action_id


@HANDLERS.react(StepCompleted)
def _begin(state: State, event: StepCompleted, _now_us: int) -> tuple[Scheduled, ...]:
    """Schedule the next step; if another robot acts in it, the robot that acted in this one tells it."""
    task = state.task[event.subject.task_id]
    is_last = task.step == len(task.steps)
    before = acting(task, task.step - 1)
    told = () if is_last or acting(task, task.step) == before else (at_once(before),)
    return (Scheduled(BeginStep(event.subject.task_id), 1, told),)


@HANDLERS.react(TaskArrived)
def _on_arrival(state: State, event: TaskArrived, now_us: int) -> tuple[Scheduled, ...]:
    """Schedule the first step, and the time at which the task is given up.

    That is after so many budgets, and at the latest at the end of the run.
    """
    left_us = max(1, given_up_us(event, state.fleet.structure.expiry_budgets) - now_us)
    return (Scheduled(BeginStep(event.task_id)), Scheduled(ExpireTask(event.task_id), left_us + 1))
