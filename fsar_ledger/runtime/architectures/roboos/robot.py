"""RoboOS: a robot serves one subtask at a time, in order of arrival, and sends one result back.

Source: slaver/run.py, handle_task and _execute_task: one agent and one lock a robot. Nothing is checked. Our choices:
with the dial `gate`, a subtask is refused on arrival, and a refusal is a result like any other; a subtask of a task
that was given up comes back as a result, too. The source has no way to cancel one; here a queued one is withdrawn with
its task, as under every architecture (reading R3), which is kinder where tasks run late.
"""

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import COORDINATOR, RequestSubject, Robot, Subject
from fsar_ledger.events.execution import (
    ExecutionFinished,
    ExecutionPaused,
    ExecutionWithdrawn,
    RoutinePerformed,
    RoutineWithheld,
)
from fsar_ledger.events.request import CommandIssued, RequestDenied
from fsar_ledger.events.world import ContextChanged
from fsar_ledger.projections.fold import State
from fsar_ledger.runtime.handlers.commands import (
    ActionCommand,
    DecideRoutine,
    Handlers,
    ResumeAction,
    Scheduled,
    StartAction,
    TakeTurn,
    body,
    message,
    named,
    open_request,
)
from fsar_ledger.runtime.handlers.execution import approach, pause_running, queued, started, waiting
from fsar_ledger.runtime.handlers.policy import own_policy

from .master import TakeResult, on_record

HANDLERS = Handlers()


class TakeSubtask(ActionCommand):
    """Take the subtask that the master has sent."""

    task_id: str
    robot: Robot


@HANDLERS.decide(TakeSubtask, named)
def take_subtask(state: State, command: TakeSubtask) -> tuple[Event, ...]:
    """Queue the subtask behind the lock; with the gate, refuse what the robot's own policy denies."""
    request, robot = open_request(state, command.action_id), command.robot
    if request is None:  # its task was given up meanwhile
        return (ExecutionWithdrawn(Subject(command.task_id, command.action_id), robot),)
    if not _may(state, robot, request.capability, request.task_id):
        subject = RequestSubject(request.task_id, request.action_id, None)
        return (RequestDenied(subject, on_record(robot).decided(robot), "policy"),)
    return (queued(request, on_record(robot), robot, is_supervised=False),)


def _may(state: State, robot: Robot, capability: str | None, context: str | None) -> bool:
    """Tell whether the robot does it: always, unless it has a gate and its own policy denies."""
    if not state.fleet.roboos.gate:
        return True
    return own_policy(state.policy, state.world, robot, capability, context) != "deny"


@HANDLERS.decide(StartAction, body)
def start(state: State, command: StartAction) -> tuple[Event, ...]:
    """Start the execution, whatever any policy says by now."""
    action = waiting(state.execution, command.action_id)
    return () if action is None else (started(state, action, command),)


@HANDLERS.decide(DecideRoutine, named)
def decide_routine(state: State, command: DecideRoutine) -> tuple[Event, ...]:
    """Perform the routine operation; with the gate, withhold a motion that the robot's own policy denies."""
    principals = on_record(command.robot).decided(command.robot)
    if command.operation == "motion" and not _may(state, command.robot, None, None):
        return (RoutineWithheld(principals, command.robot, command.operation),)
    return (RoutinePerformed(principals, command.robot, command.operation),)


@HANDLERS.react(CommandIssued)
def _on_command(_state: State, event: CommandIssued, _now_us: int) -> tuple[Scheduled, ...]:
    task_id, action_id = event.subject.task_id, event.subject.action_id
    take = TakeSubtask(action_id, task_id, event.robot)
    return (Scheduled(take, 0, (message(COORDINATOR, action_id, 1),)),)


@HANDLERS.react(ExecutionFinished, ExecutionWithdrawn)
def _on_end(_state: State, event: ExecutionFinished | ExecutionWithdrawn, _now_us: int) -> tuple[Scheduled, ...]:
    return _reported(event.subject.action_id, event.subject.task_id, event.robot)


@HANDLERS.react(RequestDenied)
def _on_refusal(_state: State, event: RequestDenied, _now_us: int) -> tuple[Scheduled, ...]:
    task_id, action_id, robot = event.subject.task_id, event.subject.action_id, event.principals.executed_by
    if task_id is None or action_id is None or robot is None:  # an outsider's
        return ()
    return _reported(action_id, task_id, robot)


def _reported(action_id: str, task_id: str, robot: Robot) -> tuple[Scheduled, ...]:
    """Send the master the one message that a subtask brings back."""
    return (Scheduled(TakeResult(action_id, task_id, robot), 0, (message(robot, action_id, 4),)),)


@HANDLERS.react(ContextChanged)
def _on_context(state: State, event: ContextChanged, now_us: int) -> tuple[Scheduled, ...]:
    return pause_running(state, event, now_us)


@HANDLERS.react(ExecutionPaused)
def _on_pause(state: State, event: ExecutionPaused, _now_us: int) -> tuple[Scheduled, ...]:
    """Let the robot's own agent replan: it turns from observation to action by itself (slaver_agent.py, run)."""
    return (Scheduled(ResumeAction(event.subject.action_id), state.fleet.structure.replan_us),)


HANDLERS.decide(TakeTurn, body)(approach)
