"""What was to be done for a task that is given up is not begun any more, whoever governs. Paper: sec:evaluation:metrics (fleet tasks).

Reading R3: what waits for its robot, approaches or is held is withdrawn, its claims end, and nobody answers what was asked for it. What executes
by then, or is being recovered, ends as it would have: a robot does not stop in a doorway.
"""

from fsar_ledger.events import Event
from fsar_ledger.events.execution import ExecutionWithdrawn
from fsar_ledger.events.task import TaskAbandoned
from fsar_ledger.projections.execution import Action
from fsar_ledger.projections.fold import State

from .actors import nobody
from .authority import released
from .commands import Actors, Command, Decides, Reacts, Scheduled
from .execution import holds_robot

WAITING = ("queued", "approaching", "held", "polling")


class WithdrawTask(Command):
    """The task was given up."""

    task_id: str


def withdraw_task(state: State, command: WithdrawTask) -> tuple[Event, ...]:
    """Nothing of the task holds or waits for a robot but what executes, and nobody claims what nobody does."""
    waiting = [
        action for action in state.execution.actions.values() if action.task_id == command.task_id and _has_not_begun(action) and _is_step(state, action)
    ]
    withdrawn = sorted(waiting, key=lambda action: holds_robot(state, action))
    never = {action.action_id for action in withdrawn}
    never |= {name for name in state.authority.claims if name not in state.execution.actions and name not in state.request}
    ended = [claim for name, claims in state.authority.claims.items() if name in never for claim in claims if claim.task_id == command.task_id]
    return (*released(ended), *(ExecutionWithdrawn(action.task_id, action.action_id, action.robot) for action in withdrawn))


def _has_not_begun(action: Action) -> bool:
    return action.stage in WAITING or (action.stage == "preempted" and not action.has_begun)


def _is_step(state: State, action: Action) -> bool:
    """False for a request that a robot issued by itself in the context of the task."""
    request = state.request.get(action.action_id)
    return request is None or not request.is_adhoc


def _on_abandoned(_state: State, event: TaskAbandoned, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(WithdrawTask(event.task_id)),)


DECIDES: Decides = {WithdrawTask: withdraw_task}
ACTORS: Actors = {WithdrawTask: nobody}
REACTS: Reacts = {TaskAbandoned: _on_abandoned}
