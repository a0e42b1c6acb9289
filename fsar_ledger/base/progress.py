"""Progress reporting for long operations."""

from collections.abc import Callable, Iterator, Sequence
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
