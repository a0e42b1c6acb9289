"""Lines of JSON, read one at a time: what cannot be read is told, and the lines after it are read all the same."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

import msgspec

from fsar_ledger.base import utc
from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import value

from .adapter import Input, Record, unreadable

MAX_LINE = 1 << 24
"""Bytes of one line; a longer one is no record of any source that is known here."""

LOOKED_AT = 100
"""Records at the beginning of which one at least is known, where an input is of the format."""

BOM = b"\xef\xbb\xbf"

One = TypeVar("One")
_DECODER = msgspec.json.Decoder()


def lines(inputs: Iterable[Input]) -> Iterator[bytes]:
    """Yield the lines of the inputs without their ends, but for blank ones; one that is too long comes in parts."""
    for one in inputs:
        mark = BOM
        while line := one.file.readline(MAX_LINE):
            if line := line.removeprefix(mark).strip(b"\r\n"):
                yield line
            mark = b""


def objects(inputs: Iterable[Input]) -> Iterator[tuple[bytes, dict[str, Any]] | Record]:
    """Yield each line with the JSON object that it holds, or a record of a line that holds none.

    Raises: UsageError if the first lines all hold none.
    """
    files = list(inputs)
    return known(_objects(files), files, lambda one: isinstance(one, tuple), "one JSON object a line")


def _objects(inputs: Iterable[Input]) -> Iterator[tuple[bytes, dict[str, Any]] | Record]:
    for line in lines(inputs):
        if not line.strip():
            continue
        try:
            data = _DECODER.decode(line)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            yield unreadable(line, error)
            continue
        yield (line, data) if isinstance(data, dict) else unreadable(line, f"found {line[:40]!r}, expected an object")


def known(
    found: Iterable[One], inputs: Sequence[Input], is_known: Callable[[One], bool], expected: str
) -> Iterator[One]:
    """Yield all that was found; none of it is told before one is known to be of the format.

    Raises: UsageError if none of the first `LOOKED_AT` is, or none at all.
    """
    waiting, size = list[One](), 0
    each = iter(found)
    for one in each:
        waiting.append(one)
        raw = one.raw if isinstance(one, Record) else b""
        size += len(raw)
        if is_known(one):
            yield from waiting
            yield from each
            return
        if len(waiting) >= LOOKED_AT or size >= MAX_LINE:
            break
    if waiting:
        raw = waiting[0].raw if isinstance(waiting[0], Record) else b""
        raise UsageError(
            f"{value(inputs[0].name)}: found {raw[:40]!r} and no such record in the first {len(waiting):,}, expected "
            f"{expected}; nothing was recorded: give the format that it has (--as, --with)"
        )


def utc_us(text: object) -> int | None:
    """Return a time of ISO 8601 in microseconds since 1970, None for anything else; without a zone it is UTC."""
    if not isinstance(text, str):
        return None
    try:
        return (utc.parsed(text) - utc.EPOCH) // utc.MICROSECOND
    except ValueError:
        return None


def shown(found: object) -> str:
    """Return a value of JSON as text: a string as it is."""
    if isinstance(found, str):
        return found
    return f"{found}" if type(found) is int else msgspec.json.encode(found).decode()
