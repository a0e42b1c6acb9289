"""The paper's metrics of a shift or a day: each case counts once, when it began."""

from collections.abc import Sequence
from typing import Any

import pytest

from tests.queries.histories import Row, S, act, answer, event, run
from tests.recycled import from_rows

DAY = 86_400 * S
FOREIGN: dict[str, Any] = {"kind": "foreign", "seed": None, "scenario": None, "run": None, "architecture": None}
EVENING = "2026-03-01T22:00:00Z"
COLUMNS = ("metric", "numerator", "denominator", "value", "not_observed")


def by(period: str, *runs: Sequence[Row]) -> dict[str, dict[str, tuple[Any, ...]]]:
    """For each period the numerator, denominator, value and what is not observed of each metric."""
    found: dict[str, dict[str, tuple[Any, ...]]] = {}
    with from_rows([row for rows in runs for row in rows]) as database:
        for row in database.query("audit/metrics_by_period", {"per": period}).to_pylist():
            metric, *numbers = (row[column] for column in COLUMNS)
            found.setdefault(row["period"], {})[metric] = tuple(numbers)
    return found


def arrived(time_us: int, task: str, budget_us: int = 600 * S) -> Row:
    return event("TaskArrived", time_us, task_id=task, budget_us=budget_us)


def failed(time_us: int, action_id: str) -> Row:
    return act("ExecutionFailed", time_us, action_id, robot="robot/A1", failure=1, cause="worn")


MIDNIGHT = 2 * 3600 * S
NIGHT = (
    arrived(MIDNIGHT - 2 * S, "t"),
    failed(MIDNIGHT - S, "t/1"),
    act("FailureResolved", MIDNIGHT + S, "t/1", robot="robot/A1", failure=1, level="local"),
    event("TaskCompleted", MIDNIGHT + 2 * S, task_id="t"),
    arrived(MIDNIGHT + 3 * S, "u"),
    event("SupervisorCalled", MIDNIGHT + 4 * S, supervisor="supervisor/fleet", purpose="review"),
    event("SupervisorCalled", MIDNIGHT + 5 * S, supervisor="supervisor/fleet", purpose="review"),
    event("TaskAbandoned", MIDNIGHT + 6 * S, task_id="u"),
)


def test_a_case_counts_on_the_day_on_which_it_began() -> None:
    days = by("day", run(*NIGHT, epoch=EVENING))
    assert list(days) == ["2026-03-01", "2026-03-02"]
    first, second = days.values()
    assert (first["coordination_success"], second["coordination_success"]) == ((1, 1, 1.0, None), (0, 1, 0.0, None))
    assert (first["recovery_containment"], second["recovery_containment"]) == ((1, 1, 1.0, None), (0, 0, None, None))
    assert first["reassignment_latency_s"] == (2 * S, 1, 2.0, None)
    assert (first["human_intervention"], second["human_intervention"]) == ((0, 1, 0.0, None), (1, 1, 1.0, None))


def test_a_day_without_records_has_no_row() -> None:
    days = by("day", run(arrived(0, "t"), event("TaskCompleted", 2 * DAY, task_id="t"), epoch=EVENING))
    assert list(days) == ["2026-03-01", "2026-03-03"]
    assert by("day", run(*NIGHT)) == {}, "nobody knows when it began"


def test_parts_lie_between_the_cuts_and_have_the_names_of_the_runs() -> None:
    def cut(time_us: int, before: str) -> Row:
        return event("RunContinued", time_us, continues=before, continues_seq=1)

    events = (arrived(S, "t"), cut(2 * S, "yard"), arrived(2 * S, "u"), arrived(3 * S, "v"), cut(4 * S, "yard.2"))
    parts = by("part", run(*events, run_id="yard.3"))
    assert {name: numbers["coordination_success"][1] for name, numbers in parts.items()} == {
        "yard": 1,
        "yard.2": 2,
        "yard.3": 0,
    }


def test_what_a_run_does_not_observe_is_not_zero_in_any_period() -> None:
    rows = run(arrived(S, "t"), event("TaskCompleted", 2 * S, task_id="t"), **FOREIGN, observes=["task"], epoch=EVENING)
    for found in (by("day", rows)["2026-03-01"], by("part", rows)["r1"]):
        assert found["coordination_success"] == (1, 1, 1.0, None)
        assert found["policy_violations"] == (None, None, None, "execution, fleet, policy, supervision")


@pytest.mark.parametrize("name", ["facts/metric_cases", "audit/metrics_by_period"])
def test_nothing_on_record_is_no_case(name: str) -> None:
    with from_rows([]) as database:
        assert database.query(name).to_pylist() == []


def test_cases_add_up_to_the_metrics_of_the_run() -> None:
    rows = run(*NIGHT)
    (found,) = by("part", rows).values()
    whole = answer("metrics/run_metrics", rows, columns=COLUMNS)
    assert found == {metric: numbers for metric, *rest in whole if metric in found for numbers in [tuple(rest)]}
