"""The fleet at its beginning. Paper: sec:prototype:design."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from fsar_ledger import designs
from fsar_ledger.designs import Fleet, TrustByRecord, registered
from fsar_ledger.designs.constants import WorldConstants
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot, Supervisor, local_supervisor, robot_named, supervisor_named
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.events.policy import RolePolicyRuleSet
from fsar_ledger.events.recovery import RecoveryBudgetSet
from fsar_ledger.events.registry import CapabilityAdvertised, CapabilityInstalled
from fsar_ledger.events.supervision import SupervisionDensitySet
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
            domain=one.design.domain,
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
            override_allowed=capability.override_allowed,
            visibility=capability.visibility,
        )
        for name, capability in possessed
    ]
    return (*joined, *_trust_and_rules(design), *_spending(design, everyone))


def _trust_and_rules(design: Fleet) -> Iterator[Event]:
    """Yield whom the robots trust, and the rules that hold for them."""
    # See docs/decisions/trust-and-rules-are-by-role.md.
    for trust in design.trust:
        pairs = [(trust.role, trust.peer_role)]
        if trust.is_mutual and trust.role != trust.peer_role:
            pairs.append((trust.peer_role, trust.role))
        for role, peer_role in pairs:
            yield RoleTrustSet(role=role, peer_role=peer_role, scope=trust.scope, domain=trust.domain)
    if (by_record := design.trust_by_record) != TrustByRecord():
        yield TrustThresholdsSet(by_record.promote_after, by_record.downgrade_after, None)
    for policy in design.policies:
        yield RolePolicyRuleSet(
            scope=policy.scope,
            role=policy.role,
            outcome=policy.outcome,
            domain=policy.domain,
            capability=policy.capability,
        )


def _spending(design: Fleet, everyone: Sequence[Member]) -> Iterator[Event]:
    """Yield how often supervisors are asked, and what recovery may spend, where the fleet's design says so."""
    for density in design.density:
        of_role: list[Robot | None] = [one.name for one in everyone if one.design.kind == density.role]
        for robot in of_role if density.role is not None else [None]:
            yield SupervisionDensitySet(
                robot=robot, review_every=density.review_every, decided_by=None, reason="founding"
            )
    own = {(one.role, one.level) for one in design.budgets}
    for budget in design.budgets:
        for one in everyone:
            is_own, kind = budget.role is not None, one.design.kind
            if budget.role == kind or (not is_own and (kind, budget.level) not in own):
                yield RecoveryBudgetSet(
                    robot=one.name,
                    level=budget.level,
                    t_max_us=round(budget.time_s * 1e6),
                    n_max=budget.attempts,
                    decided_by=None,
                )
