"""ALLIANCE: a robot tries again until it gives up; then a teammate takes over, or it goes on trying by itself.

Recovery has these two levels only: the architecture has no fleet level and calls no human (abstract: humans add and
remove robots). A failure resolved by takeover is over when the teammate becomes active, as one that is reassigned is
under FSAR. How a robot tries again is open; it does so as under every architecture that retries by itself.
"""

from fsar_ledger.events import Event
from fsar_ledger.events.execution import ExecutionFailed
from fsar_ledger.events.recovery import FailureResolved, RecoveryAttempted, RecoveryAttemptFailed
from fsar_ledger.projections.fold import State
from fsar_ledger.runtime.handlers.commands import (
    ActionCommand,
    EndAttempt,
    Failure,
    Handlers,
    Scheduled,
    body,
    holds,
    lasts,
    open_failure,
)
from fsar_ledger.runtime.handlers.recovery import attempt_failed, attempt_succeeds, attempted

from .activity import by_robot

HANDLERS = Handlers()


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
