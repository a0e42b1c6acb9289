"""Runs of different seeds, constants, models, kinds or fleet sizes are never in one row, and the constants that differ
are named."""

import json
from collections.abc import Sequence
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsar_ledger.metrics.constant_names import MAX_PARAMETERS
from fsar_ledger.metrics.database import Value
from fsar_ledger.metrics.results import MetricRow, StatisticRow, metric_rows, statistic_rows
from tests.queries.histories import Row, answer, event, run
from tests.quick import few
from tests.recycled import from_rows

LOW, HIGH = (
    '{"world":{"rate_per_s":0.01,"windows":{"mean_s":11.3}}}',
    '{"world":{"rate_per_s":0.03,"windows":{"mean_s":11.3}}}',
)


def called(*calls: int, **dimensions: Value) -> list[list[Row]]:
    """A run for each number, with so many calls of the fleet's supervisor, under the three architectures."""
    return [
        run(
            *[event("SupervisorCalled", 1, supervisor="supervisor/fleet")] * (count + at),
            run_id=f"{architecture}-{number}-{sorted(dimensions.items())}",
            run=number,
            architecture=architecture,
            **dimensions,
        )
        for number, count in enumerate(calls)
        for at, architecture in enumerate(("fsar", "cfc", "dhma"))
    ]


def judged(runs: Sequence[Sequence[Row]], *, pools_seeds: bool = False) -> tuple[list[MetricRow], list[StatisticRow]]:
    with from_rows([row for rows in runs for row in rows]) as database:
        return metric_rows(database, pools_seeds=pools_seeds), statistic_rows(database, pools_seeds=pools_seeds)


def constants(*parameters: str | None) -> list[str | None]:
    """What the runs with these parameters have otherwise than the others, in their order."""
    runs = [run(run_id=f"r{at:02}", parameters=one) for at, one in enumerate(parameters)]
    return [label for _, label in answer("staging/run_settings", *runs, columns=("run_id", "constants"))]


OTHERS: dict[str, Any] = {
    "seed": 43,
    "fleet_size": 8,
    "model_version": "another",
    "parameters": HIGH,
    "kind": "live",
    "configuration": "without-x",
}


@pytest.mark.slow
def test_runs_that_differ_in_one_dimension_are_never_in_one_row() -> None:
    groups = [called(0, 1, parameters=LOW)]
    groups += [
        called(*[0] * (3 + at), **{"parameters": LOW, name: other}) for at, (name, other) in enumerate(OTHERS.items())
    ]
    metrics, statistics = judged([rows for group in groups for rows in group])
    means = sorted(row.n for row in metrics if (row.metric, row.architecture) == ("human_intervention", "fsar"))
    tests = sorted(row.n for row in statistics if (row.metric, row.comparison) == ("human_intervention", "fsar-cfc"))
    assert means == tests == list(range(2, 9))


def test_other_constants_are_named_where_they_differ_and_only_there() -> None:
    metrics, statistics = judged([*called(0, parameters=LOW), *called(1, parameters=HIGH)])
    assert (
        {row.constants for row in metrics}
        == {row.constants for row in statistics}
        == {"world.rate_per_s=0.01", "world.rate_per_s=0.03"}
    )
    metrics, statistics = judged(called(0, 1, parameters=LOW))
    assert {row.constants for row in metrics} == {row.constants for row in statistics} == {None}


def test_constants_are_compared_by_value_and_not_by_text() -> None:
    same = (
        '{"world":{"a":1,"b":2.5,"n":null},"list":[["carry.heavy",{"low_s":2.0}]]}',
        ' {"list": [["carry.heavy", {"low_s": 2}]], "world": {"b": 25e-1, "a": 1.0}, "later": null}',
    )
    assert constants(*same) == [None, None]
    runs = [run(run_id=f"r{at}", parameters=one) for at, one in enumerate(same)]
    assert len(set(answer("staging/run_settings", *runs, columns=("setting",)))) == 1
    other = '{"world":{"a":1,"b":2.5},"list":[["carry.heavy",{"low_s":3}]],"more":{"x":"y"}}'
    found = constants(*same, other)
    assert found == [*['list["carry.heavy"].low_s=2, more.x=absent'] * 2, 'list["carry.heavy"].low_s=3, more.x="y"']


def test_five_constants_are_named_and_the_others_counted() -> None:
    one, two = constants(*(json.dumps({f"c{at}": value for at in range(8)}) for value in (1, 2)))
    assert one is not None
    assert two is not None
    assert one.startswith("c0=1, c1=1, c2=1, c3=1, c4=1 and 3 more (set ")
    assert one[-9:] != two[-9:]


HOSTILE = {
    "no JSON": "nope",
    "no object": "[1]",
    "without end": "[" * 50_000,
    "deep": '{"a":' * 5_000 + "1" + "}" * 5_000,
    "a long number": '{"a":' + "9" * 5_000 + "}",
    "too much": json.dumps({"a": "x" * MAX_PARAMETERS}),
    "beyond 64 bits": '{"a":18446744073709551616}',
}


def test_parameters_that_cannot_be_read_are_a_set_of_their_own_and_stop_nobody() -> None:
    labels = constants(LOW, *HOSTILE.values(), None)
    assert labels[0] is None
    assert labels[-1] is None
    assert all(label is not None and label.startswith("unreadable, SHA-256 ") for label in labels[1:-1])
    assert len(set(labels[1:-1])) == len(HOSTILE)


def test_names_that_could_be_taken_for_others_are_not() -> None:
    alike = ('{"a.b":1}', '{"a":{"b":1}}', '{"a":[1]}', '{"a":{"[0]":1}}', '{"a":[["0",1]]}', '{"a":{"0":1}}')
    assert len(set(constants(*alike))) == len(alike)


CALLS = st.lists(st.integers(0, 2), min_size=1, max_size=4)
OTHER_RUNS = st.lists(
    st.tuples(
        st.integers(0, 2), st.sampled_from((43, 44)), st.sampled_from((4, 8)), st.sampled_from((LOW, '{"world":{}}'))
    ),
    min_size=1,
    max_size=4,
)


def assert_only_rows_are_added(calls: list[int], others: list[tuple[int, int, int, str]]) -> None:
    ours = called(*calls, parameters=LOW)
    more = [
        rows
        for count, seed, size, text in others
        for rows in called(count, seed=seed, fleet_size=size, parameters=text)
    ]
    unique = {str(rows[0]["run_id"]): rows for rows in more}

    def nameless(rows: Sequence[MetricRow | StatisticRow]) -> list[MetricRow | StatisticRow]:
        return [msgspec.structs.replace(row, constants=None) for row in rows if (row.seed, row.fleet_size) == (42, 4)]

    (metrics, statistics), (after_metrics, after_statistics) = judged(ours), judged([*ours, *unique.values()])
    assert nameless(after_metrics) == nameless(metrics)
    assert nameless(after_statistics) == nameless(statistics)
    assert len(after_metrics) > len(metrics)


def test_runs_of_another_seed_never_change_the_rows_of_the_first() -> None:
    assert_only_rows_are_added([0, 1, 2], [(2, 43, 4, LOW), (1, 44, 8, '{"world":{}}')])


@pytest.mark.parametrize("ledgers", few([6, 100], [], [6]))
def test_no_runs_of_other_seeds_change_the_rows_of_the_first(ledgers: int) -> None:
    settings(max_examples=ledgers, deadline=None)(given(CALLS, OTHER_RUNS)(assert_only_rows_are_added))()


@pytest.mark.slow
def test_all_seeds_are_taken_together_only_when_that_is_asked_for() -> None:
    runs = [*called(0, 1, seed=42), *called(1, 1, 1, seed=43)]
    metrics, statistics = judged(runs, pools_seeds=True)
    pooled = next(row for row in metrics if (row.metric, row.architecture) == ("human_intervention", "fsar"))
    assert (pooled.seed, pooled.seeds, pooled.n, pooled.mean) == (None, 2, 5, 4 / 5)
    assert {row.n for row in statistics if row.metric == "human_intervention"} == {5}
    assert {row.seed for row in statistics} == {None}
    metrics, statistics = judged(runs)
    found = {(row.seed, row.seeds, row.n) for row in metrics if row.metric == "human_intervention"}
    assert found == {(42, 1, 2), (43, 1, 3)}
    assert {(row.seed, row.n) for row in statistics if row.metric == "human_intervention"} == {(42, 2), (43, 3)}


def test_constants_of_other_seeds_do_not_keep_seeds_together() -> None:
    metrics, _ = judged([*called(0, parameters=LOW, seed=1), *called(0, parameters=HIGH, seed=2)], pools_seeds=True)
    found = {(row.constants, row.n) for row in metrics if row.metric == "human_intervention"}
    assert found == {("world.rate_per_s=0.01", 1), ("world.rate_per_s=0.03", 1)}


def test_a_run_without_a_scenario_counts_once() -> None:
    metrics, _ = judged(
        [run(run_id="a", scenario=None, kind="foreign"), run(run_id="b", scenario=None, kind="foreign")]
    )
    assert {row.n for row in metrics if row.metric == "human_intervention"} == {2}


def test_runs_of_workflows_are_no_runs_of_a_scenario_and_have_rows_of_their_own() -> None:
    rows, _ = judged([*called(1, 1), *called(0, scenario="workflow-door-relay")])
    calls = [(row.architecture, row.kind, row.n, row.mean) for row in rows if row.metric == "human_intervention"]
    assert sorted(calls)[:4] == [
        ("cfc", "simulated", 2, 1.0),
        ("cfc", "workflow", 1, 1.0),
        ("dhma", "simulated", 2, 1.0),
        ("dhma", "workflow", 1, 1.0),
    ]
    assert sorted(calls)[4:] == [("fsar", "simulated", 2, 1.0), ("fsar", "workflow", 1, 0.0)]
