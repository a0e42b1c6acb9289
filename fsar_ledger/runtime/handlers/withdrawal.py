"""What is withdrawn when a task is given up, under every architecture. Paper: sec:evaluation:metrics (fleet tasks).

Reading R3: what waits for its robot, approaches or is held is withdrawn, its claims end, and nobody answers what was
asked for it. What executes by then, or is being recovered, ends as it would have: a robot does not stop in a doorway.
The robot that asked for it tells each robot that has something of the task; until the message is there, that robot does
not know. What a robot has by its own word it withdraws at once.
"""

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import Robot
from fsar_ledger.events.execution import ExecutionWithdrawn
from fsar_ledger.events.task import TaskAbandoned
from fsar_ledger.projections.authority import Authority
from fsar_ledger.projections.execution import Action, Execution
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.request import Requests

from .authority import released
from .commands import Command, Handlers, Scheduled, message, named, nobody
from .execution import holds_robot

WAITING = ("queued", "approaching", "held", "polling")

HANDLERS = Handlers()


class WithdrawTask(Command):
    """Tell the robot that the task was given up."""

    task_id: str
    robot: Robot


class EndClaims(Command):
    """End what no robot has yet of a task that was given up."""

    task_id: str


@HANDLERS.decide(WithdrawTask, named)
def withdraw_task(state: State, command: WithdrawTask) -> tuple[Event, ...]:
    """Withdraw the actions of the task that the robot has not begun, and release every claim on them."""
    waiting = [
        action for action in _waiting(state.execution, state.request, command.task_id) if action.robot == command.robot
    ]
    withdrawn = sorted(waiting, key=lambda action: holds_robot(state.execution, action))
    ended = _claims(state.authority, command.task_id, {action.action_id for action in withdrawn})
    return (
        *released(ended),
        *(ExecutionWithdrawn(action.subject, action.robot) for action in withdrawn),
    )


@HANDLERS.decide(EndClaims, nobody)
def end_claims(state: State, command: EndClaims) -> tuple[Event, ...]:
    """Release the claims on actions that no robot has."""
    never = {
        name
        for name in state.authority.claims
        if name not in state.execution.actions and name not in state.request.open
    }
    return released(_claims(state.authority, command.task_id, never))


def _waiting(execution: Execution, requests: Requests, task_id: str) -> list[Action]:
    """Return the actions of the task that robots have and have not begun."""
    return [
        action
        for action in execution.actions.values()
        if action.task_id == task_id and _has_not_begun(action) and _is_step(requests, action)
    ]


def _claims(authority: Authority, task_id: str, actions: set[str]) -> list[AuthorityClaimed]:
    return [
        claim
        for name, claims in authority.claims.items()
        if name in actions
        for claim in claims
        if claim.subject.task_id == task_id
    ]


def _has_not_begun(action: Action) -> bool:
    return action.stage in WAITING or (action.stage == "preempted" and not action.has_begun)


def _is_step(requests: Requests, action: Action) -> bool:
    """Tell whether this is a step, not a request that a robot issued by itself in the task's context."""
    request = requests.open.get(action.action_id)
    return request is None or not request.is_adhoc


@HANDLERS.react(TaskAbandoned)
def _on_abandoned(state: State, event: TaskAbandoned, _now_us: int) -> tuple[Scheduled, ...]:
    asked = {
        action.robot: action.requested_by or action.on_behalf_of
        for action in _waiting(state.execution, state.request, event.task_id)
    }
    told = (_told(event.task_id, robot, by) for robot, by in asked.items())
    return (Scheduled(EndClaims(event.task_id)), *told)


def _told(task_id: str, robot: Robot, by: str) -> Scheduled:
    if by == robot:
        return Scheduled(WithdrawTask(task_id, robot))
    return Scheduled(WithdrawTask(task_id, robot), 0, (message(by, task_id, f"given up/{robot}"),))
