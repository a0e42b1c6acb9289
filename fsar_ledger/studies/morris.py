"""Screen by Morris' method: trajectories through the unit cube on which one factor moves at a time, and the effects.

The definitions are those of Morris (1991) with the mean of absolute effects of Campolongo et al. (2007), as in SALib; a
test compares the numbers with SALib's. Two things are ours. Where a cell is undefined at a point, only the two effects
that touch the point are unknown. And the design is drawn from hashes: trajectory 5 is the same whatever the number of
trajectories or the version of numpy.
"""

import math
from collections.abc import Sequence
from hashlib import blake2b

import msgspec
import numpy as np

LEVELS = 4
DELTA = LEVELS / (2 * (LEVELS - 1))  # step of every move, as a part of the unit interval
Z_95 = 1.959963984540054
LEAST_EFFECTS = 2  # with fewer there is no spread

Vector = np.ndarray[tuple[int], np.dtype[np.float64]]
Matrix = np.ndarray[tuple[int, int], np.dtype[np.float64]]


class Effects(msgspec.Struct, frozen=True):
    """The effects of moving one factor on one cell, over `count` known effects; None if those are fewer than two.

    They are mean, mean size, standard deviation and half-width of the 95 % interval of the mean size.
    """

    count: int
    mu: float | None
    mu_star: float | None
    sigma: float | None
    mu_star_conf: float | None


class Trajectory(msgspec.Struct, frozen=True):
    """A sequence of points, each with a position for every factor; `moved` names the factor that each step moves."""

    points: Matrix
    moved: tuple[int, ...]


def trajectory(number: int, names: Sequence[str]) -> Trajectory:
    """Return the trajectory of this number: a random point of the grid, then each factor moved once in random order."""
    digests = [_digest(f"{number}/{name}") for name in names]
    levels = np.array([digest % LEVELS for digest in digests])
    rows = [levels]
    order = tuple(sorted(range(len(names)), key=lambda factor: digests[factor] // LEVELS))
    for factor in order:
        levels = levels.copy()
        levels[factor] += LEVELS // 2 if levels[factor] < LEVELS // 2 else -(LEVELS // 2)
        rows.append(levels)
    return Trajectory(np.asarray(np.array(rows) / (LEVELS - 1)), order)


def _digest(text: str) -> int:
    return int.from_bytes(blake2b(text.encode(), digest_size=16, person=b"morris").digest(), "big")


def elementary_effects(path: Trajectory, outputs: Vector, is_switch: Sequence[bool]) -> Vector:
    """Return the effect of moving each factor on this trajectory, NaN if the cell is undefined before or after.

    It is per whole range of the factor, as if the effect continued beyond the step; for a switch, per change.
    """
    effects = np.full(len(path.moved), math.nan)
    for step, factor in enumerate(path.moved):
        moved = path.points[step + 1, factor] - path.points[step, factor]
        change = outputs[step + 1] - outputs[step]
        effects[factor] = change * math.copysign(1, moved) if is_switch[factor] else change / moved
    return effects


def summary(effects: Vector) -> Effects:
    """Summarise the effects of one factor on one cell over all trajectories; NaN is unknown.

    The interval is what SALib finds by resampling trajectories, computed directly: 1.96 times their standard error.
    """
    known = effects[~np.isnan(effects)]
    if len(known) < LEAST_EFFECTS:
        return Effects(len(known), None, None, None, None)
    sizes = np.abs(known)
    error = float(np.std(sizes)) / math.sqrt(len(sizes))
    return Effects(len(known), float(np.mean(known)), float(np.mean(sizes)), float(np.std(known, ddof=1)), Z_95 * error)


def by_chance(deviation: float, *, is_switch: bool) -> float:
    """Return the mean size of effects if only chance moved the cell: of two independent means with this SD.

    An upper bound: points of a trajectory meet the same worlds, and much of the chance is common to them.
    """
    return 2 * deviation / math.sqrt(math.pi) / (1 if is_switch else DELTA)
