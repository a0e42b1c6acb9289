"""What a recovery attempt meets in the world, whoever ordered it. Paper: sec:model:recovery."""

from fsar_ledger.projections.fold import State
from fsar_ledger.projections.recovery import Recovery

from .commands import EndAttempt


def attempt_succeeds(state: State, recovery: Recovery, command: EndAttempt) -> bool:
    """True when the way is clear, or the degraded actuator held this time."""
    if recovery.cause == "obstruction":
        return not state.world.obstructions.get(recovery.robot)
    return bool(command.drawn) or recovery.robot not in state.world.degraded
