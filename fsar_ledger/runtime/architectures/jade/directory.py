"""JADE: the yellow pages (DF), in which agents find each other, and the platform's watch over its nodes.

An agent searches the DF for every step (a request and its answer, `jade/domain/DFService.java`), or subscribes to it
(dial `subscribes`). The DF shows every entry to every agent: it has no rule of visibility. It deregisters agents that
the AMS reports dead (`jade/domain/df.java`), and entries whose lease has ended. Nodes are pinged every second, and a
node that is silent for `dead_after_us` is removed with its agents
(`jade/core/nodeMonitoring/UDPNodeMonitoringService.java`); the pings themselves are not recorded.

Ours: an agent renews its lease as long as its messages get through (`jade/domain/DFRegistrationRenewer.java`), so its
entry ends one lease after it fell silent; and it registers again as soon as it can be reached again.
"""

import msgspec

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import REGISTRY, Parties, Principal, Robot
from fsar_ledger.events.registry import AvailabilityChanged, RegistryCached, RegistryQueried
from fsar_ledger.events.request import GapDetected, MessageUndelivered
from fsar_ledger.events.task import StepBegan
from fsar_ledger.events.world import LinkCameUp, LinkWentDown, RobotCameBack, RobotWentOff
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.registry import NO_ANSWER, advertisement, surface
from fsar_ledger.projections.request import Request
from fsar_ledger.projections.world import World, is_linked
from fsar_ledger.runtime.handlers.attribution import capable, on_shift
from fsar_ledger.runtime.handlers.commands import (
    ActionCommand,
    Handlers,
    RobotCommand,
    Scheduled,
    commanded_robot,
    message,
    nobody,
    open_request,
    requester,
)

HANDLERS = Handlers()


class DetectGap(ActionCommand):
    """Detect that the step needs another robot."""


class SearchDirectory(ActionCommand):
    """Deliver the search, or a first subscription, to the DF; a subscriber reads its own copy."""


class Deregister(RobotCommand):
    """Remove the robot from the DF, unless it was reached since; `returns` counts how often it was."""

    returns: int


class RemoveNode(RobotCommand):
    """Remove the robot's node from the platform, unless it was reached since."""

    returns: int


class Register(RobotCommand):
    """Deliver the robot's registration to the DF."""


class HearOfChange(RobotCommand):
    """Deliver the DF's notification to a robot that has subscribed."""


def recorded(state: State, by: Robot, *, requested_by: Principal | None, executed_by: Robot | None) -> Parties:
    """Return the parties of this robot's record: sender and receiver of the message, and the owner of its agent.

    `AMSAgentDescription.ownership` names the owner (dial `owner_is_named`). As under every architecture, none is named
    for a robot whose supervisor is off shift.
    """
    owner = on_shift(state, by) if state.fleet.jade.owner_is_named else None
    return Parties(requested_by=requested_by, executed_by=executed_by, supervised_by=owner)


def listed(state: State, robot: Robot, capability: str) -> tuple[tuple[Robot, ...], int | None]:
    """Return the robots that the DF lists for the capability, and the run time of the copy if one was read.

    The nearest team comes first, as in every architecture.
    """
    copy = state.registry.caches.get(robot) if state.fleet.jade.subscribes else None
    registry = state.registry if copy is None else msgspec.structs.replace(state.registry, offers=copy.offers)
    robots = []
    for name in capable(state.fleet, registry, capability, robot):
        entry = advertisement(registry, name, capability)
        if entry is not None and entry.availability != "offline":
            robots.append(name)
    return tuple(robots), None if copy is None else copy.as_of_us


@HANDLERS.decide_on(open_request, DetectGap, requester)
def detect_gap(state: State, _command: DetectGap, request: Request) -> tuple[Event, ...]:
    """Record that the robot needs another one."""
    robot = request.requester
    parties = recorded(state, robot, requested_by=robot, executed_by=None)
    return (GapDetected(request.subject, parties, request.capability),)


@HANDLERS.decide_on(open_request, SearchDirectory, nobody)
def search_directory(state: State, command: SearchDirectory, request: Request) -> tuple[Event, ...]:
    """Return the listed agents; after a first subscription, the robot is notified of changes."""
    robot = request.requester
    candidates, as_of_us = listed(state, robot, request.capability)
    queried = RegistryQueried(
        subject=request.subject,
        principals=recorded(state, robot, requested_by=robot, executed_by=None),
        capability=request.capability,
        candidates=candidates,
        as_of_us=as_of_us,
    )
    if state.fleet.jade.subscribes and as_of_us is None:
        return (queried, RegistryCached(robot, command.now_us))
    return (queried,)


def _is_silent(world: World, command: Deregister | RemoveNode) -> bool:
    """Return whether the robot has been out of reach ever since the command was scheduled."""
    return not is_linked(world, command.robot) and world.returns.get(command.robot, 0) == command.returns


@HANDLERS.decide(Deregister, nobody)
def deregister(state: State, command: Deregister) -> tuple[Event, ...]:
    """Remove the entries of a robot that is still out of reach from the DF."""
    robot = command.robot
    if (
        not _is_silent(state.world, command)
        or robot in state.registry.silent
        or not any(surface(state.registry, robot))
    ):
        return ()
    return (AvailabilityChanged(robot=robot, capability=None, availability="offline", reason=NO_ANSWER),)


@HANDLERS.decide(RemoveNode, nobody)
def remove_node(state: State, command: RemoveNode) -> tuple[Event, ...]:
    """Record the messages that wait for the robot as undeliverable, and remove its entries from the DF."""
    if not _is_silent(state.world, command):
        return ()
    robot = command.robot
    undelivered = [
        MessageUndelivered(request.subject, robot)
        for request in state.request.open.values()
        if awaits_delivery(request, robot)
    ]
    return (*undelivered, *deregister(state, Deregister(robot, command.returns, now_us=command.now_us)))


def awaits_delivery(request: Request, robot: Robot) -> bool:
    """Return whether a call or an acceptance of this round has not reached the robot yet."""
    if robot in request.undelivered or request.is_unanswered or request.is_accepted:
        return False
    if request.target is not None and request.step > 0:
        return request.target == robot
    return robot in called(request) and robot not in request.bids and robot not in request.underway


def called(request: Request) -> tuple[Robot, ...]:
    """Return the robots a call goes to: the listed ones that have not failed in it, else all of them again."""
    return tuple(robot for robot in request.candidates if robot not in request.failed) or request.candidates


@HANDLERS.decide(Register, nobody)
def register(state: State, command: Register) -> tuple[Event, ...]:
    """List the robot's offers again."""
    availabilities = state.registry.silent.get(command.robot, {})
    return tuple(
        AvailabilityChanged(
            robot=command.robot, capability=capability, availability=availability, reason="registered again"
        )
        for capability, availability in availabilities.items()
    )


@HANDLERS.decide(HearOfChange, commanded_robot)
def hear_of_change(_state: State, command: HearOfChange) -> tuple[Event, ...]:
    """Refresh the subscriber's copy of the DF."""
    return (RegistryCached(command.robot, command.now_us),)


@HANDLERS.react(StepBegan)
def _on_step(_state: State, event: StepBegan, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(DetectGap(event.subject.action_id)),) if event.target_role is not None else ()


@HANDLERS.react(GapDetected)
def _on_gap(state: State, event: GapDetected, _now_us: int) -> tuple[Scheduled, ...]:
    assert event.subject.action_id is not None
    search, robot = SearchDirectory(event.subject.action_id), event.principals.requested_by
    if state.fleet.jade.subscribes and robot in state.registry.caches:
        return (Scheduled(search),)
    return (Scheduled(search, 0, (message(robot, event.subject.action_id, 0),)),)


@HANDLERS.react(RobotWentOff, LinkWentDown)
def _on_silence(state: State, event: RobotWentOff | LinkWentDown, _now_us: int) -> tuple[Scheduled, ...]:
    jade, returns = state.fleet.jade, state.world.returns.get(event.robot, 0)
    removed = Scheduled(RemoveNode(event.robot, returns), jade.dead_after_us)
    if jade.lease_us == 0:
        return (removed,)
    return (Scheduled(Deregister(event.robot, returns), jade.lease_us), removed)


@HANDLERS.react(RobotCameBack, LinkCameUp)
def _on_return(state: State, event: RobotCameBack | LinkCameUp, now_us: int) -> tuple[Scheduled, ...]:
    if event.robot not in state.registry.silent:
        return ()
    return (Scheduled(Register(event.robot), 0, (message(event.robot, f"{event.robot}/{now_us}", "back"),)),)


@HANDLERS.react(AvailabilityChanged)
def _on_change(state: State, event: AvailabilityChanged, now_us: int) -> tuple[Scheduled, ...]:
    key = f"{event.robot}/{event.capability or ''}/{now_us}"
    subscribers = [name for name in state.fleet.robots if name in state.registry.caches and name != event.robot]
    return tuple(Scheduled(HearOfChange(name), 0, (message(REGISTRY, key, f"notify/{name}"),)) for name in subscribers)
