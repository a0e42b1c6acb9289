"""FSAR: a robot whose actuator failed it tells the registry, and again when it was serviced. Paper: sec:architecture:registry."""

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Availability
from fsar_ledger.events.execution import ExecutionFailed
from fsar_ledger.events.registry import AvailabilityChanged
from fsar_ledger.events.supervision import ActuatorServiced
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.registry import surface
from fsar_ledger.runtime.handlers.actors import nobody
from fsar_ledger.runtime.handlers.commands import Actors, Command, Decides, Reacts, Scheduled, message


class ReportActuator(Command):
    """The robot's word about its actuator has reached the registry: degraded, or (False) in order again."""

    robot: str
    is_degraded: bool


def report_actuator(state: State, command: ReportActuator) -> tuple[Event, ...]:
    """What the robot advertises is degraded, or ready again; what it had restricted or taken offline stays so.

    A word that was overtaken by what has happened since changes nothing.
    """
    if command.is_degraded != (command.robot in state.world.degraded):
        return ()
    before: tuple[Availability, ...] = ("ready", "busy") if command.is_degraded else ("degraded",)
    after: Availability = "degraded" if command.is_degraded else "ready"
    shown = tuple(surface(state.registry, command.robot))
    changing = [record.capability for record in shown if record.availability in before]
    if changing and len(changing) == len(shown):
        return (AvailabilityChanged(command.robot, None, after, "actuator"),)
    return tuple(AvailabilityChanged(command.robot, capability, after, "actuator") for capability in changing)


def _on_failure(state: State, event: ExecutionFailed, _now_us: int) -> tuple[Scheduled, ...]:
    if event.cause != "degradation" or "shared-registry" in state.fleet.without:
        return ()
    return (Scheduled(ReportActuator(event.robot, True), 0, (message(event.robot, f"{event.action_id}/{event.failure}", "degraded"),)),)


def _on_service(state: State, event: ActuatorServiced, now_us: int) -> tuple[Scheduled, ...]:
    if "shared-registry" in state.fleet.without:
        return ()
    return (Scheduled(ReportActuator(event.robot, False), 0, (message(event.robot, f"{event.robot}/{now_us}", "serviced"),)),)


DECIDES: Decides = {ReportActuator: report_actuator}
ACTORS: Actors = {
    ReportActuator: nobody,
}
REACTS: Reacts = {ExecutionFailed: _on_failure, ActuatorServiced: _on_service}
