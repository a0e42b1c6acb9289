"""RoboOS: the shared store, one entry for each robot.

The master writes `busy` when it sends a subtask and `idle` when a result comes (master/agents/agent.py); there is no
periodic copy. A robot registers as idle when it connects, and its heartbeat renews the expiry of the entry
(slaver/run.py, connect_to_robot and _heartbeat_loop). Redis adds two facts: the master's SET removes the expiry until
the next heartbeat, and an entry that has expired comes back neither by a heartbeat nor by the master
(communication.py, update_json_field_py), but only when the robot connects again.

`idle` is the availability `ready` here. Reading and writing the store takes no time: the source has it beside the
master. While the fleet has no task, heartbeats go on and are not recorded: the last one on record does not expire.
"""

from fsar_ledger.events.envelope import COORDINATOR, Availability, Robot
from fsar_ledger.events.knowledge import StoreEntryWritten
from fsar_ledger.events.world import RobotCameBack, SnapshotPhaseSet, TaskArrived
from fsar_ledger.projections.fold import State
from fsar_ledger.runtime.handlers.commands import Handlers, RobotCommand, Scheduled, at_once, named

HANDLERS = Handlers()


class Heartbeat(RobotCommand):
    """Renew the expiry of the robot's entry; its last writing there holds until `until_us` (run time, 0: for ever)."""

    until_us: int


class Connect(RobotCommand):
    """Register the robot, which has just been switched on."""


def entry(state: State, robot: Robot) -> StoreEntryWritten:
    """Return the robot's entry as last written; every robot connects at the beginning of the run."""
    known = state.knowledge.store.get(robot)
    return _registered(state, robot, 0) if known is None else known


def is_stored(state: State, robot: Robot, now_us: int) -> bool:
    """Tell whether the store has an entry of the robot that has not expired."""
    until_us = entry(state, robot).until_us
    return until_us is None or until_us > now_us


def is_shown_idle(state: State, robot: Robot, now_us: int) -> bool:
    """Tell whether the store shows the robot as idle."""
    return is_stored(state, robot, now_us) and entry(state, robot).availability == "ready"


def written(state: State, robot: Robot, availability: Availability, now_us: int) -> tuple[StoreEntryWritten, ...]:
    """Return what the master writes into the robot's entry: nothing if it has expired."""
    if not is_stored(state, robot, now_us):
        return ()
    return (StoreEntryWritten(robot=robot, availability=availability, until_us=None, written_by=COORDINATOR),)


def _registered(state: State, robot: Robot, now_us: int) -> StoreEntryWritten:
    until_us = now_us + state.fleet.roboos.expiry_us
    return StoreEntryWritten(robot=robot, availability="ready", until_us=until_us, written_by=robot)


@HANDLERS.decide(Heartbeat, named)
def beat(state: State, command: Heartbeat) -> tuple[StoreEntryWritten, ...]:
    """Renew the expiry, unless the robot has connected again since or the entry has expired."""
    robot, expiry_us = command.robot, state.fleet.roboos.expiry_us
    is_last = state.knowledge.beats.get(robot, expiry_us) == command.until_us
    if not (is_last and is_stored(state, robot, command.now_us)):
        return ()
    is_at_rest = command.now_us > state.fleet.structure.watch_us and not state.task
    shown, until_us = entry(state, robot).availability, None if is_at_rest else command.now_us + expiry_us
    return (StoreEntryWritten(robot=robot, availability=shown, until_us=until_us, written_by=robot),)


@HANDLERS.decide(Connect, named)
def connect(state: State, command: Connect) -> tuple[StoreEntryWritten, ...]:
    """Register the robot as idle, whatever it has in hand (slaver/run.py, connect_to_robot)."""
    return (_registered(state, command.robot, command.now_us),)


@HANDLERS.react(SnapshotPhaseSet)
def _first_beat(state: State, event: SnapshotPhaseSet, _now_us: int) -> tuple[Scheduled, ...]:
    dials = state.fleet.roboos
    after_us = max(1, event.phase_ppm * dials.refresh_us // 1_000_000)
    return (Scheduled(Heartbeat(event.robot, dials.expiry_us), after_us, (at_once(event.robot),)),)


@HANDLERS.react(StoreEntryWritten)
def _next_beat(state: State, event: StoreEntryWritten, _now_us: int) -> tuple[Scheduled, ...]:
    if event.written_by != event.robot or event.until_us is None:
        return ()
    beat = Heartbeat(event.robot, event.until_us)
    return (Scheduled(beat, state.fleet.roboos.refresh_us, (at_once(event.robot),)),)


@HANDLERS.react(TaskArrived)
def _on_arrival(state: State, _event: TaskArrived, _now_us: int) -> tuple[Scheduled, ...]:
    """Record the heartbeats again that were not recorded while there was no task."""
    at_rest = [robot for robot, until_us in state.knowledge.beats.items() if until_us == 0]
    return tuple(Scheduled(Heartbeat(robot, 0), 1, (at_once(robot),)) for robot in at_rest)


@HANDLERS.react(RobotCameBack)
def _on_back(_state: State, event: RobotCameBack, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(Connect(event.robot), 1, (at_once(event.robot),)),)
