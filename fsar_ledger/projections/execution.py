"""What each robot executes, and how far each action is.

A robot serves one action at a time, by override level, then in order of arrival. Paper: eq:override.
"""

from collections.abc import Mapping
from typing import Literal, assert_never

import msgspec

from fsar_ledger.events.envelope import ActionId, OverrideLevel, Principal, Robot, Subject, Supervisor, TaskId
from fsar_ledger.events.execution import (
    ApproachStarted,
    ExecutionFailed,
    ExecutionFinished,
    ExecutionHalted,
    ExecutionHeld,
    ExecutionPaused,
    ExecutionPreempted,
    ExecutionQueued,
    ExecutionResumed,
    ExecutionStarted,
    ExecutionWithdrawn,
)
from fsar_ledger.events.recovery import AssistanceAdmitted, AssistanceEnded, AssistanceFailed

from .authority import rank
from .maps import put, without

HANDLES = (
    ExecutionQueued
    | ApproachStarted
    | ExecutionHeld
    | ExecutionStarted
    | ExecutionPaused
    | ExecutionHalted
    | ExecutionPreempted
    | ExecutionResumed
    | ExecutionFailed
    | ExecutionFinished
    | ExecutionWithdrawn
    | AssistanceAdmitted
    | AssistanceEnded
    | AssistanceFailed
)

Stage = Literal[
    "queued", "approaching", "held", "polling", "running", "paused", "halted", "failed", "withdrawn", "preempted"
]
HELPING = "assist:"  # prefix of the action that a robot helps with, in `Execution.current`
INTERRUPTING = rank("hard-preempt")  # from this level up, a request interrupts a weaker one


class Action(msgspec.Struct, frozen=True, gc=False):
    """One action at its robot. Units: `ends_us` run time of the planned end, `remaining_us` execution left.

    `has_begun` says whether a preempted action had begun to execute. `supervised_by` is the supervisor recorded when
    the action was queued, if any.
    """

    task_id: str
    action_id: str
    requested_by: Principal | None
    executed_by: Robot | None
    robot: Robot
    on_behalf_of: Robot
    capability: str
    step: int
    attempt: int
    is_delegated: bool
    has_approach: bool
    is_supervised: bool
    stage: Stage = "queued"
    ends_us: int = 0
    remaining_us: int = 0
    failures: int = 0
    segments: int = 0
    was_denied: bool = False
    override: OverrideLevel = "none"
    preemptions: int = 0
    has_begun: bool = False
    supervised_by: Supervisor | None = None

    @property
    def subject(self) -> Subject[TaskId, ActionId]:
        """Return what an event of this action is about."""
        return Subject(self.task_id, self.action_id)


class Execution(msgspec.Struct, frozen=True, gc=False):
    """The actions, and what occupies robots.

    `current`: robot -> the action or assistance that occupies it; `queues`: robot -> waiting actions; `served`: robot
    -> the actions on its behalf.
    """

    current: Mapping[Robot, str] = {}
    queues: Mapping[Robot, tuple[str, ...]] = {}
    actions: Mapping[str, Action] = {}
    served: Mapping[Robot, tuple[str, ...]] = {}


INITIAL = Execution()


def in_hand(state: Execution, robot: Robot) -> Action | None:
    """Return the action that holds the robot, or None where nothing does or it helps with one."""
    return state.actions.get(state.current.get(robot, ""))


def evolve(state: Execution, event: HANDLES) -> Execution:
    """Return the queues and actions after the event."""
    match event:
        case ExecutionQueued():
            return _queued(state, event)
        case ApproachStarted():
            return _staged(state, event.subject.action_id, "approaching")
        case ExecutionStarted():
            return _staged(state, event.subject.action_id, "running", ends_us=event.ends_us)
        case ExecutionFinished():
            return _freed(_ended(state, event.subject.action_id), event.robot)
        case ExecutionHeld():
            return _held(state, event)
        case ExecutionPaused():
            return _staged(state, event.subject.action_id, "paused", remaining_us=event.remaining_us)
        case ExecutionHalted():
            return _staged(state, event.subject.action_id, "halted", remaining_us=event.remaining_us)
        case ExecutionPreempted():
            return _preempted(state, event)
        case ExecutionResumed():
            return _staged(state, event.subject.action_id, "running", ends_us=event.ends_us)
        case ExecutionFailed():
            return _staged(
                state, event.subject.action_id, "failed", remaining_us=event.remaining_us, failures=event.failure
            )
        case ExecutionWithdrawn():
            withdrawn = _staged(state, event.subject.action_id, "withdrawn")
            if state.current.get(event.robot) == event.subject.action_id:
                return _freed(withdrawn, event.robot)
            queue = tuple(name for name in state.queues.get(event.robot, ()) if name != event.subject.action_id)
            return Execution(
                withdrawn.current, put(state.queues, event.robot, queue), withdrawn.actions, withdrawn.served
            )
        case AssistanceAdmitted():
            return Execution(
                put(state.current, event.helper, HELPING + event.subject.action_id),
                state.queues,
                state.actions,
                state.served,
            )
        case AssistanceEnded() | AssistanceFailed():
            return _freed(state, event.helper)
        case _:
            assert_never(event)


def _queued(state: Execution, event: ExecutionQueued) -> Execution:
    known = state.actions.get(event.subject.action_id)
    action = Action(
        event.subject.task_id,
        event.subject.action_id,
        event.principals.requested_by,
        event.principals.executed_by,
        event.robot,
        event.on_behalf_of,
        event.capability,
        event.step,
        event.attempt,
        event.is_delegated,
        event.has_approach,
        event.is_supervised,
        failures=known.failures if known else 0,
        segments=known.segments if known else 0,
        override=event.override,
        supervised_by=event.principals.supervised_by,
    )
    actions, served = put(state.actions, event.subject.action_id, action), state.served
    if known is None:
        own = served.get(event.on_behalf_of, ())
        served = put(served, event.on_behalf_of, (*own, event.subject.action_id))
    if event.robot in state.current:
        queue = state.queues.get(event.robot, ())
        place = len(queue) if event.override == "none" else _place(state, queue, event.override)
        return Execution(
            state.current,
            put(state.queues, event.robot, (*queue[:place], event.subject.action_id, *queue[place:])),
            actions,
            served,
        )
    return Execution(put(state.current, event.robot, event.subject.action_id), state.queues, actions, served)


def _ended(state: Execution, action_id: str) -> Execution:
    """Forget the action."""
    known = state.actions.get(action_id)
    if known is None:
        return state
    robot = known.on_behalf_of
    left = tuple(name for name in state.served[robot] if name != action_id)
    served = put(state.served, robot, left) if left else without(state.served, robot)
    return Execution(state.current, state.queues, without(state.actions, action_id), served)


def _place(state: Execution, queue: tuple[str, ...], override: OverrideLevel) -> int:
    """Return the position in the queue ahead of all weaker actions.

    Only an interrupting level goes ahead of an action that was itself interrupted. Paper: eq:override.
    """
    for place, name in enumerate(queue):
        waiting = state.actions[name]
        if rank(waiting.override) < rank(override) and (waiting.stage != "preempted" or rank(override) >= INTERRUPTING):
            return place
    return len(queue)


def _preempted(state: Execution, event: ExecutionPreempted) -> Execution:
    """Put the action at the head of the queue and free the robot for the one that preempted it."""
    known = state.actions[event.subject.action_id]
    changed = msgspec.structs.replace(
        known,
        stage="preempted",
        ends_us=0,
        remaining_us=event.remaining_us or 0,
        preemptions=known.preemptions + 1,
        has_begun=event.remaining_us is not None,
    )
    held = state.current.get(event.robot) == event.subject.action_id
    current = without(state.current, event.robot) if held else state.current
    queues = put(state.queues, event.robot, (event.subject.action_id, *state.queues.get(event.robot, ())))
    return Execution(current, queues, put(state.actions, event.subject.action_id, changed), state.served)


def _held(state: Execution, event: ExecutionHeld) -> Execution:
    """Hold the action, which polls the fleet's rule or waits for a window of the robot's own policy to close.

    The event has a `path` when the wait is a denial.
    """
    action = state.actions[event.subject.action_id]
    stage: Stage = "polling" if event.reason == "fleet-rule" else "held"
    changed = msgspec.structs.replace(action, stage=stage, was_denied=action.was_denied or bool(event.principals.path))
    return Execution(state.current, state.queues, put(state.actions, event.subject.action_id, changed), state.served)


def _staged(
    state: Execution, action_id: str, stage: Stage, ends_us: int = 0, remaining_us: int = 0, failures: int | None = None
) -> Execution:
    action = state.actions[action_id]
    changed = msgspec.structs.replace(
        action,
        stage=stage,
        ends_us=ends_us,
        remaining_us=remaining_us,
        failures=action.failures if failures is None else failures,
        segments=action.segments + (stage == "running"),
    )
    return Execution(state.current, state.queues, put(state.actions, action_id, changed), state.served)


def _freed(state: Execution, robot: Robot) -> Execution:
    """Move the robot on to the next action in its queue, if any."""
    queue = state.queues.get(robot, ())
    if queue:
        return Execution(
            put(state.current, robot, queue[0]), put(state.queues, robot, queue[1:]), state.actions, state.served
        )
    return Execution(without(state.current, robot), state.queues, state.actions, state.served)
