"""Commands, and how a reaction schedules one.

A reaction cannot know how long a message takes: it names the draws that the delay consists of, and the
clock asks the world. A draw is named by its stream and by what it serves (action, failure, hop), so that
every architecture that meets the same hop of the same action meets the same latency.
"""

from collections.abc import Callable
from typing import Any

import msgspec

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Operation, Robot
from fsar_ledger.projections.fold import State


class Command(msgspec.Struct, kw_only=True):
    """Something is to be decided. The clock stamps `now_us` (run time) and, where asked, the world's draw, when it is due."""

    now_us: int = 0
    drawn: int = 0


class PublicCommand(Command, kw_only=True):
    """A robot, an operator or a supervisor asks for something from outside; what cannot be done is rejected as an event, and changes nothing."""


class Draw(msgspec.Struct, frozen=True, gc=False):
    """A draw from the world: which law, what it serves, and which share of it counts (parts per million).

    The latency of a message has a `sender`, which must be linked when it sets out, as must be the actor of the command, who receives it, when it is there.
    """

    stream: str
    key: str
    share_ppm: int = 1_000_000
    sender: str | None = None


class Scheduled(msgspec.Struct, frozen=True, gc=False):
    """`command` is due `after_us` plus the drawn lengths of time from now; never at the same instant."""

    command: Command
    after_us: int = 1
    draws: tuple[Draw, ...] = ()
    ask: Draw | None = None


Decide = Callable[[State, Any], tuple[Event, ...]]
React = Callable[[State, Any, int], tuple[Scheduled, ...]]
Decides = dict[type[Command], Decide]
Reacts = dict[type[Event], React]
Actor = Callable[[State, Any], Robot | None]
"""Which robot does a command, as things stand when it is due; None is whoever is never off: the world, a service, the coordinator, a human."""
Actors = dict[type[Command], Actor]


def message(sender: str | None, key: str, hop: int | str) -> Draw:
    """The latency of one message from the sender to another principal, in service of `key`. Paper: sec:evaluation:simulator."""
    return Draw("message", f"{key}/{hop}", 1_000_000, sender or "")


def at_once(sender: str | None) -> Draw:
    """A message to which the model gives no time."""
    return Draw("message", "", 0, sender or "")


def hop(state: State, key: str, ordinal: int | str) -> Draw:
    """The latency of one internal hop between two agents of a robot."""
    return Draw("message", f"{key}/hop{ordinal}", state.fleet.structure.hop_ppm)


def hops(state: State, key: str, name: str, count: int) -> tuple[Draw, ...]:
    """The latencies of several internal hops in a row."""
    return tuple(hop(state, key, f"{name}{ordinal}") for ordinal in range(count))


class BeginStep(Command):
    """Turn to the task's next step, or to the same one again after the attempt `after` has come to nothing ("": no attempt of this step was made)."""

    task_id: str
    after: str = ""


class ExpireTask(Command):
    """The time after which a task is given up is over."""

    task_id: str


class CompleteStep(Command):
    """The acting robot learns that the step is done."""

    action_id: str


class TakeTurn(Command):
    """The action is first in its robot's queue."""

    action_id: str


class StartAction(Command):
    """The robot is where it must be; asks for the duration."""

    action_id: str


class HaltAction(Command):
    """The executing robot is off."""

    action_id: str


class FinishAttempt(Command):
    """The planned end has come; asks whether a degraded actuator holds (1) or not (0)."""

    action_id: str
    ends_us: int


class DetectObstruction(Command):
    """Something is in the way of the executing robot."""

    action_id: str


class PauseAction(Command):
    """The context of the executing robot has changed."""

    action_id: str


class ResumeAction(Command):
    """The new plan is there, or the failure is over."""

    action_id: str


class CloseExecution(Command):
    """Execution has ended; authority over it ends."""

    action_id: str


class CloseRequest(Command):
    """The result has come back."""

    action_id: str


class Respond(Command):
    """The supervisor who was called has made up their mind; `call` is its number within the run."""

    call: int


class EndAttempt(Command):
    """An attempt to recover is over; asks whether a degraded actuator holds (1) or not (0)."""

    action_id: str
    number: int


class EndAssistance(Command):
    """The helper is done with this failure; asks whether a degraded actuator of its own holds (1) or not (0)."""

    action_id: str
    helper: Robot
    failure: int


class StopAssistance(Command):
    """Something is in the way of the robot that helps."""

    action_id: str
    helper: Robot


class DecideRoutine(Command):
    """A routine operation is due."""

    robot: Robot
    operation: Operation
