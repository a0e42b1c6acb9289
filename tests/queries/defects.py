"""Ways to put a defect into the rows of a real run: each changes the rows and returns the positions that must be
caught."""

from collections.abc import Callable
from typing import Any

import msgspec

Row = dict[str, Any]
Seeds = Callable[[list[Row]], list[int]]
"""Puts a defect into the rows and says at which positions it shows."""


def where(rows: list[Row], name: str, **fields: Any) -> list[int]:
    """The positions of the events of this type with these values (a callable: that satisfy it), in order."""
    matches = {
        key: value if callable(value) else (lambda found, value=value: found == value) for key, value in fields.items()
    }
    return [
        at
        for at, row in enumerate(rows)
        if row["type"].partition(".")[0] == name and all(match(row[key]) for key, match in matches.items())
    ]


def robots(name: str | None) -> bool:
    return name is not None and name.startswith("robot/")


def forged(name: str, change: dict[str, Any], nth: int = 0, **fields: Any) -> Seeds:
    """One event of this type says something else."""

    def seed(rows: list[Row]) -> list[int]:
        at = where(rows, name, **fields)[nth]
        rows[at] = {**rows[at], **change}
        return [at]

    return seed


def delegated_start(rows: list[Row]) -> int:
    return next(at for at in where(rows, "ExecutionStarted") if rows[at]["robot"] != rows[at]["on_behalf_of"])


def of_delegated_start(change: dict[str, Any]) -> Seeds:
    """The record of an execution for another robot, whose supervisor is on shift, says something else."""

    def seed(rows: list[Row]) -> list[int]:
        at = next(
            at
            for at in where(rows, "ExecutionStarted", supervised_by=lambda found: found is not None)
            if rows[at]["robot"] != rows[at]["on_behalf_of"]
        )
        rows[at] = {**rows[at], **change}
        return [at]

    return seed


def lost(name: str) -> Seeds:
    """Lose the events of this type of a delegated action: they become an event that says nothing of it."""

    def seed(rows: list[Row]) -> list[int]:
        start = delegated_start(rows)
        key = ("run_id", "action_id")
        for at in where(rows, name):
            if all(rows[at][column] == rows[start][column] for column in key):
                rows[at] = {**rows[at], "action_id": None}
        return [start]

    return seed


def swapped(name: str, other: str) -> Seeds:
    """An event of the first type and the next one of the other type of the same action have changed places."""

    def seed(rows: list[Row]) -> list[int]:
        for at in where(rows, name):
            key = (rows[at]["run_id"], rows[at]["action_id"])
            later = [
                place
                for place in where(rows, other)
                if place > at and (rows[place]["run_id"], rows[place]["action_id"]) == key
            ]
            if later and (name != "RequestAccepted" or rows[later[0]]["robot"] != rows[later[0]]["on_behalf_of"]):
                rows[at], rows[later[0]] = rows[later[0]], rows[at]
                for column in ("seq", "time_us"):
                    rows[at][column], rows[later[0]][column] = rows[later[0]][column], rows[at][column]
                return [at]
        raise AssertionError(f"no {name} before {other}")

    return seed


def before_start(name: str, change: dict[str, Any]) -> Seeds:
    """An event of this type about the action stands just before a delegated execution, in place of another action's
    event."""

    def seed(rows: list[Row]) -> list[int]:
        start = next(
            at
            for at in where(rows, "ExecutionStarted")
            if rows[at]["robot"] != rows[at]["on_behalf_of"] and is_free(rows[at - 1])
        )
        about = {key: rows[start][key] for key in ("action_id", "robot")}
        put(rows, start - 1, {"type": f"{name}.v1", **about, **change})
        return [start]

    return seed


def free_before(rows: list[Row], start: int, most: int) -> int | None:
    """The last place before this one, of its run and fewer than `most` away, whose event no invariant judges."""
    near = range(start - 1, max(start - most, 0), -1)
    return next((at for at in near if is_free(rows[at]) and rows[at]["run_id"] == rows[start]["run_id"]), None)


def put(rows: list[Row], place: int, said: dict[str, Any]) -> None:
    """Put another event in this place, at its time and for its cause."""
    kept = {column: rows[place][column] for column in ("run_id", "seq", "time_us", "caused_by")}
    rows[place] = {**dict.fromkeys(rows[place]), **kept, **said}


def is_free(row: Row) -> bool:
    return row["type"] in (
        *("RoutineDue.v1", "RoutinePerformed.v1", "ContextChanged.v1"),
        *("PeersMet.v1", "ObstructionAppeared.v1", "ApproachStarted.v1"),
    )


def under_its_own_deny(name: str) -> Seeds:
    """A window of the robot's own policy opened before this event, and nothing heeded it."""

    def seed(rows: list[Row]) -> list[int]:
        for start in where(rows, name, **({"operation": "motion"} if name == "RoutinePerformed" else {})):
            free = free_before(rows, start, 6)
            if free is not None:
                window = {
                    "type": "PolicyWindowOpened.v1",
                    "robot": rows[start]["robot"],
                    "scope": "local",
                    "window": "seeded",
                    "outcome": "deny",
                }
                put(rows, free, window)
                return [start]
        raise AssertionError(f"no place before {name}")

    return seed


def carried(outcome: str) -> Seeds:
    """The request of an admitted action carried another policy than it said."""

    def seed(rows: list[Row]) -> list[int]:
        admitted = where(rows, "RequestAdmitted", outcome="allow")[0]
        key = (rows[admitted]["run_id"], rows[admitted]["action_id"])
        for at in where(rows, "RequestIssued"):
            if (rows[at]["run_id"], rows[at]["action_id"]) == key:
                rows[at] = {**rows[at], "carried_policy": outcome}
        return [admitted]

    return seed


def at_its_start(seed: Seeds) -> Seeds:
    """The same defect, which shows when the action of that event is executed."""

    def seed_and_follow(rows: list[Row]) -> list[int]:
        (at,) = seed(rows)
        key = {column: rows[at][column] for column in ("run_id", "action_id")}
        return [next(place for place in where(rows, "ExecutionStarted", **key) if place > at)]

    return seed_and_follow


def in_place_before(name: str, inserted: str, change: dict[str, Any], kept: tuple[str, ...], **fields: Any) -> Seeds:
    """An event that never was stands before one of this type, in place of another's that no invariant judges; it shows
    at itself."""

    def seed(rows: list[Row]) -> list[int]:
        for at in where(rows, name, **fields):
            free = free_before(rows, at, 12)
            if free is not None:
                put(rows, free, {**{column: rows[at][column] for column in kept}, "type": f"{inserted}.v1", **change})
                return [free]
        raise AssertionError(f"no place before {name}")

    return seed


def revoked_before_admission(rows: list[Row]) -> list[int]:
    """Revoke the right to ask before a request is admitted; it shows at the admission."""
    for at in where(rows, "RequestAdmitted"):
        free = free_before(rows, at, 12)
        if free is not None:
            said = {
                "type": "AuthorityRevoked.v1",
                "requested_by": rows[at]["requested_by"],
                "reason": "human override",
                "decided_by": "supervisor/fleet",
            }
            put(rows, free, said)
            return [at]
    raise AssertionError("no place before an admission")


def delegated_end(rows: list[Row]) -> int:
    start = delegated_start(rows)
    return next(
        at
        for at in where(rows, "ExecutionFinished", run_id=rows[start]["run_id"], action_id=rows[start]["action_id"])
        if at > start
    )


def finished_by_another(rows: list[Row]) -> list[int]:
    at = delegated_end(rows)
    rows[at] = {**rows[at], "robot": "robot/Z1", "executed_by": "robot/Z1"}
    return [at]


def never_closed(rows: list[Row]) -> list[int]:
    end = delegated_end(rows)
    (closed,) = where(rows, "RequestClosed", run_id=rows[end]["run_id"], action_id=rows[end]["action_id"])
    rows[closed] = {**rows[closed], "action_id": None}
    return [end]


def without(name: str, shows_at: str, **fields: Any) -> Seeds:
    """Lose the last event of this type about an action; it shows at the next one of the other type."""

    def seed(rows: list[Row]) -> list[int]:
        shown = where(rows, shows_at, **fields)[0]
        about = {rows[shown]["action_id"], rows[shown]["failed_action"]} - {None}
        key = rows[shown]["run_id"]
        lost = [
            at
            for at in where(rows, name)
            if at < shown and rows[at]["run_id"] == key and about & {rows[at]["action_id"], rows[at]["failed_action"]}
        ]
        assert lost, f"no {name} before {shows_at}"
        rows[lost[-1]] = {**rows[lost[-1]], "type": "PeersMet.v1", "action_id": None, "failed_action": None}
        return [shown]

    return seed


def an_hour_later(name: str, **fields: Any) -> Seeds:
    """This event and all that follows in its run come an hour later."""

    def seed(rows: list[Row]) -> list[int]:
        at = where(rows, name, **fields)[0]
        for row in rows[at:]:
            if row["run_id"] == rows[at]["run_id"]:
                row["time_us"] += 3_600_000_000
        return [at]

    return seed


def beyond(name: str, change: dict[str, int]) -> Seeds:
    """Found the fleet with another budget, which what was done overran."""

    def seed(rows: list[Row]) -> list[int]:
        at = where(rows, name)[0]
        founded = next(place for place in where(rows, "RunStarted") if rows[place]["run_id"] == rows[at]["run_id"])
        parameters = msgspec.json.decode(rows[founded]["parameters"])
        parameters["structure"] |= change
        rows[founded] = {**rows[founded], "parameters": msgspec.json.encode(parameters).decode()}
        return [at]

    return seed


def joined_again(rows: list[Row]) -> list[int]:
    first, second = where(rows, "RobotJoined")[:2]
    rows[second] = {**rows[second], "robot": rows[first]["robot"]}
    return [second]
