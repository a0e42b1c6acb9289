"""What is open when the record of another system ends has no outcome yet, which is no failure."""

from typing import Any

import pytest

from tests.queries.histories import answer, event, run

S = 1_000_000
FOREIGN: dict[str, Any] = {"kind": "foreign", "seed": None, "scenario": None, "run": None, "architecture": None}
ARRIVED = event("TaskArrived", 0, task_id="t", budget_us=10 * S)
FAILED = event("ExecutionFailed", S, task_id="t", action_id="t/1", robot="robot/A1", failure=1, cause="worn")
RESOLVED = event("FailureResolved", 2 * S, task_id="t", action_id="t/1", robot="robot/A1", failure=1, level="local")


def seen_at(at_s: float) -> dict[str, Any]:
    return event("Observed", int(at_s * S), source="s", kind="k")


def success(*events: dict[str, Any], **started: Any) -> Any:
    [[numerator, not_observed]] = answer(
        "metrics/coordination_success", run(ARRIVED, *events, **started), columns=("numerator", "not_observed")
    )
    return not_observed or numerator


OPEN = "the end of what was open"


def test_a_task_within_its_budget_at_the_end_of_the_record_is_no_failure() -> None:
    assert success(seen_at(9), **FOREIGN) == OPEN
    assert success(seen_at(10), **FOREIGN) == 0
    assert success(seen_at(9)) == 0  # a simulated run ends when nothing is left to happen


def test_a_budget_longer_than_any_run_is_a_budget() -> None:
    endless = event("TaskArrived", S, task_id="u", budget_us=2**63 - 1)
    assert success(endless, seen_at(10), **FOREIGN) == OPEN
    assert ("u", None) in answer("facts/late_tasks", run(ARRIVED, endless), columns=("task_id", "due_us"))


def test_a_task_that_was_done_or_given_up_is_not_open() -> None:
    assert success(event("TaskCompleted", 3 * S, task_id="t"), **FOREIGN) == 1
    assert success(event("TaskAbandoned", 3 * S, task_id="t"), **FOREIGN) == 0


def test_what_was_open_when_a_recorder_stopped_is_not_known_when_it_goes_on() -> None:
    opened = event("SourceOpened", source="s", format="f", adapter="a", clock="arrival")
    again = {**opened, "time_us": 2 * S}
    assert success(again, seen_at(60), **FOREIGN) == OPEN  # it may have been done meanwhile
    late = {**again, "time_us": 12 * S}
    assert success(late, seen_at(60), **FOREIGN) == OPEN  # and that in time
    assert success(seen_at(10), late, seen_at(60), **FOREIGN) == 0  # it was late when the recorder stopped
    assert success(again, event("TaskCompleted", 9 * S, task_id="t"), **FOREIGN) == 1
    assert success({**again, "input_sha256": "0" * 64}, seen_at(60), **FOREIGN) == 0  # an input has no such gap


def contained(*events: dict[str, Any], **started: Any) -> Any:
    [[numerator, not_observed]] = answer(
        "metrics/recovery_containment", run(FAILED, *events, **started), columns=("numerator", "not_observed")
    )
    return not_observed or numerator


@pytest.mark.parametrize(
    ("events", "found"),
    [
        ((), OPEN),
        ((RESOLVED,), 1),
        ((event("ExecutionWithdrawn", 2 * S, task_id="t", action_id="t/1", robot="robot/A1", failure=1),), 0),
    ],
)
def test_a_failure_without_an_end_is_open(events: tuple[dict[str, Any], ...], found: Any) -> None:
    assert contained(*events, **FOREIGN) == found


def test_a_failure_that_is_told_twice_under_its_number_is_not_counted_twice() -> None:
    assert contained(FAILED, RESOLVED, **FOREIGN) == "which failure was resolved"
    assert contained({**FAILED, "failure": 2}, RESOLVED, {**RESOLVED, "failure": 2}, **FOREIGN) == 2


def test_who_releases_what_nobody_claimed_on_record_may_have_held_it_against_another() -> None:
    def held(type: str, at_s: int, claimant: str) -> dict[str, Any]:
        fields = {"task_id": "t", "action_id": "t/1", "dimension": "execution", "reason": "acceptance"}
        return event(type, at_s * S, claimant=claimant, **fields)

    mine, given_back = held("AuthorityClaimed", 1, "robot/A1"), held("AuthorityReleased", 3, "robot/A1")
    for rows, expected in (
        ((mine, given_back), (0, None)),
        ((mine, held("AuthorityReleased", 2, "robot/B1"), given_back), (None, "who held authority before the record")),
    ):
        found = answer("metrics/authority_conflicts", run(*rows, **FOREIGN), columns=("numerator", "not_observed"))
        assert found == [expected]


def joined(at_s: int, supervisor: str | None) -> dict[str, Any]:
    return event("RobotJoined", at_s * S, robot="robot/A1", role="A", domain="", supervisor=supervisor)


@pytest.mark.parametrize(
    ("again", "not_observed"),
    [
        ("supervisor/A1", None),
        ("supervisor/B1", "who supervised a robot before it joined again"),
        (None, "who supervised a robot before it joined again"),
    ],
)
def test_a_robot_that_joins_again_under_another_supervisor_does_not_make_older_records_offences(
    again: str | None, not_observed: str | None
) -> None:
    """Its own supervisor was off shift when it acted, so nobody is missing from that record."""
    named = {"requested_by": "robot/A1", "executed_by": "robot/A1"}
    rows = [
        joined(0, "supervisor/A1"),
        event("SupervisorLeft", S, supervisor="supervisor/A1"),
        event("ExecutionStarted", 2 * S, action_id="t/1", robot="robot/A1", on_behalf_of="robot/A1", **named),
        joined(9, again),
    ]
    for metric in ("audit_attributability", "true_attribution"):
        found = answer(f"metrics/{metric}", run(*rows, **FOREIGN), columns=("value", "not_observed"))
        assert found == [(None, not_observed) if not_observed else (1, None)]
    hidden = answer("facts/unobservable", run(*rows, **FOREIGN), columns=("judge", "not_observed", "hides_offences"))
    for invariant in ("i5_audit_attributability", "a5_audit_completeness"):
        assert ((invariant, not_observed, True) in hidden) == (not_observed is not None)


def test_nobody_is_missing_from_what_was_done_while_a_supervisor_may_have_been_off_shift() -> None:
    named = {"requested_by": "robot/A1", "executed_by": "robot/A1"}
    acted = event("ExecutionStarted", 2 * S, action_id="t/1", robot="robot/A1", on_behalf_of="robot/A1", **named)
    back = event("SupervisorReturned", 3 * S, supervisor="supervisor/A1")
    rows = run(joined(0, "supervisor/A1"), acted, back, **FOREIGN)
    found = answer("metrics/true_attribution", rows, columns=("value", "not_observed"))
    assert found == [(None, "who was off shift before the record")]


def test_a_failure_of_a_simulated_run_that_nobody_resolves_is_not_contained() -> None:
    assert contained() == 0


@pytest.mark.parametrize(
    ("observes", "events", "is_contained"),
    [
        (["execution", "recovery"], (), False),
        (["execution"], (), None),
        (["execution"], (RESOLVED,), True),
        (["execution"], ({**RESOLVED, "level": "fleet"},), False),
    ],
)
def test_a_failure_that_was_not_seen_to_recover_is_neither_contained_nor_not(
    observes: list[str], events: tuple[dict[str, Any], ...], is_contained: bool | None
) -> None:
    rows = run(FAILED, *events, **{**FOREIGN, "observes": observes})
    assert answer("facts/failures", rows, columns=("is_contained",)) == [(is_contained,)]


def test_a_name_that_comes_again_is_another_task_and_each_has_the_end_that_follows_it() -> None:
    given_up, done = event("TaskAbandoned", 5 * S, task_id="t"), event("TaskCompleted", 40 * S, task_id="t")
    again = event("TaskArrived", 20 * S, task_id="t", budget_us=10 * S)
    columns = ("arrived_seq", "ended_us", "is_completed")
    found = answer("facts/late_tasks", run(ARRIVED, given_up, again, done), columns=columns)
    assert found == [(1, 5 * S, False), (3, 40 * S, True)]
    verdicts = answer("facts/verdict_events", run(ARRIVED, again, given_up), columns=("verdict", "seq"))
    assert [verdict for verdict in verdicts if verdict[0] == "late"] == [("late", 1), ("late", 3)]


@pytest.mark.parametrize(
    ("events", "kind", "found"),
    [
        ((ARRIVED, seen_at(9)), "live", [(1, 0)]),
        ((ARRIVED, seen_at(10)), "live", []),
        ((ARRIVED, seen_at(9)), "simulated", []),
        ((ARRIVED, seen_at(9)), "foreign", [(1, 0)]),
        ((FAILED,), "live", [(0, 1)]),
        ((ARRIVED, FAILED), "live", [(1, 1)]),
        ((FAILED, RESOLVED), "live", []),
    ],
)
def test_what_is_open_where_a_record_ends_is_counted(
    events: tuple[dict[str, Any], ...], kind: str, found: list[tuple[int, int]]
) -> None:
    rows = answer("facts/open_work", run(*events, kind=kind), columns=("open_tasks", "open_failures"))
    assert rows == found


def late(*events: dict[str, Any], **started: Any) -> list[Any]:
    return answer("facts/late_tasks", run(*events, **started), columns=("arrived_seq", "held_up_seqs"))


def test_a_task_that_a_recording_stopped_too_early_to_tell_of_is_not_late() -> None:
    again = event("SourceOpened", 9 * S, source="s", format="f", adapter="a", clock="arrival")
    unlimited = event("TaskArrived", S, task_id="u")
    assert late(ARRIVED, unlimited, seen_at(9), **FOREIGN) == []
    assert late(ARRIVED, **FOREIGN) == []
    assert late(seen_at(0), ARRIVED, seen_at(9), again, seen_at(60), **FOREIGN) == []
    assert late(ARRIVED, seen_at(10), again, seen_at(60), **FOREIGN) == [(1, [])]
    assert late(ARRIVED, {**again, "input_sha256": "0" * 64}, seen_at(60), **FOREIGN) == [(1, [])]
    assert late(ARRIVED, seen_at(10), **FOREIGN) == [(1, [])]
    assert late(ARRIVED, seen_at(10), **{**FOREIGN, "observes": [], "records": ["TaskArrived"]}) == []
    assert late(ARRIVED, seen_at(9)) == late(ARRIVED, seen_at(9), kind="live") == [(1, [])]
    cases = answer("facts/metric_cases", run(ARRIVED, unlimited, seen_at(9), **FOREIGN), columns=("numerator",))
    assert cases == [(None,), (None,)]


def test_what_held_up_a_task_is_not_told_of_the_next_one_of_its_name() -> None:
    denied = event("RequestDenied", 2 * S, task_id="t", reason="busy")
    done, again = event("TaskCompleted", 30 * S, task_id="t"), event("TaskArrived", 40 * S, task_id="t", budget_us=S)
    held = event("ExecutionHeld", 41 * S, task_id="t", action_id="t/1", robot="robot/A1")
    given_up = event("TaskAbandoned", 42 * S, task_id="t")
    assert late(ARRIVED, denied, done, again, held, given_up) == [(1, [2]), (4, [5])]
    assert late(ARRIVED, denied, done, again, given_up) == [(1, [2]), (4, [])]


def test_the_verdict_on_a_task_without_a_budget_on_record_names_no_time_at_which_it_was_due() -> None:
    unlimited, given_up = event("TaskArrived", S, task_id="u"), event("TaskAbandoned", 4 * S, task_id="u")
    found = answer("facts/verdict_events", run(unlimited, given_up, **FOREIGN), columns=("verdict", "found"))
    assert found == [("late", "u given up at 4.000 s")]


MIXED_UP = "which task was completed"
DONE = event("TaskCompleted", 3 * S, task_id="t")


def test_what_arrives_twice_or_was_completed_before_is_not_counted_at_random() -> None:
    again = event("TaskArrived", 20 * S, task_id="t", budget_us=10 * S)
    assert success(DONE, again, seen_at(31), **FOREIGN) == MIXED_UP
    assert success(ARRIVED, DONE, **FOREIGN) == MIXED_UP
    other = event("TaskArrived", 5 * S, task_id="u", budget_us=10 * S)
    assert success(DONE, event("TaskCompleted", 4 * S, task_id="u"), other, **FOREIGN) == MIXED_UP
    assert (
        success(DONE, again, event("TaskArrived", 21 * S, task_id="u", budget_us=S), **FOREIGN) == f"{OPEN}, {MIXED_UP}"
    )
    assert success(DONE, event("TaskCompleted", 4 * S, task_id="t"), **FOREIGN) == 1  # it is said twice


def test_a_task_without_a_budget_on_record_is_neither_in_time_nor_late() -> None:
    unknown, done = event("TaskArrived", S, task_id="u"), event("TaskCompleted", 4 * S, task_id="u")
    assert success(DONE, unknown, done, **FOREIGN) == "TaskArrived.budget_us"
    assert success(DONE, unknown, seen_at(9), **FOREIGN) == "TaskArrived.budget_us"
    assert answer("facts/late_tasks", run(ARRIVED, DONE, unknown, done), columns=("task_id",)) == []
    given_up = event("TaskAbandoned", 4 * S, task_id="u")
    assert answer("facts/late_tasks", run(unknown, given_up), columns=("task_id", "due_us")) == [("u", None)]


JOINED = event("RobotJoined", robot="robot/A1", role="carrier", supervisor="supervisor/own")


def called(*supervisors: str | None, **started: Any) -> Any:
    calls = [event("SupervisorCalled", S, supervisor=one, purpose="review") for one in supervisors]
    [[numerator, not_observed]] = answer(
        "metrics/human_intervention", run(JOINED, *calls, **started), columns=("numerator", "not_observed")
    )
    return not_observed or numerator


def test_a_call_of_somebody_who_supervises_no_robot_may_be_a_call_of_the_fleets_supervisor() -> None:
    assert called("supervisor/anna", **FOREIGN) == "who supervises the fleet"
    assert called(None, **FOREIGN) == "who supervises the fleet"
    assert called("supervisor/anna") == 0  # in our own runs the fleet's supervisor has one name
    assert called("supervisor/own", **FOREIGN) == 0
    assert called("supervisor/anna", "supervisor/fleet", **FOREIGN) == 1
    assert called(**FOREIGN) == 0
