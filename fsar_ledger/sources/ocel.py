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
column itself, with blanks (`on behalf of`). Of the number before the colon in `1:robot/A1` there may be one in a log:
`robot/A1` of two runs is not one robot.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Literal

import msgspec

from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import escaped
from fsar_ledger.events import CONCERN_OF, Event
from fsar_ledger.ledger.rows.schema import MAX_INTEGER, RECORDS, Field

from .adapter import Derived, Input, Record, shown
from .columns import LAYOUT_OF, OUTCOMES, laid_out
from .ocel_logs import Item, Log, opened_log

OWN = {name: layout for name, layout in LAYOUT_OF.items() if name in CONCERN_OF}
"""The event types that can come back: those that describe a run or a source are of that run or source alone."""
COLUMNS = {
    "requester": "requested_by",
    "executor": "executed_by",
    "supervisor": "supervised_by",
    "decider": "decided_by",
    "task": "task_id",
    "action": "action_id",
    "request": "request_id",
}
"""By qualifier, the column whose name is another."""
_OBJECT = re.compile(
    r"(?:(\d+):)?((?:robot|supervisor|service|agent)/.+|coordinator(?:/.*)?|(?:task|action|request|principal)/(.+))",
    re.DOTALL,
)
_LIST = msgspec.json.Decoder(list[str])


class Ocel:
    """Reads logs of OCEL 2.0."""

    name = "ocel"
    version = "1"
    format = "ocel/2.0"
    clock: Literal["arrival", "source"] = "source"
    is_sampled = False

    def __init__(self) -> None:
        self._logs: list[Log] | None = None
        self._declared: tuple[str, ...] = ()

    def look(self, inputs: Sequence[Input]) -> None:
        """Open the logs, and find what they record: before that nothing is declared, and nothing is derived.

        A type of ours is recorded if the log declares it and every event of it can come back; a field of it if every
        such event has it. Nothing is recorded by a log of several runs.

        Raises: UsageError as `read`.
        """
        self._logs = [opened_log(one) for one in inputs]
        runs: set[object] = set()
        fields: dict[str, set[str] | None] = {
            kind: None for log in self._logs for kind in log.event_types() if kind in OWN
        }
        unfit: set[str] = set()
        for item in (one for log in self._logs for one in log.events() if isinstance(one, Item)):
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
            if (known := fields[kind]) is None or field.name in known  # of a type without events no field is missing
        )
        self._declared = (*names, *(name for name in columns if name in RECORDS))

    def declares(self) -> Iterable[str]:
        """Name what the logs themselves show to be recorded; nothing before they were looked at."""
        return self._declared

    def read(self, inputs: Iterable[Input]) -> Iterator[Record]:
        """Yield the objects of each log, then its events by time.

        Raises: UsageError for an input that is no such log, or a damaged one: where, and what was found.
        """
        logs = self._logs if self._logs is not None else [opened_log(one) for one in inputs]
        for log in logs:
            for item in log.objects():
                yield item if isinstance(item, Record) else _record(item, f"object/{item.kind}", item.id)
            for item in log.events():
                yield item if isinstance(item, Record) else _record(item, item.kind, None)

    def derive(self, record: Record) -> Iterable[Derived] | None:
        """Return the event that the record is, if it is one of ours; an object says nothing by itself."""
        item: Item | None = record.data
        if item is None:
            return None
        if record.kind != item.kind:
            return ()
        event = _event(item.kind, _columns(item)) if item.kind in self._declared else None
        if event is None:
            return None
        told = dict(item.attributes)
        key, cause = (None if told.get(name) is None else shown(told[name]) for name in ("seq", "caused_by"))
        return [Derived(event, key, cause)]


def _record(item: Item, kind: str, own: str | None) -> Record:
    """Return a record of an event, or of an object with this id; several qualifiers of one object are joined."""
    objects = {} if own is None else {own: "object"}
    for name, qualifier in item.related:
        before = objects.get(name)
        objects[name] = qualifier if before is None else f"{before}, {qualifier}"
    values = {"id": item.id} if own is None else {}
    values |= {name: shown(found) for name, found in item.attributes}
    return Record(kind, item.raw, item, values, objects, item.time_us)


def _run(item: Item) -> object:
    """Return the run that the names of an event belong to: its number, None where they have none."""
    found = (_OBJECT.fullmatch(name) for name, _ in item.related)
    return next((one[1] for one in found if one is not None), None)


def _columns(item: Item) -> dict[str, Any]:
    """Return the columns of an event of ours, as far as its objects and attributes name them."""
    known = {field.name: field for field in OWN[item.kind].fields}
    row: dict[str, Any] = {}
    for name, value in item.attributes:
        if (field := known.get(name)) is not None and value is not None:
            row[name] = _value(field, value)
    told = frozenset(row)
    for name, qualifiers in item.related:
        label = _OBJECT.fullmatch(name)
        if label is None:
            continue
        for qualifier in qualifiers.split(", "):
            column = COLUMNS.get(qualifier, "")
            field = known.get(column) or known.get(qualifier.replace(" ", "_"))
            if field is not None and field.name not in told:
                one = escaped(label[3] or label[2])
                row[field.name] = [*row.get(field.name, ()), one] if field.kind == "strings" else one
    path, decider = row.get("path"), row.get("decided_by")
    if "path" not in told and path is not None and decider in path:  # an object comes once; the decider is last
        row["path"] = [*(one for one in path if one != decider), decider]
    return row


def _value(field: Field, found: Any) -> Any:
    """Return an attribute as the column holds it: other writers make texts of numbers and lists."""
    try:
        match field.kind:
            case "integer" if not isinstance(found, bool):
                return int(found) if isinstance(found, str) or float(found).is_integer() else found
            case "boolean" if not isinstance(found, bool):
                return {"true": True, "1": True, "false": False, "0": False}.get(str(found).lower(), found)
            case "strings" if isinstance(found, str):
                return list(map(escaped, _LIST.decode(found)))
            case "string" if isinstance(found, str):
                return escaped(found)
    except (ValueError, OverflowError, TypeError, msgspec.DecodeError):
        return found
    return found


def _event(kind: str, row: dict[str, Any]) -> Event | None:
    """Return the event of ours with these columns, None if it lacks one or has one that a ledger cannot hold."""
    if any(isinstance(one, int) and abs(one) > MAX_INTEGER for one in row.values()):
        return None
    if (outcome := OUTCOMES.get(kind)) is not None and row.get(outcome) is None:
        return None
    try:
        return laid_out(OWN[kind], row)
    except UsageError:
        return None
