"""The paper beside ours: does the model give the printed number, and could the paper's experiment have printed it?"""

import math

import numpy as np
import pytest
from scipy import stats

from fsar_ledger.metrics.definitions import Printed
from fsar_ledger.metrics.results import MetricRow
from fsar_ledger.metrics.verdicts import MARGINS, Comparison, Odds, compare, gives, odds, published, share_text
from tests.sure import known


def row(metric: str, architecture: str, mean: float | None, sd: float | None, n: int = 100) -> MetricRow:
    """A row with the interval mean +- 2 sd / sqrt(n), or with none."""
    half_width = None if sd is None else 2 * sd / math.sqrt(n)
    return MetricRow(
        architecture=architecture,
        configuration="full",
        fleet_size=4,
        seed=42,
        kind="simulated",
        source=None,
        model_version="test",
        constants=None,
        seeds=1,
        scenario=None,
        metric=metric,
        mean=mean,
        sd=sd,
        n=n,
        ci_low=None if mean is None or half_width is None else mean - half_width,
        ci_high=None if mean is None or half_width is None else mean + half_width,
        denominator=n,
        published_convention_mean=mean,
        mean_without_routine=None,
    )


def judged(
    mean: float | None, sd: float | None, n: int = 100, metric: str = "authority_conflicts", architecture: str = "fsar"
) -> Comparison:
    (one,) = compare([row(metric, architecture, mean, sd, n)])
    return one


def test_all_24_cells_are_published_in_our_units_with_the_step_of_their_last_digit() -> None:
    assert len(published()) == 24
    assert {metric for metric, _ in published()} == MARGINS.keys()
    assert published()["coordination_success", "fsar"] == pytest.approx((0.93, 0.001))
    assert published()["human_intervention", "cfc"] == pytest.approx((0.32, 0.001))
    assert published()["reassignment_latency_s", "dhma"] == pytest.approx((5.18, 0.01))


def test_the_interval_of_the_difference_has_our_error_alone_at_two_tests_of_one_in_twenty() -> None:
    one = judged(1.10, 0.8, n=25)
    half_width = stats.t.ppf(0.95, 24) * 0.8 / 5
    assert (one.difference, one.low, one.high) == pytest.approx((0.06, 0.06 - half_width, 0.06 + half_width))
    assert one.distance == pytest.approx(0.06 / 0.25)


def test_a_model_gives_a_number_gives_it_not_or_cannot_be_told() -> None:
    assert judged(1.04, 0.5).gives == "yes"
    assert judged(1.10, 0.5).gives == "yes", "another number, and within the margin"
    assert judged(1.60, 0.5).gives == "no"
    assert judged(1.04, 3.0).gives == "undecided", "too wide to tell"
    assert judged(1.33, 0.5).gives == "undecided", "about a margin away"


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        *((-0.25, 0.25, "yes"), (-0.26, 0.25, "undecided"), (-0.25, 0.26, "undecided")),
        *((0.01, 0.1, "yes"), (0.25, 0.4, "undecided"), (0.26, 0.4, "no")),
        *((-0.4, -0.26, "no"), (-0.4, 0.4, "undecided"), (None, None, "undecided")),
    ],
)
def test_the_answer_is_fixed_by_interval_and_margin(low: float | None, high: float | None, expected: str) -> None:
    assert gives(low, high, 0.25) == expected


def test_what_does_not_tell_how_much_runs_vary_is_undecided() -> None:
    for one in (judged(None, None, n=0), judged(1.04, None, n=1), judged(1.04, 0.0, n=2)):
        assert (one.gives, one.low, one.high, one.power) == ("undecided", None, None, None)


def test_the_power_is_the_share_of_experiments_in_which_an_equal_number_is_found_equal() -> None:
    for sd, n in ((1.0, 100), (1.2, 100), (0.5, 20)):
        means = np.random.default_rng(3).normal(1.04, sd, size=(4000, n))
        found = [
            judged(float(mean), float(spread), n).gives == "yes"
            for mean, spread in zip(means.mean(axis=1), means.std(axis=1, ddof=1), strict=True)
        ]
        assert np.mean(found) == pytest.approx(judged(1.04, sd, n).power, abs=0.05)
    assert judged(1.04, 3.0).power == 0.0


def test_a_number_at_the_margin_is_found_equal_no_oftener_than_alpha() -> None:
    means = np.random.default_rng(4).normal(1.04 + 0.25, 0.8, size=(4000, 100))
    found = [
        judged(float(mean), float(spread)).gives == "yes"
        for mean, spread in zip(means.mean(axis=1), means.std(axis=1, ddof=1), strict=True)
    ]
    assert 0.035 < np.mean(found) < 0.065


def test_the_second_answer_is_by_the_share_of_drawn_experiments_and_needs_them() -> None:
    of = row("authority_conflicts", "fsar", 1.0, 1.0)
    answers = {
        share: compare([of], Odds({("authority_conflicts", "fsar"): share}, share))[0].could
        for share in (0.0, 0.049, 0.05, 1.0)
    }
    assert answers == {0.0: "no", 0.049: "no", 0.05: "yes", 1.0: "yes"}
    assert compare([of])[0].could is None
    assert compare([of], Odds({}, 1.0))[0].could is None


def test_rows_that_the_paper_does_not_print_are_left_out() -> None:
    assert compare([row("authority_conflicts", "swarm", 1.0, 1.0)]) == []


RNG = np.random.default_rng(7)
CELL = ("policy_violations", "fsar")
OTHER = ("authority_conflicts", "fsar")


def test_the_share_is_of_experiments_that_print_a_number_as_far_out_on_either_side() -> None:
    drawn = {CELL: [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0]}
    shares = {value: odds(drawn, {CELL: Printed(value, 0.1)}).cells[CELL] for value in (0.1, 0.2, 0.5, 1.0, 1.1)}  # type: ignore[union-attr]
    assert shares == pytest.approx({0.1: 0.2, 0.2: 0.4, 0.5: 1.0, 1.0: 0.2, 1.1: 0.0})


def test_a_number_that_rounds_to_the_printed_one_is_the_printed_one() -> None:
    found = known(odds({CELL: [0.934, 0.936, 0.944]}, {CELL: Printed(0.94, 0.01)}))
    assert found.cells[CELL] == pytest.approx(1.0)


def test_a_table_drawn_from_the_model_is_refused_as_often_as_alpha_says() -> None:
    """Two cells that go together: with min-p the error of the whole table is alpha, whatever their dependence."""
    first = RNG.normal(size=(2000, 1))
    tables = 0.8 * first + 0.6 * RNG.normal(size=(2000, 2))
    drawn = {CELL: tables[:, 0], OTHER: tables[:, 1]}
    refused = 0
    for _ in range(400):
        base = RNG.normal()
        one, two = (0.8 * base + 0.6 * RNG.normal() for _ in range(2))
        found = known(odds(drawn, {CELL: Printed(one, 0.001), OTHER: Printed(two, 0.001)}))
        refused += found.table < 0.05
    assert 6 <= refused <= 36, "20 expected, give or take three and a half standard deviations"


def test_a_table_with_one_number_that_the_model_never_gives_is_refused_as_a_whole() -> None:
    drawn = {CELL: RNG.normal(size=1000), OTHER: RNG.normal(size=1000)}
    found = known(odds(drawn, {CELL: Printed(0.0, 0.01), OTHER: Printed(9.0, 0.01)}))
    assert found.cells[CELL] > 0.5
    assert found.cells[OTHER] == found.table == 0.0


def test_a_share_of_none_says_of_how_many() -> None:
    assert [share_text(share) for share in (0.0, 0.0005, 1.0)] == ["0 of 4,000", "0.0005", "1.0000"]


def test_what_an_experiment_leaves_undefined_counts_neither_way_and_a_cell_without_numbers_has_no_share() -> None:
    found = known(
        odds({CELL: [0.1, None, 0.3], OTHER: [None, None, None]}, {CELL: Printed(0.1, 0.1), OTHER: Printed(0.1, 0.1)})
    )
    assert found.cells == pytest.approx({CELL: 1.0})
    assert odds({OTHER: [None]}, {OTHER: Printed(0.1, 0.1)}) is None
