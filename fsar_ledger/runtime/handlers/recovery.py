"""What a recovery attempt meets in the world, whoever ordered it. Paper: sec:model:recovery."""

from fsar_ledger.projections.execution import Action
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.recovery import Recovery

from .commands import EndAttempt


def open_failure(state: State, action_id: str) -> tuple[Action, Recovery] | None:
    """The action and its failure that is being recovered, or None when there is none any more."""
    action, recovery = state.execution.actions.get(action_id), state.recovery.get(action_id)
    return None if action is None or recovery is None else (action, recovery)


def attempt_succeeds(state: State, recovery: Recovery, command: EndAttempt) -> bool:
    """True when the way is clear, or the degraded actuator held this time."""
    if recovery.cause == "obstruction":
        return not state.world.obstructions.get(recovery.robot)
    return bool(command.drawn) or recovery.robot not in state.world.degraded
