"""The fleet at its beginning. Paper: sec:prototype:design."""

from typing import NamedTuple

from fsar_ledger import designs
from fsar_ledger.designs import Fleet, TrustByRecord, registered
from fsar_ledger.designs.constants import WorldConstants
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot, Supervisor, local_supervisor, robot_named, supervisor_named
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.events.policy import RolePolicyRuleSet
from fsar_ledger.events.registry import CapabilityAdvertised, CapabilityInstalled
from fsar_ledger.events.trust import RoleTrustSet, TrustThresholdsSet

FLOOR_TEAMS = WorldConstants().floor_teams


class Member(NamedTuple):
    """A robot of the fleet: its principal, its team, and its design."""

    name: Robot
    team: int
    design: designs.Robot

    @property
    def supervisor(self) -> Supervisor | None:
        """Return who supervises the robot, if not the fleet supervisor: a person of its own, or one of several."""
        if not self.design.has_supervisor:
            return None
        named = self.design.supervisor
        return local_supervisor(self.name) if named is None else supervisor_named(f"supervisor/{named}")


def team_size(fleet: Fleet | None) -> int:
    """Return the number of robots in a team; None is the paper's fleet."""
    return max(1, len((fleet or registered.fleet()).robots))


def members(fleet_size: int, fleet: Fleet | None = None) -> tuple[Member, ...]:
    """Return every robot, team by team."""
    robots = (fleet or registered.fleet()).robots
    teams = range(1, fleet_size // len(robots) + 1)
    return tuple(Member(robot_named(robot.name, team), team, robot) for team in teams for robot in robots)


def floor_of(team: int, floor_teams: int) -> int:
    """Return the floor on which the team works, from 1; `floor_teams` teams share one."""
    return (team - 1) // floor_teams + 1


def founding(fleet_size: int, floor_teams: int = FLOOR_TEAMS, fleet: Fleet | None = None) -> tuple[Event, ...]:
    """Return the events that found the fleet: members, capabilities, trust and policy. Paper: sec:prototype:design.

    Trust and policy are given by role, so their number does not depend on the number of teams. The robots of a fleet
    that fits on one floor have no place.
    """
    design = fleet or registered.fleet()
    everyone = members(fleet_size, design)
    has_floors = fleet_size > len(design.robots) * floor_teams
    joined: list[Event] = [
        RobotJoined(
            robot=one.name,
            role=one.design.kind,
            team=one.team,
            supervisor=one.supervisor,
            place=f"floor/{floor_of(one.team, floor_teams)}" if has_floors else None,
        )
        for one in everyone
    ]
    capabilities = {one.name: one for one in design.capabilities}
    possessed = [(one.name, capabilities[name]) for one in everyone for name in one.design.capabilities]
    joined += [
        CapabilityInstalled(
            robot=name,
            capability=capability.name,
            version="1.0.0",
            preconditions=(),
            postconditions=capability.postconditions,
        )
        for name, capability in possessed
    ]
    joined += [
        CapabilityAdvertised(
            robot=name,
            capability=capability.name,
            visible_to=capability.visible_to,
            postconditions=capability.postconditions,
        )
        for name, capability in possessed
    ]
    # See docs/decisions/trust-and-rules-are-by-role.md.
    for trust in design.trust:
        joined.append(RoleTrustSet(role=trust.role, peer_role=trust.peer_role, scope=trust.scope))
        if trust.is_mutual and trust.role != trust.peer_role:
            joined.append(RoleTrustSet(role=trust.peer_role, peer_role=trust.role, scope=trust.scope))
    if (by_record := design.trust_by_record) != TrustByRecord():
        joined.append(TrustThresholdsSet(by_record.promote_after, by_record.downgrade_after, None))
    joined += [
        RolePolicyRuleSet(scope=policy.scope, role=policy.role, outcome=policy.outcome, capability=policy.capability)
        for policy in design.policies
    ]
    return tuple(joined)
