"""Small logs of OCEL 2.0, of our own making by the published schemas: JSON, SQLite, and our own events in them."""

import sqlite3
from collections.abc import Iterable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import msgspec

Log = dict[str, Any]
BEGINS = datetime(2026, 3, 1, 10, tzinfo=UTC)


def event(name: str, kind: str, at_s: float, *, run: str | None = None, **columns: Any) -> Log:
    """An event; a column whose name is a qualifier or `on_behalf_of` and the like names an object."""
    prefix = "" if run is None else f"{run}:"
    roles: dict[str, list[str]] = {}
    attributes = []
    for column, value in columns.items():
        if isinstance(value, str) and "/" in value and column != "action":
            roles.setdefault(prefix + value, []).append(column.replace("_", " "))
        elif column in ("task", "action", "request"):
            roles.setdefault(f"{prefix}{column}/{value}", []).append(column)
        else:
            attributes.append({"name": column, "value": value})
    return {
        "id": name,
        "type": kind,
        "time": (BEGINS + timedelta(seconds=at_s)).isoformat().replace("+00:00", "Z"),
        "attributes": attributes,
        "relationships": [{"objectId": one, "qualifier": ", ".join(found)} for one, found in roles.items()],
    }


def log(events: Iterable[Log], objects: Iterable[Log] = (), also: Iterable[str] = ()) -> Log:
    """A log of these, which declares other types of events, too."""
    events, objects = list(events), list(objects)
    names = dict.fromkeys(one["objectId"] for each in events for one in each["relationships"])
    for name in names.keys() - {one["id"] for one in objects}:
        kind = name.rpartition(":")[2].partition("/")[0]
        objects.append({"id": name, "type": kind, "attributes": [], "relationships": []})
    objects.sort(key=lambda one: str(one["id"]))
    types = {one["type"]: {each["name"] for each in one["attributes"]} for one in events}
    return {
        "eventTypes": [
            {"name": kind, "attributes": [{"name": one, "type": "string"} for one in sorted(types.get(kind, ()))]}
            for kind in sorted({*types, *also})
        ],
        "objectTypes": [{"name": kind, "attributes": []} for kind in sorted({one["type"] for one in objects})],
        "events": events,
        "objects": objects,
    }


def orders() -> Log:
    """A log of a shop, which knows nothing of robots; one of its types has a name of ours."""
    order = {
        "id": "o1",
        "type": "order",
        "attributes": [
            {"name": "price", "time": "1970-01-01T00:00:00Z", "value": 10},
            {"name": "price", "time": "2026-03-01T10:00:05Z", "value": 9},
        ],
        "relationships": [{"objectId": "i1", "qualifier": "contains"}],
    }
    events = [
        event("e2", "pack item", 20),
        event("e1", "place order", 10, channel="web"),
        event("e3", "TaskCompleted", 30),
    ]
    for one, name in zip(events, ("i1", "o1", "o1"), strict=True):
        one["relationships"] = [{"objectId": name, "qualifier": "the thing"}, {"objectId": name, "qualifier": "again"}]
    return log(events, [order])


CONTEXT = (
    *("AssistanceAdmitted", "AssistanceEnded", "AssistanceRequested", "AuthorityGranted", "AuthorityRevoked"),
    *("ExecutionFailed", "ExecutionHeld", "FailureResolved", "RequestUnanswered", "RobotDeparted", "RobotReturned"),
    *("FleetRuleLearned", "PolicyRuleSet", "PolicyConflictEscalated", "ReassignmentDecided", "RecoveryAttempted"),
    *("RecoveryAttemptFailed", "RecoveryEscalated", "RequestDenied", "RequestRelayed", "RolePolicyRuleSet"),
    *("SupervisorCalled", "SupervisorLeft", "SupervisorResponded", "SupervisorReturned"),
)
"""Types that the log of a run declares although nothing of the kind happened."""


def parties(requester: str, executor: str) -> Log:
    return {"requester": requester, "executor": executor, "supervisor": executor.replace("robot/", "supervisor/")}


ENDED = {"result": "success"}


def honest_events() -> list[Log]:
    """A run as it is exported: A does a step of its own and has B do the next, while no policy forbids it."""
    a, b = "robot/A", "robot/B"
    own = {"task": "T1", "action": "T1/1", **parties(a, a)}
    asked = {"task": "T1", "action": "T1/2", **parties(a, b)}
    named = {"request": "r", "carried_policy": "allow"}
    told: list[tuple[str, Log]] = [
        ("RobotJoined", {"robot": a, "supervisor": "supervisor/A", "role": "carrier"}),
        ("RobotJoined", {"robot": b, "supervisor": "supervisor/B", "role": "door"}),
        ("PolicyWindowOpened", {"robot": b, "scope": "local", "window": "w", "outcome": "deny"}),
        ("PolicyWindowClosed", {"robot": b, "scope": "local", "window": "w"}),
        ("OwnStepDecided", {**own, "decider": a, "path": a, "capability": "go"}),
        ("ExecutionStarted", {**own, "robot": a, "on_behalf_of": a, "capability": "go"}),
        ("ExecutionFinished", {**own, "robot": a, **ENDED}),
        ("RequestIssued", {**asked, **named, "decider": a, "path": a, "capability": "open"}),
        ("RequestAdmitted", {**asked, "decider": b, "path": b, "outcome": "allow"}),
        ("RequestAccepted", {**asked, "decider": b, "path": b}),
        ("ExecutionStarted", {**asked, "robot": b, "on_behalf_of": a, "capability": "open"}),
        ("ExecutionFinished", {**asked, "robot": b, **ENDED}),
        ("RequestClosed", {**asked, "decider": "service/coordination", "path": "service/coordination", **ENDED}),
    ]
    return [
        event(f"1:{at}", kind, at, run="1", **columns, seq=at, caused_by=at - 1)
        for at, (kind, columns) in enumerate(told, 1)
    ]


def written(found: Log) -> bytes:
    return msgspec.json.encode(found)


def database(path: Path, found: Log) -> Path:
    """Write a log as SQLite."""
    with sqlite3.connect(path) as made:
        for part in ("event", "object"):
            made.execute(f"CREATE TABLE {part} (ocel_id TEXT PRIMARY KEY, ocel_type TEXT)")
            made.execute(f"CREATE TABLE {part}_map_type (ocel_type TEXT, ocel_type_map TEXT)")
            for kind in found[f"{part}Types"]:
                _table(made, part, kind["name"], [one for one in found[f"{part}s"] if one["type"] == kind["name"]])
        made.execute("CREATE TABLE event_object (ocel_event_id TEXT, ocel_object_id TEXT, ocel_qualifier TEXT)")
        made.execute("CREATE TABLE object_object (ocel_source_id TEXT, ocel_target_id TEXT, ocel_qualifier TEXT)")
        for part, table in (("events", "event_object"), ("objects", "object_object")):
            rows = [(one["id"], it["objectId"], it["qualifier"]) for one in found[part] for it in one["relationships"]]
            made.executemany(f"INSERT INTO {table} VALUES (?, ?, ?)", rows)
    made.close()
    return path


def _table(made: sqlite3.Connection, part: str, kind: str, items: list[Log]) -> None:
    name = "".join(filter(str.isalnum, kind))
    made.execute(f"INSERT INTO {part}_map_type VALUES (?, ?)", (kind, name))
    made.executemany(f"INSERT INTO {part} VALUES (?, ?)", [(one["id"], kind) for one in items])
    columns = list(dict.fromkeys(each["name"] for one in items for each in one["attributes"]))
    more = "" if part == "event" else ', "ocel_changed_field"'
    made.execute(f'CREATE TABLE "{part}_{name}" (ocel_id, ocel_time{more}{"".join(f", {one}" for one in columns)})')
    for one in items:
        whole = {each["name"]: each["value"] for each in one["attributes"]}
        states = [(one["time"], whole)] if part == "event" else []
        if part == "object":
            times = sorted({each["time"] for each in one["attributes"]}) or ["1970-01-01T00:00:00Z"]
            states = [(time, {e["name"]: e["value"] for e in one["attributes"] if e["time"] == time}) for time in times]
        for time, values in states:
            row = {"ocel_id": one["id"], "ocel_time": time, **values}
            names, marks = ", ".join(row), ", ".join("?" for _ in row)
            made.execute(f'INSERT INTO "{part}_{name}" ({names}) VALUES ({marks})', list(row.values()))
