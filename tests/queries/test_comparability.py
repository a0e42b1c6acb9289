"""Only runs that met the same world are compared; the others are named, with what differs, and what cannot be compared
is said."""

from collections.abc import Sequence
from typing import get_args

import numpy as np
import pytest
from scipy import stats

from fsar_ledger.events import CONCERN_OF
from fsar_ledger.events.world import WorldEvent
from fsar_ledger.metrics.comparability import (
    DifferingWorlds,
    differing_worlds,
    imputed,
    left_over,
    not_compared,
    remarks_on,
    too_few,
)
from fsar_ledger.metrics.database import Value
from fsar_ledger.metrics.results import StatisticRow, statistic_rows
from tests.queries.histories import Row, S, answer, event, run
from tests.recycled import from_rows

OBSTRUCTED = event("ObstructionAppeared", 2 * S, robot="robot/A1", obstruction="o1")
MET = event("PeersMet", 2 * S, robot="robot/A1", peer="robot/B1")
CALL = event("SupervisorCalled", 1, supervisor="supervisor/fleet")
SUMMARY = ("comparison", "differs", "first_run_id", "second_run_id")


def of(architecture: str, number: int, *events: Row, **dimensions: Value) -> list[Row]:
    return run(
        *events,
        run_id=f"{architecture}-{number}-{dimensions.get('configuration', 'full')}",
        architecture=architecture,
        run=number,
        **dimensions,
    )


def said(*runs: Sequence[Row]) -> tuple[list[DifferingWorlds], list[str], list[StatisticRow]]:
    with from_rows([row for rows in runs for row in rows]) as database:
        return differing_worlds(database), not_compared(database), statistic_rows(database)


def test_runs_whose_facts_differ_are_no_pair_and_are_named_with_the_first_fact() -> None:
    same = [of(name, 0, OBSTRUCTED, MET) for name in ("fsar", "cfc")]
    unlike = [of("fsar", 1, MET), of("cfc", 1, MET, OBSTRUCTED)]
    differing, _, rows = said(*same, *unlike)
    assert len(differing) == 1
    found = differing[0]
    assert (found.comparison, found.differs, found.pairs, found.is_fault) == ("fsar-cfc", "facts", 1, True)
    assert found.first.first_run_id == "fsar-1-full"
    assert found.first.first_found == '2.0 s PeersMet.v1 peer="robot/B1" robot="robot/A1"'
    assert found.first.second_run_id == "cfc-1-full"
    assert found.first.second_found == '2.0 s ObstructionAppeared.v1 obstruction="o1" robot="robot/A1"'
    assert {row.n for row in rows} == {1}
    assert (
        "1 pair of runs is left out: they did not meet the same facts of the world; first under seed 42, "
        "door-relay, 4 robots, run 1:" in str(found)
    )


@pytest.mark.parametrize(
    "other",
    [
        event("ObstructionAppeared", 2 * S, robot="robot/A1", obstruction="o2"),
        event("ObstructionAppeared", 2 * S + 1, robot="robot/A1", obstruction="o1"),
        event("ObstructionCleared", 2 * S, robot="robot/A1", obstruction="o1"),
        event("TaskCompleted", 2 * S, task_id="t1"),
    ],
    ids=["another field", "a microsecond later", "another type", "no fact at all"],
)
def test_a_fact_is_its_time_its_type_and_its_fields(other: Row) -> None:
    assert answer("statistics/differing_worlds", of("fsar", 0, OBSTRUCTED), of("cfc", 0, other), columns=SUMMARY) == [
        ("fsar-cfc", "facts", "fsar-0-full", "cfc-0-full")
    ]


def test_neither_decisions_nor_the_order_of_facts_of_one_time_make_another_world() -> None:
    first, second = of("fsar", 0, CALL, OBSTRUCTED, MET), of("cfc", 0, MET, OBSTRUCTED, CALL, CALL)
    assert answer("statistics/differing_worlds", first, second) == []
    assert answer("statistics/run_pairs", first, second, columns=("first_run_id", "second_run_id", "differs")) == [
        ("fsar-0-full", "cfc-0-full", None)
    ]


def test_constants_of_a_pair_are_compared_by_value_and_other_ones_are_named() -> None:
    text, same, other = '{"world":{"a":1,"b":2}}', '{"world": {"b": 2.0, "a": 1}}', '{"world":{"a":1,"b":3}}'
    assert answer("statistics/differing_worlds", of("fsar", 0, parameters=text), of("cfc", 0, parameters=same)) == []
    (found,), (why, *_), rows = said(of("fsar", 0, parameters=text), of("cfc", 0, parameters=other))
    assert (found.differs, found.is_fault, rows) == ("setting", False, [])
    assert found.first.first_found == "simulated, model test, world.b=2"
    assert found.first.second_found == "simulated, model test, world.b=3"
    assert why == (
        "fsar-cfc: every pair of runs (1) is left out, as said above; simulate both under one world and the "
        "same constants"
    )


def test_a_run_with_a_counterpart_under_its_own_constants_is_not_held_against_others() -> None:
    runs = [of(name, at, parameters=f'{{"a":{at}}}') for name in ("fsar", "cfc") for at in (0, 1)]
    both = [[{**row, "run": 0} if row["seq"] == 0 else row for row in rows] for rows in runs]
    assert answer("statistics/differing_worlds", *both) == []
    pairs = answer("statistics/run_pairs", *both, columns=("first_run_id", "second_run_id"))
    assert sorted(pairs) == [("fsar-0-full", "cfc-0-full"), ("fsar-1-full", "cfc-1-full")]


def test_nobody_says_which_of_two_runs_of_one_world_is_the_pair() -> None:
    twin = [{**row, "run_id": "twin"} for row in of("fsar", 0, MET)]
    found = answer("statistics/differing_worlds", of("fsar", 0, MET), twin, of("cfc", 0, MET), columns=SUMMARY[:3])
    assert found == [("fsar-cfc", "repeated", "fsar-0-full"), ("fsar-cfc", "repeated", "twin")]


def test_a_world_that_was_not_observed_is_not_taken_for_the_same() -> None:
    found = answer(
        "statistics/differing_worlds", of("fsar", 0), of("cfc", 0, observes=["request"]), columns=SUMMARY[:2]
    )
    assert found == [("fsar-cfc", "unobserved")]


def test_whose_source_records_the_world_records_every_fact_of_it() -> None:
    concerns = {CONCERN_OF[fact.__name__] for fact in get_args(WorldEvent)}
    runs = [
        of("fsar", 0, observes=sorted(concerns)),
        *(of("fsar", at, observes=sorted(concerns - {one})) for at, one in enumerate(concerns, 1)),
    ]
    observing = answer("statistics/compared_runs", *runs, columns=("run_id", "observes_world"))
    assert [run_id for run_id, observes in observing if observes] == ["fsar-0-full"]
    assert len(observing) == 1 + len(concerns) > 4


def test_of_many_seeds_the_first_are_named_and_the_others_counted() -> None:
    runs = [of("fsar", at, seed=at) for at in range(1, 9)]
    _, (why, *_), _ = said(*runs, of("cfc", 0, seed=99))
    assert (
        "fsar (full) under seeds 1, 2, 3, 4, 5 and 3 more, 4 robots, door-relay; cfc (full) under seeds 99, 4 robots"
        in why
    )


def ablated(calls: Sequence[int], *, with_full: bool = True) -> list[list[Row]]:
    """Runs of FSAR, and of FSAR without trust evaluation with so many calls more."""
    full = [of("fsar", at, *[CALL] * (at % 2)) for at in range(len(calls))] if with_full else []
    return [
        *full,
        *(of("fsar", at, *[CALL] * more, configuration="without-trust-evaluation") for at, more in enumerate(calls)),
    ]


def test_an_ablation_is_compared_with_the_whole_architecture_in_pairs() -> None:
    calls = [1, 1, 0, 1, 1, 0, 1, 1] * 2
    differing, _, rows = said(*ablated(calls))
    assert differing == []
    row = next(row for row in rows if row.metric == "human_intervention")
    first, second = np.arange(16) % 2, np.minimum(calls, 1)
    expected = stats.ttest_rel(first, second)
    assert (row.comparison, row.configuration) == ("fsar-without-trust-evaluation", "without-trust-evaluation")
    assert (row.family, row.n) == ("ablations of fsar", 16)
    assert (row.first_mean, row.second_mean, row.t, row.p) == pytest.approx(
        (first.mean(), second.mean(), expected.statistic, expected.pvalue)
    )
    assert row.d_z == pytest.approx((first - second).mean() / (first - second).std(ddof=1))
    assert row.wilcoxon_p is not None
    assert (row.family_tests, row.p_holm) == (1, row.p), "the other seven do not vary"


def test_ablations_are_adjusted_apart_from_architectures() -> None:
    calls = [1, 1, 0, 1, 1, 0, 1, 1]
    _, _, alone = said(*ablated(calls))
    _, _, beside = said(*ablated(calls), *(of("cfc", at, *[CALL] * (at % 3)) for at in range(8)))
    assert [row for row in beside if row.family == "ablations of fsar"] == alone
    assert {row.family for row in beside} == {"architectures", "ablations of fsar"}


@pytest.mark.slow
def test_what_cannot_be_compared_is_said_with_what_it_takes() -> None:
    cases: list[tuple[list[list[Row]], str]] = [
        ([], "found no runs; `fsar-ledger simulate` makes some"),
        (
            [of("fsar", 0)],
            (
                "fsar-cfc: found 1 run of fsar (full) and none of cfc (full); simulate it with the same seed, "
                "scenarios, runs and fleet size"
            ),
        ),
        (
            ablated([0], with_full=False),
            "fsar-without-trust-evaluation: found 1 run of fsar (without-trust-evaluation) and none of fsar (full)",
        ),
        (
            [of("fsar", 0), of("cfc", 0, seed=7)],
            (
                "no runs of both have the same seed, scenario, fleet size and number: found fsar (full) under seeds "
                "42, 4 robots"
            ),
        ),
        (
            [of("fsar", 0), of("cfc", 0, fleet_size=8)],
            "cfc (full) under seeds 42, 8 robots, door-relay; simulate both alike",
        ),
        (
            [of("fsar", 0, seed=None, kind="foreign")],
            "found 1 run (foreign) of fsar, all without seed, scenario, fleet size or number",
        ),
        (
            [of("ours", 0)],
            "found 1 run (simulated) of ours; expected two architectures, or the configurations of one",
        ),
    ]
    for runs, expected in cases:
        _, why, rows = said(*runs)
        assert rows == []
        assert any(expected in line for line in why), (expected, why)


def test_what_rows_do_not_show_is_said() -> None:
    _, _, rows = said(of("fsar", 0), of("cfc", 0))
    metrics = [row.metric for row in rows]
    assert remarks_on(rows, [*metrics, "audit_attributability"]) == [
        "fsar-cfc: no pair of runs has a value of audit_attributability on both sides: undefined, or not observed",
        "fsar-cfc: one pair of runs has a difference but no test; simulate more runs",
    ]


def test_what_rows_of_one_seed_lack_is_not_said_of_all_seeds() -> None:
    started = event("ExecutionStarted", 0, action_id="t1/1", robot="robot/A1", on_behalf_of="robot/A1")
    sides = (("fsar", (CALL,)), ("cfc", ()))
    few = [of(name, 0, *called) for name, called in sides]
    many = [of(name, at + 1, *called, started, seed=7) for at in range(6) for name, called in sides]
    _, _, rows = said(*few, *many)
    assert too_few(rows) == [
        "fsar-cfc: under some seeds or settings no Wilcoxon test of human_intervention: fewer than 6 pairs differ"
    ]
    assert remarks_on(rows, ["true_attribution"]) == [
        "fsar-cfc: under some seeds or settings no pair of runs has a value of true_attribution on both sides: "
        "undefined, or not observed",
        "fsar-cfc: one pair of runs has a difference but no test; simulate more runs",
    ]


def test_runs_without_a_partner_are_said() -> None:
    runs = [of("fsar", 0), of("cfc", 0), of("fsar", 1), of("fsar", 2), of("fsar", 3, seed=7)]
    with from_rows([row for rows in runs for row in rows]) as database:
        assert left_over(database) == [
            "fsar-cfc: 1 run of fsar under seed 7 has no partner and is left out",
            "fsar-cfc: 2 runs of fsar under seed 42 have no partner and are left out",
        ]
    with from_rows([row for rows in runs[:2] for row in rows]) as database:
        assert left_over(database) == []


def test_runs_counted_as_the_paper_does_are_said_and_pairs_of_nothing_else_are_no_test() -> None:
    failed = (
        event("ExecutionFailed", 0, action_id="t1/1", failure=1),
        event("FailureResolved", S, action_id="t1/1", failure=1, level="local"),
    )
    names = ("recovery_containment", "reassignment_latency_s")
    alone = of("fsar", 1)  # without a failure, and without a partner: no test counts it
    for runs, shown in (([of("fsar", 0), of("cfc", 0)], 0), ([of("fsar", 0, *failed), of("cfc", 0), alone], 2)):
        with from_rows([row for rows in runs for row in rows]) as database:
            rows = statistic_rows(database)
            said_of_them = imputed(database, rows)
        assert [row.metric for row in rows if row.metric in names] == list(names[:shown])
        assert len(said_of_them) == shown
    assert said_of_them[1].startswith(
        "reassignment_latency_s: 1 run without a failure counts as in the paper, as 0 s (basis published)"
    )


def test_a_run_whose_failure_has_no_latency_is_not_called_one_without_a_failure() -> None:
    open_failure = event("ExecutionFailed", 0, action_id="t1/1", failure=1)
    resolved = event("FailureResolved", S, action_id="t1/1", failure=1, level="local")
    pairs = [of("fsar", 0, open_failure), of("cfc", 0, open_failure, resolved), of("fsar", 1), of("cfc", 1)]
    like_none = "count as the paper counts those without a failure, as 0 s (basis published)"
    with from_rows([row for rows in pairs for row in rows]) as database:
        containment, latency = imputed(database, statistic_rows(database))
    assert containment.startswith("recovery_containment: 2 runs without a failure count as in the paper, as 1 (basis")
    both = "2 runs without a failure and 1 run with failures that give no value"
    assert latency.startswith(f"reassignment_latency_s: {both} {like_none}")


def test_a_missing_wilcoxon_test_has_its_reason() -> None:
    _, _, rows = said(of("fsar", 0, CALL), of("cfc", 0), of("fsar", 1), of("cfc", 1))
    assert too_few(rows) == ["fsar-cfc: no Wilcoxon test of human_intervention: fewer than 6 pairs differ"]
