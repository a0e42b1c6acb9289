"""Take rows, lines of canonical JSON, apart into columns, in C where it was built (`_read_rows.c`).

`codec.encode_coded` gives the same columns from events, and `chain.tables` from any rows, in Python.
"""

import pyarrow as pa

from fsar_ledger.ledger.rows.compiled import codec
from fsar_ledger.ledger.rows.schema import ARROW_TYPES, CODED_SCHEMA, COLUMNS, Kind

_KINDS: dict[Kind, int] = {"string": 0, "integer": 1, "boolean": 2, "strings": 3}
"""As in `_read_rows.c`."""
_NAMES = tuple((name.encode(), _KINDS[COLUMNS[name]]) for name in sorted(COLUMNS))
_REQUIRED = tuple(field.name for field in CODED_SCHEMA if not field.nullable)


# See docs/decisions/columns-come-from-canonical-rows.md.
def plain_table(lines: bytes) -> pa.Table | None:
    """Return rows, the canonical bytes of each with a line feed after it, with the columns of `CODED_SCHEMA`.

    None says nothing about them: it was not built, or a row is not canonical or has text that is not plain ASCII. Nor
    does a table say that a row has the columns of its type.
    """
    if codec is None or (taken := codec.read_rows(lines, _NAMES)) is None:
        return None
    parts = dict(zip(sorted(COLUMNS), taken, strict=True))
    if any(parts[name] is None for name in _REQUIRED):
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
    is_there, values, *words = map(pa.py_buffer, parts)
    if not words:
        return pa.Array.from_buffers(kind, rows, [is_there, values])
    texts = pa.Array.from_buffers(pa.string(), words[0].size // 4 - 1, [None, *words])
    if COLUMNS[name] == "strings":
        return pa.Array.from_buffers(ARROW_TYPES["strings"], rows, [is_there, values], children=[texts])
    return pa.DictionaryArray.from_buffers(kind, rows, [is_there, values], texts)
