"""Helpers for reading columns: as one array, strings as codes, buffers as numpy arrays, each once a table."""

from collections.abc import Callable
from typing import Any, TypeAlias, TypeVar

import numpy as np
import pyarrow as pa

Mask: TypeAlias = "np.ndarray[tuple[int], np.dtype[np.bool_]]"
Codes: TypeAlias = "np.ndarray[tuple[int], np.dtype[np.signedinteger[Any]]]"

_T = TypeVar("_T")


class Derived(dict[str, _T]):
    """What follows from a column, by its name, made when it is first asked for."""

    def __init__(self, make: Callable[[str], _T]) -> None:
        super().__init__()
        self._make = make

    def __missing__(self, name: str) -> _T:
        value = self[name] = self._make(name)
        return value


class Columns:
    """The columns of a table, each taken apart once, for all who look at it.

    `arrays` are the columns as one array each, `valid` which rows have a value. `coded` are strings as codes, those of
    all lists of a column one after the other; `texts` are their dictionary, and `places` the index of each string in
    it.
    """

    def __init__(self, table: pa.Table) -> None:
        arrays: Derived[pa.Array] = Derived(lambda name: whole(table.column(name)))
        codes: Derived[pa.DictionaryArray] = Derived(lambda name: coded(_strings(arrays[name])))
        self.table, self.arrays, self.coded = table, arrays, codes  # no lambda holds self, so no cycle holds columns
        self.valid: Derived[Mask] = Derived(lambda name: validity(arrays[name]))
        self.texts: Derived[list[str]] = Derived(lambda name: codes[name].dictionary.to_pylist())
        self.places: Derived[Codes] = Derived(lambda name: places(codes[name]))


def taken(rows: pa.Table | Columns) -> Columns:
    """Return the columns of a table, or these."""
    return rows if isinstance(rows, Columns) else Columns(rows)


def _strings(column: pa.Array) -> pa.Array:
    return column.flatten() if pa.types.is_list(column.type) else column


def whole(column: pa.ChunkedArray) -> pa.Array:
    """Return the column as one array, copied only if it has several chunks."""
    return column.chunk(0) if column.num_chunks == 1 else column.combine_chunks()


def coded(strings: pa.Array) -> pa.DictionaryArray:
    """Return the strings as codes into a dictionary, which they may be already.

    The dictionary may hold a string twice, or one that no row uses.
    """
    return strings if isinstance(strings, pa.DictionaryArray) else strings.dictionary_encode()


def validity(array: pa.Array) -> Mask:
    """Return which values are not NULL. Takes a tenth of the time of `is_valid` for a few thousand rows."""
    bits = array.buffers()[0]
    if bits is None or not array.null_count:
        return np.ones(len(array), bool)
    mask: Mask = np.unpackbits(np.frombuffer(bits, np.uint8), count=array.offset + len(array), bitorder="little")[
        array.offset :
    ].view(bool)
    return mask


def numbers(array: pa.Array) -> Codes:
    """Return the values of an integer array; for a NULL, any value."""
    kind = array.type.to_pandas_dtype()
    data = np.frombuffer(array.buffers()[1] or b"", kind)
    return data[array.offset : array.offset + len(array)]


def places(strings: pa.DictionaryArray) -> Codes:
    """Return the index of each string in the dictionary; for a NULL, the index past its end."""
    if not strings.null_count:
        return numbers(strings.indices)
    return np.where(validity(strings.indices), numbers(strings.indices), len(strings.dictionary))
