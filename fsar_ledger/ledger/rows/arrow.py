"""Helpers for reading columns: as one array, strings as codes, buffers as numpy arrays."""

from typing import Any, TypeAlias

import numpy as np
import pyarrow as pa

Mask: TypeAlias = "np.ndarray[tuple[int], np.dtype[np.bool_]]"


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
    found: Mask = np.unpackbits(np.frombuffer(bits, np.uint8), count=array.offset + len(array), bitorder="little")[
        array.offset :
    ].view(bool)
    return found


def numbers(array: pa.Array) -> "np.ndarray[tuple[int], np.dtype[np.signedinteger[Any]]]":
    """Return the values of an integer array; for a NULL, any value."""
    kind = array.type.to_pandas_dtype()
    data = np.frombuffer(array.buffers()[1] or b"", kind)
    return data[array.offset : array.offset + len(array)]


def places(strings: pa.DictionaryArray) -> "np.ndarray[tuple[int], np.dtype[np.signedinteger[Any]]]":
    """Return the index of each string in the dictionary; for a NULL, the index past its end."""
    return np.where(validity(strings.indices), numbers(strings.indices), len(strings.dictionary))
