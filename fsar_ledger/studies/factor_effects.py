"""Two measures of how much each factor matters: elementary effects by Morris' method, and Sobol indices.

Morris: trajectories through the unit cube on which one factor moves at a time. The definitions are those of Morris
(1991) with the mean of absolute effects of Campolongo et al. (2007), as in SALib; a test compares the numbers with
SALib's. Two things differ from SALib. Where a cell is undefined at a point, only the two effects at that point are
unknown. And the design is drawn from hashes: trajectory 5 is the same for any number of trajectories and any version
of numpy.

Sobol indices of a few factors come from a polynomial that emulates the simulator. It is of degree three in each factor
and has the product of each pair. Its terms are orthonormal under the distribution of the design (each factor uniform
over its range or settings, independent of the others), so the squares of its coefficients are parts of the variance,
and the indices are sums of them; nothing more is drawn. How well it emulates the simulator is measured by predicting
each point from all others.
"""

import math
from collections.abc import Sequence
from hashlib import blake2b
from itertools import combinations

import msgspec
import numpy as np

from fsar_ledger.metrics.robustness import Z_95
from fsar_ledger.studies.factors import Factor

LEVELS = 4
DELTA = LEVELS / (2 * (LEVELS - 1))  # step of every move, as a part of the unit interval
LEAST_EFFECTS = 2  # with fewer there is no spread

Vector = np.ndarray[tuple[int], np.dtype[np.float64]]
Matrix = np.ndarray[tuple[int, int], np.dtype[np.float64]]


class Effects(msgspec.Struct, frozen=True):
    """The effects of moving one factor on one cell, over `count` known effects; None if there are fewer than two.

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

    It is per whole range of the factor, extrapolated from the step; for a switch, per change.
    """
    effects = np.full(len(path.moved), math.nan)
    for step, factor in enumerate(path.moved):
        moved = path.points[step + 1, factor] - path.points[step, factor]
        change = outputs[step + 1] - outputs[step]
        effects[factor] = change * math.copysign(1, moved) if is_switch[factor] else change / moved
    return effects


def summary(effects: Vector) -> Effects:
    """Summarise the effects of one factor on one cell over all trajectories; NaN is unknown.

    The interval is the one that SALib gets by resampling trajectories, computed directly: 1.96 standard errors.
    """
    known = effects[~np.isnan(effects)]
    if len(known) < LEAST_EFFECTS:
        return Effects(len(known), None, None, None, None)
    sizes = np.abs(known)
    error = float(np.std(sizes)) / math.sqrt(len(sizes))
    return Effects(len(known), float(np.mean(known)), float(np.mean(sizes)), float(np.std(known, ddof=1)), Z_95 * error)


def by_chance(deviation: float, *, is_switch: bool) -> float:
    """Return the mean size of effects if only chance moved the cell: for two independent means with this SD.

    It is an upper bound: points of a trajectory meet the same worlds, and share much of the chance.
    """
    return 2 * deviation / math.sqrt(math.pi) / (1 if is_switch else DELTA)


DEGREE = 3
GRID = 840  # positions that sample a factor evenly; 2 to 8 settings divide it equally
PENALTIES = (0.0, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
LEAST_R2 = 0.8
"""Below this the polynomial is too inaccurate, and no index is given."""


class Indices(msgspec.Struct, frozen=True):
    """The contribution of each factor to the variance of one cell: alone, and with others.

    `r2` is for points that the polynomial had not seen. None if the cell does not vary, is undefined at a point, or
    there are fewer points than terms; the indices also if R2 is below 0.8.
    """

    r2: float | None
    first: tuple[float, ...] | None
    total: tuple[float, ...] | None


class Terms(msgspec.Struct, frozen=True):
    """The polynomial at each point of a design: a column for each term, and the factors of each."""

    values: Matrix
    of: tuple[tuple[int, ...], ...]


def design(points: int, names: Sequence[str]) -> Matrix:
    """Return `points` points of the unit cube, a coordinate per factor: a Sobol sequence, shifted by hashed names."""
    from scipy.stats import qmc

    if not points:
        return np.zeros((0, len(names)))
    sequence = qmc.Sobol(len(names), scramble=False).random_base2((points - 1).bit_length())[:points]
    shifts = [
        int.from_bytes(blake2b(name.encode(), digest_size=6, person=b"sobol").digest(), "big") / 2**48 for name in names
    ]
    return np.asarray((sequence + np.array(shifts)) % 1.0)


def terms(factors: Sequence[Factor], positions: Matrix) -> Terms:
    """Return the terms of the polynomial of these factors, without the constant."""
    columns: list[Vector] = []
    factors_of: list[tuple[int, ...]] = []
    linear: dict[int, Vector] = {}
    for number, factor in enumerate(factors):
        powers = _orthonormal(factor, positions[:, number])
        columns += list(powers)
        factors_of += [(number,)] * len(powers)
        linear[number] = powers[0]
    for first, second in combinations(range(len(factors)), 2):
        columns.append(linear[first] * linear[second])
        factors_of.append((first, second))
    return Terms(np.array(columns).T.reshape(len(positions), len(factors_of)), tuple(factors_of))


def _orthonormal(factor: Factor, positions: Vector) -> list[Vector]:
    """Return polynomials of the factor at these positions, orthonormal and with mean 0 under its distribution.

    There are as many as its settings can distinguish.
    """
    grid = _coordinates(factor, (np.arange(GRID) + 0.5) / GRID)
    coordinates = _coordinates(factor, positions)
    degree = min(DEGREE, len(factor.settings) - 1) if factor.settings else DEGREE
    _, triangle = np.linalg.qr(np.vander(grid, degree + 1, increasing=True) / np.sqrt(GRID))
    polynomials = np.linalg.solve(triangle.T, np.vander(coordinates, degree + 1, increasing=True).T)
    signs = np.sign(np.diag(triangle))
    return [np.asarray(sign * row) for sign, row in zip(signs[1:], polynomials[1:], strict=True)]


def _coordinates(factor: Factor, positions: Vector) -> Vector:
    """Map the factor to the interval from -1 to 1: by its position, or by the number of its setting."""
    count = len(factor.settings)
    return np.asarray(
        2 * np.minimum(np.floor(positions * count), count - 1) / (count - 1) - 1 if count else 2 * positions - 1
    )


def indices(found: Terms, outputs: Vector, factor_count: int) -> Indices:
    """Return the indices of one cell from its values at the points of the design."""
    if np.isnan(outputs).any() or len(outputs) <= len(found.of) + 1 or np.ptp(outputs) == 0:
        return Indices(None, None, None)
    r2, coefficients = _fitted(found.values, outputs)
    variances = coefficients**2
    if r2 < LEAST_R2:
        return Indices(r2, None, None)
    whole = float(variances.sum())
    first = [
        sum(float(part) for part, members in zip(variances, found.of, strict=True) if members == (factor,)) / whole
        for factor in range(factor_count)
    ]
    total = [
        sum(float(part) for part, members in zip(variances, found.of, strict=True) if factor in members) / whole
        for factor in range(factor_count)
    ]
    return Indices(r2, tuple(first), tuple(total))


def _fitted(values: Matrix, outputs: Vector) -> tuple[float, Vector]:
    """Return R2 of predicting each point from all others, and the coefficients, under the best predicting penalty."""
    centre, mean = values.mean(axis=0), float(outputs.mean())
    left, singular, right = np.linalg.svd(values - centre, full_matrices=False)
    centred = outputs - mean
    projected = left.T @ centred
    best: tuple[float, Vector] | None = None
    for penalty in PENALTIES:
        shrinkage = singular**2 / (singular**2 + penalty)
        leverage = 1 / len(outputs) + (left**2) @ shrinkage
        errors = (centred - left @ (shrinkage * projected)) / np.maximum(1 - leverage, 1e-9)
        r2 = 1 - float(errors @ errors) / float(centred @ centred)
        if best is None or r2 > best[0]:
            best = r2, np.asarray(right.T @ (singular / (singular**2 + penalty) * projected))
    assert best is not None
    return best
