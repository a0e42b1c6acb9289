"""The paper beside ours: two questions, and an answer to each for every cell of the results table.

Both rules were registered before the fit, in `reports/registration.toml`.

- *Does this model give the printed number?* Equivalence by two one-sided tests, with our sampling error alone: `yes` if the 90 % interval of
  (ours - paper) lies within the metric's margin, `no` if it lies wholly outside, `undecided` otherwise, also where our mean has no SD.
- *Could the paper's experiment, run on this model, have printed it?* `no` if fewer than one in twenty experiments of the paper's size, drawn from our
  runs, print a number as far out (`odds.py`), `yes` otherwise.
"""

import csv
import math
from collections.abc import Iterable
from functools import cache
from importlib.resources import files
from typing import Literal

import msgspec

from fsar_ledger.registration import registration

from .odds import Cell, Odds, Printed
from .results import MetricRow

Answer = Literal["yes", "no", "undecided"]

ALPHA = registration().verdicts.alpha
MARGINS: dict[str, float] = registration().margins
"""Half-width within which a difference does not matter, in the metric's unit."""

_PRINTED: dict[str, tuple[str, float]] = {
    "coordination_success": ("coordination_success_pct", 100.0),
    "governance_locality": ("governance_locality", 1.0),
    "recovery_containment": ("recovery_containment", 1.0),
    "authority_conflicts": ("authority_conflicts", 1.0),
    "policy_violations": ("policy_violations", 1.0),
    "reassignment_latency_s": ("reassignment_latency_s", 1.0),
    "human_intervention": ("human_interventions_pct", 100.0),
    "audit_attributability": ("audit_attributability", 1.0),
}
# Each metric's name in results.csv, and how many printed units make one of ours (percent, shares).


class Comparison(msgspec.Struct, frozen=True, kw_only=True):
    """One cell judged. Differences are ours minus the paper's, in the metric's unit; None where ours is undefined.

    `low` and `high` are the 90 % interval of the difference, with our error alone; `distance` is the difference in margins. `gives` answers the first
    question, and `power` is the chance that it is `yes` where the model gives exactly the printed number. `share` is the two-sided share of drawn
    experiments, and `could` the answer to the second question; None where none were drawn.
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
    """The 24 cells of the paper's results table in our unit, by metric and architecture. No other table is read for them. Paper: tab:results."""
    text = files("fsar_ledger.reports").joinpath("paper", "results.csv").read_text("utf-8")
    printed = {(row["metric"], row["architecture"]): row["mean"] for row in csv.DictReader(text.splitlines())}
    cells: dict[Cell, Printed] = {}
    for metric, (name, unit) in _PRINTED.items():
        for architecture in ("FSAR", "CFC", "DHMA"):
            mean = printed[name, architecture]
            cells[metric, architecture.lower()] = Printed(float(mean) / unit, 10.0 ** -len(mean.partition(".")[2]) / unit)
    return cells


def compare(rows: Iterable[MetricRow], odds: Odds | None = None) -> list[Comparison]:
    """The answers for every row whose metric and architecture the paper prints, in the order given; the second only with odds."""
    return [_judge(row, paper.value, odds) for row in rows if (paper := published().get((row.metric, row.architecture or "")))]


def _judge(row: MetricRow, paper: float, odds: Odds | None) -> Comparison:
    """One cell judged by the rules above."""
    margin = MARGINS[row.metric]
    difference = None if row.mean is None else row.mean - paper
    low = high = power = None
    if difference is not None and row.sd and row.n > 1:
        half_width = _half_width(row.sd, row.n)
        low, high, power = difference - half_width, difference + half_width, _power(row.sd, row.n, margin)
    share = None if odds is None or row.mean is None else odds.cells.get((row.metric, row.architecture or ""))
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
        could=None if share is None else "no" if share < ALPHA else "yes",
    )


def gives(low: float | None, high: float | None, margin: float) -> Answer:
    """The answer to the first question, by the 90 % interval of (ours - paper)."""
    if low is None or high is None:
        return "undecided"
    if -margin <= low and high <= margin:
        return "yes"
    return "no" if low > margin or high < -margin else "undecided"


def _half_width(sd: float, n: int) -> float:
    """Half the 90 % interval of a mean of n runs: each of the two tests is at `ALPHA`."""
    from scipy.special import stdtrit

    return float(stdtrit(n - 1, 1.0 - ALPHA)) * sd / math.sqrt(n)


def _power(sd: float, n: int, margin: float) -> float:
    """The chance of `yes` where the difference is nothing: that the mean lies so near that its interval is within the margin."""
    from scipy.special import stdtr

    reach = (margin - _half_width(sd, n)) / (sd / math.sqrt(n))
    return float(stdtr(n - 1, reach) - stdtr(n - 1, -reach)) if reach > 0 else 0.0
