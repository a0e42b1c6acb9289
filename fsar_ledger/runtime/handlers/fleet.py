"""Who belongs to the fleet, what robots possess, and in which state a robot is.

Paper: eq:fleet, eq:runtime, eq:possess.

The commands here are public; `issued_by` is who gave it, None when that is not stated.
"""

from typing import Literal

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot, Supervisor, local_supervisor
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.events.registry import CapabilityInstalled, CapabilityRemoved
from fsar_ledger.events.trust import InitialTrustSet
from fsar_ledger.projections.execution import Execution
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.registry import Contract, Registry, path_of, possesses, surface
from fsar_ledger.projections.world import World

from .candidates import contradiction, version_of
from .commands import Handlers
from .public import PublicCommand, carried_out, made_from, unknown_robot

ExecutionState = Literal["off", "idle", "executing", "degraded", "failed"]

HANDLERS = Handlers()


class JoinFleet(PublicCommand):
    """Register a robot in the domain's registry, under its own supervisor if it has one.

    Paper: sec:discussion:heterogeneity.
    """

    robot: Robot
    role: str
    team: int
    supervisor: Supervisor | None = None
    domain: str = ""
    place: str | None = None
    issued_by: Supervisor | None = None


class InstallCapability(PublicCommand):
    """Install a capability that the robot did not have. Paper: eq:possess."""

    robot: Robot
    capability: str
    version: str
    preconditions: tuple[str, ...] = ()
    postconditions: tuple[str, ...] = ()
    resources: tuple[str, ...] = ()
    issued_by: Supervisor | None = None


class RemoveCapability(PublicCommand):
    """Remove a capability from the robot."""

    robot: Robot
    capability: str
    issued_by: Supervisor | None = None


def execution_state(state: State, robot: Robot) -> ExecutionState:
    """Return the robot's state: off before failed before degraded before executing before idle.

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
    return "executing" if held else "idle"


def is_degraded(registry: Registry, world: World, robot: Robot) -> bool:
    """Tell whether the robot's actuator is degraded, or it says so of something that it advertises."""
    return robot in world.degraded or any(record.availability == "degraded" for record in surface(registry, robot))


@HANDLERS.decide(JoinFleet)
def join_fleet(state: State, command: JoinFleet) -> tuple[Event, ...]:
    """Make the robot a member, with initial trust of the narrowest scope both ways; it possesses nothing yet.

    What requires more is refused until an operator approves, or the record promotes it. Paper:
    sec:discussion:heterogeneity (the text gives no direction).
    """
    robot, wrong = command.robot, None
    if robot in state.fleet.robots:
        wrong = f"{robot} is a member already"
    elif not _is_robots_name(robot):
        wrong = f"{robot!r} is no robot's name, expected one such as robot/A1"
    elif not command.role or command.team < 1:
        wrong = f"role {command.role!r} of team {command.team}, expected a role and a team from 1"
    elif command.supervisor not in (None, local_supervisor(robot)):
        wrong = f"supervisor {command.supervisor}, expected {local_supervisor(robot)} or none"
    elif not all(path_of(command.domain)):
        wrong = f"domain {command.domain!r} is no path, expected one such as hall/cell, or nothing for the fleet's own"
    elif command.place == "":
        wrong = "an empty place, expected a name such as floor/2, or none for a fleet of one place"
    trust = [
        InitialTrustSet(robot=robot, scope="capability", is_trusting=is_trusting, decided_by=command.issued_by)
        for is_trusting in (True, False)
    ]
    return carried_out(command, robot, wrong, command.issued_by, made_from(RobotJoined, command), *trust)


def _is_robots_name(name: str) -> bool:
    """Tell whether the name is `robot/` and one word."""
    word = name.removeprefix("robot/")
    return word != name and "/" not in word and word.split() == [word]


@HANDLERS.decide(InstallCapability)
def install_capability(state: State, command: InstallCapability) -> tuple[Event, ...]:
    """Install the capability, advertised to nobody. Paper: sec:model:capability."""
    robot, capability = command.robot, command.capability
    wrong = unknown_robot(state.fleet, robot)
    if wrong is None and possesses(state.registry, robot, capability):
        wrong = (
            f"{robot} possesses version {state.registry.modules[robot][capability].version} already, "
            "expected an upgrade"
        )
    if wrong is None and (not capability.strip() or "*" in capability):
        wrong = f"capability {capability!r} is no name, expected one such as grasp.robust"
    if wrong is None and version_of(command.version) is None:
        wrong = f"{command.version!r} is no version, expected one such as 1.2.0"
    contract = Contract(command.preconditions, command.postconditions, command.resources)
    wrong = wrong or contradiction(contract)
    return carried_out(command, capability, wrong, command.issued_by, made_from(CapabilityInstalled, command, contract))


@HANDLERS.decide(RemoveCapability)
def remove_capability(state: State, command: RemoveCapability) -> tuple[Event, ...]:
    """Remove the capability and its advertisement."""
    robot, capability = command.robot, command.capability
    wrong = (
        unknown_robot(state.fleet, robot)
        or not_possessed(state.registry, robot, capability)
        or in_use(state.execution, robot, capability)
    )
    return carried_out(command, capability, wrong, command.issued_by, CapabilityRemoved(robot, capability))


def not_possessed(registry: Registry, robot: Robot, capability: str) -> str | None:
    """Return why to reject a command that needs the robot's capability, or None if it possesses it."""
    return None if possesses(registry, robot, capability) else f"{robot} does not possess {capability}"


def in_use(execution: Execution, robot: Robot, capability: str) -> str | None:
    """Return why the capability cannot be changed now, or None: an action at the robot needs it."""
    for name in (execution.current.get(robot, ""), *execution.queues.get(robot, ())):
        action = execution.actions.get(name)
        if action is not None and action.capability == capability:
            return f"{capability} is in use by {name}, expected it to be over"
    return None
