"""Long operations: how their progress is reported, and their parts."""

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
    """Yield these in order, in parts of at most this size all together, or of one that is larger."""
    part: list[_One] = []
    whole = 0
    for one in every:
        size = size_of(one)
        if part and whole + size > most:
            yield part
            part, whole = [], 0
        part.append(one)
        whole += size
    if part:
        yield part
