"""What was planned, which runs the plans name, and which none."""

from typing import Any

from fsar_ledger.metrics.database import from_rows
from fsar_ledger.metrics.provenance import completeness
from tests.queries.histories import answer, run


def plan(name: str = "p1", **changes: Any) -> list[dict[str, Any]]:
    """The row of a plan of two runs of one scenario under two architectures."""
    given = {
        "architectures": ["fsar", "cfc"],
        "configurations": ["full"],
        "scenarios": ["door-relay"],
        "run_count": 2,
        "seed": 42,
        "fleet_size": 4,
        "model_version": "test",
        "parameters": "{}",
    }
    return [
        {"run_id": name, "seq": 0, "caused_by": None, "type": "ExperimentPlanned.v1", "time_us": 0, **given, **changes}
    ]


def counted(*rows: Any) -> list[tuple[Any, ...]]:
    return answer(
        "audit/experiments", *rows, columns=("plan", "planned_count", "there_count", "missing_count", "larger_plans")
    )


def test_a_plan_counts_the_runs_that_it_names_and_no_others() -> None:
    there = [run(run_id="a"), run(run_id="b", run=1), run(run_id="c", architecture="cfc")]
    others = [
        run(run_id="d", run=2),
        run(run_id="e", architecture="dhma"),
        run(run_id="f", scenario="fleet-contention"),
        run(run_id="g", seed=41),
        run(run_id="h", fleet_size=8),
        run(run_id="i", model_version="other"),
        run(run_id="j", parameters='{"world":{}}'),
        run(run_id="k", configuration="without-trust-evaluation"),
        run(run_id="l", kind="live"),
    ]
    assert counted(plan(), *there, *others) == [("p1", 4, 3, 1, 0)]
    found = answer("facts/planned_runs", plan(), *there, *others, columns=("plan", "run_id"))
    assert found == [("p1", "a"), ("p1", "b"), ("p1", "c")]
    assert answer("audit/unplanned_runs", plan(), *there, *others, columns=("run_id",)) == [
        (name,) for name in "defghijkl"
    ]


def test_a_plan_without_any_run_lacks_all_of_them() -> None:
    assert counted(plan()) == [("p1", 4, 0, 4, 0)]


def test_a_plan_that_another_one_contains_is_part_of_a_larger_one() -> None:
    larger = plan("p2", run_count=5, scenarios=["fleet-contention", "door-relay"])
    assert counted(plan(), larger) == [("p1", 4, 0, 4, 1), ("p2", 20, 0, 20, 0)]


def test_plans_that_do_not_contain_each_other_are_not_larger() -> None:
    others = [
        plan("p2", run_count=1, scenarios=["door-relay", "fleet-contention", "x", "y", "z"]),
        plan("p3", seed=41, run_count=9),
    ]
    others += [
        plan("p4", run_count=9, parameters='{"world":{}}'),
        plan("p5", run_count=9, architectures=["fsar", "dhma"]),
    ]
    assert [row[-1] for row in counted(plan(), *others)] == [0] * 5


def test_a_run_that_two_plans_name_is_missing_once() -> None:
    plans = [*plan(run_count=3), *plan("p2", architectures=["fsar"], scenarios=["door-relay", "fleet-contention"])]
    there = run(run_id="a")
    assert [row[3] for row in counted(plans, there)] == [5, 3]
    columns = ("architecture", "scenario", "planned_count", "there_count", "missing_count")
    assert answer("audit/missing_runs", plans, there, columns=columns) == [
        ("cfc", "door-relay", 3, 0, 3),
        ("fsar", "door-relay", 3, 1, 2),
        ("fsar", "fleet-contention", 2, 0, 2),
    ]
    with from_rows([*plans, *there]) as database:
        assert completeness(database).answer() == {"complete": False, "missing_count": 7}


def test_a_plan_of_endless_names_stops_no_answer() -> None:
    names = [f"n{at}" for at in range(1000)]
    plans = [*plan(run_count=3), *plan("p2", architectures=names, scenarios=names, configurations=names)]
    with from_rows(plans) as database:
        assert completeness(database).answer() == {"complete": False, "missing_count": None}


def test_a_name_that_a_plan_repeats_counts_once() -> None:
    assert counted(plan(scenarios=["door-relay", "door-relay"]), run(run_id="a"), run(run_id="b")) == [
        ("p1", 4, 1, 3, 0)
    ]


def test_a_plan_is_neither_a_run_nor_a_decision() -> None:
    assert answer("staging/runs", plan()) == []
    assert answer("metrics/run_metrics", plan()) == []
    assert answer("facts/decisions", plan()) == []


def test_a_plan_of_later_runs_names_those_and_lacks_no_earlier_ones() -> None:
    there = [run(run_id=f"a{at}", run=at) for at in range(4)]
    assert counted(plan(first_run=2, architectures=["fsar"]), *there) == [("p1", 2, 2, 0, 0)]
    found = answer("facts/planned_runs", plan(first_run=2, architectures=["fsar"]), *there, columns=("run_id",))
    assert found == [("a2",), ("a3",)]


def test_plans_of_overlapping_numbers_ask_for_each_number_once() -> None:
    plans = [*plan(run_count=3), *plan("p2", first_run=2, run_count=4), *plan("p3", first_run=8, run_count=1)]
    columns = ("architecture", "planned_count", "there_count", "missing_count")
    found = answer("audit/missing_runs", plans, run(run_id="a", run=2), columns=columns)
    assert found == [("cfc", 7, 0, 7), ("fsar", 7, 1, 6)]


def test_only_a_plan_whose_numbers_lie_within_another_is_part_of_it() -> None:
    assert counted(plan(first_run=3), plan("p2", run_count=5)) == [("p1", 4, 0, 4, 1), ("p2", 10, 0, 10, 0)]
    assert [row[-1] for row in counted(plan(first_run=4), plan("p2", run_count=5))] == [0, 0]
