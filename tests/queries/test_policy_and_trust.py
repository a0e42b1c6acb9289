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


def responded(time_us: int, purpose: str = "review", action_id: str = "t1/1", approves: bool | None = None) -> Row:
    return event("SupervisorResponded", time_us, purpose=purpose, action_id=action_id, approves=approves)


def violations(*events: Row) -> int:
    return measured("policy_violations", *events)[0]


MANY = (
    opened(1),
    opened(1, window="w2"),
    opened(1, robot="robot/A1", window="w3"),
    opened(1, scope="fleet", window="w4"),
)
REVIEW = opened(1, "review")
VIOLATIONS: dict[str, tuple[tuple[tuple[Row, ...], int], ...]] = {
    "a window holds from its opening until its closing, at one time in the order of the log": (
        ((started(10), opened(10)), 0),
        ((opened(10), started(10)), 1),
        ((opened(10), started(20), closed(20)), 1),
        ((opened(10), closed(20), started(20)), 0),
    ),
    "a window that never closes holds for ever": (((opened(10), started(10**9)), 1),),
    "a window of no duration never held": (((opened(10), closed(10), started(10)), 0),),
    "own policy of executor and requester and the fleet rule of the executor count": (
        ((opened(1, robot="robot/B1"), started(2)), 1),
        ((opened(1, robot="robot/A1"), started(2)), 1),
        ((opened(1, robot="robot/B1", scope="fleet"), started(2)), 1),
    ),
    "the fleet rule of the requester and the policy of others do not count": (
        ((opened(1, robot="robot/A1", scope="fleet"), started(2)), 0),
        ((opened(1, robot="robot/C1"), started(2)), 0),
    ),
    "one execution is one violation however many windows are open": (
        ((*MANY, started(2)), 1),
        ((*MANY, started(2), started(3)), 2),
    ),
    "a window that closed hides no other that is open": (
        ((opened(1), opened(2, window="w2"), closed(3), started(4)), 1),
    ),
    "the first closing of a window counts": (((opened(1), closed(3), started(4), closed(5)), 0),),
    "a review with an earlier approval of the same action is none": (((REVIEW, responded(2), started(3)), 0),),
    "the last answer before the start counts": (
        ((REVIEW, responded(2), started(3), responded(4, approves=False)), 0),
        ((REVIEW, responded(2, approves=True), responded(3, approves=False), started(4)), 1),
        ((REVIEW, responded(2, approves=False), responded(3, approves=True), started(4)), 0),
    ),
    "a review without approval is one": (((REVIEW, started(3)), 1),),
    "a review that was approved too late is one": (((REVIEW, started(3), responded(3)), 1),),
    "the approval of another action is none": (((REVIEW, responded(2, action_id="t1/2"), started(3)), 1),),
    "the decision of another matter is no approval": (((REVIEW, responded(2, purpose="recovery"), started(3)), 1),),
    "an approval does not lift a denial": (
        ((opened(1, "deny"), responded(2), started(3)), 1),
        ((REVIEW, opened(1, "deny", window="w2"), responded(2), started(3)), 1),
    ),
    "motion in a window is one and sensing is none": (
        ((opened(1), performed(2)), 1),
        ((opened(1, "review", scope="fleet"), performed(2)), 1),
        ((opened(1), performed(2, "sensing")), 0),
        ((opened(1, robot="robot/A1"), performed(2)), 0),
    ),
}


@pytest.mark.parametrize("name", VIOLATIONS)
def test_what_starts_in_a_window_is_a_violation(name: str) -> None:
    for events, count in VIOLATIONS[name]:
        assert violations(*events) == count


def test_a_run_without_starts_has_no_violations() -> None:
    assert measured("policy_violations", opened(1)) == (0, 1, 0.0)


def test_governed_starts_show_the_true_policy_and_the_approval() -> None:
    rows = answer(
        "facts/governed_starts",
        run(opened(1, "review"), responded(2), started(3), closed(4), started(5, action_id="t1/2"), performed(6)),
        columns=("started_us", "outcome", "is_approved", "is_violation"),
    )
    assert rows == [(3, "review", True, False), (5, "allow", False, False), (6, "allow", False, False)]


@pytest.mark.parametrize(
    ("events", "periods"),
    [
        (
            (REVIEW, opened(2, "deny", window="w2"), closed(3, window="w2"), closed(4)),
            [(1, 2, "review"), (2, 3, "deny"), (3, 4, "review"), (4, None, "allow")],
        ),
        ((opened(1), closed(2), opened(2, "review", window="w2")), [(1, 2, "deny"), (2, None, "review")]),
        (
            (opened(1), opened(1, window="w2"), closed(2), closed(3, window="w2")),
            [(1, 2, "deny"), (2, 3, "deny"), (3, None, "allow")],
        ),
    ],
    ids=["at every time", "at one moment after all of its edges", "of two that open together"],
)
def test_policy_in_force_is_the_strictest_of_the_open_windows(events: tuple[Row, ...], periods: list[object]) -> None:
    assert answer("facts/policy_in_force", run(*events), columns=("since_us", "until_us", "outcome")) == periods


def test_policy_windows_pair_each_opening_with_its_closing() -> None:
    rows = answer(
        "facts/policy_windows",
        run(opened(1), opened(2, window="w2"), closed(3)),
        columns=("opened_us", "closed_us", "window_name"),
    )
    assert rows == [(1, 3, "w1"), (2, None, "w2")]


@pytest.mark.parametrize(
    ("events", "pairs"),
    [
        ((opened(1), closed(2), opened(4), closed(5)), [(1, 2), (4, 5)]),
        ((opened(1), closed(2), opened(4)), [(1, 2), (4, None)]),
        ((opened(1), opened(2, "review"), closed(3)), [(1, 3), (2, 3)]),
    ],
    ids=["that opens again", "that stays open then", "that opens twice before it closes"],
)
def test_a_window_ends_with_the_first_closing_after_it(events: tuple[Row, ...], pairs: list[object]) -> None:
    assert answer("facts/policy_windows", run(*events), columns=("opened_us", "closed_us")) == pairs


def test_trust_in_force_changes_where_it_is_set() -> None:
    def trust(time_us: int, scope: str) -> Row:
        return event("TrustSet", time_us, robot="robot/B1", peer="robot/A1", scope=scope)

    rows = answer(
        "facts/trust_in_force",
        run(trust(0, "task"), trust(5, "none"), trust(5, "session")),
        columns=("since_us", "until_us", "trust_scope"),
    )
    assert rows == [(0, 5, "task"), (5, None, "session")]
