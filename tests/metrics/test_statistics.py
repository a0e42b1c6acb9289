"""Statistics agree with scipy to 1e-9, ties, zeros and no variance included."""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from fsar_ledger.events import CONCERNS
from fsar_ledger.ledger.rows.schema import SCHEMA
from fsar_ledger.metrics.database import Database, from_table
from fsar_ledger.metrics.results import StatisticRow, statistic_rows

Vector = NDArray[np.float64]
METRIC = "authority_conflicts"
WILCOXON: Any = stats.wilcoxon  # its type stubs lag behind its methods


def close(expected: Any) -> Any:
    """Equal to 1e-9, and to 1e-12 near zero."""
    return pytest.approx(expected, rel=1e-9, abs=1e-12)


def run_metrics(
    values: Mapping[tuple[str, str], Sequence[float | None]],
    published: float | None = None,
    fleet_sizes: Sequence[int] = (4,),
) -> pa.Table:
    """The relation `run_metrics` with these values per (metric, architecture), one run each."""
    rows = [
        {
            "run_id": f"{architecture}-{fleet_size}-{number:04}",
            "architecture": architecture,
            "configuration": "full",
            "seed": 42,
            "scenario": "door-relay",
            "fleet_size": fleet_size,
            "run": number,
            "kind": "simulated",
            "source": None,
            "model_version": "test",
            "observes": list(CONCERNS),
            "setting": f"robots {fleet_size}",
            "constants": None,
            "position": 1,
            "metric": metric,
            "value": value,
            "numerator": None,
            "denominator": None,
            "published_convention_value": published if value is None else value,
        }
        for fleet_size in fleet_sizes
        for (metric, architecture), numbers in values.items()
        for number, value in enumerate(numbers)
    ]
    names = (
        *("run_id", "architecture", "configuration", "scenario", "metric", "kind"),
        *("source", "model_version", "setting", "constants"),
    )
    kinds = {
        "value": pa.float64(),
        "published_convention_value": pa.float64(),
        **dict.fromkeys(names, pa.string()),
        "observes": pa.list_(pa.string()),
    }
    return pa.Table.from_pylist(rows, schema=pa.schema([(name, kinds.get(name, pa.int64())) for name in rows[0]]))


@cache
def opened(threads: int | None) -> Database:
    """One connection for all tests: each holds its own values."""
    return from_table(SCHEMA.empty_table(), threads)


@contextmanager
def over(table: pa.Table, threads: int | None = None) -> Iterator[Database]:
    """A database whose `run_metrics` are these."""
    database = opened(threads)
    database.refill(SCHEMA.empty_table())
    database.hold("run_metrics", table)
    try:
        yield database
    finally:
        database.drop("run_metrics")


def compared(table: pa.Table) -> list[StatisticRow]:
    with over(table) as database:
        return statistic_rows(database)


def one(first: Sequence[float | None], second: Sequence[float | None], metric: str = METRIC) -> StatisticRow:
    (row,) = compared(run_metrics({(metric, "fsar"): first, (metric, "cfc"): second}))
    return row


def billionths(differences: Sequence[float]) -> Vector:
    return np.array([float(round(one * 1e9)) for one in differences])


# Half of the values repeat, so that ties and zeros are common; none is so close to another that only rounding tells.
VALUE = st.integers(-4, 4).map(float) | st.integers(-(10**6), 10**6).map(lambda whole: whole / 997)
SAMPLES = st.lists(st.lists(st.tuples(VALUE, VALUE), min_size=3, max_size=30), min_size=1, max_size=10)
Sample = list[tuple[float, float]]


def each(samples: list[Sample]) -> Iterator[tuple[Vector, Vector, StatisticRow]]:
    """The two sides of every sample and what SQL says of them; the samples are metrics of one table."""
    sides = [np.array(sample).T for sample in samples]
    values: dict[tuple[str, str], Sequence[float | None]] = {}
    for at, (first, second) in enumerate(sides):
        values |= {(f"m{at:02}", "fsar"): list(first), (f"m{at:02}", "cfc"): list(second)}
    for (first, second), row in zip(sides, compared(run_metrics(values)), strict=True):
        yield first, second, row


@settings(max_examples=6, deadline=None)
@given(SAMPLES)
def test_paired_t_cohens_d_and_d_z_agree_with_scipy(samples: list[Sample]) -> None:
    for first, second, row in each(samples):
        differences = first - second
        assert (row.first_mean, row.second_mean, row.mean_difference) == close(
            (first.mean(), second.mean(), differences.mean())
        )
        assert row.df == row.n - 1 == len(first) - 1
        if len(set(billionths(list(differences)))) == 1:
            assert (row.t, row.p, row.d_z) == (None, None, None)
            continue
        expected = stats.ttest_rel(first, second)
        assert (row.t, row.p) == close((expected.statistic, expected.pvalue))
        assert row.d_z == close(differences.mean() / differences.std(ddof=1))
        assert row.cohens_d == close(differences.mean() / math.sqrt((first.var(ddof=1) + second.var(ddof=1)) / 2))


@pytest.mark.slow
@settings(max_examples=6, deadline=None)
@given(SAMPLES)
def test_wilcoxon_agrees_with_scipy_with_ties_and_zeros(samples: list[Sample]) -> None:
    for first, second, row in each(samples):
        differences = billionths(list(first - second))
        assert row.wilcoxon_n == np.count_nonzero(differences)
        if not differences.any():
            assert (row.wilcoxon_w, row.wilcoxon_z, row.wilcoxon_p) == (None, None, None)
            continue
        if row.wilcoxon_n < 6:
            assert (row.wilcoxon_z, row.wilcoxon_p) == (None, None), "the normal approximation does not hold"
            continue
        expected = WILCOXON(differences, zero_method="wilcox", correction=False, method="asymptotic")
        assert row.wilcoxon_w == expected.statistic
        assert (row.wilcoxon_p, abs(row.wilcoxon_z or 0)) == close((expected.pvalue, abs(expected.zstatistic)))


@pytest.mark.slow
@settings(max_examples=6, deadline=None)
@given(SAMPLES)
def test_hedges_g_and_its_interval_follow_their_formulas(samples: list[Sample]) -> None:
    for first, second, row in each(samples):
        if min(len(set(first)), len(set(second))) == 1:
            assert (row.g_ci_low, row.g_ci_high) == (None, None)
            continue
        n = len(first)
        d = (first - second).mean() / math.sqrt((first.var(ddof=1) + second.var(ddof=1)) / 2)
        j = 1 - 3 / (4 * (n - 1) - 1)
        r = float(np.corrcoef(first, second)[0, 1])
        covariances = np.cov(first, second)
        pooled, spread = covariances.trace() / 2, (covariances**2).sum()  # s1^4 + s2^4 + 2 cov^2
        variance = (first - second).var(ddof=1) / n / pooled + d * d * spread / (8 * (n - 1) * pooled**2)
        half_width = stats.norm.ppf(0.975) * j * math.sqrt(variance)
        assert row.hedges_g == close(j * d)
        if row.g_ci_low is None:
            assert r == pytest.approx(1, abs=1e-8), "no interval of width 0"
            continue
        # 1 - r loses digits where r is near 1, whichever way it is computed; its root loses half of them.
        assert (row.g_ci_low, row.g_ci_high) == pytest.approx(
            (j * d - half_width, j * d + half_width), rel=1e-9, abs=1e-6
        )
        assert (row.d_ci_low, row.d_ci_high) == pytest.approx(
            (d - half_width / j, d + half_width / j), rel=1e-9, abs=1e-6
        )


@pytest.mark.parametrize(("effect", "correlation"), [(0.0, 0.5), (1.0, 0.9), (5.0, 0.9), (5.0, 0.0)])
def test_the_interval_of_an_effect_size_holds_the_truth_in_93_to_97_of_100_experiments(
    effect: float, correlation: float
) -> None:
    draws = np.random.default_rng(7)
    experiments, runs = 1500, 60
    second = draws.standard_normal((experiments, runs))
    first = effect + correlation * second + math.sqrt(1 - correlation**2) * draws.standard_normal((experiments, runs))
    texts = ("test", "holm_family", "basis", "family", "configuration", "kind", "source", "model_version", "constants")
    tests = pa.table(
        {
            "test_id": pa.array(np.arange(experiments)),
            **{name: pa.array(["x"] * experiments) for name in (*texts, "setting", "metric", "comparison")},
            **{name: pa.array(np.full(experiments, 4)) for name in ("fleet_size", "seed", "position")},
            "pools_seeds": pa.array(np.zeros(experiments, bool)),
        }
    )
    differences = pa.table(
        {
            "test_id": pa.array(np.repeat(np.arange(experiments), runs)),
            "pair": pa.array(np.tile(np.arange(runs), experiments)),
            "first_value": pa.array(first.ravel()),
            "second_value": pa.array(second.ravel()),
            "difference": pa.array((first - second).ravel()),
            "difference_ppb": pa.array(np.round((first - second).ravel() * 1e9).astype(np.int64)),
        }
    )
    with from_table(SCHEMA.empty_table()) as database:
        database.hold("paired_tests", tests)
        database.hold("paired_differences", differences)
        found = database.table("SELECT g_ci_low, g_ci_high FROM paired_t_tests")
    low, high = (found.column(name).to_numpy() for name in ("g_ci_low", "g_ci_high"))
    assert 0.93 <= np.mean((low <= effect) & (effect <= high)) <= 0.97


def test_wilcoxon_ties_differences_that_only_the_last_bits_of_a_float_tell_apart() -> None:
    row = one([0.3, 0.2, 0.1, 0.9], [0.1, 0.0, 0.3, 0.0])
    assert 0.3 - 0.1 != 0.2 - 0.0
    assert (row.wilcoxon_w, row.wilcoxon_n) == (2.0, 4), "three ties of rank 2 and one of rank 4"


@pytest.mark.slow
@settings(max_examples=6, deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=60))
def test_mcnemar_of_human_intervention_is_the_exact_binomial_test(pairs: list[tuple[bool, bool]]) -> None:
    row = one([float(first) for first, _ in pairs], [float(second) for _, second in pairs], "human_intervention")
    first_only, second_only = sum(a and not b for a, b in pairs), sum(b and not a for a, b in pairs)
    assert (row.mcnemar_first_only, row.mcnemar_second_only) == (first_only, second_only)
    expected = stats.binomtest(first_only, first_only + second_only).pvalue if first_only + second_only else 1.0
    assert row.mcnemar_p == close(expected)


def test_mcnemar_is_only_for_the_metric_that_is_0_or_1() -> None:
    assert one([0.0, 1.0], [1.0, 1.0]).mcnemar_p is None


def test_equal_differences_have_no_t_and_constant_sides_no_d() -> None:
    shifted = one([1.0, 2.0, 3.0], [0.9, 1.9, 2.9])
    assert (shifted.t, shifted.p, shifted.d_z, shifted.p_holm) == (None, None, None, None)
    assert shifted.cohens_d == close(0.1)
    constant = one([0.1] * 7, [0.3] * 7)
    assert (constant.t, constant.cohens_d, constant.hedges_g, constant.g_ci_low) == (None, None, None, None)
    assert constant.mean_difference == close(-0.2)
    assert constant.wilcoxon_p == close(WILCOXON([-0.2] * 7, correction=False, method="asymptotic").pvalue)


def test_two_pairs_have_no_hedges_g_and_sides_that_vary_alike_no_interval_of_it() -> None:
    two = one([1.0, 2.0], [2.0, 5.0])
    assert two.cohens_d is not None
    assert (two.hedges_g, two.g_ci_low, two.g_ci_high) == (None, None, None), "its correction is 0"
    alike = one([1.0, 2.0, 4.0], [0.5, 1.5, 3.5])
    assert alike.hedges_g is not None
    assert (alike.g_ci_low, alike.g_ci_high) == (None, None)


def test_fewer_than_six_pairs_that_differ_have_no_wilcoxon_test() -> None:
    sides = [float(at * at) for at in range(6)]
    assert one([*sides[1:], 3.0], [0.0] * 5 + [3.0]).wilcoxon_p is None
    assert one([*sides[1:], 4.0], [0.0] * 5 + [3.0]).wilcoxon_p == close(
        WILCOXON([*sides[1:], 1.0], correction=False, method="asymptotic").pvalue
    )


def test_a_single_pair_has_a_difference_and_no_test() -> None:
    row = one([1.0], [2.0])
    assert (row.n, row.mean_difference, row.df) == (1, -1.0, 0)
    assert (row.t, row.p, row.cohens_d, row.hedges_g, row.p_holm) == (None, None, None, None, None)


def family() -> pa.Table:
    chance = np.random.default_rng(5)
    architectures = {"fsar": 0.0, "cfc": 0.3, "dhma": 0.9}
    return run_metrics(
        {
            (metric, name): list(chance.normal(shift * k, 1.0, 30))
            for k, metric in enumerate(("a", "b", "c", "d"))
            for name, shift in architectures.items()
        },
        fleet_sizes=(4, 8),
    )


def test_holm_adjusts_over_the_family_of_one_fleet_size() -> None:
    rows = [row for row in compared(family()) if row.fleet_size == 4]
    assert len(rows) == 12
    ps = [row.p for row in rows if row.p is not None]
    by_p = sorted(range(12), key=lambda at: ps[at])
    expected: dict[int, float] = {}
    running = 0.0
    for step, at in enumerate(by_p):
        running = max(running, min(1.0, (12 - step) * ps[at]))
        expected[at] = running
    assert [row.p_holm for row in rows] == close([expected[at] for at in range(12)])
    assert any(row.p_holm == 1.0 for row in rows), "the cap is met"


def test_comparisons_are_three_per_metric_in_the_order_of_the_paper() -> None:
    rows = compared(
        run_metrics({(METRIC, name): [float(at), 2.0, 5.0] for at, name in enumerate(("fsar", "cfc", "dhma"))})
    )
    assert [row.comparison for row in rows] == ["fsar-cfc", "fsar-dhma", "cfc-dhma"]
    assert [row.mean_difference for row in rows] == close([-1 / 3, -2 / 3, -1 / 3])


def test_every_two_architectures_are_compared_whatever_their_names_and_the_paper_s_stay_a_family() -> None:
    names = ("fsar", "cfc", "dhma", "jade", "a-seventh")
    values = {(METRIC, name): [float(at), 2.0, 5.0 + at * at] for at, name in enumerate(names)}
    rows = {row.comparison: row for row in compared(run_metrics(values))}
    assert list(rows)[:3] == ["fsar-cfc", "fsar-dhma", "cfc-dhma"]
    added = {
        *("fsar-a-seventh", "fsar-jade", "cfc-a-seventh", "cfc-jade", "dhma-a-seventh", "dhma-jade"),
        "a-seventh-jade",
    }
    assert set(list(rows)[3:]) == added
    assert {rows[one].family for one in added} == {"architectures added"}
    assert {rows[one].family_tests for one in added} == {7}
    alone = compared(run_metrics({key: one for key, one in values.items() if key[1] in names[:3]}))
    assert [rows[one.comparison] for one in alone] == alone, "the three of the paper are as if nobody else had run"
    (pair,) = compared(run_metrics({key: one for key, one in values.items() if key[1] in ("jade", "a-seventh")}))
    assert pair.comparison == "a-seventh-jade"


@pytest.mark.slow
def test_runs_pair_only_with_the_run_of_the_same_world() -> None:
    (row,) = compared(run_metrics({(METRIC, "fsar"): [1.0, 2.0, 3.0, 4.0], (METRIC, "cfc"): [2.0, 4.0]}))
    assert (row.n, row.first_mean, row.second_mean) == (2, 1.5, 3.0)
    table = run_metrics({(METRIC, "fsar"): [1.0, 2.0], (METRIC, "cfc"): [2.0, 4.0]})
    others = {
        "seed": 43,
        "run": 9,
        "fleet_size": 8,
        "scenario": "fleet-contention",
        "configuration": "without-trust-evaluation",
        "setting": "another model, or other constants",
        "observes": [],
    }
    for column, other in others.items():
        rows = table.to_pylist()
        rows[0][column] = other
        (left,) = compared(pa.Table.from_pylist(rows, schema=table.schema))
        assert (left.n, left.first_mean) == (1, 2.0), column


def test_undefined_values_count_by_the_published_convention_or_leave_the_pair_out() -> None:
    table = run_metrics({(METRIC, "fsar"): [0.5, None, 0.25], (METRIC, "cfc"): [None, None, 0.5]}, published=1.0)
    with over(table) as database:
        rows = database.rows("SELECT basis, n, first_mean, second_mean FROM all_pairwise_tests WHERE NOT pools_seeds")
    found = {row.pop("basis"): tuple(row.values()) for row in rows}
    assert found == {"published": (3, close(1.75 / 3), close(2.5 / 3)), "defined": (1, 0.25, 0.5)}


@pytest.mark.slow
def test_the_answer_is_the_same_bits_on_any_number_of_threads() -> None:
    answers = set()
    for threads in (1, 2, 4):
        with over(family(), threads) as database:
            answers.add(repr(statistic_rows(database)))
    assert len(answers) == 1


def test_the_cluster_bootstrap_takes_every_sample_of_scenarios() -> None:
    chance = np.random.default_rng(3)
    sizes = {"a": 3, "b": 7, "c": 5, "d": 4}
    differences = {
        scenario: billionths(list(chance.normal(at, 1.0, size))) / 1e9
        for at, (scenario, size) in enumerate(sizes.items())
    }
    flat = [(scenario, float(value)) for scenario, values in differences.items() for value in values]
    table = run_metrics({(METRIC, "fsar"): [value for _, value in flat], (METRIC, "cfc"): [0.0] * len(flat)})
    scenarios = pa.array([scenario for scenario, _ in flat] * 2)
    with over(table.set_column(table.column_names.index("scenario"), "scenario", scenarios)) as database:
        rows = database.query("statistics/cluster_bootstrap").to_pylist()
    (row,) = [row for row in rows if row["test"].startswith("published/") and "/42/" in row["test"]]
    assert len(rows) == 4, "two bases, one seed and all seeds"
    means = [
        np.concatenate([differences[one] for one in sample]).mean() for sample in itertools.product(sizes, repeat=4)
    ]
    assert (row["scenarios"], row["samples"]) == (4, 256)
    assert row["mean_difference"] == close(np.mean([value for _, value in flat]))
    assert (row["ci_low"], row["ci_high"]) == close(tuple(np.quantile(means, (0.025, 0.975), method="inverted_cdf")))
