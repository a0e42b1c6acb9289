"""Redo the paper's own arithmetic from its printed numbers alone, without any ledger.

Each function computes the numbers that one paragraph of "Contradictions in the paper" quotes, so that each can be
checked by hand.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import combinations

import msgspec

Z95 = 1.96  # two-sided 95 % quantile of the normal distribution, as rounded in the paper's intervals
ARCHITECTURES = ("FSAR", "CFC", "DHMA")


def half_width(sd: float, n: int) -> float:
    """Return the half width of a 95 % interval around a mean of `n` values with this SD. Unit: that of `sd`."""
    return Z95 * sd / math.sqrt(n)


def sd_of_half_width(half: float, n: int) -> float:
    """Return the SD implied by a printed 95 % half width of `n` values: the inverse of `half_width`."""
    return half * math.sqrt(n) / Z95


def wilson(share: float, n: int) -> tuple[float, float]:
    """Return the Wilson 95 % interval of a share observed on `n` trials. Unit: share."""
    centre = (share + Z95**2 / (2 * n)) / (1 + Z95**2 / n)
    reach = Z95 / (1 + Z95**2 / n) * math.sqrt(share * (1 - share) / n + Z95**2 / (4 * n * n))
    return centre - reach, centre + reach


def pooled_sd(difference: float, d: float) -> float:
    """Return the pooled SD implied by Cohen's d: |difference| / d. Unit: that of the difference."""
    return abs(difference) / d


def binary_d(first: float, second: float) -> float:
    """Return Cohen's d of a 0/1 value, which follows from its two means (shares) alone."""
    return abs(first - second) / math.sqrt((first * (1 - first) + second * (1 - second)) / 2)


def smallest_sd_with_a_zero(mean: float, groups: int) -> float:
    """Return the least SD of `groups` group means that average `mean` while one of them is 0.

    It is least when the others are equal, mean x groups / (groups - 1) each. The divisor is `groups`, which gives the
    smaller SD.
    """
    other = mean * groups / (groups - 1)
    return math.sqrt((mean**2 + (groups - 1) * (other - mean) ** 2) / groups)


def counts_that_print(percent: int, largest: int) -> list[str]:
    """Return the fractions "k/n" with n up to `largest` that round to this percentage, one k for each n."""
    found = []
    for n in range(1, largest + 1):
        k = round(percent * n / 100)
        if 100 * k >= (percent - 0.5) * n and 100 * k < (percent + 0.5) * n:
            found.append(f"{k}/{n}")
    return found


class Variances(msgspec.Struct, frozen=True):
    """Variances implied by three pairwise d, and the largest that rounding of the printed values still allows."""

    metric: str
    implied: Mapping[str, float]
    largest: Mapping[str, float]


def _squared_sd_range(first: float, second: float, d: float, mean_step: float, d_step: float) -> tuple[float, float]:
    difference = abs(first - second)
    least = max(difference - mean_step, 0.0) / (d + d_step / 2)
    most = (difference + mean_step) / (d - d_step / 2)
    return least**2, most**2


def implied_variances(
    metric: str, means: Mapping[str, float], d: Mapping[frozenset[str], float], mean_step: float, d_step: float = 0.01
) -> Variances:
    """Return the three variances that follow from (v_a + v_b) / 2 = ((m_a - m_b) / d_ab)^2 for each pair.

    `mean_step` and `d_step` are one unit in the last printed place; `largest` uses all the room that rounding leaves.
    """
    squared = {
        frozenset(pair): pooled_sd(means[pair[0]] - means[pair[1]], d[frozenset(pair)]) ** 2
        for pair in combinations(means, 2)
    }
    ranges = {
        frozenset(pair): _squared_sd_range(means[pair[0]], means[pair[1]], d[frozenset(pair)], mean_step, d_step)
        for pair in combinations(means, 2)
    }
    implied, largest = {}, {}
    for one in means:
        first, second = (other for other in means if other != one)
        near, far, opposite = frozenset((one, first)), frozenset((one, second)), frozenset((first, second))
        implied[one] = squared[near] + squared[far] - squared[opposite]
        largest[one] = ranges[near][1] + ranges[far][1] - ranges[opposite][0]
    return Variances(metric=metric, implied=implied, largest=largest)


def growth_exponent(sizes: Sequence[float], values: Sequence[float]) -> float:
    """Return the exponent b of value ~ size^b between the first and the last point; above 1 is super-linear."""
    return math.log(values[-1] / values[0]) / math.log(sizes[-1] / sizes[0])
