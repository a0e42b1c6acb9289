"""ALLIANCE: a robot becomes active on an action, broadcasts it, and leaves it by acquiescence or when it is done.

It claims execution while active. Two robots active on the same action hold two claims to it, and nothing decides
between them. Each executes it under its own name (`projections.motivation`), and the first to finish completes the
step; the other's motion is wasted, and ends when it hears of that. What this leaves out: the work of both does not add
up, and neither is in the other's way.
"""

import msgspec

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import Parties, RequestSubject, Robot, Subject
from fsar_ledger.events.execution import ExecutionFinished, ExecutionQueued, ExecutionWithdrawn, OwnStepDecided
from fsar_ledger.events.knowledge import ActivityBroadcast, ActivityHeard, NeedEnded
from fsar_ledger.events.recovery import FailureResolved
from fsar_ledger.events.request import RequestAccepted
from fsar_ledger.events.world import PolicyWindowOpened
from fsar_ledger.projections.execution import Action
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.motivation import action_of, execution_name, motivation_of, task_of
from fsar_ledger.projections.request import Request
from fsar_ledger.runtime.handlers.attribution import is_idle
from fsar_ledger.runtime.handlers.authority import released
from fsar_ledger.runtime.handlers.commands import CompleteStep, Handlers, Scheduled, commanded_robot, message
from fsar_ledger.runtime.handlers.execution import queued
from fsar_ledger.runtime.handlers.recovery import escalated

from .motivation import HearActivity, NeedCommand, TakeUp, impatience_us, is_applicable, level_us, teammates, wanted

REASON = "motivation"

HANDLERS = Handlers()


class Broadcast(NeedCommand):
    """Broadcast again that the robot is active."""

    since_us: int


class Acquiesce(NeedCommand):
    """Leave the action, if there is reason to."""

    since_us: int


class EndActivity(NeedCommand):
    """End the claim of a robot that stopped executing; `execution_id` is the execution it finished, empty if none."""

    execution_id: str = ""
    capability: str = ""


class HearDone(NeedCommand):
    """Deliver the message that the peer has done the action."""

    peer: Robot
    capability: str


def by_robot(robot: Robot) -> Parties:
    """Return the parties on record: the robot that acts, without a requester or a known supervisor."""
    return Parties(requested_by=None, executed_by=robot, supervised_by=None)


def in_hand_of(state: State, robot: Robot, action_id: str) -> Action | None:
    """Return the robot's own execution of the action, if it is active on it."""
    active = state.motivation.active.get(robot)
    if active is None or active.action_id != action_id:
        return None
    return state.execution.actions.get(execution_name(state.execution, action_id, robot))


@HANDLERS.decide(TakeUp, commanded_robot)
def take_up(state: State, command: TakeUp) -> tuple[Event, ...]:
    """Become active at the threshold, unless suppressed by another activity or not applicable.

    If a teammate, or the robot itself, gave the action up after a failure, this takes over what was left.
    """
    robot, action_id, dials = command.robot, command.action_id, state.fleet.alliance
    request, motivation = wanted(state, action_id, command.now_us), motivation_of(state.motivation, action_id, robot)
    if request is None or motivation is None or motivation.as_of_us is None:
        return ()
    if not is_idle(state.execution, robot) or not is_applicable(state, robot, request):
        return ()
    threshold_us = impatience_us(state, robot)
    if level_us(motivation, command.now_us, threshold_us, dials.silence_us) < threshold_us:
        return ()  # a teammate was heard meanwhile
    name = execution_name(state.execution, action_id, robot)
    principals = by_robot(robot).decided(robot)
    decided: Event = (
        RequestAccepted(RequestSubject(request.task_id, name, None), principals)
        if request.is_delegated
        else OwnStepDecided(request.subject, principals, request.capability)
    )
    return (
        decided,
        AuthorityClaimed(subject=request.subject, dimension="execution", claimant=robot, reason=REASON),
        ActivityBroadcast(request.subject, robot, command.now_us),
        *_taken_over(state, action_id, robot),
        _queued(state, request, robot, name),
    )


def _queued(state: State, request: Request, robot: Robot, name: str) -> ExecutionQueued:
    """Return the event that queues the step at the robot, without an approach if the robot is still there.

    That a robot that left the step and went nowhere else needs no approach is our choice: otherwise a step that takes
    longer than the give-up delay would never end.
    """
    is_there = state.motivation.at.get(robot) == request.action_id
    return msgspec.structs.replace(
        queued(request, by_robot(robot), robot, is_supervised=False),
        subject=Subject(request.task_id, name),
        has_approach=request.is_delegated and request.step > 0 and not is_there,
    )


def _taken_over(state: State, action_id: str, robot: Robot) -> tuple[FailureResolved, ...]:
    """Return the resolution of each failure after which another robot, or this one itself, gave the action up."""
    return tuple(
        FailureResolved(Subject(task_of(action_id), name), recovery.robot, recovery.failure, recovery.level)
        for name, recovery in state.recovery.items()
        if action_of(name) == action_id
        and (recovery.level == "peer" or recovery.robot == robot)
        and (execution := state.execution.actions.get(name)) is not None
        and execution.stage == "withdrawn"
    )


@HANDLERS.decide(Broadcast, commanded_robot)
def broadcast(state: State, command: Broadcast) -> tuple[Event, ...]:
    """Broadcast the activity while it lasts."""
    active, action_id = state.motivation.active.get(command.robot), command.action_id
    if active is None or (active.action_id, active.since_us) != (action_id, command.since_us):
        return ()
    return (ActivityBroadcast(Subject(task_of(action_id), action_id), command.robot, active.since_us),)


@HANDLERS.decide(Acquiesce, commanded_robot)
def acquiesce(state: State, command: Acquiesce) -> tuple[Event, ...]:
    """Leave the action: yield to a teammate that broadcasts, give up, or stop because its sensors no longer allow it.

    Active for more than the yielding delay while another broadcasts, or for more than the giving-up delay
    (acquiescence.cpp). Once it executes, a window of its own policy does not stop a robot: it replans, as under every
    architecture (our choice).
    """
    robot, action_id, dials = command.robot, command.action_id, state.fleet.alliance
    active, action = state.motivation.active.get(robot), in_hand_of(state, robot, action_id)
    if active is None or action is None or active.since_us != command.since_us:
        return ()
    elapsed_us, motivation = command.now_us - active.since_us, motivation_of(state.motivation, action_id, robot)
    heard = () if motivation is None else motivation.heard.values()
    is_heard = any(entry.last_us >= command.now_us - dials.silence_us for entry in heard)
    request = state.request.open.get(action_id)
    has_begun = action.stage not in ("queued", "approaching")
    if elapsed_us > dials.yield_us and is_heard:
        # That teammate may have left as well; then the failure is not over until another robot takes the action up.
        others = (activity for other, activity in state.motivation.active.items() if other != robot)
        return leave_action(state, action, is_taken=any(activity.action_id == action_id for activity in others))
    if elapsed_us > dials.give_up_us:
        return leave_action(state, action, is_taken=False)
    if not has_begun and request is not None and not is_applicable(state, robot, request):
        return leave_action(state, action, is_taken=False)
    return ()


def leave_action(state: State, action: Action, *, is_taken: bool) -> tuple[Event, ...]:
    """Return the events of leaving the action; `is_taken`: a teammate is active on it, so its failure is over."""
    robot, recovery, records = action.robot, state.recovery.get(action.action_id), list[Event]()
    if recovery is not None and recovery.level == "local" and action.is_delegated:
        records.append(escalated(action, recovery, by_robot(robot).decided(robot), "peer", "acquiescence"))
    claims = state.authority.claims.get(action_of(action.action_id), ())
    records += released(claim for claim in claims if claim.claimant == robot)
    records.append(ExecutionWithdrawn(action.subject, robot))
    if recovery is not None and is_taken:
        records.append(FailureResolved(action.subject, robot, recovery.failure, "peer"))
    return tuple(records)


@HANDLERS.decide(EndActivity, commanded_robot)
def end_activity(state: State, command: EndActivity) -> tuple[Event, ...]:
    """End the robot's claim. A finished action is no longer needed, and a failure it recovered from by itself ends."""
    robot, action_id = command.robot, command.action_id
    releases = released(claim for claim in state.authority.claims.get(action_id, ()) if claim.claimant == robot)
    if not command.execution_id:
        return releases
    subject, recovery = Subject(task_of(action_id), command.execution_id), state.recovery.get(command.execution_id)
    resolved = () if recovery is None else (FailureResolved(subject, robot, recovery.failure, "local"),)
    return (*releases, *resolved, *_need_ended(state, command, robot))


@HANDLERS.decide(HearDone, commanded_robot)
def hear_done(state: State, command: HearDone) -> tuple[Event, ...]:
    """Stop the robot's work on the action, and forget the need."""
    action = in_hand_of(state, command.robot, command.action_id)
    stopped = () if action is None else leave_action(state, action, is_taken=True)
    return (*stopped, *_need_ended(state, command, command.peer))


def _need_ended(state: State, command: EndActivity | HearDone, peer: Robot) -> tuple[NeedEnded, ...]:
    """Return the end of the need for the robot, if it knew of the need or of a teammate's activity."""
    motivation = motivation_of(state.motivation, command.action_id, command.robot)
    if motivation is None:
        return ()
    heard = motivation.heard.get(peer)
    return (
        NeedEnded(
            subject=Subject(task_of(command.action_id), command.action_id),
            robot=command.robot,
            peer=peer,
            capability=command.capability,
            took_us=None if heard is None else command.now_us - heard.first_us,
        ),
    )


@HANDLERS.react(ActivityBroadcast)
def _on_broadcast(state: State, event: ActivityBroadcast, _now_us: int) -> tuple[Scheduled, ...]:
    """Send it to every robot with such a behaviour set, and schedule the next broadcast.

    The first is sent at activation (our choice: the timer of the sources runs on its own). Without a period, no others.
    """
    action_id, robot, dials = event.subject.action_id, event.robot, state.fleet.alliance
    request, active = state.request.open.get(action_id), state.motivation.active[robot]
    hop = f"active/{state.motivation.spells[action_id]}.{active.broadcasts}"
    deliveries = tuple(
        Scheduled(HearActivity(peer, action_id, robot), 0, (message(robot, action_id, f"{hop}/{robot}/{peer}"),))
        for peer in (() if request is None else teammates(state, request, robot))
    )
    repeat = (Scheduled(Broadcast(robot, action_id, event.since_us), dials.broadcast_us),) if dials.broadcast_us else ()
    if active.broadcasts > 1:
        return (*deliveries, *repeat)
    delays_us = (dials.yield_us, dials.give_up_us)
    checks = (Scheduled(Acquiesce(robot, action_id, event.since_us), delay_us + 1) for delay_us in delays_us)
    return (*deliveries, *repeat, *checks)


@HANDLERS.react(ActivityHeard)
def _on_heard(state: State, event: ActivityHeard, now_us: int) -> tuple[Scheduled, ...]:
    """Let an active robot past its yielding delay consider yielding."""
    active = state.motivation.active.get(event.robot)
    if active is None or active.action_id != event.subject.action_id:
        return ()
    if now_us - active.since_us <= state.fleet.alliance.yield_us:
        return ()
    return (Scheduled(Acquiesce(event.robot, active.action_id, active.since_us)),)


@HANDLERS.react(PolicyWindowOpened)
def _on_window(state: State, event: PolicyWindowOpened, _now_us: int) -> tuple[Scheduled, ...]:
    active = state.motivation.active.get(event.robot)
    if active is None or event.scope != "local":
        return ()
    return (Scheduled(Acquiesce(event.robot, active.action_id, active.since_us)),)


@HANDLERS.react(ExecutionFinished)
def _on_finish(state: State, event: ExecutionFinished, _now_us: int) -> tuple[Scheduled, ...]:
    """Tell the robot whose step it is, and every teammate that may be working on it, one message each."""
    robot, action_id = event.robot, action_of(event.subject.action_id)
    request = state.request.open.get(action_id)
    capability = "" if request is None else request.capability
    end = Scheduled(EndActivity(robot, action_id, event.subject.action_id, capability))
    if request is None:
        return (end,)
    result = (message(robot, action_id, 4),) if request.is_delegated else ()
    deliveries = tuple(
        Scheduled(HearDone(peer, action_id, robot, capability), 0, (message(robot, action_id, f"done/{robot}/{peer}"),))
        for peer in teammates(state, request, robot)
    )
    return (end, Scheduled(CompleteStep(action_id), 0, result), *deliveries)


@HANDLERS.react(ExecutionWithdrawn)
def _on_withdrawn(_state: State, event: ExecutionWithdrawn, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(EndActivity(event.robot, action_of(event.subject.action_id))),)
