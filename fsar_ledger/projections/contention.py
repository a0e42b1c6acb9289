"""Requests that compete for one robot, and the order in which H_F lets them go. Paper: sec:prototype:workflows."""

from typing import assert_never

import msgspec

from fsar_ledger.events.request import RequestDeferred, RequestDenied, RequestUnanswered
from fsar_ledger.events.supervision import SupervisorCalled, SupervisorResponded

HANDLES = SupervisorCalled | SupervisorResponded | RequestDeferred | RequestDenied | RequestUnanswered


class Order(msgspec.Struct, frozen=True, gc=False):
    """Two actions were put before H_F; `has_joined`: the other one waits for the answer as well."""

    action_id: str
    other: str
    has_joined: bool = False
    is_answered: bool = False


class Contention(msgspec.Struct, frozen=True, gc=False):
    """`orders`: action -> the order it was put in; `refused`: actions that were denied or had nobody to ask, and compete no more."""

    orders: dict[str, Order] = {}
    refused: frozenset[str] = frozenset()


INITIAL = Contention()


def evolve(state: Contention, event: HANDLES) -> Contention:
    """Contention after the event."""
    match event:
        case SupervisorCalled():
            if event.competing is None:
                return state
            return Contention({**state.orders, event.action_id: Order(event.action_id, event.competing)}, state.refused)
        case SupervisorResponded():
            known = state.orders.get(event.action_id)
            if known is None or event.purpose != "ordering":
                return state
            return _with(state, msgspec.structs.replace(known, is_answered=True))
        case RequestDeferred():
            for order in state.orders.values():
                if order.other == event.action_id and not order.is_answered:
                    return _with(state, msgspec.structs.replace(order, has_joined=True))
            return state
        case RequestDenied() | RequestUnanswered():
            return state if event.action_id is None else Contention(state.orders, state.refused | {event.action_id})
        case _:
            assert_never(event)


def _with(state: Contention, order: Order) -> Contention:
    return Contention({**state.orders, order.action_id: order}, state.refused)
