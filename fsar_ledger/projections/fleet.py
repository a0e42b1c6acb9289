"""The members of the fleet, and the run's structure. Paper: eq:fleet, eq:runtime."""

from collections.abc import Iterable, Mapping
from functools import cached_property, lru_cache
from typing import TypeVar, assert_never

import msgspec

from fsar_ledger.designs import registered
from fsar_ledger.designs.constants import Constants, Membership, Outages, Structure, read_constants, with_all_groups
from fsar_ledger.designs.dials import Alliance, Jade, Roboos
from fsar_ledger.events.configuration import removed_mechanisms
from fsar_ledger.events.envelope import Robot, Supervisor
from fsar_ledger.events.fleet import (
    Departure,
    IsolationBegan,
    IsolationEnded,
    RobotDeparted,
    RobotJoined,
    RobotReturned,
    RunStarted,
)

from . import put, without

HANDLES = RunStarted | RobotJoined | RobotDeparted | RobotReturned | IsolationBegan | IsolationEnded
NEVER_US = 2**63 - 1
"""Later than any time that can be stored."""

_Key = TypeVar("_Key")


class Member(msgspec.Struct, frozen=True, gc=False):
    """One robot of the fleet. `team` is 0 if the record has none."""

    name: Robot
    role: str
    team: int
    supervisor: Supervisor | None
    domain: str = ""
    place: str | None = None
    public_key: str | None = None


class Fleet(msgspec.Struct, frozen=True, dict=True):
    """The run's structure, the mechanisms that its configuration lacks, and its robots in order of joining.

    Groups of constants are those of the run's `Constants` of the same names, or their defaults if it has none.
    `departed`: robot that has left and not returned -> how; `fences`: robot -> its departures so far. `bodies` are the
    roles whose robots can clear an obstruction; `substitutes` maps a capability to the one that can replace it.
    `is_live`: the robots are real. `isolated`: the robot that is alone, without the federation; `handed_over`: robot ->
    the last run on its own that it has handed over.

    Units: `answer_us` microseconds that a robot waits for an answer.
    """

    without: frozenset[str] = frozenset()
    size: int = 0
    structure: Structure = Structure()
    robots: Mapping[Robot, Member] = {}
    departed: Mapping[Robot, Departure] = {}
    fences: Mapping[Robot, int] = {}
    membership: Membership = Membership()
    answer_us: int = round(Outages().answer_s * 1e6)
    is_live: bool = False
    bodies: tuple[str, ...] = ()
    substitutes: dict[str, str] = {}
    jade: Jade = Jade()
    alliance: Alliance = Alliance()
    roboos: Roboos = Roboos()
    isolated: Robot | None = None
    handed_over: Mapping[Robot, str] = {}

    @cached_property
    def teams(self) -> dict[int, frozenset[Robot]]:
        """The robots of each team."""
        return _grouped((robot.team, robot.name) for robot in self.robots.values())

    @cached_property
    def able_bodies(self) -> tuple[Robot, ...]:
        """The robots whose body can clear an obstruction, sorted by name."""
        return tuple(sorted(robot.name for robot in self.robots.values() if robot.role in self.bodies))

    @cached_property
    def places(self) -> dict[str | None, frozenset[Robot]]:
        """The robots that work at each place."""
        return _grouped((robot.place, robot.name) for robot in self.robots.values())


def _grouped(names: Iterable[tuple[_Key, Robot]]) -> dict[_Key, frozenset[Robot]]:
    groups: dict[_Key, set[Robot]] = {}
    for key, name in names:
        groups.setdefault(key, set()).add(name)
    return {key: frozenset(robots) for key, robots in groups.items()}


def evolve(state: Fleet, event: HANDLES) -> Fleet:
    """Return the fleet after the event."""
    match event:
        case RunStarted():
            fleet = _empty_fleet(event.parameters)
            return msgspec.structs.replace(
                fleet,
                without=removed_mechanisms(event.configuration or ""),
                size=event.fleet_size or 0,
                is_live=event.kind == "live",
                robots=state.robots,
            )
        case RobotJoined():
            robot = Member(
                event.robot,
                event.role,
                event.team or 0,
                event.supervisor,
                event.domain,
                event.place,
                event.public_key,
            )
            robots, departed = put(state.robots, event.robot, robot), without(state.departed, event.robot)
            return msgspec.structs.replace(state, robots=robots, departed=departed)
        case RobotDeparted():
            departed = put(state.departed, event.robot, event.reason)
            return msgspec.structs.replace(state, departed=departed, fences=put(state.fences, event.robot, event.fence))
        case RobotReturned():
            return msgspec.structs.replace(state, departed=without(state.departed, event.robot))
        case IsolationBegan():
            fences = {} if event.fence is None else {event.robot: event.fence}
            return msgspec.structs.replace(state, isolated=event.robot, fences=fences)
        case IsolationEnded():
            handed_over = put(state.handed_over, event.robot, event.isolated_run)
            return msgspec.structs.replace(state, handed_over=handed_over)
        case _:
            assert_never(event)


@lru_cache(maxsize=4)
def _empty_fleet(parameters: str | None) -> Fleet:
    """Return a fleet without robots from the run's parameters, or with the defaults if it records none.

    Cached, because all runs of an experiment share their parameters.
    """
    constants = with_all_groups(Constants() if parameters is None else read_constants(parameters))
    design = constants.fleet or registered.fleet()
    assert constants.outages is not None
    groups = {name: getattr(constants, name) for name in Fleet.__struct_fields__ if name in constants.__struct_fields__}
    return Fleet(
        **groups,
        answer_us=round(constants.outages.answer_s * 1e6),
        bodies=design.bodies,
        substitutes={substitute.of: substitute.by for substitute in design.substitutes},
    )


INITIAL = _empty_fleet(None)
