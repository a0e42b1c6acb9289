"""Any two sides in pairs: differences, intervals and tests on given rows, what pairs share, and which sides are
meant."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from numpy.typing import NDArray
from scipy import stats

from fsar_ledger.base.errors import UsageError
from fsar_ledger.metrics.comparison_sides import Paired, Side, chosen, paired, sides
from fsar_ledger.metrics.database import Database
from tests.queries.histories import Row, S, event, run
from tests.recycled import from_rows

Numbers = NDArray[np.float64]
MET = event("PeersMet", 2 * S, robot="robot/A1", peer="robot/B1")
CALL = event("SupervisorCalled", 1, supervisor="supervisor/fleet")
POOLED, COUNT, YES_NO = "recovery_containment", "authority_conflicts", "human_intervention"


def differences(metric: str, first: tuple[Numbers, Numbers], second: tuple[Numbers, Numbers]) -> list[dict[str, Any]]:
    """The answers over numerators and denominators of two sides: a row of each is one experiment, a column one pair."""
    experiments, runs = first[0].shape
    tables = []
    for name, (numerators, denominators) in (("first", first), ("second", second)):
        number = np.tile(np.arange(runs), experiments)
        counted = denominators.ravel()
        values = np.divide(numerators.ravel(), counted, out=np.zeros(counted.size), where=counted > 0)
        tables.append(
            pa.table(
                {
                    "side": pa.array([f"{name} {at:05}" for at in np.repeat(np.arange(experiments), runs)]),
                    "run_id": pa.array([f"{at:05}" for at in number]),
                    **{
                        key: pa.array([key] * number.size)
                        for key in ("setting", "model_version", "world_sha256", "scenario")
                    },
                    **{key: pa.array(np.ones(number.size, np.int64)) for key in ("seed", "twins")},
                    "kind": pa.array(["simulated"] * number.size),
                    "run": pa.array(number),
                    "observes_world": pa.array(np.ones(number.size, bool)),
                    "metric": pa.array([metric] * number.size),
                    "value": pa.array(values, mask=counted == 0),
                    "numerator": pa.array(numerators.ravel().astype(np.int64)),
                    "denominator": pa.array(counted.astype(np.int64)),
                }
            )
        )
    pairs = [{"first_side": f"first {at:05}", "second_side": f"second {at:05}"} for at in range(experiments)]
    with Database(None, ()) as database:
        database.hold("side_runs", pa.concat_tables(tables))
        database.hold("side_comparisons", pa.Table.from_pylist(pairs))
        return database.rows(
            "SELECT * FROM side_differences WHERE scenario IS NULL AND NOT pools_seeds ORDER BY first_side"
        )


def of_runs(metric: str, first: Sequence[float] | Numbers, second: Sequence[float] | Numbers) -> dict[str, Any]:
    """The answer over one value a run."""
    one = [np.array([numbers], dtype=float) for numbers in (first, second)]
    return differences(metric, (one[0], np.ones_like(one[0])), (one[1], np.ones_like(one[1])))[0]


def test_a_difference_is_the_paired_t_test_of_what_runs_count() -> None:
    first, second = np.array([3.0, 1, 4, 1, 5, 9, 2, 6]), np.array([2.0, 7, 1, 8, 2, 8, 4, 5])
    found, expected = of_runs(COUNT, first, second), stats.ttest_rel(first, second)
    low, high = expected.confidence_interval()
    assert (found["n"], found["differing_pairs"], found["test"]) == (8, 8, "paired t")
    assert (found["first_mean"], found["second_mean"], found["mean_difference"]) == pytest.approx(
        (31 / 8, 37 / 8, -6 / 8)
    )
    assert (found["ci_low"], found["ci_high"], found["p"]) == pytest.approx((low, high, expected.pvalue))
    assert found["d_z"] == pytest.approx((first - second).mean() / (first - second).std(ddof=1))


def test_where_few_pairs_differ_it_is_the_exact_sign_test_and_the_interval_knows_how_few() -> None:
    first, second = [1.0] * 5 + [0.0] + [2.0] * 14, [0.0] * 5 + [1.0] + [2.0] * 14
    found = of_runs(COUNT, first, second)
    d = np.subtract(first, second)
    half = stats.t.ppf(0.975, 6 - 1) * d.std(ddof=1) / np.sqrt(20)
    assert (found["differing_pairs"], found["test"]) == (6, "sign")
    assert found["p"] == pytest.approx(stats.binomtest(5, 6).pvalue)
    assert (found["ci_low"], found["ci_high"]) == pytest.approx((d.mean() - half, d.mean() + half))


def test_yes_or_no_has_mcnemars_test_and_an_interval_even_where_no_pair_differs() -> None:
    found = of_runs(YES_NO, [1] * 9 + [0] * 11, [1] * 2 + [0] * 17 + [1])
    assert (found["test"], found["p"]) == ("sign", pytest.approx(stats.binomtest(7, 8).pvalue))
    more, less = 8 / 22, 2 / 22  # Bonett and Price: one more pair of each kind
    half = stats.norm.ppf(0.975) * np.sqrt((more + less - (more - less) ** 2) / 22)
    assert (found["ci_low"], found["ci_high"]) == pytest.approx((more - less - half, more - less + half))
    alike = of_runs(YES_NO, [0] * 20, [0] * 20)
    assert (alike["test"], alike["p"], alike["differing_pairs"]) == (None, None, 0)
    assert alike["ci_low"] < 0 < alike["ci_high"], "twenty equal pairs do not show that there is no difference"


def test_equal_pairs_of_a_count_have_neither_test_nor_interval() -> None:
    found = of_runs(COUNT, [1, 2, 3], [1, 2, 3])
    assert (found["mean_difference"], found["test"], found["p"], found["ci_low"]) == (0, None, None, None)
    assert (found["ci_high"], found["d_z"]) == (None, None)


def test_a_pooled_metric_is_a_difference_of_ratios_with_the_error_of_the_jackknife() -> None:
    n1, d1 = np.array([[2, 0, 1, 3, 0, 1.0]]), np.array([[2, 1, 1, 4, 0, 1.0]])
    n2, d2 = np.array([[1, 0, 0, 2, 0, 1.0]]), np.array([[2, 1, 2, 4, 0, 2.0]])
    [found] = differences(POOLED, (n1, d1), (n2, d2))
    without = [
        np.delete(n1, at).sum() / np.delete(d1, at).sum() - np.delete(n2, at).sum() / np.delete(d2, at).sum()
        for at in range(6)
    ]
    error = np.sqrt(5 / 6 * ((np.array(without) - np.mean(without)) ** 2).sum())
    half = stats.t.ppf(0.975, 4 - 1) * error
    assert (found["n"], found["differing_pairs"]) == (6, 4)
    assert (found["first_mean"], found["second_mean"], found["mean_difference"]) == pytest.approx(
        (7 / 9, 4 / 11, 7 / 9 - 4 / 11)
    )
    assert (found["ci_low"], found["ci_high"]) == pytest.approx((7 / 9 - 4 / 11 - half, min(1, 7 / 9 - 4 / 11 + half)))
    assert found["p"] == pytest.approx(2 * stats.t.sf((7 / 9 - 4 / 11) / error, 3))


def test_a_ratio_that_hangs_on_one_pair_has_no_interval() -> None:
    [found] = differences(
        POOLED, (np.array([[1, 0, 0.0]]), np.array([[2, 0, 0.0]])), (np.array([[1, 1, 0.0]]), np.array([[1, 1, 1.0]]))
    )
    assert (found["mean_difference"], found["ci_low"], found["d_z"]) == (pytest.approx(1 / 2 - 2 / 3), None, None)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("failures", "share", "less"),
    [
        (0.5, 0.9, 0.6),
        pytest.param(1.0, 0.7, 0.7, marks=pytest.mark.soak),
        pytest.param(3.0, 0.95, 0.8, marks=pytest.mark.soak),
    ],
)
def test_the_interval_of_a_pooled_difference_holds_the_truth_in_94_to_98_of_100_experiments(
    failures: float, share: float, less: float
) -> None:
    draws, shape = np.random.default_rng(11), (600, 60)
    common = draws.poisson(failures, shape)
    kept = draws.binomial(common, less)
    more = kept + draws.binomial(common - kept, (share - less) / (1 - less))  # the same failures met twice
    own = draws.poisson(failures / 5, shape)
    found = differences(
        POOLED,
        ((more + draws.binomial(own, share)).astype(float), (common + own).astype(float)),
        (kept.astype(float), common.astype(float)),
    )
    assert len(found) == 600
    holds = [row["ci_low"] <= share - less <= row["ci_high"] for row in found]
    assert 0.94 <= np.mean(holds) <= 0.98


def of(number: int, *events: Row, **dimensions: Any) -> list[Row]:
    name = "-".join(map(str, (dimensions.get("architecture", "fsar"), number, *dimensions.values())))
    return run(*events, run_id=name, run=number, **dimensions)


def compared(
    *runs: Sequence[Row], first: str | None = None, second: str | None = None
) -> tuple[tuple[Side, Side], Paired]:
    with from_rows([row for rows in runs for row in rows]) as database:
        both = chosen([sides(database)], (first, second), ["the ledger"])
        return both, paired([database], both)


def test_two_sides_need_no_names_and_pairs_say_what_their_worlds_share() -> None:
    both, found = compared(
        of(0, MET),
        of(1, MET),
        of(0, MET, CALL, architecture="cfc"),
        of(1, MET, architecture="cfc"),
        of(2, MET, architecture="cfc"),
    )
    assert [side.name for side in both] == ["fsar:full@A/4", "cfc:full@A/4"]
    assert (found.pairs, found.same_facts, found.first_alone, found.second_alone, found.constants) == (2, 2, 0, 1, [])
    row = next(row for row in found.rows if row.metric == YES_NO)
    assert (row.n, row.differing_pairs, row.first_mean, row.second_mean, row.mean_difference) == (2, 1, 0.0, 0.5, -0.5)


def test_other_constants_share_draws_alone_and_are_named() -> None:
    one, other = '{"world":{"a":1,"b":2}}', '{"world":{"a":1,"b":3}}'
    runs = [of(0, MET, parameters=one), of(1, parameters=one), of(1, parameters=other), of(0, CALL, parameters=other)]
    both, found = compared(*runs, first="fsar@A", second="fsar@B")
    assert (found.same_facts, found.same_draws, found.same_seed, found.left_out) == (1, 1, 0, [])
    values = {side.letter: value for side, value in zip(both, ("2", "3"), strict=True)}
    assert [(one.name, one.first_value, one.second_value) for one in found.constants] == [
        ("world.b", values["A"], values["B"])
    ]


def test_another_model_shares_the_seed_alone() -> None:
    _, found = compared(of(0, MET), of(0, model_version="later"))
    assert (found.pairs, found.same_seed) == (1, 1)


def test_fleets_of_two_sizes_are_paired_without_it() -> None:
    both, found = compared(of(0, MET), of(0, MET, MET, fleet_size=8), first="fsar/4", second="fsar/8")
    assert ([side.fleet_size for side in both], found.pairs, found.same_draws) == ([4, 8], 1, 1)


@pytest.mark.parametrize(
    ("other", "why"),
    [(of(0, architecture="cfc"), "facts"), (of(0, MET, architecture="cfc", observes=["request"]), "unobserved")],
    ids=["other facts", "no facts on record"],
)
def test_a_pair_whose_worlds_differ_or_are_not_known_is_left_out_and_named(other: list[Row], why: str) -> None:
    _, found = compared(of(0, MET), other)
    assert (found.pairs, [one.differs for one in found.left_out], found.rows) == (0, [why], [])
    assert found.left_out[0].one["first"] == "fsar-0"


@pytest.mark.parametrize(
    ("first", "second", "why"),
    [
        (None, None, "found 3 sides, expected two, or --first NAME and --second NAME"),
        ("fsar", None, "--second NAME to say which"),
        ("fsra", "cfc", "--first fsra: found no such runs in the ledger"),
        ("cfc", "cfc/4", "as both sides, expected two different ones"),
        ("cfc", "fsar:full@Z", "--second fsar:full@Z: found no such runs"),
    ],
)
def test_what_is_not_one_side_is_refused_with_what_there_is(first: str | None, second: str | None, why: str) -> None:
    runs = (of(0), of(0, architecture="cfc"), of(0, configuration="without-layered-recovery"))
    with pytest.raises(UsageError) as refused:
        compared(*runs, first=first, second=second)
    assert why in str(refused.value)
    assert "fsar:without-layered-recovery@A/4 (1 run)" in str(refused.value)


def side(name: str, size: int = 4) -> Side:
    with from_rows(of(0, architecture=name, fleet_size=size)) as database:
        return sides(database)[0]


def test_of_two_ledgers_the_one_side_in_common_is_meant() -> None:
    fsar, cfc, large = side("fsar"), side("cfc"), side("fsar", 8)
    assert chosen([[fsar, cfc], [fsar]], (None, None), ["one", "other"]) == (fsar, fsar)
    assert chosen([[fsar], [cfc]], (None, None), ["one", "other"]) == (fsar, cfc)
    assert chosen([[fsar, cfc], [cfc, large]], ("fsar", None), ["one", "other"]) == (fsar, large)
    with pytest.raises(UsageError, match="found 2 sides in common, expected --first NAME"):
        chosen([[fsar, cfc], [fsar, cfc]], (None, None), ["one", "other"])
    with pytest.raises(UsageError, match="found 2 sides in one: fsar:full@A/4"):
        chosen([[fsar, large], [cfc]], ("fsar", None), ["one", "other"])


def test_one_pair_of_two_that_differs_is_a_sign_test_and_no_t_test_without_degrees_of_freedom() -> None:
    found = of_runs(COUNT, [3.0, 1], [2.0, 1])
    assert (found["test"], found["p"], found["family_tests"]) == ("sign", 1.0, 1)
