"""Events by their type's name and their stored columns, as a program can write them without our classes."""

import re
from collections.abc import Mapping
from typing import Any

import msgspec

from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import did_you_mean, value
from fsar_ledger.events import Event
from fsar_ledger.events.source import Observed
from fsar_ledger.ledger.rows.schema import LAYOUTS, OPENINGS, StoredType

BY_ITSELF = ("SourceOpened", "SourceClosed")
"""What a recorder says of its own accord."""
LAYOUT_OF: dict[str, StoredType] = {
    name: layout
    for tag, layout in LAYOUTS.items()
    if tag not in OPENINGS and (name := tag.partition(".v")[0]) not in BY_ITSELF
}
"""How the events are stored that others can record, by name without version."""
ALIGNED = (("names", "texts"), ("objects", "qualifiers"))
"""Columns of an observation that go together."""
_FLAW = re.compile(r"(?P<what>.*?)(?: - at `\$(?P<at>.*)`)?", re.DOTALL)


def event_of(tag: object, columns: Mapping[str, Any]) -> Event:
    """Return the event of this type (`ExecutionStarted`) with these columns; what may be NULL and is not there is NULL.

    A decision without a path has that of its decider alone. Raises: UsageError, which names the field.
    """
    kind = tag.partition(".v")[0] if isinstance(tag, str) else ""
    layout = LAYOUT_OF.get(kind)
    if layout is None or tag not in (kind, layout.tag):
        meant = did_you_mean(kind, [*LAYOUT_OF, *BY_ITSELF]) if layout is None else f", {kind} or {layout.tag}"
        by_itself = " that is not said of its own accord" if kind in BY_ITSELF else meant
        raise UsageError(f"field type: found {shown(tag)}, expected an event type{by_itself}")
    known = {field.name: field for field in layout.fields}
    if unknown := sorted(columns.keys() - known.keys()):
        raise UsageError(
            f"field {value(unknown[0])}: found it in {kind}, which has no such field"
            f"{did_you_mean(unknown[0], known)}; expected some of {', '.join(known)}"
        )
    event = laid_out(layout, columns)
    for first, second in ALIGNED if isinstance(event, Observed) else ():
        if len(getattr(event, first)) != len(getattr(event, second)):
            raise UsageError(f"field {second}: found {shown(columns.get(second))}, expected one for each of `{first}`")
    return event


def laid_out(layout: StoredType, columns: Mapping[str, Any]) -> Event:
    """Return the event of this layout with these columns. Raises: UsageError for a value that is missing or wrong."""
    given: dict[str, Any] = {"type": layout.tag}
    for member in layout.members:
        inside = {
            field.name: columns.get(field.name) for field in member.fields if field.name in columns or field.is_nullable
        }
        if member.part is None:
            given |= inside
            continue
        if "path" in {field.name for field in member.fields} and "path" not in columns:
            inside["path"] = [columns["decided_by"]] if columns.get("decided_by") is not None else []
        given[member.name] = inside
    try:
        return msgspec.convert(given, layout.cls)
    except msgspec.ValidationError as error:
        raise UsageError(_flaw(layout, f"{error}")) from error


def _flaw(layout: StoredType, message: str) -> str:
    """Return what is wrong with the columns of an event, of which msgspec names the type and the path."""
    kind, found = layout.tag.partition(".v")[0], _FLAW.fullmatch(message)
    assert found is not None
    lacks = re.search(r"missing required field `(\w+)`", found["what"])
    path = re.findall(r"[a-z_]\w*", found["at"] or "")
    name = lacks[1] if lacks else path[-1] if path else None
    members = [member for member in layout.members if member.name == name and member.part is not None]
    if members:
        name = ", ".join(field.name for field in members[0].fields if not field.is_nullable)
    words = f"found none, expected one in {kind}" if lacks else f"{found['what']:.200} in {kind}"
    return f"field {name}: {words}" if name else f"{kind}: {words}"


def shown(found: object) -> str:
    """Return a value of a message."""
    return value(found if isinstance(found, str) else msgspec.json.encode(found).decode())
