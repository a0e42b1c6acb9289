"""The intervals of the metrics: within the scale of each, and right as often as they say."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pyarrow as pa
import pytest
from numpy.typing import NDArray
from scipy import stats

from fsar_ledger.metrics.database import Database, from_rows
from tests.quick import few

Numbers = NDArray[np.float64]
Drawn = Callable[[np.random.Generator, tuple[int, int]], tuple[Numbers, ...]]
COUNT, TIME, SHARE = "authority_conflicts", "reassignment_latency_s", "coordination_success"
POOLED_SHARE = "recovery_containment"
YES_NO = "human_intervention"


@cache
def opened() -> Database:
    """One connection for all tests: each holds its own values."""
    return from_rows([])


def intervals(
    metric: str, x: Numbers, pooled: Numbers | None = None, denominators: Numbers | None = None
) -> tuple[Numbers, Numbers]:
    """The lower and upper bounds for each row of `x`, whose columns are runs; NaN where there is none."""
    repeats, runs = x.shape
    each = np.repeat(np.arange(repeats), runs)
    values = {
        "architecture": pa.array(["fsar"] * x.size),
        "configuration": pa.array(each),
        "fleet_size": pa.array(np.full(x.size, 4)),
        "pools_seeds": pa.array(np.zeros(x.size, bool)),
        "seed": pa.array(np.full(x.size, 42)),
        "run_seed": pa.array(np.full(x.size, 42)),
        **{
            name: pa.nulls(x.size, pa.string())
            for name in ("setting", "kind", "source", "model_version", "constants", "scenario", "not_observed")
        },
        "position": pa.array(np.full(x.size, 1)),
        "metric": pa.array([metric] * x.size),
        "run_id": pa.array(np.tile(np.arange(runs), repeats)),
        "denominator": pa.array((np.ones(x.size) if denominators is None else denominators.ravel()).astype(np.int64)),
        "value_without_routine": pa.nulls(x.size, pa.float64()),
        "published_convention_value": pa.nulls(x.size, pa.float64()),
        "x": pa.array(x.ravel()),
        "pooled_mean": pa.nulls(x.size, pa.float64()) if pooled is None else pa.array(np.repeat(pooled, runs)),
    }
    database = opened()
    database.hold("summary_values", pa.table(values))
    found = database.table("SELECT ci_low, ci_high FROM metric_summary ORDER BY configuration")
    low, high = (found.column(name).to_numpy() for name in ("ci_low", "ci_high"))
    return low, high


def linearised(numerators: Numbers, denominators: Numbers) -> tuple[Numbers, Numbers, Numbers]:
    """What each run contributes to a pooled ratio (`summary_values`), the ratios, and what each run counts."""
    is_any = denominators.sum(axis=1) > 0
    numerators, denominators = numerators[is_any], denominators[is_any]
    ratios = numerators.sum(axis=1) / denominators.sum(axis=1)
    residuals = numerators - ratios[:, None] * denominators
    return ratios[:, None] + residuals / denominators.mean(axis=1)[:, None], ratios, denominators


def contained(failures_a_run: float, share: float) -> Drawn:
    """Failures of each run, of which so many are contained."""

    def drawn(draws: np.random.Generator, shape: tuple[int, int]) -> tuple[Numbers, ...]:
        failures = draws.poisson(failures_a_run, shape)
        return linearised(draws.binomial(failures, share).astype(float), failures.astype(float))

    return drawn


def latencies(failures_a_run: float) -> Drawn:
    """Latencies of the failures of each run, 3 s in the mean."""

    def drawn(draws: np.random.Generator, shape: tuple[int, int]) -> tuple[Numbers, ...]:
        failures = draws.poisson(failures_a_run, shape)
        return linearised(draws.gamma(4 * failures + 1e-12, 0.75), failures.astype(float))

    return drawn


RUNS = 100
"""As many as the paper has for each architecture."""

LAWS: dict[str, tuple[str, float, Drawn]] = {
    "one or two tasks a run": (SHARE, 0.93, lambda draws, shape: (draws.binomial(2, 0.93, shape) / 2,)),
    "scenarios that differ": (
        SHARE,
        0.92,
        lambda draws, shape: (draws.binomial(1, np.where(np.arange(shape[1]) % 5, 0.95, 0.8), shape).astype(float),),
    ),
    "nearly every record": (SHARE, 0.98, lambda draws, shape: (draws.beta(98, 2, shape),)),
    "rare conflicts": (COUNT, 0.3, lambda draws, shape: (draws.poisson(0.3, shape).astype(float),)),
    "conflicts in bursts": (COUNT, 8.0, lambda draws, shape: (draws.negative_binomial(2, 0.2, shape).astype(float),)),
    "failures contained": (POOLED_SHARE, 0.9, contained(0.75, 0.9)),
    "latency of failures": (TIME, 3.0, latencies(0.75)),
}


@pytest.mark.parametrize("law", few(LAWS, ["one or two tasks a run", "failures contained", "latency of failures"]))
def test_an_interval_holds_the_truth_in_93_to_97_of_100_experiments(law: str) -> None:
    metric, truth, drawn = LAWS[law]
    low, high = intervals(metric, *drawn(np.random.default_rng(2026), (6_000, RUNS)))
    assert 0.93 <= np.mean((low <= truth) & (truth <= high)) <= 0.97


FEW: dict[str, tuple[str, float, float, int, Drawn]] = {
    "3 failures in 20 runs": (POOLED_SHARE, 0.93, 0.8, 20, contained(0.15, 0.8)),
    "8 failures in 20 runs": (POOLED_SHARE, 0.93, 0.8, 20, contained(0.4, 0.8)),
    "5 failures in 100 runs": (POOLED_SHARE, 0.93, 0.8, 100, contained(0.05, 0.8)),
    "3 latencies in 20 runs": (TIME, 0.92, 3.0, 20, latencies(0.15)),
    "8 latencies in 20 runs": (TIME, 0.92, 3.0, 20, latencies(0.4)),
}


@pytest.mark.parametrize("law", FEW)
def test_an_interval_from_few_failures_holds_the_truth_nearly_as_often_as_it_says_or_more_often(law: str) -> None:
    metric, least, truth, runs, drawn = FEW[law]
    low, high = intervals(metric, *drawn(np.random.default_rng(2026), (1_000, runs)))
    is_known = ~np.isnan(high)
    assert is_known.mean() > 0.5
    assert np.mean((low <= truth) & (truth <= high), where=is_known) >= least


@pytest.mark.parametrize("metric", [SHARE, POOLED_SHARE, COUNT, TIME, YES_NO])
def test_an_interval_stays_within_its_scale_and_around_its_mean(metric: str) -> None:
    draws = np.random.default_rng(7)
    for runs in (2, 3, 11, 20):
        x = draws.binomial(1, draws.choice([0.02, 0.5, 0.98], (300, 1)), (300, runs)).astype(float)
        means = x.mean(axis=1)
        low, high = intervals(metric, x)
        is_known = ~np.isnan(high)
        assert is_known.any()
        assert (low[is_known] >= 0).all()
        assert (low[is_known] <= means[is_known]).all()
        assert (high[is_known] >= means[is_known]).all()
        if metric in (SHARE, POOLED_SHARE, YES_NO):
            assert (high[is_known] <= 1).all()


def test_runs_that_all_agree_leave_room_for_the_next_one() -> None:
    (low, high) = intervals(SHARE, np.ones((1, 20)))
    assert (low[0], high[0]) == (pytest.approx(0.025 ** (1 / 20)), 1.0)
    (low, high) = intervals(SHARE, np.zeros((1, 20)))
    assert (low[0], high[0]) == (0.0, pytest.approx(1 - 0.025 ** (1 / 20)))
    (low, high) = intervals(COUNT, np.zeros((1, 20)))
    assert (low[0], high[0]) == (0.0, pytest.approx(-np.log(0.025) / 20))
    (low, high) = intervals(TIME, np.zeros((1, 20)))
    assert np.isnan([low[0], high[0]]).all(), (
        "no time that differs from 0 was seen, so nothing says how long one would be"
    )


def test_what_does_not_vary_has_an_exact_interval_or_none() -> None:
    (low, high) = intervals(COUNT, np.ones((1, 2)))
    assert (low[0], high[0]) == pytest.approx((stats.chi2.ppf(0.025, 4) / 4, stats.chi2.ppf(0.975, 6) / 4))
    for metric in (SHARE, TIME):
        assert np.isnan(intervals(metric, np.full((1, 3), 0.8))).all(), metric
    failures = np.array([[0.0, 1.0, 0.0, 1.0, 2.0]])
    assert np.isnan(intervals(TIME, *linearised(3.6 * failures, failures))).all()
    assert np.isnan(intervals(TIME, *linearised(3.6 * failures[:, :3], failures[:, :3]))).all(), "one failure"


def test_wilsons_interval_ends_at_0_and_at_1_exactly() -> None:
    for runs in (1, 3, 11, 29):
        assert intervals(YES_NO, np.zeros((1, runs)))[0][0] == 0.0
        assert intervals(YES_NO, np.ones((1, runs)))[1][0] == 1.0
