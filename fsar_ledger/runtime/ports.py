"""Ports: where a run leaves what the federation decides, and what answers there.

A reaction cannot know how long a message, a robot or a human takes, or what comes of it: it asks at a port, and the
environment of the run answers. The clock is the kernel's own, so a fixed time is asked of nobody.

A robot or a human who is really there answers when it does: the environment gives no answer then, nothing is scheduled,
and what was asked for comes by a command from outside (`handlers/public.py`).
"""

from collections.abc import Sequence
from typing import Literal, Protocol, TypeAlias

import msgspec

from fsar_ledger.events import Event

Port = Literal["network", "body", "human", "decision"]
"""Who answers: what carries messages, the body of a robot, a supervisor, a robot's own judgement of a request."""

Fact: TypeAlias = tuple[int, Event]
"""What happens by itself: when (microseconds of run time), and what."""


AS_USUAL, DISAPPROVES, PREFERS_OTHER = range(3)
"""What a supervisor can answer to a call (`verdict`): as the model's supervisors do (approve the review, put first whom
the order of the fleet puts first, resolve the failure); no to a review; the other of two actions first.
"""


ANSWERS_LATER = 3
"""What is answered for a robot that is asked to help and says so itself: it is asked, and nothing is admitted yet."""
UNKNOWN_US = -1
"""The length of an execution of which nobody knows how long it takes: the robot reports when it has finished."""


class Ask(msgspec.Struct, frozen=True, gc=False):
    """A question at a port: what it is about, what it serves, and the share of the answer that counts, in ppm.

    `what` and `key` name it within the run: the same message of the same action asks the same under every architecture.
    A message has a `sender`, who must be linked when it sets out. The actor of the command, who receives it, must be
    linked when it arrives.
    """

    port: Port
    what: str
    key: str
    share_ppm: int = 1_000_000
    sender: str | None = None


# See docs/decisions/ports-answer-for-the-world.md.
class Environment(Protocol):
    """What answers at the ports of one run, and what happens there by itself.

    `facts` are in order of time. A run that is still busy after `latest_us` does not end; None: it may take any time.
    """

    @property
    def facts(self) -> Sequence[Fact]:
        """What happens by itself, in order of time."""

    @property
    def latest_us(self) -> int | None:
        """The time by which the run has ended; None if it may take any time. Units: microseconds."""

    def answer(self, ask: Ask) -> int | None:
        """Return a length in microseconds, or whether a degraded actuator holds (1 or 0), or a verdict.

        None: the answer comes by a command from outside, if at all.
        """


class World(Environment, Protocol):
    """An environment that answers everything at once."""

    def answer(self, ask: Ask) -> int:
        """As `Environment`, and never None."""


class LiveEnvironment:
    """A fleet that is really there: messages arrive at once, and robots and humans answer by commands."""

    def __init__(self, facts: Sequence[Fact] = ()) -> None:
        """Begin with the commands that are known beforehand, as when the run is made again."""
        self.facts = facts
        self.latest_us: int | None = None

    def answer(self, ask: Ask) -> int | None:
        """Return no time for a message; who is asked to help answers later; no answer to anything else."""
        if ask.port == "network":
            return 0
        return ANSWERS_LATER if ask.what == "help" else None
