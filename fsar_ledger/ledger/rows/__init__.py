"""Rows: events as typed columns, the bytes that are hashed, and the one accepted form of a segment on disk.

```
schema      the columns, derived from the event types, and those that each release wrote
runs        the runs passed to a writer and their limits; splitting and joining them
codec       runs of events <-> one Arrow table
compiled    the hot paths of the codec in C, if they were built: events -> rows, rows -> columns
canonical   the hashed bytes of a row, made from structs and again from columns
check       the rules for every stored row
blocks      the runs in a table, and which rows of each
segment     one batch of runs as one Parquet file
layout      whether a segment has the accepted form; grammar: the bytes allowed in it
bounds      limits on the cost of reading a segment
```

This module has the column helpers shared by all of these: columns read as one array, strings as codes, buffers as numpy
arrays; and columns made from Python values.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable
from itertools import count
from typing import Any, TypeAlias, TypeVar

import numpy as np
import pyarrow as pa

from fsar_ledger.ledger.rows.schema import MAX_INTEGER

Mask: TypeAlias = "np.ndarray[tuple[int], np.dtype[np.bool_]]"
Integers: TypeAlias = "np.ndarray[tuple[int], np.dtype[np.signedinteger[Any]]]"
Positions: TypeAlias = "np.ndarray[tuple[int], np.dtype[np.int64]]"
Codes: TypeAlias = "np.ndarray[tuple[int], np.dtype[np.int32]]"
Values: TypeAlias = "np.ndarray[tuple[int], np.dtype[Any]]"

_T = TypeVar("_T")


class Derived(dict[str, _T]):
    """Values derived from columns, by column name, computed on first access."""

    def __init__(self, make: Callable[[str], _T]) -> None:
        super().__init__()
        self._make = make

    def __missing__(self, name: str) -> _T:
        value = self[name] = self._make(name)
        return value


class Columns:
    """The columns of a table, each decomposed once and shared.

    `arrays` are the columns as one array each, `valid` masks the rows with a value. `coded` are strings as codes, those
    of all lists of a column one after the other; `texts` are their dictionary, and `places` the index of each string in
    it.
    """

    def __init__(self, table: pa.Table) -> None:
        arrays: Derived[pa.Array] = Derived(lambda name: as_one_array(table.column(name)))
        codes: Derived[pa.DictionaryArray] = Derived(lambda name: coded(_strings(arrays[name])))
        self.table, self.arrays, self.coded = table, arrays, codes  # no lambda holds self, so no cycle holds columns
        self.valid: Derived[Mask] = Derived(lambda name: validity(arrays[name]))
        self.texts: Derived[list[str]] = Derived(lambda name: codes[name].dictionary.to_pylist())
        self.places: Derived[Integers] = Derived(lambda name: places(codes[name]))


def as_columns(rows: pa.Table | Columns) -> Columns:
    """Return the columns of a table, or the argument if it is `Columns` already."""
    return rows if isinstance(rows, Columns) else Columns(rows)


def _strings(column: pa.Array) -> pa.Array:
    return column.flatten() if pa.types.is_list(column.type) else column


def as_one_array(column: pa.ChunkedArray) -> pa.Array:
    """Return the column as one array, copied only if it has several chunks."""
    return column.chunk(0) if column.num_chunks == 1 else column.combine_chunks()


def coded(strings: pa.Array) -> pa.DictionaryArray:
    """Return the strings as codes into a dictionary, unchanged if they are already.

    The dictionary may contain a string twice, or one that no row uses.
    """
    return strings if isinstance(strings, pa.DictionaryArray) else strings.dictionary_encode()


def validity(array: pa.Array) -> Mask:
    """Return the mask of values that are not NULL, in a tenth of the time of `is_valid` for a few thousand rows."""
    bits = array.buffers()[0]
    if bits is None or not array.null_count:
        return np.ones(len(array), bool)
    mask: Mask = np.unpackbits(np.frombuffer(bits, np.uint8), count=array.offset + len(array), bitorder="little")[
        array.offset :
    ].view(bool)
    return mask


def numbers(array: pa.Array) -> Integers:
    """Return the values of an integer array; any value in place of NULL."""
    kind = array.type.to_pandas_dtype()
    data = np.frombuffer(array.buffers()[1] or b"", kind)
    return data[array.offset : array.offset + len(array)]


def places(strings: pa.DictionaryArray) -> Integers:
    """Return the index of each string in the dictionary; for a NULL, the index past its end."""
    if not strings.null_count:
        return numbers(strings.indices)
    return np.where(validity(strings.indices), numbers(strings.indices), len(strings.dictionary))


class Texts:
    """The distinct strings of all columns, with codes from 1. The code of None is 0."""

    def __init__(self) -> None:
        self._codes: defaultdict[object, int] = defaultdict(count(1).__next__, {None: 0})

    def codes(self, texts: Iterable[object], size: int) -> Codes:
        """Return the codes of these strings."""
        return np.fromiter(map(self._codes.__getitem__, texts), np.int32, size)

    def sorted(self) -> tuple[Values, Codes]:
        """Return None followed by all strings in order, and for each code the index of its string there."""
        _, *texts = self._codes
        order = sorted(range(len(texts)), key=texts.__getitem__)  # type: ignore[arg-type]
        ranks = np.zeros(len(texts) + 1, np.int32)
        ranks[1:][order] = np.arange(1, len(texts) + 1)
        return np.array([None, *[texts[i] for i in order]], object), ranks


def bits(is_set: Values) -> pa.Buffer:
    """Return booleans as an Arrow bitmap, faster than Arrow's own conversion from a byte mask."""
    return pa.py_buffer(np.packbits(is_set, bitorder="little"))


def array_of(values: Values, is_valid: Values) -> pa.Array:
    """Return an Arrow array of int32, int64 or bool, NULL where `is_valid` is false."""
    data = bits(values) if values.dtype == bool else pa.py_buffer(values)
    return pa.Array.from_buffers(pa.from_numpy_dtype(values.dtype), len(values), [bits(is_valid), data])


def require_exact(name: str, numbers: Values) -> None:
    """Refuse an integer beyond 2^53 - 1, which JSON readers may round. Raises: ValueError."""
    least, most = int(numbers.min(initial=0)), int(numbers.max(initial=0))
    if least < -MAX_INTEGER or most > MAX_INTEGER:
        raise ValueError(f"column {name}: found integers from {least} to {most}, expected at most 2^53 - 1 in size")
