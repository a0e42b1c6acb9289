"""Points in the registered ranges of the free constants.

A point has a coordinate for each free constant, in the order of the registration: 0 is the middle of its range, -1 and
1 are its ends, on a logarithmic scale.
"""

from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from fsar_ledger.designs.constants import Constants
from fsar_ledger.metrics.registration import Free, registration

from .factor_effects import Matrix, Vector

FREE = registration().free


def sobol(size: int, seed: int) -> Matrix:
    """Return so many points of a scrambled Sobol sequence over the unit cube, one coordinate a free constant."""
    from scipy.stats.qmc import Sobol

    return np.asarray(Sobol(len(FREE), rng=seed).random_base2((size - 1).bit_length())[:size])


def points_over_ranges(size: int, seed: int) -> list[Vector]:
    """Return so many points that cover the ranges evenly."""
    return [np.asarray(2.0 * one - 1.0) for one in sobol(size, seed)]


def at(point: Vector) -> Constants:
    """Return the constants at a point."""
    return with_values(
        [
            one.range.middle * (one.range.high / one.range.middle) ** float(place)
            for one, place in zip(FREE, point, strict=True)
        ]
    )


def point_of(values: Sequence[float]) -> Vector:
    """Return the point at which the free constants have these values; the inverse of `at`, but for its digits."""
    return np.array(
        [
            np.log(value / one.range.middle) / np.log(one.range.high / one.range.middle)
            for one, value in zip(FREE, values, strict=True)
        ]
    )


def with_values(values: Sequence[float]) -> Constants:
    """Return the constants with these values for the free ones, in the order of the registration."""
    changes: dict[str, dict[str, Any]] = {"world": {}, "structure": {}}
    for one, value in zip(FREE, values, strict=True):
        part, _, name = one.name.partition(".")
        changes[part][name] = rounded(value) if part == "world" else int(rounded(value))
    base = Constants()
    replace = msgspec.structs.replace
    return Constants(replace(base.world, **changes["world"]), replace(base.structure, **changes["structure"]))


def value_of(constants: Constants, free: Free) -> float:
    """Return the value of a free constant."""
    part, _, name = free.name.partition(".")
    return getattr(getattr(constants, part), name)  # type: ignore[no-any-return]


def rounded(value: float) -> float:
    """Return the value with three significant digits; the data do not determine more."""
    return float(f"{value:.3g}")
