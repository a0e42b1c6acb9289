"""Who is in the fleet, and what run this is. Paper: eq:fleet, eq:runtime."""

from functools import lru_cache
from typing import assert_never

import msgspec

from fsar_ledger.constants import Structure, read_constants
from fsar_ledger.events.configuration import lacks
from fsar_ledger.events.fleet import RobotJoined, RunStarted

HANDLES = RunStarted | RobotJoined


class Robot(msgspec.Struct, frozen=True, gc=False):
    """One robot of the fleet."""

    name: str
    role: str
    team: int
    supervisor: str | None
    domain: str = ""
    place: str | None = None


class Fleet(msgspec.Struct, frozen=True, gc=False):
    """The run's structure, the mechanisms that its configuration is without, and its robots by name, in order of joining.

    `teams` is the highest number of a team.
    """

    without: frozenset[str] = frozenset()
    size: int = 0
    structure: Structure = Structure()
    robots: dict[str, Robot] = {}
    teams: int = 1


INITIAL = Fleet()


def evolve(state: Fleet, event: HANDLES) -> Fleet:
    """The fleet after the event."""
    match event:
        case RunStarted():
            return Fleet(lacks(event.configuration or ""), event.fleet_size or 0, _structure(event.parameters), state.robots)
        case RobotJoined():
            robot = Robot(event.robot, event.role, event.team, event.supervisor, event.domain, event.place)
            return msgspec.structs.replace(state, robots={**state.robots, event.robot: robot}, teams=max(state.teams, event.team))
        case _:
            assert_never(event)


@lru_cache(maxsize=4)
def _structure(parameters: str | None) -> Structure:
    """The structural constants of a run, ours if it records none; all runs of an experiment have the same."""
    return Structure() if parameters is None else read_constants(parameters).structure
