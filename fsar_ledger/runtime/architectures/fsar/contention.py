"""FSAR: H_F orders two requests for one robot when one of them is time-critical.

Paper: sec:prototype:workflows (Workflow 3).

The policy resolver's outcome is then `review`: the request that was evaluated first calls H_F and the other joins the
call. Both are evaluated again in the order that H_F has given: the second waits until the first is admitted or refused.
A request that has not reached the executor by then holds nobody up. Without a time-critical task, requests wait in
order of arrival.
"""

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import FLEET_SUPERVISOR, Principals, Robot
from fsar_ledger.events.request import RequestDeferred
from fsar_ledger.events.supervision import SupervisorCalled
from fsar_ledger.projections.contention import Contention, Order
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.request import Request
from fsar_ledger.runtime.handlers.task import is_critical


def put_in_order(state: State, request: Request, executor: Robot, principals: Principals) -> tuple[Event, ...]:
    """Call H_F to order this admissible request and its rival, or let it wait; do nothing without a rival.

    It waits for H_F's answer, or for the rival that H_F lets go first.

    Reading: a request competes from the detection of its gap until the executor has admitted it.
    """
    rivals = _rivals(state, request, executor)
    if not rivals:
        return ()
    orders = [
        (order, rival)
        for rival in rivals
        if (order := _order(state.contention, request.action_id, rival.action_id)) is not None
    ]
    if any(not order.is_answered or _goes_first(state.contention, order, rival) for order, rival in orders):
        return (RequestDeferred(request.request_subject, principals),)
    if orders:
        return ()
    return (
        SupervisorCalled(
            subject=request.subject,
            supervisor=FLEET_SUPERVISOR,
            purpose="ordering",
            robot=executor,
            competing=rivals[0].action_id,
        ),
    )


def in_order(contention: Contention, action_id: str, preferred: str | None) -> tuple[str, ...]:
    """Return the requests that waited for H_F's answer about this action, in the order that H_F gave."""
    called = [pair for pair in contention.orders if pair[0] == action_id]
    if not called:
        return ()
    waiting = [name for name in called[-1] if name in contention.arrived]
    return tuple(sorted(waiting, key=lambda name: name != preferred))


def held_up(contention: Contention, action_id: str | None) -> tuple[str, ...]:
    """Return the requests that waited for this one because H_F lets it go first."""
    orders = contention.orders.values()
    pairs = [(order.action_id, order.other) for order in orders if order.is_answered and order.preferred == action_id]
    return tuple(name for pair in pairs for name in pair if name != action_id and name in contention.arrived)


def _goes_first(contention: Contention, order: Order, rival: Request) -> bool:
    """Tell whether the rival that H_F lets go first is itself still waiting for the executor."""
    return order.preferred == rival.action_id and rival.action_id in contention.arrived and rival.offered is None


def _rivals(state: State, request: Request, executor: Robot) -> list[Request]:
    """Return the unadmitted requests of other tasks for the same robot, where either is time-critical."""
    if not state.contention.critical:
        return []
    found = []
    for other in state.request.open.values():
        is_settled = (
            other.is_accepted or other.is_over or other.is_unanswered or other.action_id in state.execution.actions
        )
        is_same_robot = other.candidates[0] == executor if other.candidates else other.capability == request.capability
        is_urgent = is_critical(state.task, request.task_id) or is_critical(state.task, other.task_id)
        if (
            other.task_id != request.task_id
            and other.task_id in state.task
            and other.is_delegated
            and not is_settled
            and is_same_robot
            and is_urgent
        ):
            found.append(other)
    return found


def _order(contention: Contention, one: str, other: str) -> Order | None:
    orders = contention.orders
    return orders.get((one, other)) or orders.get((other, one))
