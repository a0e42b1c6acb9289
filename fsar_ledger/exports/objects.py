"""What an event names: robots and other principals, tasks, actions and requests, each in its role.

Which columns name a principal follows from the types of the events' fields; the others are listed.
"""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple, get_args, get_origin, get_type_hints

from fsar_ledger.events import EVENT_TYPES
from fsar_ledger.events.envelope import Agent, Coordinator, Part, Robot, Service, Supervisor

PRINCIPALS = ("robot", "supervisor", "service", "agent", "coordinator")
"""The kinds of principals; a name says its kind before the first slash."""
OTHER = "principal"
"""The kind of a principal whose name, which another system recorded, says none of these."""

_COLUMNS = {
    "task_id": "task",
    "action_id": "action",
    "failed_action": "action",
    "preempted_by": "action",
    "parent": "action",
    "request_id": "request",
}
"""By column, the kind of what it names, if that is no principal."""
_ROLES = {
    "requested_by": "requester",
    "executed_by": "executor",
    "supervised_by": "supervisor",
    "decided_by": "decider",
    "task_id": "task",
    "action_id": "action",
    "request_id": "request",
}
"""By column, the role of what it names, if that is not the name of the column."""
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
                roles.setdefault(_named(column, name), []).append(NAMING[column])
    return {one: ", ".join(dict.fromkeys(found)) for one, found in roles.items()}


def _named(column: str, name: str) -> Named:
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
"""By column that names something, the role of that."""
