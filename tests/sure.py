"""What a test is sure of: it fails here where that is not so."""

from collections.abc import Sequence
from typing import TypeVar

T = TypeVar("T")


def known(value: T | None) -> T:
    """The value, which is there."""
    assert value is not None
    return value


def only(kind: type[T], found: Sequence[object]) -> T:
    """The one that was found, which is of this kind."""
    [one] = found
    assert isinstance(one, kind)
    return one
