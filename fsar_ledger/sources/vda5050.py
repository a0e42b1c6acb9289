"""VDA 5050 2.1 and 3.0: orders, states, instant actions and connections, as a broker recorded them.

One message a line: the message itself, or an object with `topic`, `payload` (the message, or its text) and perhaps
`received` (ISO 8601 or a number), when the recorder got it, which `mosquitto_sub -F %J` calls `tst`. A state is sent
from time to time, so what follows from it is what has changed since the last one of the same vehicle.

`docs/sources/vda5050.md` says what becomes what. A vehicle clears its order by a cancelOrder, a startHibernation, or by
going into a mode in which it takes no orders: it reports no nodes, and FAILED actions, of what it has not done.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, Literal

import msgspec

from fsar_ledger.base import utc
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import COORDINATOR, Parties, Principals, RequestSubject, Robot, Subject, recorded_robot
from fsar_ledger.events.execution import (
    ExecutionFailed,
    ExecutionFinished,
    ExecutionPaused,
    ExecutionResumed,
    ExecutionStarted,
    ExecutionWithdrawn,
)
from fsar_ledger.events.request import RequestAccepted, RequestDenied, RequestIssued
from fsar_ledger.events.task import TaskAbandoned, TaskCompleted
from fsar_ledger.events.world import LinkCameUp, LinkWentDown, TaskArrived

from .adapter import BROKEN, UNREADABLE, Derived, Input, Record, json_object, json_text, objects, require_format

KINDS: Mapping[str, tuple[str, ...]] = {
    "state": ("operatingMode",),
    "connection": ("connectionState",),
    "order": ("nodes",),
    "instantActions": ("actions", "instantActions"),
    "factsheet": ("typeSpecification",),
    "responses": ("responses",),
    "zoneSet": ("zoneSet",),
    "visualization": ("agvPosition", "referenceStateHeaderId"),
}
"""Fields of which one identifies a message without a topic. Visualization comes last: a state has its fields, too."""

HEADER = ("headerId", "manufacturer", "serialNumber")
"""Fields that every message has, and no recorder adds."""
LOST = ("CONNECTIONBROKEN", "CONNECTION_BROKEN")
"""The spellings of 2.1 and 3.0."""
OF_ORDER, BESIDE = "actionStates", ("instantActionStates", "zoneActionStates")
"""The lists of action states: of an order (before 3.0 also of instant actions), and of others."""
CANCELS = ("cancelOrder", "startHibernation")
"""The types of instant actions that end an order before it is done."""
CLEARS = ("MANUAL", "SERVICE", "STARTUP", "TEACHIN", "TEACH_IN")
"""The operating modes in which a vehicle has no order: it clears the one that it has; the last is that of 3.0."""
OVER = frozenset(("FINISHED", "FAILED"))

SHOWN = ("orderId", "orderUpdateId", "lastNodeId", "operatingMode", "connectionState", "headerId", "paused", "driving")


class Vehicle(msgspec.Struct):
    """The state of a vehicle by its messages. `ended` are orders whose end is recorded, `order` is the last one.

    `newest` is the number and time of the newest message by kind; `is_down` that its connection broke; `had_arrived`
    that its last state had no nodes left; `asked` the newest update of each order; `parts` the newest order of each
    action, `horizon` those that the next update may drop, `instant` the types of instant ones, `cancels` the order that
    each of `CANCELS` ends; `orders` the order under which an action began; `listed` the list in which the newest state
    has it; `unseen` the order of each that the vehicle no longer has, and that was not over.
    """

    newest: dict[str, tuple[int, int]] = {}
    asked: dict[str, int] = {}
    accepted: dict[str, None] = {}
    refused: dict[str, None] = {}
    parts: dict[str, str] = {}
    horizon: dict[str, str] = {}
    instant: dict[str, str] = {}
    cancels: dict[str, str] = {}
    statuses: dict[str, str] = {}
    listed: dict[str, str] = {}
    unseen: dict[str, str] = {}
    orders: dict[str, str] = {}
    order: str = ""
    failures: dict[str, int] = {}
    is_down: bool = False
    had_arrived: bool = False
    ended: dict[str, None] = {}


class Vda5050:
    """Reads a recording of VDA 5050 messages."""

    name = "vda5050"
    version = "1"
    clock: Literal["arrival", "source"] = "arrival"
    is_sampled = True

    def __init__(self) -> None:
        self._version = "unknown"
        self._vehicles: dict[Robot, Vehicle] = {}

    @property
    def format(self) -> str:
        """The version that the first message names."""
        return f"vda5050/{self._version}"

    def declares(self) -> Iterable[str]:
        """Name what a complete recording of all topics has; a start may be missed between two states."""
        principals = ("decided_by", "requested_by", "executed_by", "task_id", "action_id")
        return (
            *("TaskArrived.robot", "TaskCompleted", "TaskAbandoned"),
            *(f"RequestIssued.{name}" for name in principals),
            *(f"RequestAccepted.{name}" for name in principals[:3]),
            *(f"RequestDenied.{name}" for name in principals),
            *("ExecutionStarted.executed_by", "ExecutionFinished.executed_by"),
            *("ExecutionPaused", "ExecutionResumed", "ExecutionFailed", "ExecutionWithdrawn"),
            *("LinkWentDown", "LinkCameUp"),
        )

    def read(self, inputs: Iterable[Input]) -> Iterator[Record]:
        """Yield every message. Raises: UsageError if none of the first is one."""
        files = list(inputs)
        records = (item if isinstance(item, Record) else self._record(*item) for item in objects(files))
        unknown = (UNREADABLE, "unknown")
        return require_format(records, files, lambda item: item.kind not in unknown, "VDA 5050 messages, one per line")

    def _record(self, raw: bytes, line: dict[str, Any]) -> Record:
        message = _message(line)
        kind = _kind(line.get("topic"), message)
        if self._version == "unknown" and isinstance(message.get("version"), str):
            self._version = message["version"]
        vehicle = _robot(line.get("topic"), message)
        about = {} if vehicle is None else {str(vehicle): "vehicle"}
        if isinstance(order := message.get("orderId"), str) and order:
            about[f"task/{order}"] = "order"
        values = {name: json_text(message[name]) for name in SHOWN if name in message}
        for number, error in enumerate(_listed(message, "errors"), start=1):
            if isinstance(error.get("errorType"), str):
                name = f"error/{error['errorType']}"
                values[f"{name}/{number}" if name in values else name] = json_text(error)
        return Record(
            kind if kind != "state" else f"state/{values.get('operatingMode')}",
            raw,
            (kind, vehicle, message),
            values,
            about,
            utc.read_us(message.get("timestamp")),
            utc.read_us(line.get("received", line.get("arrival", line.get("time", line.get("tst"))))),
        )

    def derive(self, record: Record) -> Iterable[Derived] | None:
        """Return what has changed since the vehicle's last message."""
        if record.data is None:
            return None
        kind, robot, message = record.data
        if robot is None or kind == "unknown":
            return None
        vehicle = self._vehicles.setdefault(robot, Vehicle())
        # The broker reports a broken connection by a message that the vehicle left before it reported to be online.
        is_of_broker = kind == "connection" and message.get("connectionState") in LOST
        if kind in ("state", "connection") and not is_of_broker and _is_late(vehicle, kind, record, message):
            return ()
        match kind:
            case "order":
                events = _ordered(vehicle, robot, message)
            case "state":
                if not _is_named(message):
                    return None
                events = _changed(vehicle, robot, message)
            case "connection":
                events = _connected(vehicle, robot, message)
            case "instantActions":
                for action in (*_listed(message, "actions"), *_listed(message, "instantActions")):  # the second of 2.0
                    vehicle.instant[str(action.get("actionId"))] = str(action.get("actionType"))
                return ()
            case _:  # visualization, factsheet, responses, zoneSet
                return ()
        return [Derived(event) for event in events]


def _is_late(vehicle: Vehicle, kind: str, record: Record, message: Mapping[str, Any]) -> bool:
    """Return whether this message of that kind, or one that was sent later, came before: it reports nothing new.

    A clock that was set back does not make a message late, since its number goes on; nor does a number that restarts,
    since its time goes on.
    """
    number, sent_us = message.get("headerId"), record.source_us
    if type(number) is not int or sent_us is None:
        return False
    newest = vehicle.newest.get(kind)
    if newest is not None and number <= newest[0] and sent_us <= newest[1]:
        return True
    vehicle.newest[kind] = (number, sent_us)
    return False


def _message(line: dict[str, Any]) -> dict[str, Any]:
    """Return the message in a line, whose payload may be the text of the message."""
    payload = line.get("payload")
    if isinstance(payload, str):
        with suppress(*BROKEN):
            payload = json_object(payload.encode())
    return payload if isinstance(payload, dict) else line


def _kind(topic: object, message: Mapping[str, Any]) -> str:
    """Return the kind of a message by its topic, or by its fields; one without any field of its kind is none."""
    last = topic.rpartition("/")[2] if isinstance(topic, str) else ""
    if any(name in message for name in (*HEADER, *KINDS.get(last, ()))) and last in KINDS:
        return last
    return next((kind for kind, fields in KINDS.items() if any(name in message for name in fields)), "unknown")


def _robot(topic: object, message: Mapping[str, Any]) -> Robot | None:
    """Return the vehicle by manufacturer and serial number, as its header or the topic names them; None without any."""
    maker, serial = message.get("manufacturer"), message.get("serialNumber")
    if isinstance(maker, str) and isinstance(serial, str) and maker + serial:
        return recorded_robot(f"robot/{maker}.{serial}")
    parts = topic.split("/")[-3:-1] if isinstance(topic, str) else []
    return recorded_robot("robot/" + ".".join(parts)) if len(parts) == 2 and any(parts) else None


def _listed(message: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
    items = message.get(name)
    return [item for item in items if isinstance(item, dict)] if items and isinstance(items, list) else []


def _is_named(message: Mapping[str, Any]) -> bool:
    """Return whether a state names each action, its status, and the type of each error, as the standard requires."""
    actions = [action for name in (OF_ORDER, *BESIDE) for action in _listed(message, name)]
    named = [action.get(name) for action in actions for name in ("actionId", "actionStatus")]
    named += [error.get("errorType") for error in _listed(message, "errors")]
    return all(isinstance(name, str) and name for name in named)


def _order(message: Mapping[str, Any]) -> str:
    return order if isinstance(order := message.get("orderId"), str) else ""


def _subject(order: str) -> RequestSubject[str, str, str | None]:
    return RequestSubject(order, order, None)


def _principals(robot: Robot, decided_by: Any) -> Principals:
    return Parties(requested_by=COORDINATOR, executed_by=robot, supervised_by=None).decided(decided_by)


def _ordered(vehicle: Vehicle, robot: Robot, message: Mapping[str, Any]) -> Iterator[Event]:
    """Yield the arrival of a task and the request to its vehicle; an update of a known order may drop actions."""
    order, told = _order(message), message.get("orderUpdateId")
    update = told if type(told) is int else 0
    if not order or update < vehicle.asked.get(order, 0):
        return
    parts = (*_listed(message, "nodes"), *_listed(message, "edges"))
    released = {f"{act.get('actionId')}": part.get("released") for part in parts for act in _listed(part, "actions")}
    for action in [act for act, of in vehicle.horizon.items() if of == order and act not in released]:
        vehicle.parts.pop(action, None)  # the update has another horizon
        vehicle.unseen.pop(action, None)
    vehicle.horizon = {action: order for action, is_released in released.items() if is_released is False}
    vehicle.parts |= dict.fromkeys(released, order)
    if order not in vehicle.asked:
        yield TaskArrived(task_id=order, robot=robot)
        yield RequestIssued(subject=_subject(order), principals=_principals(robot, COORDINATOR), capability="order")
    vehicle.asked[order] = update


def _changed(vehicle: Vehicle, robot: Robot, message: Mapping[str, Any]) -> Iterator[Event]:
    """Yield the events of what has changed since the previous state."""
    order = _order(message)
    if order and order not in vehicle.accepted:
        vehicle.accepted[order] = None
        yield RequestAccepted(_subject(order), _principals(robot, robot))
    if message.get("errors"):
        yield from _refused(vehicle, robot, message)
    states = _listed(message, OF_ORDER)
    listed = (*states, *(state for name in BESIDE for state in _listed(message, name)))
    has_arrived = message.get("nodeStates") == [] and message.get("edgeStates") == []
    cancels = [state for state in listed if _type(vehicle, state) in CANCELS]
    for state in cancels:
        is_of_last = not has_arrived and state.get("actionStatus") in OVER
        vehicle.cancels.setdefault(state["actionId"], vehicle.order if is_of_last else order)
    vehicle.order = order or vehicle.order
    yield from _vanished(vehicle, robot, order, message)
    given_up = {vehicle.cancels[state["actionId"]] for state in cancels if state.get("actionStatus") != "FAILED"}
    is_cleared = message.get("operatingMode") in CLEARS
    for state in listed:
        is_called_off = order in given_up or (is_cleared and vehicle.parts.get(state["actionId"]) == order)
        yield from _acted(vehicle, robot, order, state, is_called_off)
    for state in cancels:
        if state.get("actionStatus") == "FINISHED":
            yield from _given_up(vehicle, vehicle.cancels[state["actionId"]])
    if is_cleared and has_arrived and not vehicle.had_arrived:
        yield from _given_up(vehicle, vehicle.order)
    vehicle.had_arrived = has_arrived
    is_cancelling = any(state.get("actionStatus") not in OVER for state in cancels)
    if has_arrived and not is_cancelling and order in vehicle.asked and order not in vehicle.ended:
        yield from _over(vehicle, order, states)


def _vanished(vehicle: Vehicle, robot: Robot, order: str, message: Mapping[str, Any]) -> Iterator[Event]:
    """Yield the withdrawal of unfinished actions: their list no longer has them, or is another order's."""
    lists = {name: _listed(message, name) for name in (OF_ORDER, *BESIDE) if isinstance(message.get(name), list)}
    listed = {str(state["actionId"]): name for name, states in lists.items() for state in states}
    for action, name in [*vehicle.listed.items()]:
        action_order, is_of_order = vehicle.orders[action], action in vehicle.parts
        if name not in lists or (action in listed and not (is_of_order and order and action_order != order)):
            continue
        del vehicle.listed[action]
        if vehicle.statuses[action] in OVER:
            continue
        if is_of_order:
            vehicle.unseen[action] = action_order
        if vehicle.statuses.pop(action) in ("RUNNING", "PAUSED", "RETRIABLE"):
            yield ExecutionWithdrawn(Subject(action_order or action, action), robot)
    vehicle.listed |= listed
    for action in listed:
        if vehicle.unseen.get(action) == order:
            del vehicle.unseen[action]


def _type(vehicle: Vehicle, state: Mapping[str, Any]) -> object:
    """Return the type of an action, which a state may leave out."""
    return state.get("actionType") or vehicle.instant.get(str(state.get("actionId")))


def _given_up(vehicle: Vehicle, order: str) -> Iterator[Event]:
    """Yield the end of an order that a vehicle does no more of, unless its end is recorded."""
    if order in vehicle.asked and order not in vehicle.ended:
        vehicle.ended[order] = None
        yield TaskAbandoned(order)


def _over(vehicle: Vehicle, order: str, states: Sequence[Mapping[str, Any]]) -> Iterator[Event]:
    """Yield the end of an order whose nodes and edges are behind the vehicle, unless an action is under way."""
    statuses = {str(state.get("actionId")): state.get("actionStatus") for state in states}
    statuses = {action: status for action, status in statuses.items() if action not in vehicle.instant}
    failed = [action for action, status in statuses.items() if status == "FAILED"]
    # An action of no order may be an instant one, of which only the state was recorded.
    is_seen = OVER.issuperset(statuses.values()) and order not in vehicle.unseen.values()
    if is_seen and all(action in vehicle.parts for action in failed):
        vehicle.ended[order] = None
        yield TaskAbandoned(order) if failed else TaskCompleted(order)


def _refused(vehicle: Vehicle, robot: Robot, message: Mapping[str, Any]) -> Iterator[Event]:
    """Yield the vehicle's refusal of an order that it has not accepted: an error refers to it."""
    for error in _listed(message, "errors"):
        for reference in _listed(error, "errorReferences"):
            order = reference.get("referenceValue")
            is_order = reference.get("referenceKey") == "orderId" and isinstance(order, str)
            if not is_order or order in vehicle.accepted or order not in vehicle.asked or order in vehicle.refused:
                continue
            vehicle.refused[order] = None
            yield RequestDenied(_subject(order), _principals(robot, robot), f"{error.get('errorType')}")


def _acted(vehicle: Vehicle, robot: Robot, order: str, state: Mapping[str, Any], is_cancelled: bool) -> Iterator[Event]:
    """Yield the events of one action since the last state. The rest of a cancelled order has not failed."""
    action, status = str(state.get("actionId")), str(state.get("actionStatus"))
    previous = vehicle.statuses.get(action)
    is_of_another = vehicle.orders.get(action) != order
    if previous in OVER and is_of_another and (status not in OVER or vehicle.parts.get(action) == order):
        previous = None  # this order has an action of the same name
    if status == previous or previous == "FINISHED":
        return
    began_under = order if previous is None else vehicle.orders[action]
    vehicle.statuses[action], vehicle.orders[action] = status, began_under
    subject = Subject(began_under or action, action)  # without an order an action is a task of its own
    parties = Parties(requested_by=None, executed_by=robot, supervised_by=None)
    if status == "RUNNING":
        if previous in ("PAUSED", "RETRIABLE"):
            yield ExecutionResumed(subject, robot)
        else:
            action_type = state.get("actionType")
            capability = action_type if isinstance(action_type, str) and action_type else "action"
            yield ExecutionStarted(subject=subject, principals=parties, robot=robot, capability=capability)
    elif status == "PAUSED":
        yield ExecutionPaused(subject, robot)
    elif status == "FINISHED":
        yield ExecutionFinished(subject, parties, robot)
    elif status == "FAILED" and is_cancelled and previous != "RETRIABLE":
        if previous in ("RUNNING", "PAUSED"):
            yield ExecutionWithdrawn(subject, robot)
    elif status in ("FAILED", "RETRIABLE"):
        if previous != "RETRIABLE":
            vehicle.failures[action] = vehicle.failures.get(action, 0) + 1
            cause = str(state.get("actionResult") or state.get("resultDescription") or status)
            yield ExecutionFailed(subject=subject, robot=robot, failure=vehicle.failures[action], cause=cause)
        if status == "FAILED":  # for good: what may be tried again is RETRIABLE, and before 3.0 nothing is
            yield ExecutionWithdrawn(subject, robot, vehicle.failures[action])


def _connected(vehicle: Vehicle, robot: Robot, message: Mapping[str, Any]) -> Iterator[Event]:
    state = message.get("connectionState")
    if state in LOST and not vehicle.is_down:
        vehicle.is_down = True
        yield LinkWentDown(robot)
    elif state == "ONLINE" and vehicle.is_down:
        vehicle.is_down = False
        yield LinkCameUp(robot)
