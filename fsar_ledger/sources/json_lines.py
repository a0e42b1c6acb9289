"""Lines of JSON, read one at a time: what cannot be read is told, and the lines after it are read all the same."""

from collections.abc import Iterable, Iterator
from datetime import datetime
from typing import Any

import msgspec

from .adapter import Input, Record, unreadable

MAX_LINE = 1 << 24
"""Bytes of one line; a longer one is no record of any source that is known here."""

_DECODER = msgspec.json.Decoder()


def lines(inputs: Iterable[Input]) -> Iterator[bytes]:
    """Yield the lines of the inputs without their ends, but for blank ones; one that is too long comes in parts."""
    for one in inputs:
        while line := one.file.readline(MAX_LINE):
            if line := line.strip(b"\r\n"):
                yield line


def objects(inputs: Iterable[Input]) -> Iterator[tuple[bytes, dict[str, Any]] | Record]:
    """Yield each line with the JSON object that it holds, or a record of a line that holds none."""
    for line in lines(inputs):
        if not line.strip():
            continue
        try:
            data = _DECODER.decode(line)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            yield unreadable(line, error)
            continue
        yield (line, data) if isinstance(data, dict) else unreadable(line, f"found {line[:40]!r}, expected an object")


def utc_us(text: object) -> int | None:
    """Return a time of ISO 8601 in microseconds since 1970, None for anything else; without a zone it is UTC."""
    if not isinstance(text, str):
        return None
    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        return None
    utc = when if when.tzinfo is not None else datetime.fromisoformat(f"{text}+00:00")
    return round(utc.timestamp() * 1_000_000)


def shown(value: object) -> str:
    """Return a value of JSON as text: a string as it is."""
    return value if isinstance(value, str) else msgspec.json.encode(value).decode()
