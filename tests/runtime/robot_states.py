"""The state of a robot as the projections have it, for comparison with that of the queries."""

from typing import Literal

from fsar_ledger.events.envelope import Robot
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.registry import Registry, surface
from fsar_ledger.projections.world import World

ExecutionState = Literal["off", "idle", "executing", "degraded", "failed", "departed"]


def execution_state(state: State, robot: Robot) -> ExecutionState:
    """Return the robot's state: off before failed before degraded before executing before departed before idle.

    Failed: what it has in hand failed and has not gone on since, or is being recovered by others. Degraded: its
    actuator is, or it says so of something it advertises. Executing: it has anything in hand, from its turn on.

    Paper: sec:evaluation:simulator (robot state).
    """
    if robot in state.world.off:
        return "off"
    held = state.execution.current.get(robot, "")
    action, recovery = state.execution.actions.get(held), state.recovery.get(held)
    if (action is not None and action.stage == "failed") or (recovery is not None and recovery.level != "local"):
        return "failed"
    if is_degraded(state.registry, state.world, robot):
        return "degraded"
    if held:
        return "executing"
    return "departed" if robot in state.fleet.departed else "idle"


def is_degraded(registry: Registry, world: World, robot: Robot) -> bool:
    """Tell whether the robot's actuator is degraded, or it says so of something that it advertises."""
    return robot in world.degraded or any(record.availability == "degraded" for record in surface(registry, robot))
