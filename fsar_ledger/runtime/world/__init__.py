"""The world: the only source of randomness. It depends on scenarios and robots, but not on the architecture.

Its draws are pure functions of what they are used for, and its environment answers with them. A draw is the
BLAKE2b hash of its name under the key of the run, so it does not depend on earlier draws, on any other stream, or on
the architecture. No name contains an architecture or a configuration.

The events that found the fleet, by its design, are here, too.
"""

import struct
from collections.abc import Iterator, Sequence
from hashlib import blake2b
from math import log
from typing import NamedTuple

from fsar_ledger import designs
from fsar_ledger.designs import Fleet, TrustByRecord, registered
from fsar_ledger.designs.constants import END_US, Range, WorldConstants
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot, Supervisor, local_supervisor, robot_named, supervisor_named
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.events.policy import RolePolicyRuleSet
from fsar_ledger.events.recovery import RecoveryBudgetSet
from fsar_ledger.events.registry import CapabilityAdvertised, CapabilityInstalled
from fsar_ledger.events.supervision import SupervisionDensitySet
from fsar_ledger.events.trust import RoleTrustSet, TrustThresholdsSet
from fsar_ledger.runtime.ports import AS_USUAL, Ask, Fact

FOREVER_US = (
    10**15
)  # some 30 years; longer durations are cut to this, so that every time is an integer that can be stored
_SHARE = 2.0**-53
_BLOCK = struct.Struct("<8Q")
_ONE = struct.Struct("<Q")


def run_key(seed: int, scenario: str, run: int) -> bytes:
    """Return the key under which all draws of one run are made."""
    return blake2b(f"{seed}|{len(scenario)}:{scenario}|{run}".encode(), digest_size=32).digest()


class Stream:
    """An endless sequence of uniform draws in [0, 1) under one name, for schedules that need many."""

    __slots__ = ("_block", "_buffer", "_key")

    def __init__(self, key: bytes, name: str) -> None:
        self._key = blake2b(name.encode(), digest_size=32, key=key).digest()
        self._block = 0
        self._buffer: list[float] = []

    def uniform(self) -> float:
        """Return the next draw in [0, 1)."""
        if not self._buffer:
            words = _BLOCK.unpack(blake2b(self._block.to_bytes(8, "little"), key=self._key).digest())
            self._buffer = [(word >> 11) * _SHARE for word in reversed(words)]
            self._block += 1
        return self._buffer.pop()

    def within_us(self, law: Range) -> int:
        """Return a uniformly distributed duration. Units: microseconds."""
        return round(min((law.low_s + (law.high_s - law.low_s) * self.uniform()) * 1e6, FOREVER_US))

    def exponential_us(self, mean_s: float) -> int:
        """Return an exponentially distributed duration of at least 1. Units: microseconds."""
        return max(1, round(min(-log(1.0 - self.uniform()) * mean_s * 1e6, FOREVER_US)))


class Draws:
    """Draws that answer during the run, named by stream and by the task, step, attempt and hop that use them."""

    __slots__ = ("_begun", "_laws", "_reliability")

    def __init__(self, key: bytes, world: WorldConstants) -> None:
        self._reliability = world.degraded_reliability
        laws = {
            "message": world.message,
            "approach": world.approach,
            "retry": world.retry,
            "response": world.response,
            **dict(world.durations),
        }
        self._laws = {
            stream: (law.low_s * 1e6, (law.high_s - law.low_s) * 1e6 * _SHARE) for stream, law in laws.items()
        }
        # Each stream's hash of the prefix of its draws' names, which thousands of draws share.
        self._begun = {
            stream: blake2b(f"{stream}|".encode(), digest_size=8, key=key) for stream in (*laws, "reliability")
        }

    def answer(self, ask: Ask) -> int:
        """Draw the answer: a length in microseconds; to `reliability`, 1 if a degraded actuator holds, else 0."""
        stream, share_ppm = ask.what, ask.share_ppm
        if not share_ppm:
            return 0
        if stream in ("verdict", "admission", "help"):  # the model's supervisors and robots answer alike
            return AS_USUAL
        # See docs/decisions/draws-are-named.md.
        digest = self._begun[stream].copy()
        digest.update(ask.key.encode())
        word: int = _ONE.unpack(digest.digest())[0] >> 11
        if stream == "reliability":
            return int(word * _SHARE < self._reliability)
        low_us, scale = self._laws[stream]
        length_us = round(min(low_us + scale * word, FOREVER_US))
        return length_us if share_ppm == 1_000_000 else length_us * share_ppm // 1_000_000

    def middle(self, ask: Ask) -> int:
        """Return the midpoint of the law by which a length is drawn. Units: microseconds."""
        low_us, scale = self._laws[ask.what]
        return round(min(low_us + scale / (2 * _SHARE), FOREVER_US)) * ask.share_ppm // 1_000_000


class SimulatedEnvironment:
    """A world in which these facts happen and these draws answer."""

    __slots__ = ("answer", "facts", "latest_us", "middle")

    def __init__(self, facts: Sequence[Fact], draws: Draws) -> None:
        self.facts = facts
        self.latest_us: int | None = 2 * END_US  # no simulated run is longer: one that is still busy then is a bug
        self.answer = draws.answer
        self.middle = draws.middle


FLOOR_TEAMS = WorldConstants().floor_teams


class Member(NamedTuple):
    """A robot of the fleet: its principal, its team, and its design."""

    name: Robot
    team: int
    design: designs.Robot

    @property
    def supervisor(self) -> Supervisor | None:
        """Return the robot's supervisor, its own or one of several robots; None: the fleet supervisor."""
        if not self.design.has_supervisor:
            return None
        name = self.design.supervisor
        return local_supervisor(self.name) if name is None else supervisor_named(f"supervisor/{name}")


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
            robot=member.name,
            role=member.design.kind,
            team=member.team,
            supervisor=member.supervisor,
            domain=member.design.domain,
            place=f"floor/{floor_of(member.team, floor_teams)}" if has_floors else None,
        )
        for member in everyone
    ]
    capabilities = {capability.name: capability for capability in design.capabilities}
    possessed = [(member.name, capabilities[name]) for member in everyone for name in member.design.capabilities]
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
    """Yield the trust between roles, and the policy rules."""
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
    """Yield the supervision densities and the recovery budgets of the fleet's design."""
    for density in design.density:
        of_role: list[Robot | None] = [member.name for member in everyone if member.design.kind == density.role]
        for robot in of_role if density.role is not None else [None]:
            yield SupervisionDensitySet(
                robot=robot, review_every=density.review_every, decided_by=None, reason="founding"
            )
    own = {(budget.role, budget.level) for budget in design.budgets}
    for budget in design.budgets:
        for member in everyone:
            is_own, kind = budget.role is not None, member.design.kind
            if budget.role == kind or (not is_own and (kind, budget.level) not in own):
                yield RecoveryBudgetSet(
                    robot=member.name,
                    level=budget.level,
                    t_max_us=round(budget.time_s * 1e6),
                    n_max=budget.attempts,
                    decided_by=None,
                )
