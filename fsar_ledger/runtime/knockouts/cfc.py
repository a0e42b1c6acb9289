"""The centralized controller without one mechanism."""

from functools import partial
from typing import Any

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import COORDINATOR, flat, with_columns
from fsar_ledger.events.execution import ExecutionFailed
from fsar_ledger.events.recovery import FailureResolved, RecoveryAttempted, RecoveryAttemptFailed
from fsar_ledger.projections.budget import Budgets
from fsar_ledger.projections.execution import Action
from fsar_ledger.projections.fleet import Fleet
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.recovery import Recovery
from fsar_ledger.runtime.architectures.cfc import coordinator, execution, request
from fsar_ledger.runtime.architectures.cfc.recovery import HANDLERS, GoOnWithoutHelp, go_on_without_help
from fsar_ledger.runtime.architectures.handler_table import HandlerTable
from fsar_ledger.runtime.handlers.actors import body
from fsar_ledger.runtime.handlers.attribution import parties
from fsar_ledger.runtime.handlers.commands import Command, DecideRoutine, EndAttempt, React, Scheduled
from fsar_ledger.runtime.handlers.recovery import (
    attempt_failed,
    attempt_succeeds,
    attempted,
    budget,
    end_of_attempt,
    open_failure,
)

from .knockout import Knockout, decided_by, in_every_decision, in_no_time, nothing, seeing


def _copy_of_now(state: State) -> Any:
    """Return the knowledge with a copy that shows the present state of the robots."""
    (copy,) = coordinator.sync(state, coordinator.Sync())
    return state.knowledge.__replace__(copy=copy)


class RetryAlone(Command):
    """Start the robot's own attempt after a failure that it has seen."""

    action_id: str


def _may_try(budgets: Budgets, fleet: Fleet, recovery: Recovery, tried: int, now_us: int) -> bool:
    """Return whether the robot may try again after this many attempts, by the number and the time of its budget."""
    allowed = budget(budgets, fleet, recovery.robot, "local")
    return tried < allowed.n_max and now_us < recovery.detected_us + allowed.t_max_us


def _retried(state: State, action: Action, recovery: Recovery) -> RecoveryAttempted:
    by_robot = parties(state.fleet, state.world, action).decided(action.robot)
    allowed = budget(state.budget, state.fleet, action.robot, "local")
    return attempted(action, recovery, by_robot, recovery.detected_us + allowed.t_max_us)


def _retry_alone(state: State, command: RetryAlone) -> tuple[Event, ...]:
    failure = open_failure(state.execution, state.recovery, command.action_id)
    return () if failure is None else (_retried(state, *failure),)


def _end_own_attempt(state: State, command: EndAttempt) -> tuple[Event, ...]:
    """End the robot's attempt; once its budget is spent, the coordinator takes over."""
    failure = open_failure(state.execution, state.recovery, command.action_id)
    if failure is None or failure[1].number != command.number:
        return ()
    action, recovery = failure
    if attempt_succeeds(state.world, recovery, command):
        return (FailureResolved(action.subject, action.robot, recovery.failure, "local"),)
    failed = attempt_failed(state.registry, state.world, action, recovery)
    if _may_try(state.budget, state.fleet, recovery, command.number, command.now_us):
        return (failed, _retried(state, action, recovery))
    return (failed,)


def _on_own_failure(state: State, event: ExecutionFailed, now_us: int) -> tuple[Scheduled, ...]:
    if _may_try(state.budget, state.fleet, state.recovery[event.subject.action_id], 0, now_us):
        return (Scheduled(RetryAlone(event.subject.action_id)),)
    return HANDLERS.reacts[ExecutionFailed](state, event, now_us)


def _on_own_attempt(state: State, event: RecoveryAttempted, now_us: int) -> tuple[Scheduled, ...]:
    if event.principals.decided_by == COORDINATOR:  # it orders one where the robot may not try at all
        return HANDLERS.reacts[RecoveryAttempted](state, event, now_us)
    return (end_of_attempt(state.fleet, event),)


def _on_own_attempt_failed(state: State, event: RecoveryAttemptFailed, now_us: int) -> tuple[Scheduled, ...]:
    """Tell the coordinator of the last failed attempt only."""
    failure = open_failure(state.execution, state.recovery, event.subject.action_id)
    if failure is not None and _may_try(state.budget, state.fleet, failure[1], event.number, now_us):
        return ()
    return HANDLERS.reacts[RecoveryAttemptFailed](state, event, now_us)


def _recovering_alone(table: HandlerTable) -> HandlerTable:
    """Let robots make their own attempts before the coordinator hears of a failure."""
    instead: dict[React, React] = {
        HANDLERS.reacts[ExecutionFailed]: _on_own_failure,
        HANDLERS.reacts[RecoveryAttempted]: _on_own_attempt,
        HANDLERS.reacts[RecoveryAttemptFailed]: _on_own_attempt_failed,
    }
    reacts = {event: tuple(instead.get(react, react) for react in several) for event, several in table.reacts.items()}
    return HandlerTable(
        {**table.decides, RetryAlone: _retry_alone, EndAttempt: _end_own_attempt},
        reacts,
        {**table.actors, RetryAlone: body},
    )


def _requester_named(state: State, event: Event) -> Event:
    """Name the robot that owns the task as requester where nobody, or the coordinator, is named."""
    values = flat(event)
    task = state.task.get(values.get("task_id") or "")
    if task is not None and values.get("requested_by", "") in (None, COORDINATOR):
        return with_columns(event, requested_by=task.robot)
    return event


def _decided_by_robots(state: State, event: Event) -> Event:
    values = flat(event)
    if values.get("decided_by") != COORDINATOR:
        return event
    task = state.task.get(values["task_id"] or "")
    robot = values["executed_by"] or (None if task is None else task.robot)
    return event if robot is None else decided_by(event, robot)


_now = partial(seeing, "knowledge", _copy_of_now)
_served_at_once = partial(seeing, "fleet", in_no_time("service_us"))

KNOCKOUTS = (
    Knockout("safe-stop-claims", "cfc", {execution.SafeStop: nothing}),
    Knockout(
        "synced-copies",
        "cfc",
        {
            coordinator.ProcessWork: _now(request.process),
            request.CommandReviewed: _now(request.command_reviewed),
            DecideRoutine: _now(execution.decide_routine),
        },
    ),
    Knockout(
        "coordinator-queue",
        "cfc",
        {
            coordinator.ReachCoordinator: _served_at_once(coordinator.reach_coordinator),
            GoOnWithoutHelp: _served_at_once(go_on_without_help),
        },
    ),
    Knockout("central-recovery", "cfc", change=_recovering_alone),
    Knockout("unnamed-requests", "cfc", change=in_every_decision(_requester_named)),
    Knockout("central-decisions", "cfc", change=in_every_decision(_decided_by_robots)),
)
