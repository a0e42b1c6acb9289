"""JSON arrays that are written element by element, and what was written."""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import msgspec


class Written(NamedTuple):
    """The number of events in a file, and what else is to be told about it, a line each."""

    events: int
    notes: tuple[str, ...]


def elements(documents: Iterable[object]) -> Iterator[bytes]:
    """Yield each document as an element of a JSON array, on a line of its own, without the brackets."""
    between = b"\n"
    for one in documents:
        yield between + msgspec.json.encode(one)
        between = b",\n"
