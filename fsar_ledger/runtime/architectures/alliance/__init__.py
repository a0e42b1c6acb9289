"""ALLIANCE: each robot alone decides what it does, by motivations that grow from impatience and end in acquiescence.

There is no request, permission, assignment or supervision, no registry, no central store and no human level. A robot
takes up what it senses as needed and hears no teammate working on, and broadcasts its activity; a teammate that hears
nothing more, or has been patient for long enough, takes over.

Sources: the abstract of L. E. Parker, "ALLIANCE: an architecture for fault tolerant multirobot cooperation", IEEE T-RA
14(2), 1998 (vdocument.in, TRA.pdf); for the formulas, the package `alliance` of adrianohrl/ruler, folder
mrta_archs/alliance/src/alliance: motivational_behaviour.cpp, activity_suppression.cpp and inter_communication.cpp at
07d0c1c, impatience.cpp and impatience_reset.cpp at 0a73f2f, acquiescence.cpp at 3423946, sensory_feedback.cpp at
452f077. What they leave open are the dials of `designs.dials.Alliance`. That the slow rate reaches the threshold after
the patience with a teammate, and L-ALLIANCE's mean and deviation, are from memory of Parker's report.

Records name the executing robot. They name no requester, since no robot makes requests, and no supervisor, since
neither source has one. Fleet rules are violated, since nothing checks them; a robot's own policy reaches it as sensory
feedback (dial `senses_policy`), and a review counts as a denial, since there is no reviewer.

This module holds what a robot does while active, and when it fails. A robot retries until it gives up; then a teammate
takes over, or it keeps trying by itself. Recovery has these two levels only: the architecture has no fleet level and
calls no human (abstract: humans add and remove robots). A failure resolved by takeover is over when the teammate
becomes active, like one that is reassigned under FSAR. How a robot retries is left open; it does so as under every
architecture that retries by itself.

Left out: rates per task, and per robot where the dial `stagger_us` is 0 (teammates that sense a need
within a message's time of each other then all start), the spin of 2 Hz (motivation is linear between two events, so its
instant is computed), loss of messages, and the sensing of a teammate's effects other than by its messages.
"""

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Principals, Robot
from fsar_ledger.events.execution import (
    ApproachStarted,
    ExecutionFailed,
    ExecutionPaused,
    RoutinePerformed,
    RoutineWithheld,
)
from fsar_ledger.events.recovery import FailureResolved, RecoveryAttempted, RecoveryAttemptFailed
from fsar_ledger.events.world import ContextChanged
from fsar_ledger.projections.execution import Action
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.motivation import action_of
from fsar_ledger.runtime.architectures import COMMON, HandlerTable
from fsar_ledger.runtime.handlers.commands import (
    ActionCommand,
    Command,
    Decide,
    DecideRoutine,
    EndAttempt,
    Failure,
    Handlers,
    React,
    ResumeAction,
    Scheduled,
    StartAction,
    TakeTurn,
    body,
    commanded_robot,
    holds,
    known_action,
    lasts,
    open_failure,
)
from fsar_ledger.runtime.handlers.execution import (
    approach,
    pause_running,
    resume_when_replanned,
    resumed,
    start,
    start_after_approach,
)
from fsar_ledger.runtime.handlers.policy import own_policy
from fsar_ledger.runtime.handlers.recovery import attempt_failed, attempt_succeeds, attempted
from fsar_ledger.runtime.handlers.task import TransferSegment, transferred

from . import activity, motivation
from .activity import by_robot

HANDLERS = Handlers()


class StartWork(StartAction, kw_only=True):
    """Start the action on arrival, unless the robot has left the action since, even if it has come back to it."""

    robot: Robot
    since_us: int


@HANDLERS.decide(StartWork, body)
def start_work(state: State, command: StartWork) -> tuple[Event, ...]:
    """Start the execution of the robot that has arrived."""
    active, action = state.motivation.active.get(command.robot), state.execution.actions.get(command.action_id)
    if active is None or action is None or (action.robot, active.since_us) != (command.robot, command.since_us):
        return ()
    return start(state, command)


def _resume(state: State, command: ResumeAction) -> tuple[Event, ...]:
    """Resume the action, unless it has just failed; a robot that retries after giving up once resumes as well."""
    action = known_action(state, command.action_id)
    if action is None or (action.stage == "failed" and command.action_id in state.recovery):
        return ()
    return resumed(state, command, action)


@HANDLERS.decide(DecideRoutine, commanded_robot)
def decide_routine(state: State, command: DecideRoutine) -> tuple[Event, ...]:
    """Perform the routine operation; withhold a motion that the robot's own policy, if it is sensed, does not allow."""
    robot, operation = command.robot, command.operation
    principals = by_robot(robot).decided(robot)
    is_sensed = operation == "motion" and state.fleet.alliance.senses_policy
    if is_sensed and own_policy(state.policy, state.world, robot, None, None) != "allow":
        return (RoutineWithheld(principals, robot, operation),)
    return (RoutinePerformed(principals, robot, operation),)


def _transfer(state: State, command: TransferSegment) -> tuple[Event, ...]:
    """Give the next segment to its robot; the record names its executor and no requester."""

    def by_it(before: Robot, then: Robot) -> Principals:
        return by_robot(then).decided(before)

    return transferred(state, command, by_it)


def _on_approach(state: State, event: ApproachStarted, now_us: int) -> tuple[Scheduled, ...]:
    """Start the work on arrival. The first approach to an action takes the same time under every architecture."""
    action: Action = state.execution.actions[event.subject.action_id]
    active = state.motivation.active.get(event.robot)
    if active is None:
        return start_after_approach(state, event, now_us)
    earlier = state.motivation.spells[action_of(action.action_id)] - 1
    travel = lasts("approach", f"{action.action_id}/{earlier}" if earlier else action.action_id)
    work = StartWork(action.action_id, robot=event.robot, since_us=active.since_us)
    return (Scheduled(work, 0, (travel,), lasts(action.capability, action.action_id)),)


HANDLERS.decide(TakeTurn, body)(approach)
HANDLERS.decide(StartAction, body)(start)
HANDLERS.react(ExecutionPaused)(resume_when_replanned)
HANDLERS.react(ContextChanged)(pause_running)

INSTEAD: dict[React, React] = {start_after_approach: _on_approach}
OWN: dict[type[Command], Decide] = {ResumeAction: _resume, TransferSegment: _transfer}


class TryAgain(ActionCommand):
    """Begin an attempt to recover from this failure."""

    failure: int


class EndTry(EndAttempt):
    """End the attempt at this failure."""

    failure: int = 0


def _is_current(failure: Failure, command: TryAgain | EndTry) -> bool:
    """Return whether the open failure is the command's, and its action is still failed."""
    action, recovery = failure
    return action.stage == "failed" and recovery.failure == command.failure


@HANDLERS.decide_on(open_failure, TryAgain, body)
def try_again(state: State, command: TryAgain, failure: Failure) -> tuple[Event, ...]:
    """Begin the next attempt: only acquiescence ends the attempts."""
    action, recovery = failure
    active = state.motivation.active.get(action.robot)
    if active is None or not _is_current(failure, command):
        return ()
    principals = by_robot(action.robot).decided(action.robot)
    return (attempted(action, recovery, principals, active.since_us + state.fleet.alliance.give_up_us),)


@HANDLERS.decide_on(open_failure, EndTry, body)
def end_try(state: State, command: EndTry, failure: Failure) -> tuple[Event, ...]:
    """End the attempt: resolve the failure, or record that the attempt failed."""
    action, recovery = failure
    if recovery.number != command.number or not _is_current(failure, command):
        return ()
    if attempt_succeeds(state.world, recovery, command):
        return (FailureResolved(action.subject, action.robot, recovery.failure, "local"),)
    return (attempt_failed(state.registry, state.world, action, recovery),)


@HANDLERS.react(ExecutionFailed, RecoveryAttemptFailed)
def _on_failure(_state: State, event: ExecutionFailed | RecoveryAttemptFailed, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(TryAgain(event.subject.action_id, event.failure)),)


@HANDLERS.react(RecoveryAttempted)
def _on_attempt(state: State, event: RecoveryAttempted, _now_us: int) -> tuple[Scheduled, ...]:
    key = f"{event.failed_action}/{event.failure}/{event.number}"
    end = EndTry(event.failed_action, event.number, failure=event.failure)
    return (Scheduled(end, state.fleet.structure.retry_preparation_us, (lasts("retry", key),), holds("retry/" + key)),)


ALLIANCE: HandlerTable = HandlerTable.of(
    *COMMON,
    motivation,
    activity,
    HANDLERS,
    own=OWN,
    instead=INSTEAD,
)
