"""Long operations: reporting their progress, and splitting them into parts."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import TypeVar

_One = TypeVar("_One")

Progress = Callable[[int, int], None]
"""Called with the amount done and the total."""

Showing = Callable[[str, str], AbstractContextManager[Progress | None]]
"""Called with a verb in the past tense and a unit for each step; returns a context that yields its progress."""


def each(items: Sequence[_One], progress: Progress | None) -> Iterator[_One]:
    """Yield each item, and report progress after each."""
    for done, item in enumerate(items, start=1):
        yield item
        if progress is not None:
            progress(done, len(items))


def unseen(_verb: str, _unit: str) -> AbstractContextManager[None]:
    """Show no progress."""
    return nullcontext()


def parts_of(every: Iterable[_One], size_of: Callable[[_One], int], most: int) -> Iterator[list[_One]]:
    """Yield these items in order, in parts of at most `most` in total size, or of one larger item."""
    part: list[_One] = []
    total = 0
    for item in every:
        size = size_of(item)
        if part and total + size > most:
            yield part
            part, total = [], 0
        part.append(item)
        total += size
    if part:
        yield part
