"""Changes: what a fork does differently from its base, as data, as text, and as tables of a TOML file.

| text | what is otherwise |
|---|---|
| `drop FACT` | the fact of the world does not happen |
| `move FACT +5s` | it happens later, or with `-5s` earlier |
| `add 20s {"type":"ObstructionAppeared.v1",...}` | one more fact; `add obstruction:B1 20s for 5s` is short for a pair |
| `answer QUESTION ANSWER` | at a port: `deny`, `fail`, `2.5s`, `never` |
| `rule fleet deny robot=B1 capability=carry.heavy from 30s` | a policy rule holds from then on |
| `trust A1 B1 session from 30s` | the robot trusts the peer so far from then on |
| `budget A1 local 5s 1 from 30s` | the budget of one level of recovery, time and attempts |
| `density A1 2 from 30s` | every second admission is reviewed; `density all 1` |
| `set world.review_share=0.5 from 30s` | a constant of the world; without `from`, any constant |
| `architecture cfc`, `without shared-registry` | another architecture, or one without mechanisms, from the start |

Facts and questions have the names of `changeable.py`; `*` in one stands for any text. `instead of`
at the end of a text states the previous value, which makes it whole: a fork has such texts in its event 0.
"""

from decimal import Decimal
from math import isfinite
from typing import Literal

import msgspec

from fsar_ledger.base.errors import UsageError
from fsar_ledger.events.envelope import PolicyOutcome, PolicyScope, RecoveryLevel, Robot, TrustScope


class Change(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="change", tag=str.lower):
    """A difference of a fork from its base. Units: names that end in `_s` seconds of run time."""


class Drop(Change, frozen=True):
    """The facts of this name do not happen."""

    fact: str

    def __str__(self) -> str:
        return f"drop {self.fact}"


class Move(Change, frozen=True):
    """The facts of this name happen later by `by_s` (earlier if negative)."""

    fact: str
    by_s: float

    def __str__(self) -> str:
        return f"move {self.fact} {'+' if self.by_s >= 0 else '-'}{seconds_text(abs(self.by_s))}"


class Add(Change, frozen=True):
    """One more fact of the world happens. `event` is its JSON, as `sql` shows it: the type and its fields."""

    at_s: float
    event: str

    def __str__(self) -> str:
        return f"add {seconds_text(self.at_s)} {self.event}"


class Answer(Change, frozen=True):
    """The questions of this name get this answer. `answer` is a word or a length, as the question has them."""

    question: str
    answer: str

    def __str__(self) -> str:
        return f"answer {self.question} {self.answer}"


class Rule(Change, frozen=True, kw_only=True):
    """A rule of policy holds: the robot's own (`local`), or the fleet's for it or (None) for every robot."""

    scope: PolicyScope
    outcome: PolicyOutcome
    robot: Robot | None = None
    capability: str | None = None
    task: str | None = None
    from_s: float = 0.0

    def __str__(self) -> str:
        about = _options(robot=self.robot, capability=self.capability, task=self.task)
        return f"rule {self.scope} {self.outcome}{about}{_from(self.from_s)}"


class Trust(Change, frozen=True, kw_only=True):
    """The robot trusts the peer to this scope: for one capability, in one task, or (None) for all."""

    robot: Robot
    peer: Robot
    scope: TrustScope
    capability: str | None = None
    task: str | None = None
    from_s: float = 0.0

    def __str__(self) -> str:
        about = _options(capability=self.capability, task=self.task)
        return f"trust {self.robot} {self.peer} {self.scope}{about}{_from(self.from_s)}"


class Budget(Change, frozen=True, kw_only=True):
    """The budget of the robot's recovery at one level: a time, and a number of attempts."""

    robot: Robot
    level: RecoveryLevel
    time_s: float
    attempts: int
    from_s: float = 0.0

    def __str__(self) -> str:
        return f"budget {self.robot} {self.level} {seconds_text(self.time_s)} {self.attempts}{_from(self.from_s)}"


class Density(Change, frozen=True, kw_only=True):
    """Every n-th admission of the robot (None: of each robot) is put before a supervisor; 0 is none."""

    robot: Robot | None
    review_every: int
    from_s: float = 0.0

    def __str__(self) -> str:
        return f"density {self.robot or 'all'} {self.review_every}{_from(self.from_s)}"


class Set(Change, frozen=True, kw_only=True):
    """A constant has this value: from the start (None), or a constant of the world from then on.

    `before` is its value in the base, as text; None until the base is known.
    """

    constant: str
    value: float | int
    from_s: float | None = None
    before: str | None = None

    def __str__(self) -> str:
        when = "" if self.from_s is None else f" from {seconds_text(self.from_s)}"
        return f"set {self.constant}={number_text(self.value)}{when}{_instead(self.before)}"


class Architecture(Change, frozen=True):
    """Another architecture decides, from the start. `before` as in `Set`."""

    architecture: str
    before: str | None = None

    def __str__(self) -> str:
        return f"architecture {self.architecture}{_instead(self.before)}"


class Without(Change, frozen=True):
    """The architecture lacks these mechanisms (`+` between two), from the start; `nothing`: it is in full.

    `before` as in `Set`: what it lacked.
    """

    mechanisms: str
    before: str | None = None

    def __str__(self) -> str:
        return f"without {self.mechanisms}{_instead(self.before)}"


AnyChange = Drop | Move | Add | Answer | Rule | Trust | Budget | Density | Set | Architecture | Without
OfFacts = Drop | Move | Add
"""Changes of the world's facts."""
Commanded = Rule | Trust | Budget | Density
"""Changes that a supervisor commands."""
Changes = tuple[AnyChange, ...]

Rules = Literal["now", "to 0.18", "to 0.16", "to 0.15"]
"""The meaning of changes, by release.

Up to 0.18, a task that is moved is due when it was, one that is added when it says, and of two answers for a field of a
command the last counts. Up to 0.16, a constant set from a time on drops the facts of the other world whose number is
already used, and of two overlapping spells the first end counts. Up to 0.15, each change also names what the changes
before it left.
"""
NOW: Rules = "now"
TO_0_18: Rules = "to 0.18"
TO_0_16: Rules = "to 0.16"
TO_0_15: Rules = "to 0.15"
UP_TO_0_16 = (TO_0_16, TO_0_15)
RULES = (NOW, TO_0_18, TO_0_16, TO_0_15)

NEVER = "never"
"""The answer that does not come before the run ends."""
MODEL = "model:"
"""The prefix of a seed, for the answers that the model draws where the record of a live run has none."""

Verb = Literal["drop", "move", "add", "answer", "rule", "trust", "budget", "density", "set", "architecture", "without"]


def seconds_text(seconds: float) -> str:
    """Format a time so that `seconds_of` reads the same: 46.6s. Raises: UsageError if it is not finite."""
    if not isfinite(seconds):
        raise UsageError(f"change: found {seconds} where a time belongs, expected seconds")
    return f"{Decimal(round(seconds * 1_000_000)) / 1_000_000:f}s"


def microseconds_of(seconds: float) -> int:
    """Return the time in whole microseconds."""
    return round(seconds * 1_000_000)


def number_text(value: float | int) -> str:
    """Format the value of a constant as JSON; whole numbers without a fraction."""
    return str(int(value)) if float(value).is_integer() and abs(value) < 2**53 else repr(value)


def _from(seconds: float) -> str:
    return f" from {seconds_text(seconds)}" if seconds else ""


def _options(**options: str | None) -> str:
    return "".join(f" {name}={value}" for name, value in options.items() if value is not None)


def _instead(before: str | None) -> str:
    return "" if before is None else f" instead of {before}"
