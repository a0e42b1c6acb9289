"""Which supervisor a record can name, and small lookups in the state that several handlers need."""

from collections.abc import Iterable
from itertools import filterfalse

from fsar_ledger.events.envelope import FLEET_SUPERVISOR, Parties, Principal, Robot, Supervisor
from fsar_ledger.projections.execution import Action, Execution
from fsar_ledger.projections.fleet import Fleet
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.registry import Registry, offers, surface
from fsar_ledger.projections.task import Tasks


def on_shift(state: State, robot: Robot) -> Supervisor | None:
    """Return the robot's own supervisor H_i, None while off shift; H_F for a robot without one.

    Paper: eq:supervision.
    """
    supervisor = state.fleet.robots[robot].supervisor
    if supervisor is None:
        return FLEET_SUPERVISOR
    # See docs/decisions/principals-need-their-own-record.md.
    return None if supervisor in state.world.off_shift else supervisor


def recorded_by(state: State, robot: Robot, *, requested_by: Principal | None, executed_by: Robot | None) -> Parties:
    """Return the parties of the robot's record: these two, and its own supervisor while on shift."""
    return Parties(requested_by=requested_by, executed_by=executed_by, supervised_by=on_shift(state, robot))


def supervisor_of(state: State, action: Action) -> Supervisor | None:
    """Return the supervisor whom a record of the execution names.

    H_F if it was queued under H_F, else the robot's own while on shift.
    """
    if not action.is_supervised:
        return None
    return FLEET_SUPERVISOR if action.supervised_by == FLEET_SUPERVISOR else on_shift(state, action.robot)


def parties(state: State, action: Action) -> Parties:
    """Return the parties of a record of the execution."""
    return Parties(
        requested_by=action.requested_by,
        executed_by=action.executed_by,
        supervised_by=supervisor_of(state, action),
    )


def is_injected(action: Action) -> bool:
    """Return whether the action executes an injected out-of-trust request, which is no step of a task."""
    return action.step == 0


def is_idle(execution: Execution, robot: Robot) -> bool:
    """Return whether nothing holds the robot."""
    return robot not in execution.current


def nearest_first(fleet: Fleet, robots: Iterable[Robot], near: Robot) -> tuple[Robot, ...]:
    """Return the robots in order of distance: same team, then same place, then the others; among equals by name."""
    by_name = sorted(robots)
    if len(by_name) < 2:
        return tuple(by_name)
    team, place = fleet.teams[fleet.robots[near].team], fleet.places[fleet.robots[near].place]
    nearby = team | place
    first = sorted(filter(nearby.__contains__, by_name), key=lambda name: (name not in team, name not in place))
    return (*first, *filterfalse(nearby.__contains__, by_name))


def capable(fleet: Fleet, registry: Registry, capability: str, requester: Robot) -> tuple[Robot, ...]:
    """Return every other robot that has the capability, nearest team first. Paper: eq:possess."""
    return nearest_first(
        fleet,
        [offer.robot for offer in offers(registry.offers, capability) if offer.robot != requester],
        requester,
    )


def helpers(fleet: Fleet, registry: Registry, action: Action, cause: str | None) -> tuple[Robot, ...]:
    """Return every robot whose body could help with the failure, nearest team first.

    Paper: sec:model:recovery, level 2.
    """
    if cause == "obstruction":
        return nearest_first(fleet, [name for name in fleet.able_bodies if name != action.robot], action.robot)
    return stand_ins(fleet, registry, action)


def stand_ins(fleet: Fleet, registry: Registry, action: Action) -> tuple[Robot, ...]:
    """Return every other robot that offers the capability or a substitute for it, nearest team first."""
    able = {
        offer.robot for capability in means(fleet, action.capability) for offer in offers(registry.offers, capability)
    }
    return nearest_first(fleet, [name for name in able if name != action.robot], action.robot)


def means(fleet: Fleet, capability: str) -> tuple[str, ...]:
    """Return the capabilities with which the step can be done: itself, and its substitute if the fleet has one."""
    substitute = fleet.substitutes.get(capability)
    return (capability,) if substitute is None else (capability, substitute)


def family(capability: str) -> str:
    """Return the pattern of the capability's family, such as `grasp.*` for `grasp.robust`."""
    return capability.partition(".")[0] + ".*"


def kin(fleet: Fleet, registry: Registry, robot: Robot, capability: str) -> tuple[Robot, ...]:
    """Return every other robot that advertises something of the capability's family, nearest team first."""
    stem = family(capability)[:-1]
    others = [name for name in fleet.robots if name != robot]
    return nearest_first(
        fleet,
        [name for name in others if any(record.capability.startswith(stem) for record in surface(registry, name))],
        robot,
    )


def is_reachable(registry: Registry, robot: Robot) -> bool:
    """Return whether some capability that the robot advertises is not offline or restricted.

    Paper: eq:adv (availability).
    """
    reported = [record.availability for record in surface(registry, robot)]
    return not reported or any(availability not in ("offline", "restricted") for availability in reported)


def is_cross_robot(tasks: Tasks, action: Action) -> bool:
    """Return whether a failure of the action concerns more than its robot.

    The action was delegated, or the task is another robot's. Paper: sec:model:supervision.
    """
    task = tasks.get(action.task_id)
    return action.is_delegated or task is None or task.robot != action.robot


def pending_of_other_task(execution: Execution, robot: Robot, task_id: str) -> str | None:
    """Return the first unfinished delegated action of another task at the robot, if any."""
    current = execution.current.get(robot)
    for name in ((current,) if current else ()) + execution.queues.get(robot, ()):
        action = execution.actions.get(name)
        if action is not None and action.is_delegated and action.task_id != task_id:
            return name
    return None
