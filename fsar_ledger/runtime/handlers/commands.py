"""Commands: their actors, and how a reaction schedules one.

A reaction cannot know how long a message takes: it asks at the ports (`ports.py`), and the kernel has the environment
answer. A question is named by what it is about and by what it serves (action, failure, hop), so that every architecture
that meets the same hop of the same action meets the same latency.
"""

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

import msgspec

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import RECOVERY, Operation, Robot, robot_named
from fsar_ledger.projections.execution import Action
from fsar_ledger.projections.fleet import Fleet
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.recovery import Recovery
from fsar_ledger.projections.request import Request
from fsar_ledger.projections.task import Task
from fsar_ledger.runtime.ports import Ask


class Command(msgspec.Struct, kw_only=True, gc=False):
    """A request to decide.

    When it is due, the kernel stamps `now_us` (run time) and, where something is asked, the environment's answer.
    """

    now_us: int = 0
    answer: int = 0


class ActionCommand(Command):
    """A request to decide about one action."""

    action_id: str


class RobotCommand(Command):
    """A request to decide about one robot."""

    robot: Robot


class HelpCommand(ActionCommand):
    """A request to decide about a robot's help with a failed action."""

    helper: Robot


class Scheduled(msgspec.Struct, frozen=True, gc=False):
    """A `command` that is due `after_us` plus the lengths of its waits from now; never at the same instant.

    Its question is asked when it is due.
    """

    command: Command
    after_us: int = 1
    waits: tuple[Ask, ...] = ()
    ask: Ask | None = None


Decide = Callable[[State, Any], tuple[Event, ...]]
React = Callable[[State, Any, int], tuple[Scheduled, ...]]
Actor = Callable[[State, Any], Robot | None]
"""The robot that carries out a command, determined when it is due.

None is an actor that is never off: the world, a service, the coordinator, a human.
"""
_Function = TypeVar("_Function", bound=Callable[..., Any])
_Found = TypeVar("_Found")
_OfAction = TypeVar("_OfAction", bound=ActionCommand)
_Events = TypeVar("_Events", bound=tuple[Event, ...])
Failure = tuple[Action, Recovery]
"""The action that has failed, and its failure that is being recovered."""


class Handlers:
    """The decisions and reactions of one module, which registers them with these decorators.

    Each command has one handler here, and each event one reaction; a second one is a ValueError.
    `decides`: the handler of each command type; `actors`: its actor, for all but public commands; `reacts`:
    the reaction to each event type.
    """

    def __init__(self) -> None:
        self.decides: dict[type[Command], Decide] = {}
        self.actors: dict[type[Command], Actor] = {}
        self.reacts: dict[type[Event], React] = {}

    def decide(self, command: type[Command], actor: Actor | None = None) -> Callable[[_Function], _Function]:
        """Register the decorated function as the handler of this command, which `actor` carries out."""

        def register(function: _Function) -> _Function:
            if command in self.decides:
                raise ValueError(f"{function.__name__}: {command.__name__} has a handler in this module already")
            self.decides[command] = function
            if actor is not None:
                self.actors[command] = actor
            return function

        return register

    def decide_on(
        self, find: Callable[[State, str], _Found | None], command: type[_OfAction], actor: Actor
    ) -> Callable[[Callable[[State, _OfAction, _Found], _Events]], Callable[[State, _OfAction], _Events]]:
        """As `decide`, with the request, action or failure that `find` returns; without one, nothing is decided."""

        def register(function: Callable[[State, _OfAction, _Found], _Events]) -> Callable[[State, _OfAction], _Events]:
            @wraps(function)
            def decide(state: State, command: _OfAction) -> Any:
                item = find(state, command.action_id)
                return () if item is None else function(state, command, item)

            return self.decide(command, actor)(decide)

        return register

    def react(self, *events: type[Event]) -> Callable[[_Function], _Function]:
        """Register the decorated function as the reaction to events of these types."""

        def register(function: _Function) -> _Function:
            for event in events:
                if event in self.reacts:
                    raise ValueError(f"{function.__name__}: {event.__name__} has a reaction in this module already")
            self.reacts.update(dict.fromkeys(events, function))
            return function

        return register


def message(sender: str | None, key: str, hop: int | str) -> Ask:
    """Ask for the latency of one message from the sender to another principal, in service of `key`.

    Paper: sec:evaluation:simulator.
    """
    return Ask("network", "message", f"{key}/{hop}", 1_000_000, sender or "")


def at_once(sender: str | None) -> Ask:
    """Ask for the latency of a message to which the model gives no time."""
    return Ask("network", "message", "", 0, sender or "")


def hop(fleet: Fleet, key: str, ordinal: int | str) -> Ask:
    """Ask for the latency of one internal hop between two agents of a robot."""
    return Ask("network", "message", f"{key}/hop{ordinal}", fleet.structure.hop_ppm)


def hops(fleet: Fleet, key: str, name: str, count: int) -> tuple[Ask, ...]:
    """Ask for the latencies of several internal hops in a row."""
    return tuple(hop(fleet, key, f"{name}{ordinal}") for ordinal in range(count))


def lasts(what: str, key: str) -> Ask:
    """Ask a robot's body how long this takes: a capability, or `approach` or `retry`."""
    return Ask("body", what, key)


def holds(key: str) -> Ask:
    """Ask a robot's body whether a degraded actuator holds."""
    return Ask("body", "reliability", key)


class BeginStep(Command):
    """Begin the task's next step, or the same one after attempt `after` failed.

    An empty `after`: no attempt of this step was made. `step` counts the steps done by then; None: any number.
    """

    task_id: str
    after: str = ""
    step: int | None = None


def begin_again(fleet: Fleet, task_id: str, action_id: str) -> Scheduled:
    """Schedule the step again, after this attempt failed and the back-off has passed."""
    return Scheduled(BeginStep(task_id, action_id), fleet.structure.back_off_us)


class ExpireTask(Command):
    """End the time after which a task is given up."""

    task_id: str


def is_idle(state: State, command: Command) -> bool:
    """Return whether the command will have no effect, however long it waits."""
    return isinstance(command, ExpireTask) and command.task_id not in state.task


class CompleteStep(ActionCommand):
    """Tell the acting robot that the step is done."""


class TakeTurn(ActionCommand):
    """Take the turn of an action that is first in its robot's queue."""


class StartAction(ActionCommand):
    """Start the action at a robot that is where it must be; asks for the duration.

    `was_held`: it was held or has to ask again; nothing if the robot has been sent to it again since.
    """

    was_held: bool = False


class HaltAction(ActionCommand):
    """Halt the action of an executing robot that is off."""


class FinishAttempt(ActionCommand):
    """End the attempt as planned; asks whether a degraded actuator holds (1) or not (0)."""

    ends_us: int


class DetectObstruction(ActionCommand):
    """Stop at something in the way of the executing robot."""


class PauseAction(ActionCommand):
    """Pause for a change in the context of the executing robot."""


class ResumeAction(ActionCommand):
    """Resume with the new plan, or after the failure."""


class CloseExecution(ActionCommand):
    """End authority over an execution that has ended."""


class CloseRequest(ActionCommand):
    """Close the request whose result has come back."""


class Respond(Command):
    """Answer as the supervisor who was called.

    `call` is the number of the call within the run.
    """

    call: int


class EndAttempt(ActionCommand):
    """End an attempt to recover; asks whether a degraded actuator holds (1) or not (0).

    `succeeded` is the robot's own report; None: the world decides.
    """

    number: int
    succeeded: bool | None = None


class EndAssistance(HelpCommand):
    """End the help with this failure; asks whether a degraded actuator of the helper holds (1) or not (0)."""

    failure: int


class StopAssistance(HelpCommand):
    """Stop at something in the way of the robot that helps."""


class DecideRoutine(RobotCommand):
    """Decide about a routine operation that is due."""

    operation: Operation


def nobody(_state: State, _command: Command) -> None:
    """Return None: a world, service, coordinator or human command has no actor that could be off."""


def commanded_robot(_state: State, command: RobotCommand) -> Robot:
    """Return the robot that the command names."""
    return command.robot


def helping(_state: State, command: HelpCommand) -> Robot:
    """Return the robot that helps."""
    return command.helper


def open_request(state: State, action_id: str) -> Request | None:
    """Return the open request for the action, or None."""
    return state.request.open.get(action_id)


def known_action(state: State, action_id: str) -> Action | None:
    """Return the action, if a robot has it."""
    return state.execution.actions.get(action_id)


def open_failure(state: State, action_id: str) -> Failure | None:
    """Return the action and its failure that is being recovered, or None if there is none."""
    action, recovery = state.execution.actions.get(action_id), state.recovery.get(action_id)
    return None if action is None or recovery is None else (action, recovery)


def body(state: State, command: ActionCommand) -> Robot | None:
    """Return the robot that has the action; None if it has left the fleet, as nothing waits for it then."""
    action = state.execution.actions.get(command.action_id)
    return None if action is None else present(state.fleet, action.robot)


def requester(state: State, command: ActionCommand) -> Robot | None:
    """Return the robot whose step it is; None if it has left the fleet, as nothing waits for it then."""
    request = state.request.open.get(command.action_id)
    return None if request is None else present(state.fleet, request.requester)


def present(fleet: Fleet, robot: Robot) -> Robot | None:
    """Return the robot, or None if it has left the fleet: a service then does its part."""
    return None if robot in fleet.departed else robot


def speaker(fleet: Fleet, robot: Robot) -> str:
    """Return the sender for the robot in its recovery: itself, or the recovery service once it has left the fleet."""
    return RECOVERY if robot in fleet.departed else robot


def target(state: State, command: ActionCommand) -> Robot | None:
    """Return the robot picked to execute; for a step of its own, the robot whose step it is."""
    request = state.request.open.get(command.action_id)
    return None if request is None else request.target or request.requester


def asked_robot(state: State, command: ActionCommand) -> Robot | None:
    """Return the robot that the request goes to."""
    request = state.request.open.get(command.action_id)
    return request.candidates[0] if request is not None and request.candidates else None


def relay(state: State, command: ActionCommand) -> Robot | None:
    """Return the peer that passes the request on."""
    request = state.request.open.get(command.action_id)
    return None if request is None else request.relay


def next_in_task(state: State, command: BeginStep) -> Robot | None:
    """Return the robot that acts in the next step of the task, if there is one left."""
    task = state.task.get(command.task_id)
    return None if task is None or task.step == len(task.steps) else present(state.fleet, acting(task, task.step))


def acting(task: Task, step: int) -> Robot:
    """Return the robot that acts in the step, counted from 0."""
    return robot_named(task.steps[step].partition(" ")[0], task.team)
