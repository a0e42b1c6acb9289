"""Tell whether the paper's experiment, run on this model, could have printed these numbers.

The rules are registered in `reports/registration.toml`, `[verdicts]`.

`drawn_experiments` draws experiments of the paper's size from the runs of a ledger. The share of them that print a
number at least as far out as the paper's, on either side, is the two-sided p of a cell. For the table, the smallest p
of its cells is compared with the smallest p of each drawn table (min-p, Westfall and Young 1993), so that correlated
cells are not counted twice.
"""

from collections.abc import Mapping, Sequence
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]
Cell = tuple[str, str]
"""Metric and architecture: a cell of the results table."""

_Cell = TypeVar("_Cell")


class Printed(NamedTuple):
    """A printed number in our unit, and the step of its last digit."""

    value: float
    step: float


class Odds(NamedTuple, Generic[_Cell]):
    """The p of each cell, and that of the table as a whole.

    Cells for which no drawn experiment has a number are left out.
    """

    cells: dict[_Cell, float]
    table: float


def odds(
    drawn: Mapping[_Cell, Sequence[float | None] | Numbers], printed: Mapping[_Cell, Printed]
) -> Odds[_Cell] | None:
    """Return how likely the printed table is among the drawn ones; None if they share no cell.

    `drawn` holds a number for each drawn experiment, in the same order for every cell; None where an experiment leaves
    it undefined.
    """
    cells = [cell for cell in printed if cell in drawn and not np.isnan(_numbers(drawn[cell])).all()]
    if not cells:
        return None
    steps = {cell: np.round(_numbers(drawn[cell]) / printed[cell].step) for cell in cells}
    found = {
        cell: float(_two_sided(steps[cell], np.array([round(printed[cell].value / printed[cell].step)]))[0])
        for cell in cells
    }
    smallest = np.min([_two_sided(steps[cell], steps[cell]) for cell in cells], axis=0)
    return Odds(found, float(np.mean(smallest <= min(found.values()))))


def _numbers(values: Sequence[float | None] | Numbers) -> Numbers:
    return np.asarray(values, dtype=np.float64)


def _two_sided(steps: Numbers, asked: Numbers) -> Numbers:
    """Return twice the smaller share of experiments that print this or less, or this or more.

    An undefined number is no evidence and gets 1.
    """
    defined = np.sort(steps[~np.isnan(steps)])
    below = np.searchsorted(defined, asked, side="right") / len(defined)
    above = 1.0 - np.searchsorted(defined, asked, side="left") / len(defined)
    shares = np.minimum(1.0, 2.0 * np.minimum(below, above))
    return np.where(np.isnan(asked), 1.0, shares)
