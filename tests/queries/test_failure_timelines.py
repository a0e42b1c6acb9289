"""The timeline of a failure, told level by level: given rows, expected rows."""

from typing import Any

import pytest

from tests.queries.histories import Row, S, act, answer, event, run
from tests.queries.test_audit_questions import asked
from tests.queries.test_timelines import B, C, about, failed


def step(name: str, time_us: int, level: str | None = None, **fields: Any) -> Row:
    return event(name, time_us, **about(by=B, robot=B, failure=1, level=level, failed_action="t1/1.1"), **fields)


def ended(time_us: int, number: int, result: str, *achieved: str) -> Row:
    return act(
        "RecoveryAttemptFailed",
        time_us,
        "t1/1.1",
        robot=B,
        failure=1,
        number=number,
        result=result,
        achieved=list(achieved),
    )


CALLED = act("SupervisorCalled", 50 * S, "t1/1.1", supervisor="supervisor/fleet", purpose="recovery")
RESOLVED = act("FailureResolved", 80 * S, "t1/1.1", robot=B, failure=1, level="human")
TO_THE_END = (
    failed(10 * S),
    step("RecoveryAttempted", 11 * S, "local", number=1, deadline_us=40 * S),
    ended(20 * S, 1, "partial", "gripped"),
    step("RecoveryAttempted", 20 * S, "local", number=2, deadline_us=40 * S),
    ended(30 * S, 2, "failure"),
    step("RecoveryEscalated", 30 * S, "local", to_level="peer", reason="budget exhausted"),
    event("RegistryQueried", 31 * S, **about(), capability="grasp.*", candidates=[], rejected=[], rejected_by=[]),
    step("RecoveryEscalated", 31 * S, "peer", to_level="fleet", reason="no capable peer"),
    event("ReassignmentDecided", 50 * S, **about(by="service/recovery"), robot=B, failure=1, reason="no checkpoint"),
    step("RecoveryEscalated", 50 * S, "fleet", to_level="human"),
    CALLED,
    RESOLVED,
)


def test_a_failure_is_told_level_by_level_with_results_reasons_and_times() -> None:
    assert asked("failure_timeline", "level what result spent_s", *TO_THE_END) == [
        ("local", "attempt 1", "partial", 20.0),
        ("local", "attempt 2", "failure", 20.0),
        ("local", "leaves local for peer", "budget exhausted", 20.0),
        ("peer", "asks the registry for grasp.*", "no peer", 1.0),
        ("peer", "leaves peer for fleet", "no capable peer", 1.0),
        ("fleet", "evaluates reassignment", "infeasible: no checkpoint", 19.0),
        ("fleet", "leaves fleet for human", None, 19.0),
        ("human", "asks supervisor/fleet", "resolved", 30.0),
        ("human", "resolved", None, 30.0),
    ]
    found = asked("failure_timeline", "step achieved budget_s until_s", *TO_THE_END)[:2]
    assert found == [(1, "gripped", 30.0, 20.0), (2, None, 30.0, 30.0)]


@pytest.mark.parametrize("is_resolved", [False, True])
def test_a_call_is_a_step_of_the_last_failure_alone(is_resolved: bool) -> None:
    first, later = failed(10 * S), {**failed(50 * S), "failure": 2}
    resolved = [{**RESOLVED, "time_us": 50 * S}] if is_resolved else []
    answers = asked("failure_timeline", "failure what", first, *resolved, later, CALLED)
    assert answers == [*([(1, "resolved")] if is_resolved else []), (2, "asks supervisor/fleet")]


def test_the_last_attempt_succeeded_when_the_failure_is_resolved_after_it_and_is_open_otherwise() -> None:
    begun = TO_THE_END[:2]
    assert asked("failure_timeline", "result", *begun) == [(None,)]
    resolved = {**RESOLVED, "level": "local", "time_us": 12 * S}
    found = asked("failure_timeline", "what result spent_s", *begun, resolved)
    assert found == [("attempt 1", "success", 2.0), ("resolved", None, 2.0)]


def test_a_helper_helped_or_declined_and_a_reassignment_names_its_checkpoint() -> None:
    helped = step("AssistanceRequested", 31 * S, "peer", helper=C)
    resolved = {**RESOLVED, "level": "peer"}
    found = asked("failure_timeline", "what result", failed(10 * S), helped, resolved)[0]
    assert found == (f"asks {C} for help", "helped")
    busy = act("AssistanceDeclined", 32 * S, "t1/1.1", robot=B, helper=C, failure=1)
    assert asked("failure_timeline", "result", failed(10 * S), helped, busy, resolved)[0] == ("declined",)
    moved = event(
        "ReassignmentDecided", 50 * S, **about(by="service/recovery"), robot=B, failure=1, helper=C, checkpoint="t1/1"
    )
    assert asked("failure_timeline", "result", failed(10 * S), moved, resolved)[0] == (f"to {C} from t1/1",)


def test_nobody_is_credited_with_what_another_level_resolved() -> None:
    helped = step("AssistanceRequested", 31 * S, "peer", helper=C)
    for last in (TO_THE_END[1], helped):
        assert asked("failure_timeline", "result", failed(10 * S), last, RESOLVED) == [(None,), (None,)]


def test_each_failure_of_an_action_has_its_own_timeline() -> None:
    second = {**step("RecoveryAttempted", 91 * S, "local", number=1, deadline_us=120 * S), "failure": 2}
    rows = asked("failure_timeline", "failure step what", *TO_THE_END, failed(90 * S, 2), second)
    assert [row for row in rows if row[0] == 2] == [(2, 1, "attempt 1")]
    assert len(rows) == 10


def test_only_the_last_call_resolved_the_failure() -> None:
    first = {**CALLED, "time_us": 40 * S}
    assert asked("failure_timeline", "what result", failed(10 * S), first, CALLED, RESOLVED) == [
        ("asks supervisor/fleet", None),
        ("asks supervisor/fleet", "resolved"),
        ("resolved", None),
    ]


def test_a_helper_that_is_asked_twice_gives_each_question_its_own_answer() -> None:
    asks = [step("AssistanceRequested", at * S, "peer", helper=C) for at in (31, 41)]
    busy = act("AssistanceDeclined", 32 * S, "t1/1.1", robot=B, helper=C, failure=1)
    broken = act("AssistanceFailed", 45 * S, "t1/1.1", robot=B, helper=C, failure=1, cause="obstruction")
    assert asked("failure_timeline", "what result", failed(10 * S), asks[0], busy, asks[1], broken) == [
        (f"asks {C} for help", "declined"),
        (f"asks {C} for help", "no help: obstruction"),
    ]


def test_what_recovery_did_is_told_the_same_where_nobody_recorded_the_failure() -> None:
    helped = (step("AssistanceRequested", 31 * S, "peer", helper=C), {**RESOLVED, "level": "peer"})
    for recovery in (TO_THE_END[1:], (*TO_THE_END[1:6], *helped), TO_THE_END[1:4]):
        columns = "level to_level step what result achieved time_s until_s decided_by"
        known = asked("failure_timeline", columns, failed(10 * S), *recovery)
        assert asked("failure_timeline", columns, *recovery) == known
    results = "level what result spent_s budget_s"
    assert asked("failure_timeline", results, *TO_THE_END[1:]) == [
        ("local", "attempt 1", "partial", None, None),
        ("local", "attempt 2", "failure", None, None),
        ("local", "leaves local for peer", "budget exhausted", None, None),
        ("peer", "asks the registry for grasp.*", "no peer", 1.0, None),
        ("peer", "leaves peer for fleet", "no capable peer", 1.0, None),
        ("fleet", "evaluates reassignment", "infeasible: no checkpoint", 19.0, None),
        ("fleet", "leaves fleet for human", None, 19.0, None),
        ("human", "asks supervisor/fleet", "resolved", 30.0, None),
        ("human", "resolved", None, 30.0, None),
    ]


@pytest.mark.parametrize(("records", "open_s"), [([], None), (["FailureResolved"], 0.0)])
def test_the_time_at_the_last_level_is_unknown_where_nobody_records_that_failures_are_resolved(
    records: list[str], open_s: float | None
) -> None:
    for steps, spent in ((TO_THE_END[:-1], open_s), (TO_THE_END, 30.0)):
        rows = run(*steps, kind="foreign", observes=[], records=["ExecutionFailed", *records])
        found = dict(answer("audit/failure_timeline", rows, columns=("level", "spent_s")))
        assert found == {"local": 20.0, "peer": 1.0, "fleet": 19.0, "human": spent}
