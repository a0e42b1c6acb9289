"""Requests that compete for one robot, and the order that H_F gives them. Paper: sec:prototype:workflows."""

from collections.abc import Mapping
from typing import assert_never

import msgspec
from msgspec.structs import replace

from fsar_ledger.events.request import RequestDeferred
from fsar_ledger.events.supervision import SupervisorCalled, SupervisorResponded
from fsar_ledger.events.task import TaskAbandoned, TaskCompleted
from fsar_ledger.events.world import TaskArrived

from . import put

HANDLES = SupervisorCalled | SupervisorResponded | RequestDeferred | TaskArrived | TaskCompleted | TaskAbandoned


class Order(msgspec.Struct, frozen=True, gc=False):
    """Two competing actions that the first of them submitted to H_F; `preferred` is H_F's answer."""

    action_id: str
    other: str
    is_answered: bool = False
    preferred: str | None = None


class Contention(msgspec.Struct, frozen=True, gc=False):
    """The competing requests and their order.

    `orders`: the two actions -> their order; `arrived`: actions that wait at the executor for an order; `critical`:
    open tasks that are time-critical.
    """

    orders: Mapping[tuple[str, str], Order] = {}
    arrived: frozenset[str] = frozenset()
    critical: frozenset[str] = frozenset()


INITIAL = Contention()


def order_of(contention: Contention, one: str, other: str) -> Order | None:
    """Return the order of two competing actions, whichever of them submitted it to H_F; None if neither has."""
    orders = contention.orders
    return orders.get((one, other)) or orders.get((other, one))


def in_order(contention: Contention, action_id: str, preferred: str | None) -> tuple[str, ...]:
    """Return the requests that waited for H_F's answer about this action, in the order that H_F gave."""
    pairs = [pair for pair in contention.orders if pair[0] == action_id]
    if not pairs:
        return ()
    waiting = [name for name in pairs[-1] if name in contention.arrived]
    return tuple(sorted(waiting, key=lambda name: name != preferred))


def held_up(contention: Contention, action_id: str | None) -> tuple[str, ...]:
    """Return the requests that waited for this one because H_F lets it go first."""
    orders = contention.orders.values()
    pairs = [(order.action_id, order.other) for order in orders if order.is_answered and order.preferred == action_id]
    return tuple(name for pair in pairs for name in pair if name != action_id and name in contention.arrived)


def evolve(state: Contention, event: HANDLES) -> Contention:
    """Return the competing requests after the event."""
    match event:
        case SupervisorCalled():
            if event.competing is None:
                return state
            pair = (event.subject.action_id, event.competing)
            orders = put(state.orders, pair, Order(*pair))
            return replace(state, orders=orders, arrived=state.arrived | {event.subject.action_id})
        case SupervisorResponded():
            if event.purpose != "ordering":
                return state
            answered = {
                pair: replace(order, is_answered=True, preferred=event.preferred)
                for pair, order in state.orders.items()
                if order.action_id == event.subject.action_id and not order.is_answered
            }
            return replace(state, orders={**state.orders, **answered})
        case RequestDeferred():
            joins = any(
                order.other == event.subject.action_id and not order.is_answered for order in state.orders.values()
            )
            return replace(state, arrived=state.arrived | {event.subject.action_id}) if joins else state
        case TaskArrived():
            return replace(state, critical=state.critical | {event.task_id}) if event.is_time_critical else state
        case TaskCompleted() | TaskAbandoned():
            is_critical = event.task_id in state.critical
            return replace(state, critical=state.critical - {event.task_id}) if is_critical else state
        case _:
            assert_never(event)
