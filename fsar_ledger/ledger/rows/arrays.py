"""Helpers for making columns from Python values."""

from collections import defaultdict
from collections.abc import Iterable
from itertools import count
from typing import Any, TypeAlias

import numpy as np
import pyarrow as pa

from fsar_ledger.ledger.rows.schema import MAX_INTEGER

Positions: TypeAlias = "np.ndarray[tuple[int], np.dtype[np.int64]]"
Codes: TypeAlias = "np.ndarray[tuple[int], np.dtype[np.int32]]"
Values: TypeAlias = "np.ndarray[tuple[int], np.dtype[Any]]"


class Texts:
    """The strings of all columns, each held once, with codes from 1. The code of None is 0."""

    def __init__(self) -> None:
        self._codes: defaultdict[object, int] = defaultdict(count(1).__next__, {None: 0})

    def codes(self, texts: Iterable[object], size: int) -> Codes:
        """Return the codes of these strings."""
        return np.fromiter(map(self._codes.__getitem__, texts), np.int32, size)

    def sorted(self) -> tuple[Values, Codes]:
        """Return None and then all strings in order, and for each code the index of its string there."""
        _, *texts = self._codes
        order = sorted(range(len(texts)), key=texts.__getitem__)  # type: ignore[arg-type]
        places = np.zeros(len(texts) + 1, np.int32)
        places[1:][order] = np.arange(1, len(texts) + 1)
        return np.array([None, *[texts[at] for at in order]], object), places


def bits(is_set: Values) -> pa.Buffer:
    """Return booleans as an Arrow bitmap; Arrow's own conversion from a mask of bytes is slower."""
    return pa.py_buffer(np.packbits(is_set, bitorder="little"))


def array_of(values: Values, is_valid: Values) -> pa.Array:
    """Return an Arrow array of int32, int64 or bool, NULL where it is not valid."""
    data = bits(values) if values.dtype == bool else pa.py_buffer(values)
    return pa.Array.from_buffers(pa.from_numpy_dtype(values.dtype), len(values), [bits(is_valid), data])


def require_exact(name: str, numbers: Values) -> None:
    """Refuse an integer beyond 2^53 - 1, which JSON readers may round. Raises: ValueError."""
    least, most = int(numbers.min(initial=0)), int(numbers.max(initial=0))
    if least < -MAX_INTEGER or most > MAX_INTEGER:
        raise ValueError(f"column {name}: found integers from {least} to {most}, expected at most 2^53 - 1 in size")
