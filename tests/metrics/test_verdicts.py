"""The paper beside ours: implied SDs, the interval with both errors, fixed margins, three verdicts."""

import math

import msgspec
import pytest

from fsar_ledger.metrics.results import MetricRow
from fsar_ledger.metrics.verdicts import MARGINS, Comparison, compare, published, verdict


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


def judged(mean: float | None, sd: float | None, n: int = 100, metric: str = "authority_conflicts", architecture: str = "fsar") -> Comparison:
    (one,) = compare([row(metric, architecture, mean, sd, n)])
    return one


def test_all_24_cells_are_published_in_our_units() -> None:
    assert len(published()) == 24
    assert {metric for metric, _ in published()} == MARGINS.keys()
    assert published()["coordination_success", "fsar"].mean == 0.93
    assert published()["human_intervention", "cfc"].mean == 0.32
    assert published()["reassignment_latency_s", "dhma"].mean == 5.18
    assert published()["coordination_success", "fsar"].printed_ci95 == 0.019


def test_the_implied_sd_is_the_difference_of_means_over_d_of_the_pair_with_fsar() -> None:
    assert published()["authority_conflicts", "cfc"].implied_sd == pytest.approx((3.79 - 1.04) / 4.12)
    assert published()["authority_conflicts", "dhma"].implied_sd == pytest.approx((8.11 - 1.04) / 5.16)
    assert published()["authority_conflicts", "fsar"].implied_sd == published()["authority_conflicts", "cfc"].implied_sd
    assert published()["coordination_success", "dhma"].implied_sd == pytest.approx((0.93 - 0.84) / 0.42)


def test_the_interval_of_the_difference_has_the_sampling_error_of_both() -> None:
    ours = msgspec.structs.replace(row("authority_conflicts", "fsar", 1.10, 0.8), ci_low=1.0, ci_high=1.4)
    (one,) = compare([ours])
    papers = 1.959963984540054 * one.implied_sd / 10
    assert one.difference == pytest.approx(0.06)
    assert (one.ci_low, one.ci_high) == pytest.approx((0.06 - math.hypot(0.1, papers), 0.06 + math.hypot(0.3, papers)))


def test_a_verdict_does_not_contradict_the_interval_beside_it() -> None:
    mean = published()["reassignment_latency_s", "fsar"].mean
    without = msgspec.structs.replace(row("reassignment_latency_s", "fsar", mean + 5, 0.0, n=2), ci_low=None, ci_high=None)
    (one,) = compare([without])
    assert (one.verdict, one.ci_low, one.ci_high) == ("undecided", None, None), "two equal runs do not tell how much runs vary"
    wide = msgspec.structs.replace(row("reassignment_latency_s", "fsar", mean + 2, 0.1, n=2), ci_low=mean - 1, ci_high=mean + 9)
    assert compare([wide])[0].verdict == "undecided", "the paper's mean lies in our interval"


def test_the_distance_is_in_standard_errors_of_the_larger_sd_at_100_runs() -> None:
    implied_sd = published()["authority_conflicts", "fsar"].implied_sd
    assert judged(1.14, 0.1).distance_se == pytest.approx(0.1 / (implied_sd / 10))
    assert judged(1.14, 2.0, n=5).distance_se == pytest.approx(0.1 / (2.0 / 10))


def test_a_cell_differs_is_reproduced_or_undecided() -> None:
    assert judged(1.04, 0.5).verdict == "reproduced"
    assert judged(1.30, 0.5).verdict == "differs"
    assert judged(1.04, 3.0).verdict == "undecided", "too wide to tell"


@pytest.mark.parametrize(
    ("ci_low", "ci_high", "expected"),
    [
        (-0.25, 0.25, "reproduced"),
        (-0.26, 0.25, "undecided"),
        (-0.25, 0.26, "undecided"),
        (0.0, 0.1, "reproduced"),
        (0.01, 0.1, "differs"),
        (-0.1, -0.01, "differs"),
        (None, None, "undecided"),
    ],
)
def test_a_verdict_is_fixed_by_interval_and_margin(ci_low: float | None, ci_high: float | None, expected: str) -> None:
    assert verdict(ci_low, ci_high, 0.25) == expected


def test_an_undefined_mean_or_sd_is_undecided() -> None:
    for one in (judged(None, None, n=0), judged(1.04, None, n=1)):
        assert (one.verdict, one.ci_low, one.distance_se) == ("undecided", None, None)


def test_rows_that_the_paper_does_not_print_are_left_out() -> None:
    assert compare([row("authority_conflicts", "swarm", 1.0, 1.0)]) == []
