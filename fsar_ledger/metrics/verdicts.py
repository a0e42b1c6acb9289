"""The paper beside ours: one rule for every cell of the results table.

The interval of (ours - paper) carries the sampling error of both, side by side (MOVER): ours from the interval that
stands beside our mean, the paper's from the SD that its own tables imply, at its n of 100. The printed plus-minus is
not used: it is 1.96 * SD of five scenario means /
sqrt(100), which is no sampling error. The cell

- *differs* if the 95 % interval excludes 0,
- is *reproduced* if the interval lies inside the metric's fixed margin,
- is *undecided* otherwise, also where our mean has no interval or no SD (fewer than two runs), or the metric is undefined.
"""

import csv
import math
from collections.abc import Iterable
from functools import cache
from importlib.resources import files
from typing import Literal

import msgspec

from fsar_ledger.registration import registration

from .results import MetricRow

Verdict = Literal["reproduced", "undecided", "differs"]

PAPER_RUNS = 100
"""Runs per architecture in the paper: 5 scenarios of 20."""

Z_95 = 1.959963984540054
"""97.5 % quantile of the standard normal."""

MARGINS: dict[str, float] = registration().margins
"""Half-width within which a difference does not matter, in the metric's unit; registered before the fit."""

_PRINTED: dict[str, tuple[str, str, float]] = {
    "coordination_success": ("coordination_success_pct", "coordination_success", 100.0),
    "governance_locality": ("governance_locality", "governance_locality", 1.0),
    "recovery_containment": ("recovery_containment", "recovery_containment", 1.0),
    "authority_conflicts": ("authority_conflicts", "authority_conflicts", 1.0),
    "policy_violations": ("policy_violations", "policy_violations", 1.0),
    "reassignment_latency_s": ("reassignment_latency_s", "reassignment_latency", 1.0),
    "human_intervention": ("human_interventions_pct", "human_interventions", 100.0),
    "audit_attributability": ("audit_attributability", "audit_attributability", 1.0),
}
# Each metric's name in results.csv and in significance.csv, and how many printed units make one of ours (percent, shares).


class Published(msgspec.Struct, frozen=True, kw_only=True):
    """One cell of the paper's results table, in our unit. Paper: tab:results.

    `implied_sd` is the SD per run that its tables imply: |difference of means| / d of the pair with FSAR, for FSAR of FSAR and CFC.
    """

    metric: str
    architecture: str
    mean: float
    printed_ci95: float
    implied_sd: float


class Comparison(msgspec.Struct, frozen=True, kw_only=True):
    """One cell judged. Differences are ours minus the paper's, in the metric's unit; None where ours is undefined.

    `distance_se` is the difference in standard errors of a mean of 100 runs, from the larger of our SD and the implied one.
    """

    metric: str
    architecture: str | None
    configuration: str | None
    fleet_size: int | None
    ours: float | None
    paper: float
    implied_sd: float
    difference: float | None
    ci_low: float | None
    ci_high: float | None
    margin: float
    verdict: Verdict
    distance_se: float | None


def _table(name: str) -> list[dict[str, str]]:
    """A table of the paper as it is printed."""
    text = files("fsar_ledger.reports").joinpath("paper", f"{name}.csv").read_text("utf-8")
    return list(csv.DictReader(text.splitlines()))


@cache
def printed_means() -> dict[tuple[str, str], float]:
    """The 24 means of the paper's results table in our unit, by metric and architecture. No other table is read for them."""
    printed = {(row["metric"], row["architecture"]): float(row["mean"]) for row in _table("results")}
    return {(metric, name.lower()): printed[result, name] / unit for metric, (result, _, unit) in _PRINTED.items() for name in ("FSAR", "CFC", "DHMA")}


@cache
def published() -> dict[tuple[str, str], Published]:
    """The 24 cells of the paper's results table by metric and architecture."""
    printed = {(row["metric"], row["architecture"]): (float(row["mean"]), float(row["printed_ci95"])) for row in _table("results")}
    effects = {(row["metric"], row["comparison"]): float(row["cohens_d"]) for row in _table("significance")}
    cells: dict[tuple[str, str], Published] = {}
    for metric, (name, tested_name, unit) in _PRINTED.items():
        fsar, _ = printed[name, "FSAR"]
        for architecture in ("FSAR", "CFC", "DHMA"):
            mean, half_width = printed[name, architecture]
            other = "CFC" if architecture == "FSAR" else architecture
            implied_sd = abs(fsar - printed[name, other][0]) / effects[tested_name, f"FSAR vs {other}"]
            cells[metric, architecture.lower()] = Published(
                metric=metric,
                architecture=architecture.lower(),
                mean=mean / unit,
                printed_ci95=half_width / unit,
                implied_sd=implied_sd / unit,
            )
    return cells


def compare(rows: Iterable[MetricRow]) -> list[Comparison]:
    """The verdict on every row whose metric and architecture the paper prints, in the order given."""
    return [_judge(row, paper) for row in rows if (paper := published().get((row.metric, row.architecture or "")))]


def _judge(row: MetricRow, paper: Published) -> Comparison:
    """One cell judged by the rule above."""
    difference = None if row.mean is None else row.mean - paper.mean
    ci_low = ci_high = distance_se = None
    if row.mean is not None and difference is not None and row.sd is not None:
        distance_se = difference / (max(row.sd, paper.implied_sd) / math.sqrt(PAPER_RUNS))
        if row.ci_low is not None and row.ci_high is not None:
            half_width = Z_95 * paper.implied_sd / math.sqrt(PAPER_RUNS)
            ci_low = difference - math.hypot(row.mean - row.ci_low, half_width)
            ci_high = difference + math.hypot(row.ci_high - row.mean, half_width)
    margin = MARGINS[row.metric]
    return Comparison(
        metric=row.metric,
        architecture=row.architecture or "",
        configuration=row.configuration,
        fleet_size=row.fleet_size,
        ours=row.mean,
        paper=paper.mean,
        implied_sd=paper.implied_sd,
        difference=difference,
        ci_low=ci_low,
        ci_high=ci_high,
        margin=margin,
        verdict=verdict(ci_low, ci_high, margin),
        distance_se=distance_se,
    )


def verdict(ci_low: float | None, ci_high: float | None, margin: float) -> Verdict:
    """The verdict on a 95 % interval of (ours - paper)."""
    if ci_low is None or ci_high is None:
        return "undecided"
    if ci_low > 0 or ci_high < 0:
        return "differs"
    return "reproduced" if -margin <= ci_low and ci_high <= margin else "undecided"
