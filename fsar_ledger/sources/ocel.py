"""OCEL 2.0 (ocel-standard.org, 2023), in JSON or SQLite: events with the objects that they are about.

Memory grows with a file in JSON; a database is read row by row.

| in the log | becomes |
|---|---|
| an object | a record `object/TYPE`, with its attributes and what it is related to |
| an event | a record of its type, with its attributes and its objects, each with its qualifiers |
| an event of a type of ours, with objects and attributes as `export --as ocel` writes them | the event itself |
| any other event | an observation |

The qualifiers `requester`, `executor`, `supervisor`, `decider`, `task`, `action` and `request` name the columns
`requested_by`, `executed_by`, `supervised_by`, `decided_by`, `task_id`, `action_id` and `request_id`; any other is the
column itself, with blanks (`on behalf of`). A log may have only one number before the colon, as in `1:robot/A1`, and
only one `run_id`, also where it comes in several files: `robot/A1` of two runs is not one robot.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Literal

import msgspec

from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import escaped
from fsar_ledger.events import CONCERN_OF, Event
from fsar_ledger.ledger.rows.schema import RECORDS, Field

from .adapter import Derived, Input, Record, json_text
from .columns import LAYOUT_OF, OUTCOMES, laid_out
from .ocel_logs import Item, Log, opened_log

OWN = {name: layout for name, layout in LAYOUT_OF.items() if name in CONCERN_OF}
"""The event types that can be imported again: those that describe a run or a source belong to it alone."""
COLUMNS = {
    "requester": "requested_by",
    "executor": "executed_by",
    "supervisor": "supervised_by",
    "decider": "decided_by",
    "task": "task_id",
    "action": "action_id",
    "request": "request_id",
}
"""The columns with another name than their qualifier, by qualifier."""
_OBJECT = re.compile(
    r"(?:(\d+):)?((?:robot|supervisor|service|agent)/.+|coordinator(?:/.*)?|(?:task|action|request|principal)/(.+))",
    re.DOTALL,
)
_LIST = msgspec.json.Decoder(list[str])


class Ocel:
    """A reader of OCEL 2.0 logs."""

    name = "ocel"
    version = "1"
    format = "ocel/2.0"
    clock: Literal["arrival", "source"] = "source"
    is_sampled = False

    def __init__(self) -> None:
        self._logs: list[Log] | None = None
        self._declared: tuple[str, ...] = ()

    def look(self, inputs: Sequence[Input]) -> None:
        """Open the logs, and find what they record; until then nothing is declared, and nothing is derived.

        A type of ours is recorded if the log declares it and every event of it can be imported again; a field of it if
        every such event has it. A log of several runs records nothing.

        Raises: UsageError as `read`.
        """
        self._logs = [opened_log(log) for log in inputs]
        runs: set[object] = set()
        fields: dict[str, set[str] | None] = {
            kind: None for log in self._logs for kind in log.event_types() if kind in OWN
        }
        unfit: set[str] = set()
        for item in (item for log in self._logs for item in log.events() if isinstance(item, Item)):
            if item.kind not in OWN:
                continue
            runs.add(_run(item))
            row = _columns(item)
            known = fields.get(item.kind)
            fields[item.kind] = set(row) if known is None else known & set(row)
            if _event(item.kind, row) is None:
                unfit.add(item.kind)
        names = [kind for kind in fields if kind not in unfit] if len(runs) <= 1 else []
        columns = (
            f"{kind}.{field.name}"
            for kind in names
            for field in OWN[kind].fields
            if (known := fields[kind]) is None or field.name in known  # a type without events lacks no field
        )
        self._declared = (*names, *(name for name in columns if name in RECORDS))

    def declares(self) -> Iterable[str]:
        """Name what the logs themselves show to be recorded; nothing before `look`."""
        return self._declared

    def read(self, inputs: Iterable[Input]) -> Iterator[Record]:
        """Yield the objects of each log, then its events by time.

        Raises: UsageError for an input that is not such a log, or is damaged: where, and what was found.
        """
        logs = self._logs if self._logs is not None else [opened_log(log) for log in inputs]
        for log in logs:
            for item in log.objects():
                yield item if isinstance(item, Record) else _record(item, f"object/{item.kind}", item.id)
            for item in log.events():
                yield item if isinstance(item, Record) else _record(item, item.kind, None)

    def derive(self, record: Record) -> Iterable[Derived] | None:
        """Return the event of the record, if it is one of ours; nothing follows from an object by itself."""
        item: Item | None = record.data
        if item is None:
            return None
        if record.kind != item.kind:
            return ()
        event = _event(item.kind, _columns(item)) if item.kind in self._declared else None
        if event is None:
            return None
        attributes = dict(item.attributes)
        key, cause = (
            None if attributes.get(name) is None else json_text(attributes[name]) for name in ("seq", "caused_by")
        )
        return [Derived(event, key, cause)]


def _record(item: Item, kind: str, object_id: str | None) -> Record:
    """Return a record of an event, or of an object with this id; several qualifiers of one object are joined."""
    objects = {} if object_id is None else {object_id: "object"}
    for name, qualifier in item.related:
        earlier = objects.get(name)
        objects[name] = qualifier if earlier is None else f"{earlier}, {qualifier}"
    values = {"id": item.id} if object_id is None else {}
    for number, (name, attribute) in enumerate(item.attributes, start=1):
        values[f"{name}/{number}" if name in values else name] = json_text(attribute)
    return Record(kind, item.raw, item, values, objects, item.time_us)


def _run(item: Item) -> tuple[object, str]:
    """Return the number and the name of the run that an event belongs to, each None or null if nothing tells it."""
    matches = (_OBJECT.fullmatch(name) for name, _ in item.related)
    name = json_text(dict(item.attributes).get("run_id"))
    return next((match[1] for match in matches if match is not None), None), name


def _columns(item: Item) -> dict[str, Any]:
    """Return the columns of one of our events, as far as its objects and attributes name them."""
    known = {field.name: field for field in OWN[item.kind].fields}
    row: dict[str, Any] = {}
    for name, value in item.attributes:
        if (field := known.get(name)) is not None and value is not None:
            row[name] = _value(field, value)
    from_attributes = frozenset(row)
    for name, qualifiers in item.related:
        label = _OBJECT.fullmatch(name)
        if label is None:
            continue
        for qualifier in qualifiers.split(", "):
            column = COLUMNS.get(qualifier, "")
            field = known.get(column) or known.get(qualifier.replace(" ", "_"))
            if field is not None and field.name not in from_attributes:
                entry = escaped(label[3] or label[2])
                row[field.name] = [*row.get(field.name, ()), entry] if field.kind == "strings" else entry
    path, decider = row.get("path"), row.get("decided_by")
    # An object comes once; the decider is last.
    if "path" not in from_attributes and path is not None and decider in path:
        row["path"] = [*(entry for entry in path if entry != decider), decider]
    return row


def _value(field: Field, value: Any) -> Any:
    """Return an attribute in the type of the column: other writers store numbers and lists as texts."""
    try:
        match field.kind:
            case "integer" if not isinstance(value, bool):
                return int(value) if isinstance(value, str) or float(value).is_integer() else value
            case "boolean" if not isinstance(value, bool):
                return {"true": True, "1": True, "false": False, "0": False}.get(str(value).lower(), value)
            case "strings" if isinstance(value, str):
                return list(map(escaped, _LIST.decode(value)))
            case "string" if isinstance(value, str):
                return escaped(value)
    except (ValueError, OverflowError, TypeError, msgspec.DecodeError):
        return value
    return value


def _event(kind: str, row: dict[str, Any]) -> Event | None:
    """Return our event with these columns; None if it lacks one or has one that a ledger cannot hold."""
    if (outcome := OUTCOMES.get(kind)) is not None and row.get(outcome) is None:
        return None
    try:
        return laid_out(OWN[kind], row)
    except UsageError:
        return None
