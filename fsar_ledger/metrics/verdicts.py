"""Judge our numbers against the paper's by two questions.

Both rules were registered before the fit, in `reports/registration.toml`.

- *Does this model give the printed number?* Equivalence by two one-sided tests, with our sampling error alone: `yes` if
  the 90 % interval of (ours - paper) lies within the metric's margin, `no` if it lies entirely outside, `undecided`
    otherwise, also where our mean has no SD.
- *Could the paper's experiment, run on this model, have printed it?* `no` if fewer than one in twenty experiments of
  the paper's size print a number as far out, `yes` otherwise. `drawn_places` draws these with replacement from runs
  that it draws from ours in the same way, so that the spread is of the paper's sampling error and of ours;
  `drawn_experiments` has their means, `drawn_effects` their effect sizes. For a whole table, the smallest p of its
  cells is compared with the smallest p of each drawn table (min-p, Westfall and Young 1993), so that correlated cells
  are not counted twice.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Generic, Literal, NamedTuple, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from fsar_ledger.metrics.definitions import Printed, printed, printed_tests, published_metrics
from fsar_ledger.metrics.registration import registration
from fsar_ledger.metrics.results import MetricRow, StatisticRow

if TYPE_CHECKING:
    from fsar_ledger.metrics.study_results import Predicted

Numbers = NDArray[np.float64]
Cell = tuple[str, str]
"""Metric and architecture: a cell of the results table."""

_Cell = TypeVar("_Cell")


class Odds(NamedTuple, Generic[_Cell]):
    """The p of each cell, and that of the whole table.

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
    p_of = {
        cell: float(_two_sided(steps[cell], np.array([round(printed[cell].value / printed[cell].step)]))[0])
        for cell in cells
    }
    smallest = np.min([_two_sided(steps[cell], steps[cell]) for cell in cells], axis=0)
    return Odds(p_of, float(np.mean(smallest <= min(p_of.values()))))


def share_text(share: float) -> str:
    """Return a share of the drawn experiments as text; a share of 0 includes their number."""
    return f"0 of {DRAWS:,}" if share == 0 else f"{share:.4f}"


def _numbers(values: Sequence[float | None] | Numbers) -> Numbers:
    return np.asarray(values, dtype=np.float64)


def _two_sided(steps: Numbers, numbers: Numbers) -> Numbers:
    """Return twice the smaller share of experiments that print this or less, or this or more.

    An undefined number is no evidence and gets 1.
    """
    defined = np.sort(steps[~np.isnan(steps)])
    below = np.searchsorted(defined, numbers, side="right") / len(defined)
    above = 1.0 - np.searchsorted(defined, numbers, side="left") / len(defined)
    shares = np.minimum(1.0, 2.0 * np.minimum(below, above))
    return np.where(np.isnan(numbers), 1.0, shares)


Answer = Literal["yes", "no", "undecided"]

ALPHA, DRAWS = registration().verdicts.alpha, registration().verdicts.draws
MARGINS: dict[str, float] = {one.name: one.printed.margin for one in published_metrics()}
"""Half-width within which a difference does not matter, in the metric's unit."""


class Comparison(msgspec.Struct, frozen=True, kw_only=True):
    """One cell judged. Differences are ours minus the paper's, in the metric's unit; None where ours is undefined.

    `low` and `high` are the 90 % interval of the difference, with our error alone; `distance` is the difference in
    margins. `gives` answers the first question, and `power` is the chance that it is `yes` where the model gives
    exactly the printed number. `share` is the two-sided share of drawn experiments, and `could` the answer to the
    second question; None where none were drawn.
    """

    metric: str
    architecture: str | None
    configuration: str | None
    fleet_size: int | None
    ours: float | None
    paper: float
    difference: float | None
    low: float | None
    high: float | None
    distance: float | None
    margin: float
    gives: Answer
    power: float | None
    share: float | None = None
    could: Answer | None = None


@cache
def published() -> dict[Cell, Printed]:
    """Return the 24 cells of the paper's results table in our unit, by metric and architecture.

    No other table is read. Paper: tab:results.
    """
    return {(place.metric, place.architecture): number for place, number in printed("results").items()}


def compare(rows: Iterable[MetricRow], odds: Odds[Cell] | None = None) -> list[Comparison]:
    """Judge every row whose metric and architecture the results table prints, in the given order.

    The second question is answered only if `odds` is given.
    """
    comparisons = []
    for row in rows:
        cell = (row.metric, row.architecture or "")
        if paper := published().get(cell):
            comparisons.append(judge(row, paper.value, None if odds is None else odds.cells.get(cell)))
    return comparisons


def judge(row: "MetricRow | Predicted", paper: float, share: float | None = None) -> Comparison:
    """Judge a number against a printed one, of any table, by the rules above.

    `share` is that of the drawn experiments, None if none were drawn.
    """
    margin = MARGINS[row.metric]
    difference = None if row.mean is None else row.mean - paper
    low = high = power = None
    if difference is not None and row.sd and row.n > 1:
        half_width = _half_width(row.sd, row.n)
        low, high, power = difference - half_width, difference + half_width, _power(row.sd, row.n, margin)
    if row.mean is None:
        share = None
    return Comparison(
        metric=row.metric,
        architecture=row.architecture,
        configuration=row.configuration,
        fleet_size=row.fleet_size,
        ours=row.mean,
        paper=paper,
        difference=difference,
        low=low,
        high=high,
        distance=None if difference is None else difference / margin,
        margin=margin,
        gives=gives(low, high, margin),
        power=power,
        share=share,
        could=could_print(share),
    )


def could_print(share: float | None) -> Answer | None:
    """Answer the second question by the share of drawn experiments; None if none were drawn."""
    return None if share is None else "no" if share < ALPHA else "yes"


class ComparedEffect(msgspec.Struct, frozen=True, kw_only=True):
    """One printed Cohen's d, with the sign of its t, beside ours over all pairs, and the answer to the second question.

    `share` is the two-sided share of drawn experiments of the paper's size (`results.drawn_effects`); None as in
    `Comparison`, and `ours` where neither side varies.
    """

    metric: str
    comparison: str
    ours: float | None
    paper: float
    share: float | None
    could: Answer | None


def compare_effects(
    rows: Iterable[StatisticRow], drawn: Mapping[tuple[str, str], Sequence[float | None]]
) -> list[ComparedEffect]:
    """Judge every test that the significance table prints, in the given order; `drawn` may be empty."""
    paper = {test: test_printed.d for test, test_printed in printed_tests().items()}
    chances = odds(drawn, paper)
    shares = {} if chances is None else chances.cells
    return [
        ComparedEffect(
            metric=row.metric,
            comparison=row.comparison,
            ours=row.cohens_d,
            paper=paper[test].value,
            share=shares.get(test),
            could=could_print(shares.get(test)),
        )
        for row in rows
        if (test := (row.metric, row.comparison)) in paper
    ]


def gives(low: float | None, high: float | None, margin: float) -> Answer:
    """Answer the first question by the 90 % interval of (ours - paper)."""
    if low is None or high is None:
        return "undecided"
    if -margin <= low and high <= margin:
        return "yes"
    return "no" if low > margin or high < -margin else "undecided"


def _half_width(sd: float, n: int) -> float:
    """Return half the 90 % interval of a mean of n runs: each of the two tests is at `ALPHA`."""
    from scipy.special import stdtrit

    return float(stdtrit(n - 1, 1.0 - ALPHA)) * sd / math.sqrt(n)


def _power(sd: float, n: int, margin: float) -> float:
    """Return the chance of `yes` if the true difference is 0, so that the whole interval is within the margin."""
    from scipy.special import stdtr

    reach = (margin - _half_width(sd, n)) / (sd / math.sqrt(n))
    return float(stdtr(n - 1, reach) - stdtr(n - 1, -reach)) if reach > 0 else 0.0
