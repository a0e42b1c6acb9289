"""Requests that compete for one robot, and the order that H_F gives them. Paper: sec:prototype:workflows."""

from typing import assert_never

import msgspec

from fsar_ledger.events.request import RequestDeferred, RequestDenied, RequestUnanswered
from fsar_ledger.events.supervision import SupervisorCalled, SupervisorResponded

HANDLES = SupervisorCalled | SupervisorResponded | RequestDeferred | RequestDenied | RequestUnanswered


class Order(msgspec.Struct, frozen=True, gc=False):
    """Two competing actions that the first of them put before H_F; `preferred` is H_F's answer."""

    action_id: str
    other: str
    is_answered: bool = False
    preferred: str | None = None


class Contention(msgspec.Struct, frozen=True, gc=False):
    """The competing requests and their order.

    `orders`: the two actions -> their order; `arrived`: actions that wait at the executor for an order; `refused`:
    actions that were denied or found nobody to ask, and no longer compete.
    """

    orders: dict[tuple[str, str], Order] = {}
    refused: frozenset[str] = frozenset()
    arrived: frozenset[str] = frozenset()


INITIAL = Contention()


def evolve(state: Contention, event: HANDLES) -> Contention:
    """Return the competing requests after the event."""
    match event:
        case SupervisorCalled():
            if event.competing is None:
                return state
            orders = {
                **state.orders,
                (event.subject.action_id, event.competing): Order(event.subject.action_id, event.competing),
            }
            return Contention(orders, state.refused, state.arrived | {event.subject.action_id})
        case SupervisorResponded():
            if event.purpose != "ordering":
                return state
            answered = {
                pair: msgspec.structs.replace(order, is_answered=True, preferred=event.preferred)
                for pair, order in state.orders.items()
                if order.action_id == event.subject.action_id and not order.is_answered
            }
            return Contention({**state.orders, **answered}, state.refused, state.arrived)
        case RequestDeferred():
            joins = any(
                order.other == event.subject.action_id and not order.is_answered for order in state.orders.values()
            )
            return (
                Contention(state.orders, state.refused, state.arrived | {event.subject.action_id}) if joins else state
            )
        case RequestDenied() | RequestUnanswered():
            return (
                state
                if event.subject.action_id is None
                else Contention(state.orders, state.refused | {event.subject.action_id}, state.arrived)
            )
        case _:
            assert_never(event)
