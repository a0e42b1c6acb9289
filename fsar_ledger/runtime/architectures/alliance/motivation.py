"""ALLIANCE: what a robot senses and hears, and how its motivation to do an action grows.

m = (m + impatience) * not acquiescent * not suppressed * not reset * applicable (motivational_behaviour.cpp, getLevel).
Here m counts microseconds of growth at the fast rate, so that a robot's threshold is `impatience_us`. It grows from
zero: since the robot was told of the need, is free again (activity suppression), its policy allows again (sensory
feedback), or it first heard a teammate (impatience reset, once for each). The reset acts on what grows: a robot that is
active leaves by acquiescence alone, else its delays would mean nothing (our reading).

How a need is sensed is open: the robot whose step it is tells each capable robot of the fleet, one message each.
"""

from collections.abc import Iterator

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Parties, Robot
from fsar_ledger.events.execution import ExecutionFinished, ExecutionWithdrawn
from fsar_ledger.events.knowledge import ActivityHeard, MotivationBegan
from fsar_ledger.events.request import GapDetected
from fsar_ledger.events.task import StepBegan
from fsar_ledger.events.world import OutsiderRequestInjected, PolicyWindowClosed
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.motivation import Heard, Motivation, action_of, motivation_of
from fsar_ledger.projections.request import Request
from fsar_ledger.runtime.handlers.attribution import capable, is_idle
from fsar_ledger.runtime.handlers.commands import (
    ActionCommand,
    Handlers,
    RobotCommand,
    Scheduled,
    commanded_robot,
    message,
    open_request,
    requester,
)
from fsar_ledger.runtime.handlers.policy import own_policy

NOBODY = Parties(requested_by=None, executed_by=None, supervised_by=None)

HANDLERS = Handlers()


class NoticeNeed(ActionCommand):
    """Notice that the step is to be done."""


class NeedCommand(RobotCommand):
    """A request to decide what one robot does about one action."""

    action_id: str


class SenseNeed(NeedCommand):
    """Deliver the message about the need to the robot."""


class HearActivity(NeedCommand):
    """Deliver a teammate's broadcast to the robot."""

    peer: Robot


class GrowAgain(NeedCommand):
    """Let the motivation grow from zero, since what kept it there is over."""


class TakeUp(NeedCommand):
    """Become active on the action, if the motivation has reached the threshold."""


def teammates(state: State, request: Request, but: Robot | None = None) -> tuple[Robot, ...]:
    """Return the other robots that have a behaviour set for the step; a robot's own step is its own alone."""
    if not request.is_delegated:
        return ()
    able = capable(state.fleet, state.registry, request.capability, request.requester)
    return tuple(robot for robot in able if robot != but)


def wanted(state: State, action_id: str, now_us: int) -> Request | None:
    """Return the action's request while it still needs doing, which its robot can see.

    An outsider's need, which belongs to no open task, is pursued as long as periodic exchanges go on.
    """
    request = state.request.open.get(action_id)
    if request is None:
        return None
    is_due = now_us <= state.fleet.structure.watch_us or bool(state.task)
    return request if request.task_id in state.task or (request.step == 0 and is_due) else None


def is_applicable(state: State, robot: Robot, request: Request) -> bool:
    """Return whether the robot's sensory feedback lets it act: its own policy, sensed only with the dial."""
    if not state.fleet.alliance.senses_policy:
        return True
    return own_policy(state.policy, state.world, robot, request.capability, request.task_id) == "allow"


def patience_us(state: State, robot: Robot, peer: Robot, capability: str) -> int:
    """Return how long the robot lets this peer slow its motivation. Units: microseconds.

    L-ALLIANCE (dial `learns`): the mean plus the standard deviation of the times it has seen the peer take; the dial's
    patience until it has seen one.
    """
    dials, times_us = state.fleet.alliance, state.motivation.times_us.get((robot, peer, capability), ())
    if not dials.learns or not times_us:
        return dials.patience_us
    mean_us = sum(times_us) // len(times_us)
    return mean_us + _root(sum((time_us - mean_us) ** 2 for time_us in times_us) // len(times_us))


def _root(square: int) -> int:
    """Return the integer part of the square root."""
    root = square
    while root * root > square:
        root = (root + square // root) // 2
    return root


def slowed_until_us(heard: Heard, silence_us: int) -> int:
    """Return when the peer stops slowing the motivation: it falls silent, or it has taken too long (impatience.cpp)."""
    return min(heard.last_us + silence_us, heard.first_us + heard.patience_us)


def _phases(motivation: Motivation, from_us: int, impatience_us: int, silence_us: int) -> Iterator[tuple[int, int]]:
    """Yield the ends of the phases of slow growth, and how long growth to the threshold takes at each one's rate.

    The slowest rate counts (impatience.cpp, getLevel); no rate is faster than the fast one (setSlowRate).
    """
    slow = sorted((slowed_until_us(heard, silence_us), heard.patience_us) for heard in motivation.heard.values())
    for index, (until_us, _) in enumerate(slow):
        if until_us > from_us:
            yield until_us, max(impatience_us, *(patience for _, patience in slow[index:]))


def impatience_us(state: State, robot: Robot) -> int:
    """Return how long the robot's motivation takes to the threshold at its fast rate. Units: microseconds."""
    dials = state.fleet.alliance
    return dials.impatience_us + dials.stagger_us * (state.fleet.robots[robot].team - 1)


def level_us(known: Motivation, now_us: int, impatience_us: int, silence_us: int) -> int:
    """Return the motivation now. Units: microseconds of growth at the fast rate; `impatience_us` is the threshold."""
    if known.as_of_us is None:
        return 0
    level, at_us = known.level_us, known.as_of_us
    for until_us, patience in _phases(known, at_us, impatience_us, silence_us):
        end_us = min(until_us, now_us)
        level, at_us = level + (end_us - at_us) * impatience_us // max(1, patience), end_us
    return level + now_us - at_us


def ripe_us(known: Motivation, impatience_us: int, silence_us: int) -> int:
    """Return when the motivation reaches the threshold, if nothing more is heard. Units: run time."""
    assert known.as_of_us is not None
    level, at_us = known.level_us, known.as_of_us
    for until_us, patience in _phases(known, at_us, impatience_us, silence_us):
        left_us = -(-(impatience_us - level) * patience // max(1, impatience_us))
        if at_us + left_us <= until_us:
            return at_us + left_us
        level, at_us = level + (until_us - at_us) * impatience_us // max(1, patience), until_us
    return at_us + max(0, impatience_us - level)


@HANDLERS.decide_on(open_request, NoticeNeed, requester)
def notice_need(_state: State, command: NoticeNeed, request: Request) -> tuple[Event, ...]:
    """Begin motivation for a step of the robot's own; record another robot's step as a gap that names no robot."""
    if request.is_delegated:
        return (GapDetected(request.subject, NOBODY, request.capability),)
    return (MotivationBegan(request.subject, request.requester, command.now_us),)


@HANDLERS.decide(SenseNeed, commanded_robot)
def sense_need(state: State, command: SenseNeed) -> tuple[Event, ...]:
    """Start the motivation's growth."""
    request = wanted(state, command.action_id, command.now_us)
    return () if request is None else (MotivationBegan(request.subject, command.robot, command.now_us),)


@HANDLERS.decide(GrowAgain, commanded_robot)
def grow_again(state: State, command: GrowAgain) -> tuple[Event, ...]:
    """Let the motivation grow from zero, if the robot knows of the need, is free, and its sensors allow."""
    request, robot = wanted(state, command.action_id, command.now_us), command.robot
    motivation = motivation_of(state.motivation, command.action_id, robot)
    if request is None or motivation is None or motivation.as_of_us is None:
        return ()
    if not is_idle(state.execution, robot) or not is_applicable(state, robot, request):
        return ()
    return (MotivationBegan(request.subject, robot, command.now_us),)


@HANDLERS.decide(HearActivity, commanded_robot)
def hear_activity(state: State, command: HearActivity) -> tuple[Event, ...]:
    """Record what was heard: the first broadcast of a teammate sets the motivation to zero (impatience_reset.cpp)."""
    request, robot, dials = wanted(state, command.action_id, command.now_us), command.robot, state.fleet.alliance
    if request is None:
        return ()
    motivation = motivation_of(state.motivation, command.action_id, robot) or Motivation()
    active = state.motivation.active.get(robot)
    is_suppressed = active is not None and active.action_id != command.action_id
    is_zero = is_suppressed or command.peer not in motivation.heard or not is_applicable(state, robot, request)
    return (
        ActivityHeard(
            subject=request.subject,
            robot=robot,
            peer=command.peer,
            as_of_us=command.now_us,
            level_us=0
            if is_zero
            else level_us(motivation, command.now_us, impatience_us(state, robot), dials.silence_us),
            patience_us=patience_us(state, robot, command.peer, request.capability),
        ),
    )


def take_up_when_ripe(state: State, action_id: str, robot: Robot, now_us: int) -> tuple[Scheduled, ...]:
    """Schedule the instant at which the motivation will reach the threshold; whatever is heard before then moves it."""
    motivation = motivation_of(state.motivation, action_id, robot)
    if motivation is None or motivation.as_of_us is None or not is_idle(state.execution, robot):
        return ()
    due_us = ripe_us(motivation, impatience_us(state, robot), state.fleet.alliance.silence_us)
    return (Scheduled(TakeUp(robot, action_id), max(1, due_us - now_us)),)


def _known_to(state: State, robot: Robot) -> tuple[str, ...]:
    """Return the actions that the robot knows of, in the order in which any robot first knew of them."""
    return tuple(action_id for action_id, robots in state.motivation.of.items() if robot in robots)


@HANDLERS.react(StepBegan)
def _on_step(_state: State, event: StepBegan, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(NoticeNeed(event.subject.action_id)),)


@HANDLERS.react(OutsiderRequestInjected)
def _on_outsider(_state: State, event: OutsiderRequestInjected, _now_us: int) -> tuple[Scheduled, ...]:
    """Treat an outsider's need as a need: nothing here checks whose it is."""
    return (Scheduled(NoticeNeed(event.task_id)),)


@HANDLERS.react(GapDetected)
def _on_gap(state: State, event: GapDetected, _now_us: int) -> tuple[Scheduled, ...]:
    action_id = event.subject.action_id or ""
    request = state.request.open[action_id]
    return tuple(
        Scheduled(SenseNeed(robot, action_id), 0, (message(request.requester, action_id, f"need/{robot}"),))
        for robot in teammates(state, request)
    )


@HANDLERS.react(MotivationBegan, ActivityHeard)
def _on_motivation(state: State, event: MotivationBegan | ActivityHeard, now_us: int) -> tuple[Scheduled, ...]:
    return take_up_when_ripe(state, event.subject.action_id, event.robot, now_us)


@HANDLERS.react(ExecutionFinished, ExecutionWithdrawn)
def _on_free(state: State, event: ExecutionFinished | ExecutionWithdrawn, _now_us: int) -> tuple[Scheduled, ...]:
    """End the suppression of all other motivations, and last that of an action that the robot has left.

    That order among equals is our choice: acquiescence makes room for something else.
    """
    ended = action_of(event.subject.action_id)
    action_ids = _known_to(state, event.robot)
    left = (ended,) if ended in action_ids and isinstance(event, ExecutionWithdrawn) else ()
    others = (action_id for action_id in action_ids if action_id != ended)
    return tuple(Scheduled(GrowAgain(event.robot, action_id)) for action_id in (*others, *left))


@HANDLERS.react(PolicyWindowClosed)
def _on_window_closed(state: State, event: PolicyWindowClosed, _now_us: int) -> tuple[Scheduled, ...]:
    if event.scope != "local" or not state.fleet.alliance.senses_policy:
        return ()
    return tuple(Scheduled(GrowAgain(event.robot, action_id)) for action_id in _known_to(state, event.robot))
