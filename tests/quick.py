"""Values of a test of which plain `pytest` takes a few; with `-m ""`, as in `make test-all`, it takes them all."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def few(values: Iterable[Any], quick: Collection[Any]) -> list[Any]:
    """Return all values for a parameter, those that are not among the quick ones marked as slow.

    Raises:
        ValueError: A quick one is not among the values.
    """
    every = list(values)
    if unknown := [value for value in quick if value not in every]:
        raise ValueError(f"quick: found {unknown!r}, expected some of {every!r}")
    return [value if value in quick else pytest.param(value, marks=pytest.mark.slow) for value in every]
