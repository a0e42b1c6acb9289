"""One day beside another: what happened on each, of what was recorded."""

from typing import Any

from tests.queries.histories import answer, event, run

HOUR = 3_600_000_000
FOREIGN: dict[str, Any] = {"kind": "foreign", "seed": None, "scenario": None, "run": None, "architecture": None}


def days(*runs: Any, kind: str) -> list[tuple[Any, ...]]:
    found = answer("audit/events_by_day", *runs, columns=("type", "run_id", "day", "event_count"))
    return sorted((name, str(day), count) for type_name, name, day, count in found if type_name == kind)


def night(run_id: str, *events: Any, **dimensions: Any) -> Any:
    """A run that began at ten in the evening, and has records two and four hours later."""
    seen = (event("Observed", at * HOUR, source="s", kind="k") for at in (0, 4))
    ordered = sorted((*events, *seen), key=lambda one: one["time_us"])
    return run(*ordered, run_id=run_id, **FOREIGN, **{"epoch": "2026-03-01T22:00:00Z", **dimensions})


LATE, EARLY = (event("ExecutionFailed", at * HOUR, task_id="t", action_id="t/1", cause="worn") for at in (1, 3))
RECORDS = {"observes": [], "records": ["Observed", "ExecutionFailed"]}


def test_an_event_counts_on_the_utc_day_on_which_it_happened() -> None:
    assert days(night("a", LATE, EARLY, EARLY, **RECORDS), kind="ExecutionFailed") == [
        ("a", "2026-03-01", 1),
        ("a", "2026-03-02", 2),
    ]


def test_nothing_of_what_is_recorded_is_zero() -> None:
    runs = night("a", LATE, **RECORDS), night("b", **RECORDS)
    assert [row[2] for row in days(*runs, kind="ExecutionFailed")] == [1, 0, 0, 0]


def test_nothing_of_what_is_not_recorded_is_not_zero() -> None:
    runs = night("a", LATE, **RECORDS), night("b", **{**RECORDS, "records": ["Observed"]})
    assert {row[0] for row in days(*runs, kind="ExecutionFailed")} == {"a"}


def test_what_is_recorded_and_never_seen_is_zero() -> None:
    assert [row[2] for row in days(night("a", **RECORDS), kind="ExecutionFailed")] == [0, 0]


def test_what_was_seen_on_one_day_and_is_not_said_to_be_recorded_is_not_zero_on_another() -> None:
    found = days(night("a", LATE, **{**RECORDS, "records": ["Observed"]}), kind="ExecutionFailed")
    assert found == [("a", "2026-03-01", 1)]


def test_a_concern_that_is_observed_is_recorded_whole() -> None:
    runs = night("a", LATE, **RECORDS), night("b", observes=["recovery"])
    assert [row for row in days(*runs, kind="ExecutionFailed") if row[0] == "b"] == [
        ("b", "2026-03-01", 0),
        ("b", "2026-03-02", 0),
    ]


def test_a_run_that_does_not_know_when_it_began_has_no_days() -> None:
    assert days(night("a", LATE, **{**RECORDS, "epoch": None}), kind="ExecutionFailed") == []
