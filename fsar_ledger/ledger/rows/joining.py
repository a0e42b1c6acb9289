"""Write the rows of a table as lines of canonical JSON, in C where that was built (`_joining.c`).

`canonical.from_table` gives the same bytes, row by row, in Python.
"""

from collections.abc import Callable
from typing import Any, TypeAlias

import msgspec
import numpy as np
import pyarrow as pa

from fsar_ledger.ledger.rows.arrow import Columns, numbers
from fsar_ledger.ledger.rows.schema import COLUMNS

_ENCODER = msgspec.json.Encoder()
_BOOLEANS = (b"false\ntrue\n", np.array([5, 10]))

Integers: TypeAlias = "np.ndarray[tuple[int], np.dtype[np.int64]]"


def _compiled() -> Callable[[int, list[Any]], bytes] | None:
    try:
        from fsar_ledger.ledger.rows import _joining
    except ImportError:  # it was not built, as without a compiler
        return None
    return _joining.lines


_lines = _compiled()
IS_COMPILED = _lines is not None
"""Whether rows are joined in C."""


def lines_of(columns: Columns) -> bytes | None:
    """Return the canonical bytes of the rows, each with a line feed after it; None where that was not built.

    String columns may be dictionaries.
    """
    if _lines is None:
        return None
    names = [name for name in sorted(columns.table.column_names) if not _is_empty(columns.arrays[name])]
    return _lines(len(columns.table), [_taken(name, columns) for name in names])


def _is_empty(column: pa.Array) -> bool:
    return bool(column.null_count == len(column))


def _taken(name: str, columns: Columns) -> tuple[Any, ...]:
    """Take a column apart as `_joining.lines` wants it."""
    before, is_there, column, kind = f'"{name}":'.encode(), columns.valid[name], columns.arrays[name], COLUMNS[name]
    if kind == "integer":
        return before, is_there, numbers(column), None, None, None
    if kind == "boolean":
        return before, is_there, numbers(column.cast(pa.int32())), *_BOOLEANS, None
    if kind == "string":
        return before, is_there, columns.places[name], *_encoded(columns.texts[name]), None
    sizes: Integers = column.value_lengths().fill_null(0).to_numpy().astype(np.int64)
    starts = np.concatenate([np.zeros(1, np.int64), np.cumsum(sizes)])
    return before, is_there, columns.places[name], *_encoded(columns.texts[name]), starts


def _encoded(texts: list[str]) -> tuple[bytes, Integers]:
    """Return these texts as JSON, each with a line feed after it, and where the line feeds are."""
    found = _ENCODER.encode_lines(texts)
    return found, np.flatnonzero(np.frombuffer(found, np.uint8) == ord("\n"))
