"""ALLIANCE: what a robot does while it is active, and when it fails; routine; how a task goes to its next step's robot.

A robot tries again until it gives up; then a teammate takes over, or it goes on trying by itself. Recovery has these
two levels only: the architecture has no fleet level and calls no human (abstract: humans add and remove robots). A
failure resolved by takeover is over when the teammate becomes active, as one that is reassigned is under FSAR. How a
robot tries again is open; it does so as under every architecture that retries by itself.
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
    holds,
    known_action,
    lasts,
    named,
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

from .activity import by_robot

HANDLERS = Handlers()


class StartWork(StartAction, kw_only=True):
    """Start the action on arrival; nothing if the robot has left the action since, even if it has come back to it."""

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
    """Go on with the rest, unless it has just failed; a robot that has given up once and tries anew goes on as well."""
    action = known_action(state, command.action_id)
    if action is None or (action.stage == "failed" and command.action_id in state.recovery):
        return ()
    return resumed(state, command, action)


@HANDLERS.decide(DecideRoutine, named)
def decide_routine(state: State, command: DecideRoutine) -> tuple[Event, ...]:
    """Perform the routine operation; withhold a motion that the robot's own policy, if it is sensed, does not allow."""
    robot, operation = command.robot, command.operation
    principals = by_robot(robot).decided(robot)
    is_sensed = operation == "motion" and state.fleet.alliance.senses_policy
    if is_sensed and own_policy(state.policy, state.world, robot, None, None) != "allow":
        return (RoutineWithheld(principals, robot, operation),)
    return (RoutinePerformed(principals, robot, operation),)


def _transfer(state: State, command: TransferSegment) -> tuple[Event, ...]:
    """Give the next segment to its robot; the record names who executes it, and nobody who asked."""

    def by_it(before: Robot, then: Robot) -> Principals:
        return by_robot(then).decided(before)

    return transferred(state, command, by_it)


def _on_approach(state: State, event: ApproachStarted, now_us: int) -> tuple[Scheduled, ...]:
    """Start the work on arrival. The first way to an action is the same under every architecture."""
    action: Action = state.execution.actions[event.subject.action_id]
    active = state.motivation.active.get(event.robot)
    if active is None:
        return start_after_approach(state, event, now_us)
    again = state.motivation.spells[action_of(action.action_id)] - 1
    way = lasts("approach", f"{action.action_id}/{again}" if again else action.action_id)
    work = StartWork(action.action_id, robot=event.robot, since_us=active.since_us)
    return (Scheduled(work, 0, (way,), lasts(action.capability, action.action_id)),)


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
    """Tell whether the failure is this one, and its robot is still at it."""
    action, recovery = failure
    return action.stage == "failed" and recovery.failure == command.failure


@HANDLERS.decide_on(open_failure, TryAgain, body)
def try_again(state: State, command: TryAgain, failure: Failure) -> tuple[Event, ...]:
    """Begin the next attempt: acquiescence alone ends them."""
    action, recovery = failure
    active = state.motivation.active.get(action.robot)
    if active is None or not _is_current(failure, command):
        return ()
    principals = by_robot(action.robot).decided(action.robot)
    return (attempted(action, recovery, principals, active.since_us + state.fleet.alliance.give_up_us),)


@HANDLERS.decide_on(open_failure, EndTry, body)
def end_try(state: State, command: EndTry, failure: Failure) -> tuple[Event, ...]:
    """End the attempt, which resolved the failure or did not."""
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
