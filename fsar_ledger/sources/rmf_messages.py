"""Messages of Open-RMF as records: their kinds, values, objects and times.

The schemas are those of https://github.com/open-rmf/rmf_api_msgs, version 0.3. No field is relied on: one that is
missing, or of another kind, is treated as absent.
"""

from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from typing import Any

from fsar_ledger.base import utc
from fsar_ledger.base.printable import escaped
from fsar_ledger.events.envelope import Robot, recorded_robot

from .adapter import Record, json_text

UNKNOWN = "unknown"
RESPONSE = "response"
REQUESTS = frozenset(
    f"{name}_request"
    for name in (
        *("dispatch_task", "robot_task", "cancel_task", "kill_task", "interrupt_task", "resume_task", "rewind_task"),
        *("skip_phase", "undo_skip_phase", "robot_commission"),
    )
)
UPDATES = ("task_state", "task_log", "fleet_log", "fleet_state")
"""In the order in which a message without a type is tried."""

TIERS = ("uninitialized", "info", "warning", "error")
OF_TASK = (
    *("status", "category", "detail", "unix_millis_start_time", "unix_millis_finish_time", "assigned_to", "dispatch"),
    *("active", "completed", "cancellation", "killed", "interruptions"),
)
BEGUN = frozenset(("underway", "delayed", "blocked", "error", "completed"))
TROUBLED = frozenset(("failed", "error", "blocked", "skipped", "canceled", "killed"))
"""The statuses of an event within a phase that are recorded beside the status of the task."""
LAST_MS = int(datetime.fromisoformat("9999-12-31T00:00:00+00:00").timestamp() * 1000)


def record_of(raw: bytes, line: dict[str, Any]) -> Record:
    """Return a message as a record; its data are its kind and content, or None if it is not a message of RMF."""
    kind, data = _message(line)
    arrival_us = utc.read_us(line.get("received"))
    if kind == UNKNOWN:
        values = {name: json_text(item) for name, item in line.items()}
        return Record(text(line, "type") or UNKNOWN, raw, None, values, {}, None, arrival_us)
    about: dict[str, str] = {}
    match kind:
        case "task_state":
            values, kind_of = _state_values(data, about), f"task_state/{text(data, 'status') or UNKNOWN}"
        case "task_log":
            log_entries = list(entries(data))
            values = {location: f"{item.get('tier')}: {item.get('text')}" for location, item in log_entries}
            worst = max((_tier(item) for _, item in log_entries), default=0)
            kind_of = f"task_log/{TIERS[worst]}"
            _add(about, f"task/{data['task_id']}", "task")
        case "fleet_state":
            values, kind_of = _fleet_values(data, about), kind
        case "fleet_log":
            values, kind_of = {name: json_text(item) for name, item in data.items()}, kind
            _add(about, f"fleet/{data['name']}", "fleet")
        case _:
            values = _request_values(data, about)
            kind_of = kind if kind != RESPONSE else f"{RESPONSE}/{'accepted' if data['success'] else 'refused'}"
    return Record(kind_of, raw, (kind, data), values, about, _time_us(kind, data), arrival_us)


def _message(line: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """Return the kind of a message by its type or its fields, and its content."""
    type_name = text(line, "type")
    if type_name in REQUESTS:
        return type_name, line
    if type_name.endswith("_update"):
        kind, data = type_name.removesuffix("_update"), table(line, "data")
        return (kind, data) if _is_of(kind, data) else (UNKNOWN, line)
    if isinstance(line.get("success"), bool):
        return RESPONSE, line
    return next(((kind, line) for kind in UPDATES if _is_of(kind, line)), (UNKNOWN, line))


def _is_of(kind: str, data: Mapping[str, Any]) -> bool:
    """Return whether the data are a message of this kind: they name what they are about, as its schema demands."""
    match kind:
        case "task_state":
            return bool(task_id(data))
        case "task_log":
            return bool(text(data, "task_id")) and ("log" in data or "phases" in data)
        case "fleet_log":
            return bool(text(data, "name")) and "log" in data
        case "fleet_state":
            return bool(text(data, "name")) and isinstance(data.get("robots"), dict)
    return False


def _state_values(state: Mapping[str, Any], about: dict[str, str]) -> dict[str, str]:
    """Return the values of a task state: of the task, its booking, and what went wrong in its phases."""
    booking = table(state, "booking")
    _add(about, f"task/{booking['id']}", "task")
    if (robot := assigned_robot(state)) is not None:
        _add(about, robot, "assigned robot")
    assignment = table(table(state, "dispatch"), "assignment")
    if fleet := text(assignment, "fleet_name"):
        _add(about, f"fleet/{fleet}", "dispatched to")
    if requester := text(booking, "requester"):
        _add(about, requester, "requester")
    _label(about, booking, "booking label")
    _label(about, table(state, "cancellation"), "cancellation label")
    _label(about, table(state, "killed"), "kill label")
    values = {f"booking/{name}": json_text(item) for name, item in booking.items()}
    values |= {name: json_text(item) for name in OF_TASK if (item := state.get(name)) or item == 0}
    for item in tables(table(state, "interruptions")).values():
        _label(about, item, "interruption label")
        _label(about, table(item, "resumed_by"), "resume label")
    for number, phase in tables(table(state, "phases")).items():
        if phase.get("skip_requests"):
            values[f"phase/{number}/skip_requests"] = json_text(phase["skip_requests"])
        for event_id, event in tables(table(phase, "events")).items():
            if text(event, "status") in TROUBLED:
                values[f"phase/{number}/event/{event_id}"] = json_text(event)
    return values


def _fleet_values(fleet: Mapping[str, Any], about: dict[str, str]) -> dict[str, str]:
    """Return the state of each robot of a fleet."""
    _add(about, f"fleet/{fleet['name']}", "fleet")
    values = {}
    for name, state in tables(table(fleet, "robots")).items():
        robot = f"robot/{fleet['name']}.{name}"
        values[robot] = json_text(state)
        _add(about, robot, "robot")
        if task := text(state, "task_id"):
            _add(about, f"task/{task}", "task")
    return values


def _request_values(message: Mapping[str, Any], about: dict[str, str]) -> dict[str, str]:
    """Return the values of a request or a response, and add its objects, such as the requester, if it names one."""
    request = table(message, "request")
    for task in (text(message, "task_id"), text(message, "for_task"), task_id(table(message, "state"))):
        if task:
            _add(about, f"task/{task}", "task")
    if requester := text(request, "requester"):
        _add(about, requester, "requester")
    _label(about, request, "request label")
    _label(about, message, "request label")
    fleet, robot = text(message, "fleet"), text(message, "robot")
    if robot:
        _add(about, f"robot/{fleet}.{robot}" if fleet else f"robot/{robot}", "asked robot")
    values = {name: json_text(item) for name, item in message.items() if name not in ("request", "type", "state")}
    values |= {f"request/{name}": json_text(item) for name, item in request.items()}
    state = table(message, "state")
    return values | (
        {f"state/{name}": item for name, item in _state_values(state, about).items()} if task_id(state) else {}
    )


def _time_us(kind: str, data: Mapping[str, Any]) -> int | None:
    """Return the latest time in a message at which something happened; it is used as the time of the message.

    The start and the finish of a task are plans until it has begun and ended.
    """
    candidates: list[object] = []
    match kind:
        case "task_state":
            status = text(data, "status")
            parts = [data.get(name) for name in ("booking", "cancellation", "killed")]
            parts += table(data, "interruptions").values()
            candidates = [item.get("unix_millis_request_time") for item in parts if isinstance(item, dict)]
            candidates += [data.get("unix_millis_start_time")] if status in BEGUN else []
            candidates += [data.get("unix_millis_finish_time")] if status == "completed" else []
        case "task_log":
            candidates = [entry.get("unix_millis_time") for _, entry in entries(data)]
        case "fleet_state":
            candidates = [item.get("unix_millis_time") for item in tables(table(data, "robots")).values()]
        case "response":
            return _time_us("task_state", table(data, "state")) if data.get("state") else None
        case _:
            candidates = [table(data, "request").get("unix_millis_request_time")]
    times = [item for item in candidates if type(item) is int and 0 < item < LAST_MS]
    return max(times) * 1000 if times else None


def entries(log: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield each entry of the log of a task with its location: the task, a phase, or an event of a phase."""
    yield from _listed("log", log.get("log"))
    for number, phase in tables(table(log, "phases")).items():
        yield from _listed(f"phase/{number}/log", phase.get("log"))
        for event, entries in table(phase, "events").items():
            yield from _listed(f"phase/{number}/event/{event}", entries)


def _listed(location: str, entries: object) -> Iterator[tuple[str, dict[str, Any]]]:
    listed: Sequence[object] = entries if isinstance(entries, list) else ()
    for index, entry in enumerate(listed):
        if isinstance(entry, dict):
            yield f"{location}/{index}", entry


def _tier(entry: Mapping[str, Any]) -> int:
    tier = entry.get("tier")
    return TIERS.index(tier) if tier in TIERS else 0


def assigned_robot(state: Mapping[str, Any]) -> Robot | None:
    """Return the robot that a task is assigned to, by its fleet and name."""
    assigned = table(state, "assigned_to")
    fleet, name = text(assigned, "group"), text(assigned, "name")
    return recorded_robot(escaped(f"robot/{fleet}.{name}" if fleet else f"robot/{name}")) if name else None


def task_id(state: Mapping[str, Any]) -> str:
    """Return the name of the task of a state, empty if there is none."""
    return text(table(state, "booking"), "id")


def _label(about: dict[str, str], data: Mapping[str, Any], part: str) -> None:
    """Add each label as an object: labels name the requester, in the words of the program that sent the request."""
    for label in texts(data, "labels") if data else ():
        _add(about, label, part)


def _add(about: dict[str, str], name: str, part: str) -> None:
    """Add an object with its part; one with several parts gets all of them."""
    parts = about.get(name)
    if parts is None:
        about[name] = part
    elif part not in parts.split(", "):
        about[name] = f"{parts}, {part}"


def table(data: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return the object of this name, empty if there is none."""
    item = data.get(name)
    return item if isinstance(item, dict) else {}


def tables(data: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the values that are objects, by name."""
    return {name: item for name, item in data.items() if isinstance(item, dict)}


def text(data: Mapping[str, Any], name: str) -> str:
    """Return the text of this name, empty if there is none."""
    item = data.get(name)
    return item if isinstance(item, str) else ""


def texts(data: Mapping[str, Any], name: str) -> list[str]:
    """Return the nonempty texts in the list of this name."""
    listed = data.get(name)
    return [item for item in listed if isinstance(item, str) and item] if isinstance(listed, list) else []
