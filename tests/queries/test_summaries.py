"""Metrics over runs: plain means, pooled ratios with their linearised SD, intervals, conventions."""

import math
import random
import statistics as plain
from collections.abc import Sequence

import numpy as np
import pytest
from scipy import special, stats

from fsar_ledger.metrics.definitions import metrics
from fsar_ledger.metrics.results import MetricRow, metric_rows
from tests.queries.histories import Row, S, event, run
from tests.recycled import from_rows

SUPERVISORS_CALL = event("SupervisorCalled", 1, supervisor="supervisor/fleet")


def summary(
    runs: Sequence[Sequence[Row]], by_scenario: bool = False, threads: int = 1
) -> dict[tuple[str, str | None, str | None], MetricRow]:
    with from_rows([row for rows in runs for row in rows], threads=threads) as database:
        return {(row.metric, row.architecture, row.scenario): row for row in metric_rows(database, by_scenario)}


def failing(contained: int, lost: int, number: int, scenario: str = "door-relay") -> list[Row]:
    """A run with so many failures; each contained one is resolved after `number` seconds, the others never."""
    events: list[Row] = [event("ExecutionFailed", 0, action_id="t1/1", failure=one) for one in range(contained + lost)]
    events += [
        event("FailureResolved", number * S, action_id="t1/1", failure=one, level="local") for one in range(contained)
    ]
    return run(*events, run_id=f"{scenario}-{number}", run=number, scenario=scenario)


def test_a_count_is_a_mean_over_runs_with_students_interval_on_its_logarithm() -> None:
    claims = [
        event("AuthorityClaimed", 1, claimant=claimant, dimension="override", action_id="t1/1")
        for claimant in ("a", "b")
    ]
    row = summary([run(*claims, run_id="r0"), run(run_id="r1"), run(run_id="r2")])["authority_conflicts", "fsar", None]
    low, high = np.exp(stats.t.interval(0.95, 2, loc=math.log(1 / 3), scale=3 * stats.sem([1, 0, 0])))
    assert (row.n, row.denominator) == (3, 3)
    assert (row.mean, row.sd, row.ci_low, row.ci_high) == pytest.approx(
        (1 / 3, plain.stdev([1, 0, 0]), low, high), rel=1e-12
    )


def test_containment_is_pooled_over_failures_and_its_sd_is_linearised() -> None:
    runs = [(2, 1), (0, 0), (0, 4), (1, 0), (3, 3)]
    row = summary([failing(*counts, number) for number, counts in enumerate(runs, 1)])[
        "recovery_containment", "fsar", None
    ]
    contained, failures = np.array([won for won, _ in runs]), np.array([won + lost for won, lost in runs])
    ratio = contained.sum() / failures.sum()
    sd = np.std((contained - ratio * failures) / failures.mean(), ddof=1)
    low, high = special.expit(
        stats.t.interval(0.95, 3, loc=special.logit(ratio), scale=sd / math.sqrt(5) / (ratio * (1 - ratio)))
    )
    assert (row.n, row.denominator) == (5, 14)
    assert (row.mean, row.sd, row.ci_low, row.ci_high) == pytest.approx((ratio, sd, low, high), rel=1e-12)
    assert row.published_convention_mean == pytest.approx((2 / 3 + 1 + 0 + 1 + 1 / 2) / 5)


def test_latency_is_pooled_in_seconds() -> None:
    row = summary([failing(1, 0, 3), failing(3, 2, 1), failing(0, 0, 2)])["reassignment_latency_s", "fsar", None]
    assert row.mean == pytest.approx(6 / 4)
    assert (row.denominator, row.n) == (4, 3)
    assert row.published_convention_mean == pytest.approx((3 + 1 + 0) / 3)


def test_pooled_metrics_without_any_failure_are_undefined() -> None:
    rows = summary([run(run_id="r0"), run(run_id="r1", run=1)])
    for metric, convention in (("recovery_containment", 1.0), ("reassignment_latency_s", 0.0)):
        row = rows[metric, "fsar", None]
        assert (row.mean, row.sd, row.ci_low, row.ci_high, row.denominator, row.n) == (None, None, None, None, 0, 0)
        assert row.published_convention_mean == convention


def test_metrics_that_are_undefined_for_a_run_leave_it_out() -> None:
    decision = event("OwnStepDecided", decided_by="coordinator", path=["coordinator"])
    row = summary([run(decision, run_id="r0"), run(run_id="r1")])["governance_locality", "fsar", None]
    assert (row.mean, row.n, row.denominator, row.published_convention_mean) == (0.0, 1, 1, 0.0)


def test_a_single_run_has_a_mean_and_no_interval() -> None:
    row = summary([run()])["policy_violations", "fsar", None]
    assert (row.mean, row.sd, row.ci_low, row.ci_high, row.n) == (0.0, None, None, None, 1)


@pytest.mark.parametrize(("called", "runs"), [(0, 5), (1, 7), (7, 7), (1, 1)])
def test_human_intervention_has_wilsons_interval(called: int, runs: int) -> None:
    row = summary([run(*[SUPERVISORS_CALL] * (number < called), run_id=f"r{number}") for number in range(runs)])[
        "human_intervention", "fsar", None
    ]
    expected = stats.binomtest(called, runs).proportion_ci(method="wilson")
    assert row.mean == called / runs
    assert (row.ci_low, row.ci_high) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_scenarios_are_summarised_each_by_itself() -> None:
    runs = [failing(1, 0, 1), failing(0, 1, 2), failing(1, 1, 3, "fleet-contention")]
    rows = summary(runs, by_scenario=True)
    assert rows["recovery_containment", "fsar", "fleet-contention"].mean == 0.5
    assert rows["recovery_containment", "fsar", "door-relay"].n == 2
    assert {scenario for _, _, scenario in rows} == {"door-relay", "fleet-contention"}
    assert {scenario for _, _, scenario in summary(runs)} == {None}


def test_configurations_fleet_sizes_and_architectures_are_summarised_apart() -> None:
    runs = [
        run(run_id=f"{a}{c}{f}", architecture=a, configuration=c, fleet_size=f)
        for a in ("fsar", "cfc")
        for c in ("full", "x")
        for f in (4, 8)
    ]
    with from_rows([row for rows in runs for row in rows]) as database:
        cells = [(row.configuration, row.fleet_size, row.architecture, row.metric) for row in metric_rows(database)]
    assert len(cells) == len(set(cells)) == 8 * len(metrics())
    assert cells[:2] == [("full", 4, "fsar", "coordination_success"), ("full", 4, "cfc", "coordination_success")]


@pytest.mark.slow
def test_the_answer_is_the_same_bits_on_any_number_of_threads() -> None:
    chance = random.Random(7)
    runs = []
    for number in range(300):
        decisions = [
            event("OwnStepDecided", decided_by="robot/A1", path=["robot/A1"] * chance.randint(1, 2))
            for _ in range(chance.randint(1, 40))
        ]
        runs.append(
            [
                *failing(chance.randint(0, 3), chance.randint(0, 3), number),
                *run(*decisions, run_id=f"door-relay-{number}")[1:],
            ]
        )
    assert len({repr(sorted(summary(runs, threads=threads).items())) for threads in (1, 2, 4) for _ in range(3)}) == 1
