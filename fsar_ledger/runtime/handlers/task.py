"""How tasks go through their steps under every architecture. Paper: sec:evaluation:scenarios.

When a task is given up (reading R3), its actions that wait for their robot, approach or are held are withdrawn, their
claims end, and questions asked for it get no answer. An action that executes by then, or is being recovered, ends as it
would have: a robot does not stop in a doorway. The requesting robot notifies each robot that has an action of the task;
until the message is there, that robot does not know. A robot withdraws its own actions at once.
"""

from collections.abc import Callable

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import COORDINATION, COORDINATOR, Principals, Robot, Subject, robot_named
from fsar_ledger.events.execution import ExecutionWithdrawn
from fsar_ledger.events.request import SegmentTransferred
from fsar_ledger.events.supervision import SupervisorCalled
from fsar_ledger.events.task import StepBegan, StepCompleted, TaskAbandoned, TaskCompleted
from fsar_ledger.events.world import TaskArrived
from fsar_ledger.projections.authority import Authority
from fsar_ledger.projections.execution import Action, Execution
from fsar_ledger.projections.fleet import Fleet
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.registry import possesses
from fsar_ledger.projections.request import Requests
from fsar_ledger.projections.task import Task, Tasks, given_up_us
from fsar_ledger.runtime.ports import Ask

from .attribution import recorded_by
from .authority import released
from .commands import (
    BeginStep,
    Command,
    CompleteStep,
    ExpireTask,
    Handlers,
    Scheduled,
    acting,
    commanded_robot,
    message,
    next_in_task,
    nobody,
    present,
    requester,
)
from .execution import holds_robot
from .public import Work, absent_robot, made_from, rejected, unknown_capability

HANDLERS = Handlers()


class SubmitTask(Work):
    """Give the robot a task, with steps as in `TaskArrived`. Units: `budget_us` microseconds from now."""

    task_id: str
    steps: tuple[str, ...]
    budget_us: int
    checkpoints: tuple[str, ...] | None = None
    is_time_critical: bool = False


@HANDLERS.decide(SubmitTask)
def submit_task(state: State, command: SubmitTask) -> tuple[Event, ...]:
    """Record the task, whose first step will begin."""
    reason = absent_robot(state.fleet, command.robot) or _impossible(state, command)
    if reason is not None:
        return rejected(command, command.task_id, reason, command.robot)
    team, due_us = state.fleet.robots[command.robot].team, command.now_us + command.budget_us
    return (made_from(TaskArrived, command, team=team, due_us=due_us),)


def _impossible(state: State, command: SubmitTask) -> str | None:
    """Return why no robot could do the task, or None."""
    if not command.task_id or "/" in command.task_id or ":" in command.task_id:
        return f"task name {command.task_id!r}, expected a name without a slash or a colon"
    if command.task_id in state.task or command.task_id in state.context or _is_named(state.request, command.task_id):
        return f"the name {command.task_id} is taken, expected a new one"
    if command.budget_us <= 0 or not command.steps:
        return (
            f"{len(command.steps)} steps in {command.budget_us} microseconds, expected at least one step and some time"
        )
    step_numbers = [str(number) for number in range(1, len(command.steps) + 1)]
    unknown = [checkpoint for checkpoint in command.checkpoints or () if checkpoint not in step_numbers]
    if unknown:
        return f"checkpoint {unknown[0]!r}, expected the numbers of steps, 1 to {len(step_numbers)}"
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
    """Return whether a request has that context, or the name that a step of such a task would have."""
    steps = f"{task_id}/"
    return steps in requests.past or any(
        request.task_id == task_id or name.startswith(steps) for name, request in requests.open.items()
    )


def is_own_step(task: Task, step: int, robot: Robot) -> bool:
    """Return whether the robot acts in the step, counted from 0, and does it itself."""
    return 0 <= step < len(task.steps) and acting(task, step) == robot and task.steps[step].count(" ") == 1


def is_within_reach(fleet: Fleet, task: Task) -> bool:
    """Return whether the task's next step can begin: an isolated robot does only its own steps."""
    return fleet.isolated is None or is_own_step(task, task.step, fleet.isolated)


@HANDLERS.decide(BeginStep, next_in_task)
def begin_step(state: State, command: BeginStep) -> tuple[Event, ...]:
    """Begin the task's next step, complete the task, or give it up once its time is over.

    It is given up at once if the robot that acts in the step has left the fleet. Nothing if the task has moved on
    otherwise.
    """
    task = state.task.get(command.task_id)
    if task is None or task.action_id != command.after or command.step not in (None, task.step):
        return ()
    if task.step == len(task.steps):
        return (TaskCompleted(task.task_id),)
    if acting(task, task.step) in state.fleet.departed or command.now_us > given_up_us(task, state.fleet):
        return (TaskAbandoned(task.task_id),)
    if not is_within_reach(state.fleet, task):
        return ()
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


class TransferSegment(Command):
    """Give the rest of the task to the robot that acts in its next step."""

    task_id: str


def acted_last(state: State, command: TransferSegment) -> Robot | None:
    """Return the robot that acted in the open task's last completed step."""
    task = state.task.get(command.task_id)
    return None if task is None else present(state.fleet, acting(task, task.step - 1))


@HANDLERS.decide(TransferSegment, acted_last)
def transfer_segment(state: State, command: TransferSegment) -> tuple[Event, ...]:
    """Give the next segment to its robot, as decided by the one that acted until then, or for it if it has left."""

    def by_it(before: Robot, then: Robot) -> Principals:
        by = COORDINATION if before in state.fleet.departed else before
        return recorded_by(state, before, requested_by=before, executed_by=then).decided(by)

    return transferred(state, command, by_it)


def transferred(
    state: State, command: TransferSegment, named_by: Callable[[Robot, Robot], Principals]
) -> tuple[Event, ...]:
    """Return the transfer, unless the task is over; `named_by` gives the principals, from both robots."""
    task = state.task.get(command.task_id)
    if task is None:
        return ()
    sender, receiver = acting(task, task.step - 1), acting(task, task.step)
    return (SegmentTransferred(task.task_id, named_by(sender, receiver), receiver, task.step + 1),)


@HANDLERS.decide(ExpireTask, nobody)
def expire_task(state: State, command: ExpireTask) -> tuple[Event, ...]:
    """Give up the task if it is still open, but not a later one of the same name."""
    task = state.task.get(command.task_id)
    return () if task is None or command.now_us <= given_up_us(task, state.fleet) else (TaskAbandoned(task.task_id),)


@HANDLERS.decide(CompleteStep, requester)
def complete_step(state: State, command: CompleteStep) -> tuple[Event, ...]:
    """Complete the step, unless it was already or its task was given up."""
    request = state.request.open.get(command.action_id)
    return () if request is None or request.task_id not in state.task else (StepCompleted(request.subject),)


def is_critical(tasks: Tasks, task_id: str) -> bool:
    """Return whether the task is open and time-critical."""
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
def on_completed(state: State, event: StepCompleted, _now_us: int) -> tuple[Scheduled, ...]:
    """Schedule the next step; if another robot acts in it, its segment is transferred first."""
    task = state.task[event.subject.task_id]
    if task.step == len(task.steps) or acting(task, task.step) == acting(task, task.step - 1):
        return (Scheduled(BeginStep(task.task_id, step=task.step), 1),)
    return (Scheduled(TransferSegment(task.task_id), 1),) if state.fleet.isolated is None else ()


@HANDLERS.react(SegmentTransferred)
def on_transfer(state: State, event: SegmentTransferred, _now_us: int) -> tuple[Scheduled, ...]:
    """Let the robot begin once the message has arrived."""
    return (Scheduled(BeginStep(event.task_id), 0, (segment_message(state, event),)),)


def segment_message(state: State, event: SegmentTransferred) -> Ask:
    """Ask for the latency of the message that transfers the segment, from the principal that decided it."""
    decided_by, previous = event.principals.decided_by, acting(state.task[event.task_id], event.step - 2)
    sender = decided_by if decided_by in (COORDINATOR, COORDINATION) else previous
    return message(sender, f"{event.task_id}/{event.step}", "segment")


@HANDLERS.react(TaskArrived)
def on_arrival(state: State, event: TaskArrived, now_us: int) -> tuple[Scheduled, ...]:
    """Schedule the first step, and the time at which the task is given up.

    That is after a number of budgets, and at the latest at the end of the run.
    """
    left_us = max(1, given_up_us(event, state.fleet) - now_us)
    return (Scheduled(BeginStep(event.task_id)), Scheduled(ExpireTask(event.task_id), left_us + 1))


WAITING = ("queued", "approaching", "held", "polling")


class WithdrawTask(Command):
    """Tell the robot that the task was given up."""

    task_id: str
    robot: Robot


class EndClaims(Command):
    """End the claims of a given-up task on actions that no robot has yet."""

    task_id: str


@HANDLERS.decide(WithdrawTask, commanded_robot)
def withdraw_task(state: State, command: WithdrawTask) -> tuple[Event, ...]:
    """Withdraw the actions of the task that the robot has not begun, and release every claim on them."""
    waiting = [
        action for action in _waiting(state.execution, state.request, command.task_id) if action.robot == command.robot
    ]
    withdrawn = sorted(waiting, key=lambda action: holds_robot(state.execution, action))
    claims = _claims(state.authority, command.task_id, {action.action_id for action in withdrawn})
    return (
        *released(claims),
        *(ExecutionWithdrawn(action.subject, action.robot) for action in withdrawn),
    )


@HANDLERS.decide(EndClaims, nobody)
def end_claims(state: State, command: EndClaims) -> tuple[Event, ...]:
    """Release the claims on actions that no robot has."""
    orphaned = {
        name
        for name in state.authority.claims
        if name not in state.execution.actions and name not in state.request.open
    }
    return released(_claims(state.authority, command.task_id, orphaned))


def _waiting(execution: Execution, requests: Requests, task_id: str) -> list[Action]:
    """Return the actions of the task that robots have but have not begun."""
    return [
        action
        for action in execution.actions.values()
        if action.task_id == task_id and has_not_begun(action) and _is_step(requests, action)
    ]


def _claims(authority: Authority, task_id: str, actions: set[str]) -> list[AuthorityClaimed]:
    return [
        claim
        for name, claims in authority.claims.items()
        if name in actions
        for claim in claims
        if claim.subject.task_id == task_id
    ]


def has_not_begun(action: Action) -> bool:
    """Return whether the action waits for its robot, approaches or is held."""
    return action.stage in WAITING or (action.stage == "preempted" and not action.has_begun)


def _is_step(requests: Requests, action: Action) -> bool:
    """Return whether this is a step, not a request that a robot issued by itself in the task's context."""
    request = requests.open.get(action.action_id)
    return request is None or not request.is_adhoc


@HANDLERS.react(TaskAbandoned)
def _on_abandoned(state: State, event: TaskAbandoned, _now_us: int) -> tuple[Scheduled, ...]:
    senders = {
        action.robot: action.requested_by or action.on_behalf_of
        for action in _waiting(state.execution, state.request, event.task_id)
    }
    notices = (_scheduled_withdrawal(event.task_id, robot, sender) for robot, sender in senders.items())
    return (Scheduled(EndClaims(event.task_id)), *notices)


def _scheduled_withdrawal(task_id: str, robot: Robot, sender: str) -> Scheduled:
    if sender == robot:
        return Scheduled(WithdrawTask(task_id, robot))
    return Scheduled(WithdrawTask(task_id, robot), 0, (message(sender, task_id, f"given up/{robot}"),))
