"""Ports: the interface between a run and whatever the federation does not decide.

A reaction cannot know how long a message, a robot or a human takes, or with what result: it asks at a port, and the
environment of the run answers. The clock is the kernel's own, so fixed delays need no port.

A real robot or human takes its time: the environment returns no answer then, nothing is scheduled, and the answer
arrives as a command from outside (`handlers/public.py`).
"""

from collections.abc import Sequence
from typing import Literal, Protocol, TypeAlias

import msgspec

from fsar_ledger.events import Event

Port = Literal["network", "body", "human", "decision"]
"""What answers: the network, a robot's body, a supervisor, or a robot's own judgement of a request."""

Fact: TypeAlias = tuple[int, Event]
"""A scheduled event of the world: its time (microseconds of run time), and the event."""


AS_USUAL, DISAPPROVES, PREFERS_OTHER = range(3)
"""A supervisor's answers to a call (`verdict`): as the model's supervisors answer (approve the review, keep the fleet's
order of two actions, resolve the failure); reject the review; put the other action first.
"""


ANSWERS_LATER = 3
"""The answer of the port for a robot that answers a request for help itself: it is asked, and admits nothing yet."""
UNKNOWN_US = -1
"""The length of an execution of unknown duration: the robot reports when it has finished."""


class Ask(msgspec.Struct, frozen=True, gc=False):
    """A question at a port: what it is about, what it serves, and the share of the answer that counts, in ppm.

    `what` and `key` name it within the run: a message of an action asks the same question under every architecture.
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
    """What answers at the ports of one run, and the facts that it schedules.

    `facts` are in order of time. A run that is still busy after `latest_us` does not end; None: it may take any time.
    """

    @property
    def facts(self) -> Sequence[Fact]:
        """The scheduled facts, in order of time."""

    @property
    def latest_us(self) -> int | None:
        """The time by which the run has ended; None if it may take any time. Units: microseconds."""

    def answer(self, ask: Ask) -> int | None:
        """Return a length in microseconds, or whether a degraded actuator holds (1 or 0), or a verdict.

        None: the answer comes as a command from outside, if at all.
        """


class World(Environment, Protocol):
    """An environment that answers everything at once."""

    def answer(self, ask: Ask) -> int:
        """As `Environment`, and never None."""


class LiveEnvironment:
    """The environment of a real fleet: messages arrive at once, and robots and humans answer by commands."""

    def __init__(self, facts: Sequence[Fact] = ()) -> None:
        """Begin with commands that are known beforehand, as when a run is rebuilt."""
        self.facts = facts
        self.latest_us: int | None = None

    def answer(self, ask: Ask) -> int | None:
        """Return 0 for a message, `ANSWERS_LATER` to a request for help, and None to anything else."""
        if ask.port == "network":
            return 0
        return ANSWERS_LATER if ask.what == "help" else None
