"""Windows, the policy in force, violations and trust: half-open in time."""

import pytest

from tests.queries.histories import Row, answer, event, measured, run


def opened(
    time_us: int, outcome: str = "deny", robot: str = "robot/B1", scope: str = "local", window: str = "w1"
) -> Row:
    return event("PolicyWindowOpened", time_us, robot=robot, scope=scope, window=window, outcome=outcome)


def closed(time_us: int, robot: str = "robot/B1", scope: str = "local", window: str = "w1") -> Row:
    return event("PolicyWindowClosed", time_us, robot=robot, scope=scope, window=window)


def started(time_us: int, robot: str = "robot/B1", on_behalf_of: str = "robot/A1", action_id: str = "t1/1") -> Row:
    return event(
        "ExecutionStarted", time_us, robot=robot, on_behalf_of=on_behalf_of, action_id=action_id, ends_us=time_us + 5
    )


def performed(time_us: int, operation: str = "motion", robot: str = "robot/B1") -> Row:
    return event("RoutinePerformed", time_us, robot=robot, operation=operation)


def responded(time_us: int, purpose: str = "review", action_id: str = "t1/1") -> Row:
    return event("SupervisorResponded", time_us, purpose=purpose, action_id=action_id)


def violations(*events: Row) -> int:
    return measured("policy_violations", *events)[0]


@pytest.mark.parametrize(("time_us", "count"), [(9, 0), (10, 1), (19, 1), (20, 0), (21, 0)])
def test_a_window_holds_from_its_opening_until_just_before_its_closing(time_us: int, count: int) -> None:
    assert violations(opened(10), started(time_us), closed(20)) == count


def test_a_window_that_never_closes_holds_for_ever() -> None:
    assert violations(opened(10), started(10**9)) == 1


def test_a_window_of_no_duration_never_held() -> None:
    assert violations(opened(10), closed(10), started(10)) == 0


def test_own_policy_of_executor_and_requester_and_the_fleet_rule_of_the_executor_count() -> None:
    assert violations(opened(1, robot="robot/B1"), started(2)) == 1
    assert violations(opened(1, robot="robot/A1"), started(2)) == 1
    assert violations(opened(1, robot="robot/B1", scope="fleet"), started(2)) == 1


def test_the_fleet_rule_of_the_requester_and_the_policy_of_others_do_not_count() -> None:
    assert violations(opened(1, robot="robot/A1", scope="fleet"), started(2)) == 0
    assert violations(opened(1, robot="robot/C1"), started(2)) == 0


def test_one_execution_is_one_violation_however_many_windows_are_open() -> None:
    windows = [
        opened(1),
        opened(1, window="w2"),
        opened(1, robot="robot/A1", window="w3"),
        opened(1, scope="fleet", window="w4"),
    ]
    assert violations(*windows, started(2)) == 1
    assert violations(*windows, started(2), started(3)) == 2


def test_a_window_that_closed_hides_no_other_that_is_open() -> None:
    assert violations(opened(1), opened(2, window="w2"), closed(3), started(4)) == 1


def test_a_review_with_an_earlier_approval_of_the_same_action_is_no_violation() -> None:
    assert violations(opened(1, "review"), responded(2), started(3)) == 0


def test_the_first_approval_of_an_action_counts() -> None:
    assert violations(opened(1, "review"), responded(2), started(3), responded(4)) == 0


def test_a_review_without_approval_is_a_violation() -> None:
    assert violations(opened(1, "review"), started(3)) == 1
    assert violations(opened(1, "review"), started(3), responded(3)) == 1, "approved too late"
    assert violations(opened(1, "review"), responded(2, action_id="t1/2"), started(3)) == 1, (
        "another action was approved"
    )
    assert violations(opened(1, "review"), responded(2, purpose="recovery"), started(3)) == 1, (
        "another matter was decided"
    )


def test_an_approval_does_not_lift_a_denial() -> None:
    assert violations(opened(1, "deny"), responded(2), started(3)) == 1
    assert violations(opened(1, "review"), opened(1, "deny", window="w2"), responded(2), started(3)) == 1


def test_motion_in_a_window_is_a_violation_and_sensing_is_not() -> None:
    assert violations(opened(1), performed(2)) == 1
    assert violations(opened(1, "review", scope="fleet"), performed(2)) == 1
    assert violations(opened(1), performed(2, "sensing")) == 0
    assert violations(opened(1, robot="robot/A1"), performed(2)) == 0


def test_a_run_without_starts_has_no_violations() -> None:
    assert measured("policy_violations", opened(1)) == (0, 1, 0.0)


def test_governed_starts_show_the_true_policy_and_the_approval() -> None:
    rows = answer(
        "facts/governed_starts",
        run(opened(1, "review"), responded(2), started(3), closed(4), started(5, action_id="t1/2"), performed(6)),
        columns=("started_us", "outcome", "is_approved", "is_violation"),
    )
    assert rows == [(3, "review", True, False), (5, "allow", False, False), (6, "allow", False, False)]


def test_policy_in_force_is_the_strictest_of_the_open_windows() -> None:
    rows = answer(
        "facts/policy_in_force",
        run(opened(1, "review"), opened(2, "deny", window="w2"), closed(3, window="w2"), closed(4)),
        columns=("since_us", "until_us", "outcome"),
    )
    assert rows == [(1, 2, "review"), (2, 3, "deny"), (3, 4, "review"), (4, None, "allow")]


def test_policy_in_force_at_one_moment_is_what_holds_after_all_of_its_edges() -> None:
    rows = answer(
        "facts/policy_in_force",
        run(opened(1), closed(2), opened(2, "review", window="w2")),
        columns=("since_us", "until_us", "outcome"),
    )
    assert rows == [(1, 2, "deny"), (2, None, "review")]


def test_two_windows_that_open_together_are_two() -> None:
    rows = answer(
        "facts/policy_in_force",
        run(opened(1), opened(1, window="w2"), closed(2), closed(3, window="w2")),
        columns=("since_us", "outcome"),
    )
    assert rows == [(1, "deny"), (2, "deny"), (3, "allow")]


def test_the_first_closing_of_a_window_counts() -> None:
    assert violations(opened(1), closed(3), started(4), closed(5)) == 0


def test_policy_windows_pair_each_opening_with_its_closing() -> None:
    rows = answer(
        "facts/policy_windows",
        run(opened(1), opened(2, window="w2"), closed(3)),
        columns=("opened_us", "closed_us", "window_name"),
    )
    assert rows == [(1, 3, "w1"), (2, None, "w2")]


def test_trust_in_force_changes_where_it_is_set() -> None:
    def trust(time_us: int, scope: str) -> Row:
        return event("TrustSet", time_us, robot="robot/B1", peer="robot/A1", scope=scope)

    rows = answer(
        "facts/trust_in_force",
        run(trust(0, "task"), trust(5, "none"), trust(5, "session")),
        columns=("since_us", "until_us", "trust_scope"),
    )
    assert rows == [(0, 5, "task"), (5, None, "session")]
