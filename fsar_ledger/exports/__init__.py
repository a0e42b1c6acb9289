"""A ledger in the formats of other systems, as `export --as` writes them, and what the formats share.

An event names robots and other principals, tasks, actions and requests, each in its role. Which columns name a
principal follows from the types of the events' fields; the others are listed.
"""

from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from typing import Any, NamedTuple, get_args, get_origin, get_type_hints

import msgspec

from fsar_ledger.base import printable, utc
from fsar_ledger.base.errors import UsageError
from fsar_ledger.events import EVENT_TYPES
from fsar_ledger.events.envelope import Agent, Coordinator, Part, Robot, Service, Supervisor


class ExportedFile(NamedTuple):
    """The number of events in a file, and notes about it, a line each."""

    events: int
    notes: tuple[str, ...]


def elements(documents: Iterable[object]) -> Iterator[bytes]:
    """Yield each document as an element of a JSON array, on a line of its own, without the brackets."""
    separator = b"\n"
    for document in documents:
        yield separator + msgspec.json.encode(document)
        separator = b",\n"


LATEST_YEAR = 9000
"""Leaves room for the longest run, of 2^53 microseconds, before the last year that a date can have."""
TOLD = "times count from 1970-01-01T00:00:00Z in runs whose first event names no epoch"


def epoch_us(run: str, epoch: str | None, earliest: datetime = utc.EPOCH) -> int:
    """Return run time 0 in microseconds since 1970, from the epoch that event 0 of a run names; 0 if it names none.

    Raises: UsageError if that is not a time in ISO 8601 from `earliest` to `LATEST_YEAR`; most formats count from 1970.
    """
    if epoch is None:
        return 0
    try:
        time = utc.parsed(epoch)
        if not earliest <= time <= datetime(LATEST_YEAR, 1, 1, tzinfo=UTC):
            raise ValueError("too early or too late")
    except ValueError as error:
        raise UsageError(
            f"run {printable.value(run)}: found the epoch {printable.value(epoch)}, expected a time in ISO 8601 "
            f"between {earliest.year} and {LATEST_YEAR}; name another run"
        ) from error
    return utc.microseconds(time)


def rfc3339(time_us: int) -> str:
    """Return a time in UTC from its microseconds since 1970."""
    return utc.shown_us(time_us, "microseconds")


PRINCIPALS = ("robot", "supervisor", "service", "agent", "coordinator")
"""The kinds of principals; a name says its kind before the first slash."""
OTHER = "principal"
"""The kind of a principal whose name, recorded by another system, begins with none of these."""

_COLUMNS = {
    "task_id": "task",
    "action_id": "action",
    "failed_action": "action",
    "preempted_by": "action",
    "parent": "action",
    "request_id": "request",
}
"""The kind of what each column names, if that is not a principal."""
_ROLES = {
    "requested_by": "requester",
    "executed_by": "executor",
    "supervised_by": "supervisor",
    "decided_by": "decider",
    "task_id": "task",
    "action_id": "action",
    "request_id": "request",
}
"""The role of what each column names, if that is not the name of the column."""
_PRINCIPAL_TYPES = {Robot, Supervisor, Service, Agent, Coordinator}


class Named(NamedTuple):
    """Something that an event names. `label` begins with the kind and a slash, so no two kinds share one."""

    kind: str
    label: str


def named_in(columns: Mapping[str, Any]) -> dict[Named, str]:
    """Return what the columns of an event name, with its role; several roles of one are joined by `, `."""
    roles: dict[Named, list[str]] = {}
    for column, value in columns.items():
        if column in NAMING and value is not None:
            for name in (value,) if isinstance(value, str) else value:
                roles.setdefault(_named_object(column, name), []).append(NAMING[column])
    return {named: ", ".join(dict.fromkeys(names)) for named, names in roles.items()}


def _named_object(column: str, name: str) -> Named:
    if column in _COLUMNS:
        return Named(_COLUMNS[column], f"{_COLUMNS[column]}/{name}")
    kind = name.partition("/")[0]
    return Named(kind, name) if kind in PRINCIPALS else Named(OTHER, f"{OTHER}/{name}")


def _hints(kind: type) -> Iterator[tuple[str, Any]]:
    """Yield the columns of an event type, or of a part of one, with the types of their values."""
    for name, hint in get_type_hints(kind).items():
        part = get_origin(hint) or hint
        if isinstance(part, type) and issubclass(part, Part):
            yield from _hints(part)
        else:
            yield name, hint


def _is_principal(hint: Any) -> bool:
    return hint in _PRINCIPAL_TYPES or any(map(_is_principal, get_args(hint)))


_PRINCIPAL_COLUMNS = {name for kind in EVENT_TYPES for name, hint in _hints(kind) if _is_principal(hint)}
NAMING: Mapping[str, str] = {
    column: _ROLES.get(column, column.replace("_", " ")) for column in sorted(_PRINCIPAL_COLUMNS | _COLUMNS.keys())
}
"""The role of what each column names, of the columns that name something."""
