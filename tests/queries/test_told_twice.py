"""What a record tells twice, or at the same moment, is no second offence and no other one."""

from typing import Any

from fsar_ledger.metrics.library import library
from tests.queries.histories import Row, S, act, answer, event, run
from tests.queries.keys import broken_keys
from tests.recycled import from_rows

ROBOT = "robot/A1"


def about(name: str, time_us: int, /, **fields: Any) -> Row:
    """One event of the recovery of A1's first failure of an action."""
    return act(name, time_us, "t1/1", robot=ROBOT, failed_action="t1/1", failure=1, **fields)


def test_a_failed_attempt_that_is_told_twice_is_one_use_of_the_budget() -> None:
    told = about("RecoveryAttemptFailed", 3 * S, number=1, result="failure")
    attempts = [
        about("RecoveryAttempted", 2 * S, level="local", number=1, deadline_us=9 * S),
        told,
        told,
        about("RecoveryAttempted", 4 * S, level="local", number=2, deadline_us=9 * S),
        about("FailureResolved", 5 * S, level="local"),
    ]
    budget = event("RecoveryBudgetSet", robot=ROBOT, level="local", t_max_us=60 * S, n_max=2)
    history = run(budget, about("ExecutionFailed", 1 * S), *attempts)
    assert answer("invariants/i4_outward_recovery", history) == []
    assert [seq for (seq,) in answer("facts/recovery_acts", history, columns=("seq",))] == [2, 3, 6, 7]
    assert answer(
        "invariants/i4_outward_recovery",
        run({**budget, "n_max": 1}, about("ExecutionFailed", S), *attempts),
        columns=("seq", "found"),
    ) == [(6, "failure 1: use 2 of level local, which has a budget of 1")]


def test_of_claims_made_at_one_moment_the_second_begins_the_conflict() -> None:
    claims = [
        act("AuthorityClaimed", at, "t1/1", dimension="override", claimant=f"robot/{name}1", reason="accepted")
        for at, name in ((0, "A"), (S, "B"), (S, "C"))
    ]
    found = answer("facts/conflicting_claims", run(*claims), columns=("began_us", "seq", "claim_seqs"))
    assert found == [(S, 2, [1, 2, 3])]


def test_an_action_that_competes_with_itself_is_told_once() -> None:
    called = act("SupervisorCalled", S, "t1/1", supervisor="supervisor/fleet", purpose="ordering", competing="t1/1")
    assert len(answer("audit/request_timeline", run(act("StepBegan", 0, "t1/1", robot=ROBOT), called))) == 1


def test_of_an_action_that_a_robot_does_and_helps_with_what_began_last_is_told() -> None:
    starts = act("ExecutionStarted", S, "t1/1", robot=ROBOT, on_behalf_of=ROBOT, capability="lift")
    rows = run(starts, about("AssistanceAdmitted", 2 * S, helper=ROBOT, level="peer"))
    assert answer("audit/robot_activity", rows, columns=("doing", "action_id")) == [("helping", "t1/1")]
    with from_rows(rows) as database:
        assert broken_keys(database, iter([library().relations["robot_activity"]])) == []


def test_a_start_that_breaks_a3_in_two_ways_has_two_rows_that_its_key_tells_apart() -> None:
    acts = [
        act("RequestDenied", S, "t1/1", executed_by=ROBOT, reason="policy"),
        act("ExecutionHeld", S, "t1/1", robot=ROBOT, outcome="deny", reason="local-policy"),
        act("ExecutionStarted", S, "t1/1", robot=ROBOT, on_behalf_of=ROBOT),
    ]
    name = "invariants/a3_no_silent_policy_override"
    with from_rows(run(*acts)) as database:
        assert database.query(name).num_rows == 2
        assert broken_keys(database, iter([library().find(name)])) == []


def test_two_entries_of_initial_trust_about_one_pair_are_told_apart_by_their_place_in_the_run() -> None:
    members = [event("RobotJoined", robot=f"robot/{name}", role="r", team=1, domain="") for name in ("A1", "B1")]
    trusting = event("InitialTrustSet", S, robot=ROBOT, scope="session", is_trusting=True)
    trusted = event("InitialTrustSet", S, robot="robot/B1", scope="task", is_trusting=False)
    rows = run(*members, trusting, trusted)
    assert answer("audit/trust_at", rows, columns=("robot", "peer", "trust_scope", "seq")) == [
        (ROBOT, "robot/B1", "session", 3),
        (ROBOT, "robot/B1", "task", 4),
    ]
    with from_rows(rows) as database:
        assert broken_keys(database, iter([library().relations["trust_at"]])) == []


def test_a_failure_that_is_told_twice_has_a_row_for_each_of_its_records() -> None:
    rows = run(about("ExecutionFailed", S), about("ExecutionFailed", 2 * S))
    assert answer("facts/failures", rows, columns=("seq", "failure")) == [(1, 1), (2, 1)]
    with from_rows(rows) as database:
        assert broken_keys(database, iter([library().relations["failures"]])) == []


def test_a_level_that_recovery_reaches_after_the_resolution_has_no_time_below_zero() -> None:
    moves = [
        about("ExecutionFailed", S),
        about("RecoveryAttempted", 2 * S, level="local", number=1, deadline_us=9 * S),
        about("FailureResolved", 3 * S, level="local"),
        about("RecoveryEscalated", 5 * S, level="local", to_level="peer", reason="no answer"),
    ]
    columns = ("level", "left_us", "spent_us", "is_resolved_here")
    assert answer("audit/recovery_time", run(*moves), columns=columns) == [
        ("local", 5 * S, 4 * S, True),
        ("peer", None, None, False),
    ]
    assert answer("audit/recovery_budgets", run(*moves), columns=("level", "spent_us")) == [
        ("local", 4 * S),
        ("peer", None),
    ]
    assert answer("audit/recovery_time", run(*moves[:3]), columns=columns) == [("local", 3 * S, 2 * S, True)]
