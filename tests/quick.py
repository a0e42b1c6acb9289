"""Values of a test, by tier: plain `pytest` takes a few; `make test-all` these and the slow ones; `make soak-tests` the
rest, which find what a coarser step misses."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def few(values: Iterable[Any], quick: Collection[Any], slow: Collection[Any] | None = None) -> list[Any]:
    """Return all values for a parameter, those that are not among the quick ones marked as slow.

    Where the slow ones are named, what is in neither is marked as a soak.

    Raises:
        ValueError: A quick or slow one is not among the values.
    """
    every = list(values)
    if unknown := [value for value in (*quick, *(slow or ())) if value not in every]:
        raise ValueError(f"quick: found {unknown!r}, expected some of {every!r}")

    def marked(value: Any) -> Any:
        mark = pytest.mark.slow if slow is None or value in slow else pytest.mark.soak
        return value if value in quick else pytest.param(value, marks=mark)

    return [marked(value) for value in every]
