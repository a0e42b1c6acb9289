"""Tasks go through their steps, whoever governs them. Paper: sec:evaluation:scenarios."""

from fsar_ledger.events import Event
from fsar_ledger.events.supervision import SupervisorCalled
from fsar_ledger.events.task import StepBegan, StepCompleted, TaskAbandoned, TaskCompleted
from fsar_ledger.events.world import TaskArrived
from fsar_ledger.projections.fold import State

from .commands import BeginStep, CompleteStep, Decides, Reacts, Scheduled


def begin_step(state: State, command: BeginStep) -> tuple[Event, ...]:
    """The task has begun its next step, is completed, or has been given up after twice its budget."""
    task = state.task.get(command.task_id)
    if task is None:
        return ()
    if task.step == len(task.steps):
        return (TaskCompleted(task.task_id),)
    if command.now_us > task.due_us + (state.fleet.structure.expiry_budgets - 1) * task.budget_us:
        return (TaskAbandoned(task.task_id),)
    actor, capability, *target = task.steps[task.step].split(" ")
    attempt = task.attempt + 1
    return (
        StepBegan(
            task.task_id,
            f"{task.task_id}/{task.step + 1}.{attempt}",
            f"robot/{actor}{task.team}",
            task.step + 1,
            attempt,
            capability,
            target[0] if target else None,
        ),
    )


def complete_step(state: State, command: CompleteStep) -> tuple[Event, ...]:
    """The step is done, unless it was already."""
    request = state.request.get(command.action_id)
    return () if request is None else (StepCompleted(request.task_id, request.action_id),)


def is_critical(state: State, task_id: str) -> bool:
    """True when the task is open and time-critical."""
    task = state.task.get(task_id)
    return task is not None and task.is_time_critical


def first_in_order(state: State, call: SupervisorCalled) -> str | None:
    """Which of two competing actions H_F lets go first: the time-critical one, else the one that came first. Paper: sec:prototype:workflows."""
    if call.competing is None:
        return None
    other = state.request.get(call.competing)
    comes_before = other is not None and is_critical(state, other.task_id) and not is_critical(state, call.task_id)
    return call.competing if comes_before else call.action_id


def _begin(_state: State, event: TaskArrived | StepCompleted, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(BeginStep(event.task_id)),)


DECIDES: Decides = {BeginStep: begin_step, CompleteStep: complete_step}
REACTS: Reacts = {TaskArrived: _begin, StepCompleted: _begin}
