"""What a designer writes: fleets, scenarios and workflows, in TOML files.

Those that are nobody's but the designer's are in event 0 of a run, too. Everything here is immutable to the leaves. The
structure is checked when a file or an event is read; `runtime.world.checks` checks the rest.
"""

import msgspec

from fsar_ledger.events.envelope import PolicyOutcome, PolicyScope, TrustScope
from fsar_ledger.events.world import Grade


class Design(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """A part of a design: fields that are not there have their default, and a field that is not known is an error."""


class Robot(Design, frozen=True):
    """One robot of each team: `east-door` of team 2 is `robot/east-door2`. Without a role its name is its role."""

    name: str
    capabilities: tuple[str, ...]
    role: str | None = None
    has_supervisor: bool = True  # of its own; the fleet's stands in for none

    @property
    def kind(self) -> str:
        """Return the role, by which trust, policy and visibility are given."""
        return self.name if self.role is None else self.role


class Capability(Design, frozen=True):
    """Something that robots of the fleet can do.

    `postconditions` hold after it, in the order in which they come about; the roles in `visible_to` can discover it
    (none named: all). Units: `lasts_s` seconds, from and to; None: as `world.durations` has it.
    """

    name: str
    postconditions: tuple[str, ...] = ()
    visible_to: tuple[str, ...] = ()
    lasts_s: tuple[float, float] | None = None


class Substitute(Design, frozen=True):
    """A capability that can replace another."""

    of: str
    by: str


class Trust(Design, frozen=True):
    """Every robot of `role` trusts every robot of `peer_role`; where it is mutual, also the other way."""

    role: str
    peer_role: str
    scope: TrustScope
    is_mutual: bool = False


class Policy(Design, frozen=True):
    """A rule for every robot of a role, its own (`local`) or the fleet's; for one capability or (None) for all."""

    role: str
    outcome: PolicyOutcome
    scope: PolicyScope = "local"
    capability: str | None = None


class OffShift(Design, frozen=True):
    """A spell in which the supervisors of these robots (none named: of all that have one) are off shift.

    Units: seconds of run time; `to_s` None: to the end.
    """

    from_s: float = 0.0
    to_s: float | None = None
    robots: tuple[str, ...] = ()


class Fleet(Design, frozen=True):
    """Who is in a team, what they can do, whom they trust, and when nobody supervises.

    A fleet is one or more such teams. `bodies` are the roles whose robots can clear an obstruction.
    """

    name: str
    robots: tuple[Robot, ...]
    capabilities: tuple[Capability, ...]
    bodies: tuple[str, ...] = ()
    substitutes: tuple[Substitute, ...] = ()
    trust: tuple[Trust, ...] = ()
    policies: tuple[Policy, ...] = ()
    off_shift: tuple[OffShift, ...] = ()

    @property
    def roles(self) -> tuple[str, ...]:
        """Return each role once."""
        return tuple(dict.fromkeys(robot.kind for robot in self.robots))

    def is_off_shift(self, spell: OffShift, robot: Robot) -> bool:
        """Return whether the spell is one of this robot's supervisor."""
        return robot.has_supervisor and (not spell.robots or robot.name in spell.robots)


class Task(Design, frozen=True):
    """A task of a team. Units: `offset_s` seconds after the scenario's start.

    Steps are as in `TaskArrived`: `ACTOR capability` is done by the actor, `ACTOR capability TARGET` delegated by it;
    both are robots of the team.
    """

    owner: str
    steps: tuple[str, ...]
    offset_s: float = 0.0
    is_time_critical: bool = False
    checkpoints: tuple[str, ...] | None = None

    @property
    def delegated(self) -> int:
        """Return how many steps are delegated."""
        return sum(step.count(" ") == 2 for step in self.steps)


class Injection(Design, frozen=True):
    """A request outside trust, `times` of them per team. Paper: sec:evaluation:setup (Scenario 4)."""

    requester: str
    target: str
    capability: str
    times: int = 1


class Scenario(Design, frozen=True):
    """What there is to do, in a world that disturbs it. One of the `degradable` robots may degrade."""

    name: str
    tasks: tuple[Task, ...]
    injections: tuple[Injection, ...] = ()
    degradable: tuple[str, ...] = ()


class Wear(Design, frozen=True):
    """An actuator that degrades soon after the tasks have arrived."""

    robot: str
    grade: Grade


class Workflow(Design, frozen=True):
    """The tasks of one team, all of the same arrival, with this wear and no other disturbance.

    Paper: sec:prototype:workflows.
    """

    name: str
    tasks: tuple[Task, ...]
    wear: tuple[Wear, ...] = ()
