"""Events as lines of JSON, as a program in any language can write them."""

from datetime import UTC, datetime
from functools import partial
from typing import Any, BinaryIO

import msgspec

from fsar_ledger.base.errors import InvalidRun, UsageError
from fsar_ledger.base.printable import did_you_mean, value
from fsar_ledger.events import Event
from fsar_ledger.ledger.rows.schema import LAYOUTS, OPENINGS, StoredType

from .json_lines import BOM, MAX_LINE
from .recorder import Recorder

LAYOUT_OF: dict[str, StoredType] = {
    tag.partition(".v")[0]: layout for tag, layout in LAYOUTS.items() if tag not in OPENINGS
}
"""How the events are stored that a line can hold, by name without version."""
BESIDE = ("type", "time", "caused_by")
"""What a line may have beside the columns of its type."""


def tell(recorder: Recorder, file: BinaryIO) -> tuple[int, dict[int, str]]:
    """Record each line as it comes; return how many events there were, and what was wrong with which line.

    A time without a zone is UTC.
    """
    events, refused = 0, dict[int, str]()
    for number, line in enumerate(iter(partial(file.readline, MAX_LINE), b""), 1):
        if not line.strip():
            continue
        try:
            event, at, caused_by = told(line.removeprefix(BOM) if number == 1 else line)
            recorder.event(event, at=at, caused_by=caused_by)
            events += 1
        except (UsageError, InvalidRun) as error:
            refused[number] = f"{error}"
    return events, refused


def told(line: bytes) -> tuple[Event, datetime | None, int | None]:
    """Return the event of a line, when it happened and what caused it; None where the line does not say.

    Raises: UsageError for what is no such line; it names the field.
    """
    try:
        row = msgspec.json.decode(line, type=dict[str, Any])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise UsageError(f"{error!s:.200}; expected a JSON object") from error
    kind = str(row.get("type")).partition(".v")[0]
    if kind not in LAYOUT_OF:
        raise UsageError(
            f"field type: found {value(str(row.get('type')))}, expected an event type{did_you_mean(kind, LAYOUT_OF)}"
        )
    layout = LAYOUT_OF[kind]
    known = {field.name: field for field in layout.fields}
    if unknown := sorted(row.keys() - known.keys() - set(BESIDE)):
        raise UsageError(
            f"field {value(unknown[0])}: found it in {kind}, which has no such field"
            f"{did_you_mean(unknown[0], known)}; expected some of {', '.join(known)}"
        )
    return event_of(layout, row), _when(row.get("time")), _cause(row.get("caused_by"))


def event_of(layout: StoredType, row: dict[str, Any]) -> Event:
    """Return the event with these columns; what may be NULL and is not there is NULL.

    A decision without a path has that of its decider alone.
    """
    given: dict[str, Any] = {"type": layout.tag}
    for member in layout.members:
        columns = {field.name: row.get(field.name) for field in member.fields if field.name in row or field.is_nullable}
        if member.part is None:
            given |= columns
            continue
        if "path" in {field.name for field in member.fields} and "path" not in row:
            columns["path"] = [row["decided_by"]] if row.get("decided_by") is not None else []
        given[member.name] = columns
    try:
        return msgspec.convert(given, layout.cls)
    except msgspec.ValidationError as error:
        raise UsageError(f"{layout.tag.partition('.v')[0]}: {error!s:.200}") from error


def _when(text: object) -> datetime | None:
    if text is None:
        return None
    try:
        found = datetime.fromisoformat(str(text))
        return found if found.tzinfo is not None else found.replace(tzinfo=UTC)
    except ValueError as error:
        raise UsageError(
            f"field time: found {value(str(text))}, expected a time such as 2026-03-01T10:00:00Z"
        ) from error


def _cause(number: object) -> int | None:
    if number is not None and type(number) is not int:
        raise UsageError(f"field caused_by: found {value(str(number))}, expected the number of an earlier event")
    return number
