"""Given rows, expect rows: levels of recovery, why each was left, and what was used of each budget."""

from typing import Any

import pytest

from tests.queries.histories import Row, S, answer, event, run

BUDGETS = (
    '{"structure": {"local_budget_us": 30, "local_attempts": 2, "peer_budget_us": 20, "peer_helpers": 1, '
    '"human_budget_us": 90, "human_calls": 2}}'
)


def failure(name: str, time_us: int, /, **fields: Any) -> Row:
    """An event of failure 1 of action t1/1."""
    about = {"robot": "robot/D1", "failure": 1, **fields}
    is_named_by_failed_action = name in ("RecoveryAttempted", "RecoveryEscalated", "AssistanceRequested")
    return event(name, time_us, **about, **{"failed_action" if is_named_by_failed_action else "action_id": "t1/1"})


FAILED = failure("ExecutionFailed", 10, cause="degradation")
LADDER = (
    FAILED,
    failure("RecoveryAttempted", 11, level="local", number=1, deadline_us=40),
    failure("RecoveryAttemptFailed", 15, number=1, result="partial"),
    failure("RecoveryAttempted", 15, level="local", number=2, deadline_us=40),
    failure("RecoveryEscalated", 20, level="local", to_level="peer", reason="budget exhausted"),
    failure("RecoveryEscalated", 21, level="peer", to_level="fleet", reason="no capable peer"),
    failure("ReassignmentDecided", 23, reason="no checkpoint"),
    failure("RecoveryEscalated", 23, level="fleet", to_level="human", reason="no feasible reassignment: no checkpoint"),
    event("SupervisorCalled", 23, action_id="t1/1", purpose="recovery", supervisor="supervisor/D1"),
    event("SupervisorResponded", 63, action_id="t1/1", purpose="recovery", decided_by="supervisor/D1"),
    failure("FailureResolved", 63, level="human"),
)
HELPED = (
    *LADDER[:5],
    failure("AssistanceRequested", 22, level="peer", helper="robot/A1"),
    failure("AssistanceAdmitted", 22, level="peer", helper="robot/A1"),
)
BY_PEER, BY_ROBOT = failure("FailureResolved", 28, level="peer"), failure("FailureResolved", 13, level="local")
AT_ONCE = (FAILED, failure("RecoveryEscalated", 11, level="local", to_level="peer", reason="budget exhausted"))


def asked(name: str, columns: str, *events: Row) -> list[tuple[Any, ...]]:
    return answer(name, run(*events, parameters=BUDGETS), columns=columns.split())


def test_each_move_says_why_the_level_before_was_left() -> None:
    assert asked("recovery_moves", "from_level level reason", *LADDER) == [
        (None, "local", None),
        ("local", "peer", "budget exhausted"),
        ("peer", "fleet", "no capable peer"),
        ("fleet", "human", "no feasible reassignment: no checkpoint"),
    ]
    found = [because for (because,) in asked("recovery_time", "left_because", *LADDER)]
    assert found == ["budget exhausted", "no capable peer", "no feasible reassignment: no checkpoint", None]


def test_a_level_that_was_left_at_once_was_not_skipped() -> None:
    assert asked("recovery_moves", "from_level level reason", *AT_ONCE) == [("local", "peer", "budget exhausted")]
    assert asked("skipped_levels", "from_level to_level", *AT_ONCE) == []
    assert asked("i4_outward_recovery", "found", *AT_ONCE) == []


def test_a_skipped_level_is_named_with_the_reason_that_was_given() -> None:
    skipping = failure("RecoveryEscalated", 11, level="local", to_level="human", reason="no layered recovery")
    assert asked("skipped_levels", "from_level to_level skipped reason", FAILED, skipping) == [
        ("local", "human", ["peer", "fleet"], "no layered recovery")
    ]


def test_the_use_of_each_budget_stands_beside_it() -> None:
    assert asked("recovery_budgets", "level spent_us t_max_us used n_max set_by", *LADDER) == [
        ("local", 10, 30, 2, 2, None),
        ("peer", 1, 20, 0, 1, None),
        ("fleet", 2, None, 0, None, None),
        ("human", 40, 90, 1, 2, None),
    ]


@pytest.mark.parametrize("is_resolved", [False, True])
def test_a_call_is_no_use_of_the_budget_of_an_earlier_failure(is_resolved: bool) -> None:
    to_human = failure("RecoveryEscalated", 11, level="local", to_level="human")
    call = event("SupervisorCalled", 11, action_id="t1/1", purpose="recovery", supervisor="supervisor/D1")
    again = [*({**row, "time_us": 20, "failure": 2} for row in (FAILED, to_human)), {**call, "time_us": 20}]
    resolved = [failure("FailureResolved", 20, level="human")] if is_resolved else []
    assert asked("recovery_budgets", "failure level used", FAILED, to_human, call, *resolved, *again) == [
        (1, "human", 1),
        (2, "human", 1),
    ]


def test_a_budget_counts_from_the_moment_in_which_it_was_set() -> None:
    def budget(n_max: int, **fields: Any) -> Row:
        of_robot = {"robot": "robot/D1", "level": "local", "decided_by": "supervisor/D1", **fields}
        return event("RecoveryBudgetSet", 5, t_max_us=7, n_max=n_max, **of_robot)

    columns, spent = "level t_max_us n_max set_by", [("peer", 20, 1, None)]
    before = (budget(5), budget(1), *LADDER[:5])
    assert asked("recovery_budgets", columns, *before) == [("local", 7, 1, "supervisor/D1"), *spent]
    assert asked("recovery_budgets", columns, *LADDER[:5], budget(1)) == [("local", 30, 2, None), *spent]
    found = asked("recovery_budgets", columns, budget(1, robot="robot/A1"), *LADDER[:5])
    assert found == [("local", 30, 2, None), *spent]


@pytest.mark.parametrize(
    ("events", "found"),
    [
        (LADDER, []),
        (
            (*LADDER[:2], failure("RecoveryAttempted", 41, level="local", number=2, deadline_us=40)),
            ["an attempt begins after the time budget of its level"],
        ),
        (
            (*LADDER[:5], failure("ReassignmentDecided", 22, helper="robot/A1")),
            ["recovery acts at level fleet while it is at peer"],
        ),
        ((*LADDER, failure("ReassignmentDecided", 64)), ["recovery goes on after the failure is resolved"]),
        ((*LADDER[:9], *LADDER[8:]), []),
        ((*LADDER[:9], LADDER[8], *LADDER[8:]), ["use 3 of level human, which has a budget of 2"]),
        (LADDER[:9] + LADDER[10:], ["resolved at level human, where nothing was done"]),
        ((*HELPED, failure("AssistanceEnded", 27, helper="robot/A1"), BY_PEER), []),
        (
            (*HELPED, failure("AssistanceFailed", 27, helper="robot/A1", cause="obstruction"), BY_PEER),
            ["resolved at level peer, where nothing was done"],
        ),
        (
            (*LADDER[:2], failure("RecoveryAttemptFailed", 12, number=1), BY_ROBOT),
            ["resolved at level local, where nothing was done"],
        ),
        ((*LADDER[:2], BY_ROBOT), []),
        ((*LADDER[:5], failure("AssistanceRequested", 40, level="peer", helper="robot/A1")), []),
        (
            (*LADDER[:5], failure("AssistanceRequested", 41, level="peer", helper="robot/A1")),
            ["recovery acts after the time budget of its level"],
        ),
        (
            (*LADDER[:5], failure("AssistanceAdmitted", 22, level="peer", helper="robot/A1")),
            ["help by robot/A1, who had not been asked"],
        ),
        (
            (*LADDER[:5], failure("RecoveryEscalated", 41, level="peer", to_level="fleet")),
            ["recovery stays at level peer after the time budget of its level"],
        ),
        (
            (*LADDER[:5], failure("RecoveryEscalated", 41, level="peer", to_level="fleet", reason="budget exhausted")),
            [],
        ),
    ],
)
def test_recovery_that_overruns_or_forestalls_a_level_breaks_i4(events: tuple[Row, ...], found: list[str]) -> None:
    assert [text.removeprefix("failure 1: ") for (text,) in asked("i4_outward_recovery", "found", *events)] == found


def test_only_a_call_of_the_fleets_supervisor_is_human_intervention() -> None:
    def intervention(supervisor: str) -> list[tuple[Any, ...]]:
        called = event("SupervisorCalled", 23 * S, action_id="t1/1", purpose="recovery", supervisor=supervisor)
        return asked("metrics/human_intervention", "value", called)

    assert (intervention("supervisor/D1"), intervention("supervisor/fleet")) == ([(0.0,)], [(1.0,)])


def test_what_a_failure_used_is_its_own_however_often_recovery_turned_to_the_level() -> None:
    again = (failure("ExecutionFailed", 30, failure=2), failure("RecoveryAttempted", 31, level="local", failure=2))
    columns = "failure level used spent_us"
    assert asked("recovery_budgets", columns, *LADDER[:2], BY_ROBOT, *again) == [
        (1, "local", 1, 3),
        (2, "local", 1, None),
    ]
    back = failure("RecoveryEscalated", 25, level="peer", to_level="local")
    found = asked("recovery_budgets", columns, *LADDER[:5], back, failure("FailureResolved", 28, level="local"))
    assert found == [(1, "local", 2, 13), (1, "peer", 0, 5)]


def test_a_failure_of_which_only_its_recovery_is_told_is_told_without_the_time_of_its_detection() -> None:
    begun = failure("ExecutionFailed", 11, cause="degradation")
    columns = "level spent_us t_max_us used n_max"
    known = asked("recovery_budgets", columns, begun, *LADDER[1:])
    assert known[0] == ("local", 9, 30, 2, 2)
    assert asked("recovery_budgets", columns, *LADDER[1:]) == [("local", None, 30, 2, 2), *known[1:]]
    columns = "level entered_us left_us spent_us attempts is_resolved_here left_because"
    known = asked("recovery_time", columns, begun, *LADDER[1:])
    assert known[0] == ("local", 11, 20, 9, 2, False, "budget exhausted")
    assert asked("recovery_time", columns, *LADDER[1:]) == [
        ("local", None, 20, None, 2, False, "budget exhausted"),
        *known[1:],
    ]
    assert asked("recovery_budgets", "level spent_us", *AT_ONCE[1:], BY_PEER) == [("peer", 17)]
    moved = failure("ReassignmentDecided", 23, helper="robot/A1")
    assert asked("recovery_budgets", "level used", *LADDER[1:6], moved)[-1] == ("fleet", 1)
    assert asked("recovery_time", "level is_resolved_here", *LADDER[1:2], BY_ROBOT) == [("local", True)]


def test_no_use_no_attempt_and_no_end_on_record_is_unknown_where_the_run_does_not_observe_recovery() -> None:
    begun = run(*LADDER[:5], observes=[], parameters=BUDGETS)
    used, columns = ("level", "used"), ("level", "attempts", "is_resolved_here")
    assert answer("recovery_budgets", begun, columns=used) == [("local", 2), ("peer", None)]
    assert answer("recovery_time", begun, columns=columns) == [("local", 2, False), ("peer", None, None)]
    assert asked("recovery_budgets", "level used", *LADDER[:5]) == [("local", 2), ("peer", 0)]
    assert asked("recovery_time", "level attempts is_resolved_here", *LADDER[:5]) == [
        ("local", 2, False),
        ("peer", 0, False),
    ]


def test_how_long_a_level_took_is_unknown_where_the_move_that_began_or_ended_it_is_not_recorded() -> None:
    def stays(*events: Row, records: tuple[str, ...]) -> dict[str, tuple[Any, ...]]:
        rows = run(*events, kind="foreign", observes=[], records=list(records))
        spent = dict(answer("recovery_budgets", rows, columns=("level", "spent_us")))
        named = dict(answer("failure_timeline", rows, columns=("level", "spent_s")))
        times = answer("recovery_time", rows, columns=("level", "entered_us", "left_us", "spent_us"))
        assert {level: own for level, *_, own in times} == spent
        return {level: (entered, left, named[level]) for level, entered, left, _ in times}

    attempt, to_human, end = LADDER[1], failure("RecoveryEscalated", 20, level="local", to_level="human"), LADDER[-1]
    ends = ("ExecutionFailed", "FailureResolved")
    assert stays(FAILED, attempt, end, records=(*ends, "RecoveryAttempted")) == {
        "local": (10, None, None),
        "human": (None, 63, None),
    }
    assert stays(FAILED, to_human, end, records=(*ends, "RecoveryEscalated")) == {"human": (20, 63, 43e-6)}
    assert stays(FAILED, end, records=ends) == {"human": (None, 63, None)}
    assert stays(FAILED, BY_ROBOT, records=ends) == {"local": (10, 13, 3e-6)}
    assert stays(FAILED, attempt, to_human, end, records=(*ends, "RecoveryAttempted", "RecoveryEscalated")) == {
        "local": (10, 20, 10e-6),
        "human": (20, 63, 43e-6),
    }
