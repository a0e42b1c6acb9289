"""The intervals of the metrics: within the scale of each, and right as often as they say."""

from collections.abc import Callable

import numpy as np
import pyarrow as pa
import pytest
from numpy.typing import NDArray

from fsar_ledger.metrics.database import from_rows

Numbers = NDArray[np.float64]
Drawn = Callable[[np.random.Generator, tuple[int, int]], tuple[Numbers, Numbers | None]]
COUNT, TIME, SHARE = "authority_conflicts", "reassignment_latency_s", "coordination_success"
POOLED_SHARE = "recovery_containment"


def intervals(metric: str, x: Numbers, pooled: Numbers | None = None) -> tuple[Numbers, Numbers]:
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
        **{name: pa.nulls(x.size, pa.string()) for name in ("setting", "kind", "source", "model_version", "constants", "scenario", "not_observed")},
        "position": pa.array(np.full(x.size, 1)),
        "metric": pa.array([metric] * x.size),
        "run_id": pa.array(np.tile(np.arange(runs), repeats)),
        "denominator": pa.array(np.ones(x.size, np.int64)),
        "value_without_routine": pa.nulls(x.size, pa.float64()),
        "published_convention_value": pa.nulls(x.size, pa.float64()),
        "x": pa.array(x.ravel()),
        "pooled_mean": pa.nulls(x.size, pa.float64()) if pooled is None else pa.array(np.repeat(pooled, runs)),
    }
    with from_rows([]) as database:
        database.hold("summary_values", pa.table(values))
        found = database.table("SELECT ci_low, ci_high FROM metric_summary ORDER BY configuration")
    low, high = (found.column(name).to_numpy() for name in ("ci_low", "ci_high"))
    return low, high


def linearised(numerators: Numbers, denominators: Numbers) -> tuple[Numbers, Numbers]:
    """What each run contributes to a pooled ratio (`summary_values`), and the ratios."""
    ratios = numerators.sum(axis=1) / denominators.sum(axis=1)
    residuals = numerators - ratios[:, None] * denominators
    return ratios[:, None] + residuals / denominators.mean(axis=1)[:, None], ratios


def _contained(draws: np.random.Generator, shape: tuple[int, int]) -> tuple[Numbers, Numbers]:
    failures = draws.poisson(0.75, shape)
    return linearised(draws.binomial(failures, 0.9).astype(float), failures.astype(float))


def _latencies(draws: np.random.Generator, shape: tuple[int, int]) -> tuple[Numbers, Numbers]:
    failures = draws.poisson(0.75, shape)
    return linearised(draws.gamma(4 * failures + 1e-12, 0.75), failures.astype(float))


RUNS = 100
"""As many as the paper has for each architecture."""

LAWS: dict[str, tuple[str, float, Drawn]] = {
    "one or two tasks a run": (SHARE, 0.93, lambda draws, shape: (draws.binomial(2, 0.93, shape) / 2, None)),
    "scenarios that differ": (SHARE, 0.92, lambda draws, shape: (draws.binomial(1, np.where(np.arange(shape[1]) % 5, 0.95, 0.8), shape).astype(float), None)),
    "nearly every record": (SHARE, 0.98, lambda draws, shape: (draws.beta(98, 2, shape), None)),
    "rare conflicts": (COUNT, 0.3, lambda draws, shape: (draws.poisson(0.3, shape).astype(float), None)),
    "conflicts in bursts": (COUNT, 8.0, lambda draws, shape: (draws.negative_binomial(2, 0.2, shape).astype(float), None)),
    "failures contained": (POOLED_SHARE, 0.9, _contained),
    "latency of failures": (TIME, 3.0, _latencies),
}


@pytest.mark.parametrize("law", LAWS)
def test_an_interval_holds_the_truth_in_93_to_97_of_100_experiments(law: str) -> None:
    metric, truth, drawn = LAWS[law]
    low, high = intervals(metric, *drawn(np.random.default_rng(2026), (6_000, RUNS)))
    assert 0.93 <= np.mean((low <= truth) & (truth <= high)) <= 0.97


@pytest.mark.parametrize("metric", [SHARE, POOLED_SHARE, COUNT, TIME])
def test_an_interval_stays_within_its_scale_and_around_its_mean(metric: str) -> None:
    draws = np.random.default_rng(7)
    for runs in (2, 3, 20):
        x = draws.binomial(1, draws.choice([0.02, 0.5, 0.98], (300, 1)), (300, runs)).astype(float)
        means = x.mean(axis=1)
        low, high = intervals(metric, x)
        is_known = ~np.isnan(high)
        assert is_known.any()
        assert (low[is_known] >= 0).all()
        assert (low[is_known] <= means[is_known]).all()
        assert (high[is_known] >= means[is_known]).all()
        if metric in (SHARE, POOLED_SHARE):
            assert (high[is_known] <= 1).all()


def test_runs_that_all_agree_leave_room_for_the_next_one() -> None:
    (low, high) = intervals(SHARE, np.ones((1, 20)))
    assert (low[0], high[0]) == (pytest.approx(0.025 ** (1 / 20)), 1.0)
    (low, high) = intervals(SHARE, np.zeros((1, 20)))
    assert (low[0], high[0]) == (0.0, pytest.approx(1 - 0.025 ** (1 / 20)))
    (low, high) = intervals(COUNT, np.zeros((1, 20)))
    assert (low[0], high[0]) == (0.0, pytest.approx(-np.log(0.025) / 20))
    (low, high) = intervals(TIME, np.zeros((1, 20)))
    assert np.isnan([low[0], high[0]]).all(), "no time that differs from 0 was seen, so nothing says how long one would be"
