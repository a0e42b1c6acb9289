"""FSAR without one mechanism. The handlers check the four of the paper's ablation themselves."""

from functools import wraps
from typing import Any

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import as_robot
from fsar_ledger.events.execution import RoutinePerformed
from fsar_ledger.events.request import RequestClosed
from fsar_ledger.projections.fold import State
from fsar_ledger.runtime.architectures.fsar import authority, request
from fsar_ledger.runtime.architectures.fsar.execution import ready
from fsar_ledger.runtime.architectures.handler_table import HandlerTable
from fsar_ledger.runtime.handlers.attribution import recorded_by
from fsar_ledger.runtime.handlers.commands import CloseRequest, DecideRoutine, StartAction
from fsar_ledger.runtime.handlers.execution import started

from .knockout import ChangeTable, Knockout, decided_by, nothing


def _closed_by_requester(state: State, command: CloseRequest) -> tuple[Event, ...]:
    events = request.close_request(state, command)
    return tuple(
        decided_by(event, as_robot(event.principals.requested_by))
        if isinstance(event, RequestClosed) and event.principals.requested_by is not None
        else event
        for event in events
    )


def _starting_unchecked(*, is_delegated: bool) -> ChangeTable:
    """Return the change that starts delegated work (or the robot's own) unchecked; the other kind is still checked."""

    def changed(table: HandlerTable) -> HandlerTable:
        checked = table.decides[StartAction]

        @wraps(checked)
        def start(state: State, command: Any) -> tuple[Event, ...]:
            action = ready(state.execution, command.action_id)
            if action is None or action.is_delegated != is_delegated:
                return checked(state, command)
            return (started(state.fleet, state.world, action, command),)

        return HandlerTable({**table.decides, StartAction: start}, table.reacts, table.actors)

    return changed


def _moved_unchecked(state: State, command: DecideRoutine) -> tuple[Event, ...]:
    robot = command.robot
    parties = recorded_by(state.fleet, state.world, robot, requested_by=robot, executed_by=robot)
    return (RoutinePerformed(parties.decided(robot), robot, command.operation),)


KNOCKOUTS = (
    Knockout("trust-evaluation", "fsar"),
    Knockout("policy-composition", "fsar"),
    Knockout("layered-recovery", "fsar"),
    Knockout("shared-registry", "fsar"),
    Knockout("engine-closing", "fsar", {CloseRequest: _closed_by_requester}),
    Knockout("boundary-revocation", "fsar", {authority.Revoke: nothing}),
    Knockout("start-recheck", "fsar", change=_starting_unchecked(is_delegated=True)),
    Knockout("own-work-check", "fsar", {DecideRoutine: _moved_unchecked}, _starting_unchecked(is_delegated=False)),
)
