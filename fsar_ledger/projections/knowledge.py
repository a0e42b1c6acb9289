"""Knowledge: what deciders have been told. Decisions rest on it, and it may lag behind the world."""

from collections.abc import Mapping
from typing import assert_never

import msgspec

from fsar_ledger.events.envelope import PolicyOutcome, Robot
from fsar_ledger.events.fleet import HeartbeatReceived, RobotCleared, RobotDeparted, RobotSuspected
from fsar_ledger.events.knowledge import (
    CopySynced,
    FleetRuleLearned,
    PeerRemembered,
    PlannerEngaged,
    SnapshotTaken,
    StoreEntryWritten,
    WorkQueued,
)
from fsar_ledger.events.world import SyncPhaseSet

from . import put

HANDLES = (
    SyncPhaseSet
    | FleetRuleLearned
    | PeerRemembered
    | CopySynced
    | SnapshotTaken
    | PlannerEngaged
    | WorkQueued
    | StoreEntryWritten
    | HeartbeatReceived
    | RobotSuspected
    | RobotCleared
    | RobotDeparted
)


class Knowledge(msgspec.Struct, frozen=True, gc=False):
    """What each decider has been told.

    `copy` is the coordinator's last synced copy. `store`: robot -> its entry in a shared store; `beats`: robot -> until
    when its own last write there holds (run time), 0 if it does not expire. `heard`: robot -> the number of its last
    heartbeat at the registry; `suspected`: robots of which none came for too long. Units: `ready_us` run time at which
    the coordinator's queue of work is done.
    """

    sync_phase_ppm: int = 0
    fleet_rule: Mapping[Robot, PolicyOutcome] = {}
    fleet_rule_as_of_us: Mapping[Robot, int] = {}
    met: Mapping[tuple[Robot, Robot], int] = {}
    copy: CopySynced = CopySynced()
    snapshot: Mapping[Robot, PolicyOutcome] = {}
    engaged_until_us: Mapping[Robot, int] = {}
    ready_us: int = 0
    store: Mapping[Robot, StoreEntryWritten] = {}
    beats: Mapping[Robot, int] = {}
    heard: Mapping[Robot, int] = {}
    suspected: frozenset[Robot] = frozenset()


INITIAL = Knowledge()


def evolve(state: Knowledge, event: HANDLES) -> Knowledge:
    """Return the knowledge after the event."""
    replace = msgspec.structs.replace
    match event:
        case WorkQueued():
            return replace(state, ready_us=event.ready_us)
        case CopySynced():
            return replace(state, copy=event)
        case SnapshotTaken():
            return replace(state, snapshot=put(state.snapshot, event.robot, event.outcome))
        case FleetRuleLearned():
            return replace(
                state,
                fleet_rule=put(state.fleet_rule, event.robot, event.outcome),
                fleet_rule_as_of_us=put(state.fleet_rule_as_of_us, event.robot, event.as_of_us),
            )
        case PlannerEngaged():
            return replace(state, engaged_until_us=put(state.engaged_until_us, event.robot, event.until_us))
        case PeerRemembered():
            return replace(state, met=put(state.met, (event.robot, event.peer), event.until_us))
        case StoreEntryWritten():
            beats = state.beats
            if event.written_by == event.robot:
                beats = put(beats, event.robot, event.until_us or 0)
            return replace(state, store=put(state.store, event.robot, event), beats=beats)
        case SyncPhaseSet():
            return replace(state, sync_phase_ppm=event.phase_ppm)
        case HeartbeatReceived():
            return replace(state, heard=put(state.heard, event.robot, event.number))
        case RobotSuspected():
            return replace(state, suspected=state.suspected | {event.robot})
        case RobotCleared() | RobotDeparted():
            return replace(state, suspected=state.suspected - {event.robot})
        case _:
            assert_never(event)
