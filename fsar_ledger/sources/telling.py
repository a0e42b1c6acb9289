"""Events as lines of JSON, as a program in any language can write them."""

from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Any, BinaryIO

import msgspec

from fsar_ledger.base import utc
from fsar_ledger.base.errors import InvalidRun, UsageError
from fsar_ledger.events import Event

from .columns import event_of, shown
from .json_lines import BOM, MAX_LINE
from .recorder import Recorder

BESIDE = ("type", "time", "caused_by")
"""What a line may have beside the columns of its type."""


def tell(recorder: Recorder, file: BinaryIO) -> tuple[int, dict[int, str]]:
    """Record each line as it comes; return how many events there were, and what was wrong with which line.

    A time without a zone is UTC.
    """
    events, refused = 0, dict[int, str]()
    for number, line in enumerate(_lines(file), 1):
        if not line.strip():
            continue
        try:
            if len(line) > MAX_LINE:
                raise UsageError(f"found more than {MAX_LINE:,} bytes, expected one event a line")
            event, at, caused_by = told(line.removeprefix(BOM) if number == 1 else line)
            _record(recorder, event, at, caused_by)
            events += 1
        except (UsageError, InvalidRun) as error:
            refused[number] = f"{error}"
    return events, refused


def _record(recorder: Recorder, event: Event, at: datetime | None, caused_by: int | None) -> None:
    try:
        recorder.event(event, at=at, caused_by=caused_by)
    except UsageError as error:
        if not f"{error}".startswith("at: "):  # the name that the time has in Python
            raise
        raise UsageError(f"field time: {f'{error}'.removeprefix('at: ')}".replace("`at`", "`time`")) from error


def _lines(file: BinaryIO) -> Iterator[bytes]:
    """Yield each line as it comes; of one that is too long its beginning, which is too long as well."""
    while line := file.readline(MAX_LINE + 1):
        yield line
        while line and len(line) > MAX_LINE and not line.endswith(b"\n"):
            line = file.readline(MAX_LINE + 1)


def told(line: bytes) -> tuple[Event, datetime | None, int | None]:
    """Return the event of a line, when it happened and what caused it; None where the line does not say.

    Raises: UsageError for what is no such line; it names the field.
    """
    try:
        row = msgspec.json.decode(line, type=dict[str, Any])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise UsageError(f"{error!s:.200}; expected a JSON object") from error
    event = event_of(row.get("type"), {name: row[name] for name in row.keys() - set(BESIDE)})
    return event, _when(row.get("time")), _cause(row.get("caused_by"))


def _when(text: object) -> datetime | None:
    """Return a time of ISO 8601; without a zone it is UTC."""
    if text is None:
        return None
    try:
        if not isinstance(text, str):
            raise ValueError("no text")
        return utc.parsed(text).astimezone(UTC)
    except (ValueError, OverflowError) as error:
        raise UsageError(f"field time: found {shown(text)}, expected a time such as 2026-03-01T10:00:00Z") from error


def _cause(number: object) -> int | None:
    if number is not None and type(number) is not int:
        raise UsageError(f"field caused_by: found {shown(number)}, expected the number of an earlier event")
    return number
