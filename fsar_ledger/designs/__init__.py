"""Designs: fleets, scenarios and workflows, written in TOML files.

A design that does not come with the package is also stored in event 0 of its runs. Everything here is immutable
throughout. The structure is checked when a file or an event is read; `runtime.world.checks` checks the rest.
"""

import msgspec

from fsar_ledger.events.envelope import OverrideLevel, PolicyOutcome, PolicyScope, RecoveryLevel, TrustScope, Visibility
from fsar_ledger.events.world import Grade


class Design(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """A part of a design. A missing field has its default; an unknown field is an error."""


class Robot(Design, frozen=True):
    """One robot of each team: `east-door` of team 2 is `robot/east-door2`. Its role defaults to its name.

    `domain` is the path of the registry in which it advertises (`ward/night`); empty is the fleet's own.
    """

    name: str
    capabilities: tuple[str, ...]
    role: str | None = None
    has_supervisor: bool = True  # else the fleet supervisor is in charge
    supervisor: str | None = None  # a person (`supervisor/NAME`) who may supervise several robots; None: one of its own
    domain: str = ""

    @property
    def kind(self) -> str:
        """Return the role, to which trust, policy and visibility refer."""
        return self.name if self.role is None else self.role


class Capability(Design, frozen=True):
    """Something that robots of the fleet can do.

    `postconditions` hold after it, in the order in which they are achieved; the roles in `visible_to` can discover it
    (empty: all), in the domains that `visibility` names, or where there is trust; a request may carry priority up to
    `override_allowed`. Units: `lasts_s` seconds, shortest and longest; None: as in `world.durations`.
    """

    name: str
    postconditions: tuple[str, ...] = ()
    visible_to: tuple[str, ...] = ()
    lasts_s: tuple[float, float] | None = None
    visibility: Visibility = "global"
    override_allowed: OverrideLevel = "none"


class Substitute(Design, frozen=True):
    """A capability that can replace another."""

    of: str
    by: str


class Trust(Design, frozen=True):
    """Every robot of `role` trusts every robot of `peer_role`, and the other way round if it is mutual.

    Both are in the `domain`; empty is the whole fleet. A smaller domain takes precedence.
    """

    role: str
    peer_role: str
    scope: TrustScope
    is_mutual: bool = False
    domain: str = ""


class TrustByRecord(Design, frozen=True):
    """How trust follows the record: consecutive successes that promote it, consecutive failures that downgrade it.

    0 is never.
    """

    promote_after: int = 0
    downgrade_after: int = 0


class Policy(Design, frozen=True):
    """A rule for every robot of a role, the robot's own (`local`) or the fleet's, for one capability or (None) all.

    The robots are in the `domain`; empty is the whole fleet. The rule of a smaller domain replaces it.
    """

    role: str
    outcome: PolicyOutcome
    scope: PolicyScope = "local"
    capability: str | None = None
    domain: str = ""


class Density(Design, frozen=True):
    """Every n-th admission by each robot of a role, or (None) of every role, is submitted to a supervisor; 0: none."""

    review_every: int
    role: str | None = None


class Budget(Design, frozen=True):
    """What a level of recovery may spend: by the robots of a role, or (None) of every role without a budget of its own.

    Units: `time_s` seconds.
    """

    level: RecoveryLevel
    time_s: float
    attempts: int
    role: str | None = None


class OffShift(Design, frozen=True):
    """A spell in which the supervisors of these robots (empty: of all that have one) are off shift.

    Units: seconds of run time; `to_s` None: until the end.
    """

    from_s: float = 0.0
    to_s: float | None = None
    robots: tuple[str, ...] = ()


class Fleet(Design, frozen=True):
    """The robots of a team, their capabilities and trust, and when they are unsupervised.

    A fleet consists of one or more such teams. `bodies` are the roles whose robots can clear an obstruction.
    """

    name: str
    robots: tuple[Robot, ...]
    capabilities: tuple[Capability, ...]
    bodies: tuple[str, ...] = ()
    substitutes: tuple[Substitute, ...] = ()
    trust: tuple[Trust, ...] = ()
    trust_by_record: TrustByRecord = TrustByRecord()
    policies: tuple[Policy, ...] = ()
    density: tuple[Density, ...] = ()
    budgets: tuple[Budget, ...] = ()
    off_shift: tuple[OffShift, ...] = ()

    @property
    def roles(self) -> tuple[str, ...]:
        """Return each role once."""
        return tuple(dict.fromkeys(robot.kind for robot in self.robots))

    def is_off_shift(self, spell: OffShift, robot: Robot) -> bool:
        """Return whether this robot's supervisor is off shift in the spell."""
        return robot.has_supervisor and (not spell.robots or robot.name in spell.robots)


class Task(Design, frozen=True):
    """A task of a team. Units: `offset_s` seconds after the scenario's start.

    Steps are as in `TaskArrived`: the actor does `ACTOR capability` itself and delegates `ACTOR capability TARGET`;
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
    """Requests outside trust, `times` of them per team. Paper: sec:evaluation:setup (Scenario 4)."""

    requester: str
    target: str
    capability: str
    times: int = 1


class OutsideCommand(Design, frozen=True):
    """A command that comes to the run from outside at this time, and is decided on the state then.

    `by` is the issuer; `parameters` are its fields, as JSON. A file has them as fields beside `command`. Units: `at_s`
    run time in seconds.
    """

    at_s: float
    command: str
    by: str
    parameters: str = "{}"


class Scenario(Design, frozen=True):
    """The tasks of each team, in a world with disturbances. The actuator of one `degradable` robot may degrade.

    `commands` come to the run whichever teams work in it, not once per team. `settings` are constants that the scenario
    runs with, as `--set` takes them.
    """

    name: str
    tasks: tuple[Task, ...]
    injections: tuple[Injection, ...] = ()
    degradable: tuple[str, ...] = ()
    commands: tuple[OutsideCommand, ...] = ()
    settings: tuple[str, ...] = ()


class Wear(Design, frozen=True):
    """An actuator that degrades soon after the tasks have arrived."""

    robot: str
    grade: Grade


class Workflow(Design, frozen=True):
    """The tasks of one team, which arrive together, with this wear and no other disturbance.

    Paper: sec:prototype:workflows.
    """

    name: str
    tasks: tuple[Task, ...]
    wear: tuple[Wear, ...] = ()
