"""The hot paths of the codec in C (`_codec.c`), if they were built; each has a twin in Python.

| in C | from | to | twin |
|---|---|---|---|
| `write_events` | the events of a run | rows, lines of canonical JSON | `codec.encode_lines` |
| `write_rows` | columns | rows | `canonical.from_table` |
| `read_rows` | rows | columns | `codec.encode_coded`, `staging.table_of` |
"""

from collections.abc import Sequence
from functools import reduce
from operator import or_
from typing import Any, NamedTuple, TypeAlias

import pyarrow as pa

from fsar_ledger.events import CONCERNS
from fsar_ledger.ledger.rows.runs import LedgerRun
from fsar_ledger.ledger.rows.schema import (
    ARROW_TYPES,
    CODED_SCHEMA,
    COLUMNS,
    CONCERNED,
    ENVELOPE,
    LAYOUTS,
    OPENINGS,
    Kind,
    StoredType,
)

# See docs/decisions/c-is-optional.md.
try:
    from fsar_ledger.ledger.rows import _codec
except ImportError:  # it was not built, for example without a compiler
    _codec = None  # type: ignore[assignment]

codec = _codec
"""The functions of the table above; None if they were not built."""
IS_COMPILED = codec is not None


Columns: TypeAlias = tuple[tuple[Any, ...], ...]

OPENING = 1
"""Marks a type that only the first event of a run may have."""
MARK_OF = {concern: 2 << place for place, concern in enumerate(CONCERNS)}
_WRITTEN_AS = {
    kind: code
    for code, kind in enumerate(
        ("string", "integer", "boolean", "strings", "run_id", "seq", "time_us", "caused_by", "type")
    )
}
"""As in `_write_events.c`: the kinds of fields, then the columns that every row has."""


def _columns(layout: StoredType) -> Columns:
    """Return the columns of this event type in the form that `write_events` expects, in the order of a row."""
    columns: dict[str, tuple[Any, ...]] = {
        field.name: (_WRITTEN_AS[field.name], None, None, layout.tag, False, None) for field in ENVELOPE
    }
    for member in layout.members:
        for field in member.fields:
            source = (_WRITTEN_AS[field.kind], member.name, member.part, field.name)
            columns[field.name] = (*source, field.is_nullable, field.values)
    return tuple((kind, f'"{name}":'.encode(), *rest) for name, (kind, *rest) in sorted(columns.items()))


def _marks(tag: str) -> int:
    concern = CONCERNED.get(tag)
    return (OPENING if tag in OPENINGS else 0) | (0 if concern is None else MARK_OF[concern])


MARKS: dict[type, int] = {layout.cls: _marks(tag) for tag, layout in LAYOUTS.items()}
"""The marks of a run by the types of its events: `OPENING`, and `MARK_OF` each of their concerns."""
_TYPES: dict[type, tuple[int, Columns]] = {
    layout.cls: (MARKS[layout.cls], _columns(layout)) for layout in LAYOUTS.values()
}


_IN_C = codec.event_types(_TYPES) if codec is not None else None


class Plain(NamedTuple):
    """The rows of some runs, the canonical bytes of each followed by a line feed, and the `MARKS` of each run.

    The first event of a run does not count for its marks.
    """

    rows: bytes
    marks: tuple[int, ...]


def plain_lines(run: LedgerRun) -> tuple[bytes, int] | None:
    """Return the rows and the marks of this run, as in `Plain`; None if the fast path does not apply.

    That is if the C code was not built, or an event has text that is not plain ASCII or values that no row can hold.
    """
    if codec is None:
        return None
    times, causes, events = run.times_us, run.caused_by, run.events
    if not (type(times) is list and type(causes) is list and type(events) is list):
        times, causes, events = list(times), list(causes), list(events)
    return codec.write_events(_IN_C, run.run_id, run.first, times, causes, events)


def plain_rows(runs: Sequence[LedgerRun]) -> Plain | None:
    """Return the rows of these runs; None if `plain_lines` returns None for one of them."""
    if len(runs) == 1:
        return None if (lines := plain_lines(runs[0])) is None else Plain(lines[0], (lines[1],))
    rows: list[bytes] = []
    marks: list[int] = []
    for run in runs:
        if (lines := plain_lines(run)) is None:
            return None
        rows.append(lines[0])
        marks.append(lines[1])
    return Plain(b"".join(rows), tuple(marks))


def marks_of(run: LedgerRun) -> int:
    """Return the marks of this run, as in `Plain`."""
    return reduce(or_, map(MARKS.__getitem__, set(map(type, run.events if run.first else run.events[1:]))), 0)


_READ_AS: dict[Kind, int] = {"string": 0, "integer": 1, "boolean": 2, "strings": 3}
"""As in `_read_rows.c`."""
_READ_NAMES = tuple((name.encode(), _READ_AS[COLUMNS[name]]) for name in sorted(COLUMNS))
_READ_REQUIRED = tuple(field.name for field in CODED_SCHEMA if not field.nullable)


# See docs/decisions/columns-come-from-canonical-rows.md.
def plain_table(lines: bytes) -> pa.Table | None:
    """Return rows, the canonical bytes of each followed by a line feed, as a table with the columns of `CODED_SCHEMA`.

    None if the C code was not built, or a row is not canonical or has text that is not plain ASCII; the rows may still
    be valid. A returned table does not imply that a row has the columns of its type.
    """
    if codec is None or (decoded := codec.read_rows(lines, _READ_NAMES)) is None:
        return None
    parts = dict(zip(sorted(COLUMNS), decoded, strict=True))
    if any(parts[name] is None for name in _READ_REQUIRED):
        return None
    rows = lines.count(b"\n")
    arrays = [_array(name, parts[name], rows) for name in COLUMNS]
    if any(array.null_count for array, field in zip(arrays, CODED_SCHEMA, strict=True) if not field.nullable):
        return None
    return pa.Table.from_arrays(arrays, schema=CODED_SCHEMA)


def _array(name: str, parts: tuple[bytes, ...] | None, rows: int) -> pa.Array:
    kind = CODED_SCHEMA.field(name).type
    if parts is None:
        return pa.nulls(rows, kind)
    validity, values, *text_buffers = map(pa.py_buffer, parts)
    if not text_buffers:
        return pa.Array.from_buffers(kind, rows, [validity, values])
    texts = pa.Array.from_buffers(pa.string(), text_buffers[0].size // 4 - 1, [None, *text_buffers])
    if COLUMNS[name] == "strings":
        return pa.Array.from_buffers(ARROW_TYPES["strings"], rows, [validity, values], children=[texts])
    return pa.DictionaryArray.from_buffers(kind, rows, [validity, values], texts)
