"""FSAR: how the registry learns what is available, from robots and from unanswered requests.

A robot reports a worn actuator; who got no answer reports silence. Paper: sec:architecture:registry.

Reading R44: the paper marks a robot offline that leaves "through failure detection". Nobody sees that a robot is off.
The registry has it offline from the moment at which somebody waited for its answer in vain until the robot's own word
that it is back has come in.
"""

from collections.abc import Iterable

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Availability, Robot
from fsar_ledger.events.execution import ExecutionFailed
from fsar_ledger.events.registry import AvailabilityChanged
from fsar_ledger.events.supervision import ActuatorServiced
from fsar_ledger.events.world import LinkCameUp, RobotCameBack
from fsar_ledger.projections.fleet import Fleet
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.registry import NO_ANSWER, Registry, surface
from fsar_ledger.projections.world import World
from fsar_ledger.runtime.handlers.commands import Handlers, RobotCommand, Scheduled, message, nobody

HANDLERS = Handlers()


class ReportActuator(RobotCommand):
    """Deliver the robot's word about its actuator to the registry: degraded, or (False) in order again."""

    is_degraded: bool


class ReportBack(RobotCommand):
    """Deliver the robot's word that it can be asked again to the registry."""


def found_silent(fleet: Fleet, registry: Registry, robots: Iterable[Robot]) -> tuple[AvailabilityChanged, ...]:
    """Mark the robots that did not answer as offline in the registry, if there is one."""
    if "shared-registry" in fleet.without:
        return ()
    news = [robot for robot in dict.fromkeys(robots) if robot not in registry.silent and any(surface(registry, robot))]
    return tuple(
        AvailabilityChanged(robot=robot, capability=None, availability="offline", reason=NO_ANSWER) for robot in news
    )


@HANDLERS.decide(ReportBack, nobody)
def report_back(state: State, command: ReportBack) -> tuple[AvailabilityChanged, ...]:
    """Restore the availability from before the robot was found silent.

    What has become of its actuator since is kept.
    """
    return _present(state.registry, state.world, command.robot)


def _present(
    registry: Registry, world: World, robot: Robot, is_serviced: bool = False
) -> tuple[AvailabilityChanged, ...]:
    worn: dict[Availability, Availability] = (
        {"ready": "degraded", "busy": "degraded"} if robot in world.degraded else {}
    )
    since: dict[Availability, Availability] = {"degraded": "ready"} if is_serviced else worn
    now = {capability: since.get(before, before) for capability, before in registry.silent.get(robot, {}).items()}
    if len(set(now.values())) == 1 and len(now) == len(tuple(surface(registry, robot))):
        return (
            AvailabilityChanged(
                robot=robot, capability=None, availability=next(iter(now.values())), reason="answers again"
            ),
        )
    return tuple(
        AvailabilityChanged(robot=robot, capability=capability, availability=availability, reason="answers again")
        for capability, availability in now.items()
    )


@HANDLERS.decide(ReportActuator, nobody)
def report_actuator(state: State, command: ReportActuator) -> tuple[Event, ...]:
    """Set what the robot advertises to degraded, or back to ready, except what it restricted or took offline.

    A report that later facts have overtaken changes nothing. A report of a silent robot also says that it is back.
    """
    if command.is_degraded != (command.robot in state.world.degraded):
        return ()
    if command.robot in state.registry.silent:
        return _present(state.registry, state.world, command.robot, is_serviced=not command.is_degraded)
    before: tuple[Availability, ...] = ("ready", "busy") if command.is_degraded else ("degraded",)
    after: Availability = "degraded" if command.is_degraded else "ready"
    shown = tuple(surface(state.registry, command.robot))
    changing = [record.capability for record in shown if record.availability in before]
    if changing and len(changing) == len(shown):
        return (AvailabilityChanged(robot=command.robot, capability=None, availability=after, reason="actuator"),)
    return tuple(
        AvailabilityChanged(robot=command.robot, capability=capability, availability=after, reason="actuator")
        for capability in changing
    )


@HANDLERS.react(ExecutionFailed)
def _on_failure(state: State, event: ExecutionFailed, _now_us: int) -> tuple[Scheduled, ...]:
    if event.cause != "degradation" or "shared-registry" in state.fleet.without:
        return ()
    return (
        Scheduled(
            ReportActuator(event.robot, True),
            0,
            (message(event.robot, f"{event.subject.action_id}/{event.failure}", "degraded"),),
        ),
    )


@HANDLERS.react(ActuatorServiced)
def _on_service(state: State, event: ActuatorServiced, now_us: int) -> tuple[Scheduled, ...]:
    if "shared-registry" in state.fleet.without:
        return ()
    return (
        Scheduled(
            ReportActuator(event.robot, False), 0, (message(event.robot, f"{event.robot}/{now_us}", "serviced"),)
        ),
    )


@HANDLERS.react(RobotCameBack, LinkCameUp)
def _on_back(state: State, event: RobotCameBack | LinkCameUp, now_us: int) -> tuple[Scheduled, ...]:
    if event.robot not in state.registry.silent:
        return ()
    return (Scheduled(ReportBack(event.robot), 0, (message(event.robot, f"{event.robot}/{now_us}", "back"),)),)
