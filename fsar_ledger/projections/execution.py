"""What each robot executes, and how far each action is.

A robot serves one action at a time, by override level, then in order of arrival. Paper: eq:override.
"""

from collections.abc import Mapping
from typing import Literal, assert_never

import msgspec

from fsar_ledger.events.envelope import ActionId, OverrideLevel, Parties, Principal, Robot, Subject, Supervisor, TaskId
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

from . import put, without
from .authority import rank

AtRobot = (
    ApproachStarted
    | ExecutionHeld
    | ExecutionStarted
    | ExecutionPaused
    | ExecutionHalted
    | ExecutionPreempted
    | ExecutionResumed
    | ExecutionFailed
)
"""The events of an action at its robot."""

HANDLES = (
    ExecutionQueued
    | AtRobot
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

    Both are None if unknown, as for a robot that reports when it has finished, and 0 while there is none.

    `has_begun` says whether a preempted action had begun to execute. `supervised_by` is the supervisor recorded when
    the action was queued, if any. `capability` is empty where no event on record names it.
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
    ends_us: int | None = 0
    remaining_us: int | None = 0
    failures: int = 0
    segments: int = 0
    was_denied: bool = False
    override: OverrideLevel = "none"
    preemptions: int = 0
    has_begun: bool = False
    supervised_by: Supervisor | None = None

    @property
    def subject(self) -> Subject[TaskId, ActionId]:
        """Return the subject of the action's events."""
        return Subject(self.task_id, self.action_id)


class Execution(msgspec.Struct, frozen=True, gc=False):
    """The actions, and what occupies robots.

    `current`: robot -> the action or assistance that occupies it; `queues`: robot -> waiting actions, and those beside
    which another system began something else; `served`: robot -> the actions on its behalf.
    """

    current: Mapping[Robot, str] = {}
    queues: Mapping[Robot, tuple[str, ...]] = {}
    actions: Mapping[str, Action] = {}
    served: Mapping[Robot, tuple[str, ...]] = {}


INITIAL = Execution()


def left_us(action: Action, now_us: int) -> int | None:
    """Return how much of a running execution is left, None if unknown. Units: microseconds."""
    return None if action.ends_us is None else max(0, action.ends_us - now_us)


def in_hand(state: Execution, robot: Robot) -> Action | None:
    """Return the action that holds the robot, or None where nothing does or it helps with one."""
    return state.actions.get(state.current.get(robot, ""))


def doing_and_waiting(state: Execution, robot: Robot) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return what the robot has in hand, the newest first, and what waits for it.

    Our robots do one thing at a time. Another system's record may show that the next action began, but not that the
    one before was interrupted: then the robot does both.
    """
    doing: list[str] = []
    waiting: list[str] = []
    for name in state.queues.get(robot, ()):
        action = state.actions.get(name)
        is_active = name.startswith(HELPING) or (action is not None and action.stage in ("approaching", "running"))
        (doing if is_active else waiting).append(name)
    current = state.current.get(robot)
    return (*(() if current is None else (current,)), *doing), tuple(waiting)


def evolve(state: Execution, event: HANDLES) -> Execution:
    """Return the queues and actions after the event."""
    match event:
        case ExecutionQueued():
            return _queued(state, event)
        case ApproachStarted():
            return _staged(state, event, "approaching")
        case ExecutionStarted():
            return _staged(state, event, "running", ends_us=event.ends_us)
        case ExecutionFinished():
            known = state.actions.get(event.subject.action_id)
            is_there = known is None or known.robot == event.robot
            return forget_action(state, event.subject.action_id) if is_there else state
        case ExecutionHeld():
            return _hold_action(state, event)
        case ExecutionPaused():
            return _staged(state, event, "paused", remaining_us=event.remaining_us)
        case ExecutionHalted():
            return _staged(state, event, "halted", remaining_us=event.remaining_us)
        case ExecutionPreempted():
            return _preempted(state, event)
        case ExecutionResumed():
            return _staged(state, event, "running", ends_us=event.ends_us)
        case ExecutionFailed():
            return _staged(state, event, "failed", remaining_us=event.remaining_us, failures=event.failure)
        case ExecutionWithdrawn():
            return _withdrawn(state, event)
        case AssistanceAdmitted():
            assistance = HELPING + event.subject.action_id
            free = _set_aside(_helps_no_more(state, event.helper, assistance), event.helper)
            current = put(free.current, event.helper, assistance)
            return Execution(current, free.queues, free.actions, free.served)
        case AssistanceEnded() | AssistanceFailed():
            return _helps_no_more(state, event.helper, HELPING + event.subject.action_id)
        case _:
            assert_never(event)


def _queued(state: Execution, event: ExecutionQueued) -> Execution:
    previous = state.actions.get(event.subject.action_id)
    if previous is not None and (previous.stage != "withdrawn" or previous.on_behalf_of != event.on_behalf_of):
        state = forget_action(state, previous.action_id)  # another system's record, which does not show its withdrawal
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
        failures=previous.failures if previous else 0,
        segments=previous.segments if previous else 0,
        override=event.override,
        supervised_by=event.principals.supervised_by,
    )
    actions, served = put(state.actions, event.subject.action_id, action), state.served
    names = served.get(event.on_behalf_of, ())
    if event.subject.action_id not in names:
        served = put(served, event.on_behalf_of, (*names, event.subject.action_id))
    if event.robot in state.current:
        queue = state.queues.get(event.robot, ())
        index = len(queue) if event.override == "none" else _queue_position(state, queue, event.override)
        return Execution(
            state.current,
            put(state.queues, event.robot, (*queue[:index], event.subject.action_id, *queue[index:])),
            actions,
            served,
        )
    return Execution(put(state.current, event.robot, event.subject.action_id), state.queues, actions, served)


def forget_action(state: Execution, action_id: str) -> Execution:
    """Forget the action, which no longer occupies its robot."""
    action = state.actions.get(action_id)
    if action is None:
        return state
    robot = action.on_behalf_of
    left = tuple(name for name in state.served[robot] if name != action_id)
    served = put(state.served, robot, left) if left else without(state.served, robot)
    actions = without(state.actions, action_id)
    return _release_robot(Execution(state.current, state.queues, actions, served), action.robot, action_id)


def _withdrawn(state: Execution, event: ExecutionWithdrawn) -> Execution:
    """Take the action from the robot, unless it is at another one by now."""
    action_id = event.subject.action_id
    action = state.actions.get(action_id)
    if action is None or action.robot != event.robot:
        return state
    changed = msgspec.structs.replace(action, stage="withdrawn", ends_us=0, remaining_us=0)
    actions = put(state.actions, action_id, changed)
    return _release_robot(Execution(state.current, state.queues, actions, state.served), event.robot, action_id)


def _release_robot(state: Execution, robot: Robot, action_id: str) -> Execution:
    """Free the robot of the action, or take the action out of its queue."""
    if state.current.get(robot) == action_id:
        return _freed(state, robot)
    queue = tuple(name for name in state.queues.get(robot, ()) if name != action_id)
    return Execution(state.current, put(state.queues, robot, queue), state.actions, state.served)


def _helps_no_more(state: Execution, robot: Robot, assistance: str) -> Execution:
    is_helping = assistance in (state.current.get(robot), *state.queues.get(robot, ()))
    return _release_robot(state, robot, assistance) if is_helping else state


def _set_aside(state: Execution, robot: Robot) -> Execution:
    """Move the action or the help that the robot has in hand, if any, to the head of its queue."""
    if robot not in state.current:
        return state
    current, queue = state.current[robot], state.queues.get(robot, ())
    is_kept = current in state.actions or current.startswith(HELPING)
    queues = put(state.queues, robot, (current, *queue)) if is_kept else state.queues
    return Execution(without(state.current, robot), queues, state.actions, state.served)


def _at_robot(state: Execution, event: AtRobot) -> tuple[Execution, Action]:
    """Return the action, which is at the robot of the event.

    Another system's record may not show that it came there: then it does now.
    """
    action = state.actions.get(event.subject.action_id)
    if action is None or action.robot != event.robot or action.stage == "withdrawn":
        # See docs/decisions/state-accepts-any-history.md.
        state = _queued(_set_aside(state, event.robot), _coming(event, action))
        action = state.actions[event.subject.action_id]
    return state, action


def _coming(event: AtRobot, action: Action | None) -> ExecutionQueued:
    """Return the event that was not recorded, with what is on record of the action."""
    parties: Parties | Action | None = action
    # If the record does not say whose step it is, it counts as the step of the robot that does it.
    owner, capability = event.robot, action.capability if action else ""
    if action is not None and action.on_behalf_of != action.robot:
        owner = action.on_behalf_of
    if isinstance(event, ExecutionStarted):
        parties, owner, capability = event.principals, event.on_behalf_of or owner, event.capability
    return ExecutionQueued(
        subject=event.subject,
        principals=Parties(
            requested_by=parties.requested_by if parties else None,
            executed_by=parties.executed_by if parties else None,
            supervised_by=parties.supervised_by if parties else None,
        ),
        robot=event.robot,
        on_behalf_of=owner,
        capability=capability,
        step=action.step if action else 0,
        attempt=action.attempt if action else 0,
        is_delegated=owner != event.robot,
        has_approach=isinstance(event, ApproachStarted),
        is_supervised=parties is not None and parties.supervised_by is not None,
    )


def _queue_position(state: Execution, queue: tuple[str, ...], override: OverrideLevel) -> int:
    """Return the position in the queue ahead of all weaker actions.

    Only an interrupting level goes ahead of an action that was itself interrupted. Paper: eq:override.
    """
    for index, name in enumerate(queue):
        waiting = state.actions.get(name)
        if waiting is None:  # a help that another system set aside
            continue
        if rank(waiting.override) < rank(override) and (waiting.stage != "preempted" or rank(override) >= INTERRUPTING):
            return index
    return len(queue)


def _preempted(state: Execution, event: ExecutionPreempted) -> Execution:
    """Put the action at the head of the queue and free the robot for the one that preempted it."""
    state, action = _at_robot(state, event)
    action_id = event.subject.action_id
    changed = msgspec.structs.replace(
        action,
        stage="preempted",
        ends_us=0,
        remaining_us=event.remaining_us,
        preemptions=action.preemptions + 1,
        has_begun=event.remaining_us is not None or action.stage in ("running", "paused"),
    )
    is_current = state.current.get(event.robot) == action_id
    current = without(state.current, event.robot) if is_current else state.current
    others = tuple(name for name in state.queues.get(event.robot, ()) if name != action_id)
    queues = put(state.queues, event.robot, (action_id, *others))
    return Execution(current, queues, put(state.actions, action_id, changed), state.served)


def _hold_action(state: Execution, event: ExecutionHeld) -> Execution:
    """Hold the action, which polls the fleet's rule or waits for a window of the robot's own policy to close.

    The event has a `path` when the wait is a denial.
    """
    state, action = _at_robot(state, event)
    stage: Stage = "polling" if event.reason == "fleet-rule" else "held"
    changed = msgspec.structs.replace(action, stage=stage, was_denied=action.was_denied or bool(event.principals.path))
    return Execution(state.current, state.queues, put(state.actions, event.subject.action_id, changed), state.served)


def _staged(
    state: Execution,
    event: AtRobot,
    stage: Stage,
    ends_us: int | None = 0,
    remaining_us: int | None = 0,
    failures: int | None = None,
) -> Execution:
    state, action = _at_robot(state, event)
    changed = msgspec.structs.replace(
        action,
        stage=stage,
        ends_us=ends_us,
        remaining_us=remaining_us,
        failures=action.failures if failures is None else failures,
        segments=action.segments + (stage == "running"),
    )
    return Execution(state.current, state.queues, put(state.actions, action.action_id, changed), state.served)


def _freed(state: Execution, robot: Robot) -> Execution:
    """Move the robot on to the next action in its queue, if any."""
    queue = state.queues.get(robot, ())
    if queue:
        return Execution(
            put(state.current, robot, queue[0]), put(state.queues, robot, queue[1:]), state.actions, state.served
        )
    return Execution(without(state.current, robot), state.queues, state.actions, state.served)
