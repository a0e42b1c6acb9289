"""FSAR: how the registry learns what is available, from robots and from unanswered requests.

A robot reports a worn actuator; a sender without an answer reports silence. Paper: sec:architecture:registry.

Members announce that they leave, or are found to have left: with heartbeats, a robot that sends none is suspected, and
then cleared by the next one or declared departed. A robot without contact for that long stops its work for the fleet by
itself, as the fleet then gives it to others. Paper: sec:discussion:heterogeneity.

Reading R44: the paper marks a robot offline that leaves "through failure detection". No component sees that a robot is
off. Without heartbeats, the registry lists it as offline from the first wait for its answer that ended without one,
until the robot's own report that it is back has arrived.
"""

from collections.abc import Iterable

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import REGISTRY, Availability, Robot
from fsar_ledger.events.execution import ExecutionFailed
from fsar_ledger.events.fleet import HeartbeatReceived, RobotCleared, RobotReturned, RobotSuspected
from fsar_ledger.events.recovery import FailureResolved
from fsar_ledger.events.registry import AvailabilityChanged
from fsar_ledger.events.supervision import ActuatorServiced
from fsar_ledger.events.world import LinkCameUp, RobotCalledAway, RobotCameBack, SnapshotPhaseSet
from fsar_ledger.projections.fleet import Fleet
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.registry import NO_ANSWER, Registry, surface
from fsar_ledger.projections.world import World
from fsar_ledger.runtime.handlers.commands import (
    ActionCommand,
    Handlers,
    RobotCommand,
    Scheduled,
    message,
    nobody,
    open_request,
)
from fsar_ledger.runtime.handlers.fleet import closed_as_departed, departure, returned

HANDLERS = Handlers()


class ReportActuator(RobotCommand):
    """Deliver the robot's report on its actuator to the registry: degraded, or (False) in order again."""

    is_degraded: bool


class ReportBack(RobotCommand):
    """Deliver the robot's report that it answers again to the registry."""


class Beat(RobotCommand):
    """Deliver a heartbeat of the robot to the registry."""


class Suspect(RobotCommand):
    """Suspect the robot, if heartbeat `number` is still its last."""

    number: int


class DeclareDeparted(RobotCommand):
    """Declare the suspected robot departed, if heartbeat `number` is still its last."""

    number: int


class TakeLeave(RobotCommand):
    """Deliver the robot's notice that it leaves to the registry."""


class Rejoin(RobotCommand):
    """Deliver the report of a robot that has been away to the registry."""


class CloseDeparted(ActionCommand):
    """Close the request for an action that no robot could take over from a departed one."""


def found_silent(fleet: Fleet, registry: Registry, robots: Iterable[Robot]) -> tuple[AvailabilityChanged, ...]:
    """Mark the robots that did not answer as offline in the registry, if there is one."""
    if "shared-registry" in fleet.without:
        return ()
    newly_silent = [
        robot for robot in dict.fromkeys(robots) if robot not in registry.silent and any(surface(registry, robot))
    ]
    return tuple(
        AvailabilityChanged(robot=robot, capability=None, availability="offline", reason=NO_ANSWER)
        for robot in newly_silent
    )


@HANDLERS.decide(ReportBack, nobody)
def report_back(state: State, command: ReportBack) -> tuple[AvailabilityChanged, ...]:
    """Restore the availability from before the robot was found silent.

    Changes of its actuator since then are kept.
    """
    if command.robot in state.fleet.departed:
        return ()
    return _present(state.registry, state.world, command.robot)


def _present(
    registry: Registry, world: World, robot: Robot, is_serviced: bool = False
) -> tuple[AvailabilityChanged, ...]:
    worn: dict[Availability, Availability] = (
        {"ready": "degraded", "busy": "degraded"} if robot in world.degraded else {}
    )
    changed: dict[Availability, Availability] = {"degraded": "ready"} if is_serviced else worn
    restored = {
        capability: changed.get(previous, previous) for capability, previous in registry.silent.get(robot, {}).items()
    }
    if len(set(restored.values())) == 1 and len(restored) == len(tuple(surface(registry, robot))):
        return (
            AvailabilityChanged(
                robot=robot, capability=None, availability=next(iter(restored.values())), reason="answers again"
            ),
        )
    return tuple(
        AvailabilityChanged(robot=robot, capability=capability, availability=availability, reason="answers again")
        for capability, availability in restored.items()
    )


@HANDLERS.decide(ReportActuator, nobody)
def report_actuator(state: State, command: ReportActuator) -> tuple[Event, ...]:
    """Set what the robot advertises to degraded, or back to ready, except what it restricted or took offline.

    A report overtaken by later facts changes nothing. A report from a silent robot also shows that it is back.
    """
    is_overtaken = command.is_degraded != (command.robot in state.world.degraded)
    if is_overtaken or command.robot in state.fleet.departed:
        return ()
    if command.robot in state.registry.silent:
        return _present(state.registry, state.world, command.robot, is_serviced=not command.is_degraded)
    replaced: tuple[Availability, ...] = ("ready", "busy") if command.is_degraded else ("degraded",)
    availability: Availability = "degraded" if command.is_degraded else "ready"
    records = tuple(surface(state.registry, command.robot))
    affected = [record.capability for record in records if record.availability in replaced]
    if affected and len(affected) == len(records):
        return (
            AvailabilityChanged(robot=command.robot, capability=None, availability=availability, reason="actuator"),
        )
    return tuple(
        AvailabilityChanged(robot=command.robot, capability=capability, availability=availability, reason="actuator")
        for capability in affected
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


@HANDLERS.react(RobotCameBack, LinkCameUp, RobotReturned)
def _on_back(state: State, event: RobotCameBack | LinkCameUp | RobotReturned, now_us: int) -> tuple[Scheduled, ...]:
    waits = (message(event.robot, f"{event.robot}/{now_us}", "back"),)
    if event.robot in state.fleet.departed and isinstance(event, RobotCameBack) and not state.fleet.is_live:
        return (Scheduled(Rejoin(event.robot), 0, waits),)
    if event.robot not in state.registry.silent:
        return ()
    return (Scheduled(ReportBack(event.robot), 0, waits),)


def heard(state: State, robot: Robot) -> tuple[HeartbeatReceived | RobotCleared, ...]:
    """Return the events of a member's heartbeat."""
    beat = HeartbeatReceived(robot, state.knowledge.heard.get(robot, 0) + 1)
    return (beat, RobotCleared(robot)) if robot in state.knowledge.suspected else (beat,)


@HANDLERS.decide(Beat, nobody)
def receive_beat(state: State, command: Beat) -> tuple[Event, ...]:
    """Record the heartbeat; a robot that was declared departed and is still there becomes a member again."""
    robot = command.robot
    reason = state.fleet.departed.get(robot)
    if reason == "announced":
        return ()
    return (*(() if reason is None else (returned(state, robot, REGISTRY),)), *heard(state, robot))


def _is_missed(state: State, command: Suspect | DeclareDeparted) -> bool:
    """Return whether no heartbeat has come since, and one was due: a live robot that reported going off sends none."""
    robot = command.robot
    is_excused = robot in state.fleet.departed or (state.fleet.is_live and robot in state.world.off)
    return state.knowledge.heard.get(robot, 0) == command.number and not is_excused


@HANDLERS.decide(Suspect, nobody)
def suspect(state: State, command: Suspect) -> tuple[RobotSuspected, ...]:
    """Record that the robot may have left; nothing is taken from it."""
    return (RobotSuspected(command.robot),) if _is_missed(state, command) else ()


@HANDLERS.decide(DeclareDeparted, nobody)
def declare_departed(state: State, command: DeclareDeparted) -> tuple[Event, ...]:
    """Treat the robot as departed; as it may not be, its claims end under a fencing number."""
    if not (_is_missed(state, command) and command.robot in state.knowledge.suspected):
        return ()
    return departure(state, command.robot, "silent", REGISTRY, command.now_us)


@HANDLERS.decide(TakeLeave, nobody)
def take_leave(state: State, command: TakeLeave) -> tuple[Event, ...]:
    """Record that the robot announced that it leaves."""
    if command.robot in state.fleet.departed:
        return ()
    return departure(state, command.robot, "announced", command.robot, command.now_us)


@HANDLERS.decide(Rejoin, nobody)
def rejoin(state: State, command: Rejoin) -> tuple[Event, ...]:
    """Make the robot a member again."""
    if command.robot not in state.fleet.departed:
        return ()
    return (returned(state, command.robot, REGISTRY),)


@HANDLERS.decide(CloseDeparted, nobody)
def close_departed(state: State, command: CloseDeparted) -> tuple[Event, ...]:
    """End the request as failure(departed); the step is begun again, if a robot can be asked."""
    request = open_request(state, command.action_id)
    return () if request is None or request.is_over else (closed_as_departed(state, request),)


@HANDLERS.react(RobotCalledAway)
def _on_call(state: State, event: RobotCalledAway, now_us: int) -> tuple[Scheduled, ...]:
    if "shared-registry" in state.fleet.without:
        return ()
    return (Scheduled(TakeLeave(event.robot), 0, (message(event.robot, f"{event.robot}/{now_us}", "leave"),)),)


@HANDLERS.react(SnapshotPhaseSet)
def _first_beat(state: State, event: SnapshotPhaseSet, _now_us: int) -> tuple[Scheduled, ...]:
    period_us = state.fleet.membership.heartbeat_us
    if period_us == 0 or "shared-registry" in state.fleet.without:
        return ()
    delay_us = max(2, event.phase_ppm * period_us // 1_000_000)
    return (Scheduled(Beat(event.robot), delay_us, (message(event.robot, f"{event.robot}/heartbeat", 1),)),)


@HANDLERS.react(HeartbeatReceived)
def _on_beat(state: State, event: HeartbeatReceived, now_us: int) -> tuple[Scheduled, ...]:
    """Await the next heartbeat; a simulated robot sends it as long as periodic exchanges go on."""
    structure, membership, robot = state.fleet.structure, state.fleet.membership, event.robot
    suspicion = Scheduled(Suspect(robot, event.number), membership.suspect_us)
    if state.fleet.is_live:
        return (suspicion,)
    if now_us > structure.watch_us and not state.task:
        return ()
    waits = (message(robot, f"{robot}/heartbeat", event.number + 1),)
    return (suspicion, Scheduled(Beat(robot), membership.heartbeat_us, waits))


@HANDLERS.react(RobotSuspected)
def _on_suspicion(state: State, event: RobotSuspected, _now_us: int) -> tuple[Scheduled, ...]:
    number = state.knowledge.heard.get(event.robot, 0)
    return (Scheduled(DeclareDeparted(event.robot, number), state.fleet.membership.depart_us),)


@HANDLERS.react(FailureResolved)
def _on_resolved(state: State, event: FailureResolved, _now_us: int) -> tuple[Scheduled, ...]:
    """Close the request for a withdrawn action whose failure a human has resolved."""
    action = state.execution.actions.get(event.subject.action_id)
    if event.level != "human" or action is None or action.stage != "withdrawn":
        return ()
    return (Scheduled(CloseDeparted(action.action_id)),)
