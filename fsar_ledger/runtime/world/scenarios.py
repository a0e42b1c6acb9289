"""Who is in the fleet and which tasks arrive. Paper: sec:prototype:design, sec:evaluation:scenarios."""

from typing import NamedTuple

from fsar_ledger.constants import WorldConstants
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot, Scenario, TrustScope, local_supervisor, robot_named
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.events.registry import CapabilityAdvertised, CapabilityInstalled
from fsar_ledger.events.trust import RoleTrustSet

CAPABILITIES: dict[str, tuple[str, ...]] = {
    "A": ("navigate.indoor", "carry.package", "handover.dropoff"),
    "B": ("navigate.indoor", "door.open.basic", "door.open.secure"),
    "C": ("navigate.indoor", "inspect.visual", "inspect.private_zone"),
    "D": ("navigate.indoor", "carry.heavy", "grasp.robust"),
}
POSTCONDITIONS: dict[str, tuple[str, ...]] = {  # what holds after an ECM, in the order in which it comes about
    "grasp.robust": ("load.gripped", "load.held"),
}
VISIBLE_TO: dict[str, tuple[str, ...]] = {"inspect.private_zone": ("B",)}
FLOOR_TEAMS = WorldConstants().floor_teams
TRUST: tuple[tuple[str, str, TrustScope], ...] = (("A", "B", "task"), ("A", "D", "capability"), ("B", "C", "session"))


class TaskScript(NamedTuple):
    """A task of a team: who owns it, when it arrives after the scenario's start, and its steps.

    Steps: `ACTOR capability` is done by the actor; `ACTOR capability TARGET` is delegated by the actor.
    Units: `offset_s` seconds.
    """

    owner: str
    offset_s: float
    steps: tuple[str, ...]


class Injection(NamedTuple):
    """An out-of-trust request, `times` of them per team. Paper: sec:evaluation:setup (Scenario 4)."""

    requester: str
    target: str
    capability: str
    times: int


_RELAY = (
    "A navigate.indoor",
    "A door.open.basic B",
    "A carry.package",
    "A door.open.secure B",
    "A handover.dropoff",
    "A door.open.secure B",
)

TASKS: dict[Scenario, tuple[TaskScript, ...]] = {
    "door-relay": (TaskScript("A", 0, _RELAY), TaskScript("A", 45, _RELAY)),
    "collaborative-delivery": (
        TaskScript(
            "A",
            0,
            (
                "A navigate.indoor",
                "A carry.heavy D",
                "D door.open.secure B",
                "A grasp.robust D",
                "D navigate.indoor",
                "A door.open.basic B",
                "A carry.heavy D",
                "A handover.dropoff",
            ),
        ),
    ),
    "failure-recovery-chain": (
        TaskScript(
            "A",
            0,
            (
                "A carry.heavy D",
                "A grasp.robust D",
                "D door.open.secure B",
                "D navigate.indoor",
                "A carry.heavy D",
                "A handover.dropoff",
            ),
        ),
        TaskScript("D", 45, ("D carry.heavy", "D carry.package A", "D navigate.indoor", "D grasp.robust")),
    ),
    "mixed-trust-inspection": (
        TaskScript(
            "B",
            0,
            (
                "B navigate.indoor",
                "B inspect.private_zone C",
                "C door.open.secure B",
                "C inspect.visual",
                "B inspect.private_zone C",
            ),
        ),
        TaskScript(
            "A",
            40,
            (
                "A navigate.indoor",
                "A door.open.secure B",
                "B inspect.visual C",
                "B inspect.private_zone C",
                "A handover.dropoff",
            ),
        ),
    ),
    "fleet-contention": (
        TaskScript("A", 0, ("A door.open.secure B", "A navigate.indoor", "A carry.package", "A carry.heavy D")),
        TaskScript("C", 0, ("C door.open.secure B", "C navigate.indoor", "C inspect.visual")),
        TaskScript("B", 25, ("B door.open.basic", "B carry.package A")),
        TaskScript("D", 55, ("D navigate.indoor", "D carry.package A", "D grasp.robust")),
    ),
}
INJECTIONS: dict[Scenario, tuple[Injection, ...]] = {
    "mixed-trust-inspection": (Injection("D", "C", "inspect.private_zone", 2),)
}
DEGRADABLE: dict[Scenario, tuple[str, ...]] = {
    "failure-recovery-chain": ("D",),
    "fleet-contention": ("A", "B", "C", "D"),
}


def robots(fleet_size: int) -> tuple[tuple[Robot, str, int], ...]:
    """Name, role and team of every robot; a fleet of n = 4k has k teams of the four roles."""
    return tuple(
        (robot_named(role, team), role, team) for team in range(1, fleet_size // 4 + 1) for role in CAPABILITIES
    )


def floor_of(team: int, floor_teams: int) -> int:
    """The floor on which the team works, from 1; as many teams as that share one."""
    return (team - 1) // floor_teams + 1


def founding(fleet_size: int, floor_teams: int = FLOOR_TEAMS) -> tuple[Event, ...]:
    """The events that found the fleet: members, advertisements, trust. Paper: sec:prototype:design.

    Trust is given by role, so there are six entries of it in any fleet; a fleet that needs one floor names no place.
    """
    members = robots(fleet_size)
    has_floors = fleet_size > 4 * floor_teams
    joined: list[Event] = [
        RobotJoined(
            robot=name,
            role=role,
            team=team,
            supervisor=local_supervisor(name),
            place=f"floor/{floor_of(team, floor_teams)}" if has_floors else None,
        )
        for name, role, team in members
    ]
    possessed = [(name, capability) for name, role, _ in members for capability in CAPABILITIES[role]]
    joined += [
        CapabilityInstalled(
            robot=name,
            capability=capability,
            version="1.0.0",
            preconditions=(),
            postconditions=POSTCONDITIONS.get(capability, ()),
        )
        for name, capability in possessed
    ]
    joined += [
        CapabilityAdvertised(
            robot=name,
            capability=capability,
            visible_to=VISIBLE_TO.get(capability, ()),
            postconditions=POSTCONDITIONS.get(capability, ()),
        )
        for name, capability in possessed
    ]
    for one, other, scope in TRUST:
        joined += [
            RoleTrustSet(role=one, peer_role=other, scope=scope),
            RoleTrustSet(role=other, peer_role=one, scope=scope),
        ]
    return tuple(joined)
