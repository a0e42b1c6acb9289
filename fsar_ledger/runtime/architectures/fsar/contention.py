"""FSAR: two requests for one robot, one of them time-critical, are put in order by H_F. Paper: sec:prototype:workflows (Workflow 3).

The policy resolver's outcome is then `review`: the request that was evaluated first calls H_F, the other joins the
call, and both are evaluated again in the order that H_F has given. A request that has not reached the executor
by then holds nobody up. Without a time-critical task requests wait in order of arrival.
"""

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import FLEET_SUPERVISOR
from fsar_ledger.events.request import RequestDeferred
from fsar_ledger.events.supervision import SupervisorCalled
from fsar_ledger.projections.contention import Order
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.request import Request
from fsar_ledger.runtime.handlers.task import is_critical

Context = tuple[str, str, str, str, str, str, str | None, tuple[str, ...]]  # the envelope of what the executor decides


def put_in_order(state: State, request: Request, executor: str, context: Context) -> tuple[Event, ...]:
    """H_F is called to order this admissible request and its rival, or it waits for the answer; nothing without a rival.

    Reading: a request competes from the detection of its gap until the executor has admitted it.
    """
    rival = _rival(state, request, executor)
    if rival is None:
        return ()
    order = _order(state, request.action_id, rival.action_id)
    if order is None:
        return (SupervisorCalled(request.task_id, request.action_id, FLEET_SUPERVISOR, "ordering", executor, rival.action_id),)
    return () if order.is_answered else (RequestDeferred(*context),)


def in_order(state: State, action_id: str, preferred: str | None) -> tuple[str, ...]:
    """The requests that waited for H_F's answer about this action, in the order in which they go."""
    order = state.contention.orders.get(action_id)
    if order is None:
        return ()
    waiting = (order.action_id, order.other) if order.has_joined else (order.action_id,)
    return tuple(sorted(waiting, key=lambda name: name != preferred))


def _rival(state: State, request: Request, executor: str) -> Request | None:
    """The first request of another task that is not yet admitted, for the same robot, where one of both is time-critical."""
    if not any(task.is_time_critical for task in state.task.values()):
        return None
    for other in state.request.values():
        is_open = other.is_delegated and other.action_id not in state.execution.actions and other.action_id not in state.contention.refused
        is_same_robot = other.candidates[0] == executor if other.candidates else other.capability == request.capability
        is_urgent = is_critical(state, request.task_id) or is_critical(state, other.task_id)
        if other.task_id != request.task_id and other.task_id in state.task and is_open and is_same_robot and is_urgent:
            return other
    return None


def _order(state: State, one: str, other: str) -> Order | None:
    for order in state.contention.orders.values():
        if {order.action_id, order.other} == {one, other}:
            return order
    return None
