"""Policy rules, refusals and disapprovals: given rows, expected rows."""

from typing import Any

import pytest

from fsar_ledger.events.envelope import POLICY, Supervisor
from fsar_ledger.metrics.invariants import chosen
from tests.queries import test_audit_questions
from tests.queries.histories import Row, act, answer, event, measured, run
from tests.recycled import from_rows
from tests.runtime.governed import H_F

H_B = Supervisor("supervisor/B1")
DOOR = "door.open.secure"
ROBOTS = tuple(
    event("RobotJoined", robot=f"robot/{name}1", role=name, team=1, supervisor=f"supervisor/{name}1") for name in "AB"
)


def rule(
    time_us: int, outcome: str = "deny", robot: str | None = "robot/B1", scope: str = "local", **about: str
) -> Row:
    return event("PolicyRuleSet", time_us, scope=scope, robot=robot, outcome=outcome, decided_by=H_B, **about)


def started(
    time_us: int, capability: str = DOOR, robot: str = "robot/B1", on_behalf_of: str = "robot/A1", **fields: Any
) -> Row:
    about = {"task_id": "t1", "action_id": "t1/1", **fields}
    return event(
        "ExecutionStarted",
        time_us,
        robot=robot,
        on_behalf_of=on_behalf_of,
        capability=capability,
        ends_us=time_us + 5,
        **about,
    )


def motion(time_us: int) -> Row:
    return event("RoutinePerformed", time_us, robot="robot/B1", operation="motion")


def reviewed(time_us: int, approves: bool | None) -> Row:
    return event("SupervisorResponded", time_us, purpose="review", action_id="t1/1", decided_by=H_F, approves=approves)


def admitted(time_us: int) -> Row:
    return act("RequestAdmitted", time_us, "t1/1", outcome="allow", decided_by="robot/B1")


def asked(name: str, columns: str, *events: Row, **given: Any) -> list[tuple[Any, ...]]:
    """These columns of the answer to a question over one run of two robots with these events."""
    return test_audit_questions.asked(name, columns, *ROBOTS, *events, **given)


def violations(*events: Row) -> int:
    return measured("policy_violations", *ROBOTS, *events)[0]


def broken(name: str, *events: Row) -> list[int]:
    """The times at which the invariant is broken by one run of two robots with these events."""
    (query,) = chosen([name])
    with from_rows(run(*ROBOTS, *events)) as database:
        return [row["time_us"] for row in database.rows(f"SELECT time_us FROM {query.relation} ORDER BY ALL")]


def test_a_rule_holds_until_another_about_the_same_replaces_it() -> None:
    rules = (rule(5), rule(7, "review", capability=DOOR), rule(9, "allow"), rule(11, "review"))
    rows = answer(
        "facts/policy_rules", run(*ROBOTS, *rules), columns=("set_us", "until_us", "capability", "outcome", "robot")
    )
    assert rows == [
        (5, 9, None, "deny", "robot/B1"),
        (7, None, DOOR, "review", "robot/B1"),
        (9, 11, None, "allow", "robot/B1"),
        (11, None, None, "review", "robot/B1"),
    ]


def test_a_rule_for_every_robot_is_one_row_for_each() -> None:
    rows = answer("facts/policy_rules", run(*ROBOTS, rule(5, robot=None, scope="fleet")), columns=("robot", "scope"))
    assert rows == [("robot/A1", "fleet"), ("robot/B1", "fleet")]


def test_rules_that_deny_or_ask_for_review_are_windows_and_those_that_allow_are_none() -> None:
    rules = (
        rule(5, capability=DOOR),
        rule(6, "review", context="t1"),
        rule(7, "allow", scope="fleet"),
        rule(9, "allow", capability=DOOR),
    )
    rows = answer(
        "facts/policy_windows",
        run(*ROBOTS, *rules),
        columns=("opened_us", "closed_us", "window_name", "capability", "context", "outcome"),
    )
    assert rows == [(5, 9, None, DOOR, None, "deny"), (6, None, None, None, "t1", "review")]


@pytest.mark.parametrize("joined", [ROBOTS, ()], ids=["joined", "nobody saw them join"])
def test_a_robots_own_rule_holds_for_it_whether_or_not_it_is_known_to_have_joined(joined: tuple[Row, ...]) -> None:
    rules = (rule(1), rule(2, "review", robot=None, scope="fleet"))
    history = run(*joined, *rules, started(3), rule(4, "allow"), started(5))
    rows = answer("facts/governed_starts", history, columns=("outcome", "is_violation", "under_seqs"))
    first = len(joined) + 1
    assert rows == [("deny", True, [first, first + 1]), ("review", True, [first + 1])]
    with from_rows(history) as database:
        (i3,) = chosen(["i3"])
        assert len(database.rows(f"SELECT seq FROM {i3.relation}")) == 1


VIOLATIONS: dict[str, tuple[tuple[tuple[Row, ...], int], ...]] = {
    "from the setting of a rule that denies until its replacement, at one time in the order of the log": (
        ((started(5), rule(5)), 0),
        ((rule(5), started(5)), 1),
        ((rule(5), started(9), rule(9, "allow")), 1),
        ((rule(5), rule(9, "allow"), started(9)), 0),
    ),
    "not under a rule about another capability or task": (
        ((rule(1, capability=DOOR), started(2)), 1),
        ((rule(1, capability="carry.package"), started(2)), 0),
        ((rule(1, context="t1"), started(2)), 1),
        ((rule(1, context="t2"), started(2)), 0),
        ((rule(1, capability=DOOR, context="t2"), started(2)), 0),
    ),
    "of a motion, which is about no capability and no task": (
        ((rule(1), motion(2)), 1),
        ((rule(1, capability=DOOR), motion(2)), 0),
        ((rule(1, context="t1"), motion(2)), 0),
    ),
    "under own rules of executor and requester and fleet rules of the executor": (
        ((rule(1, robot="robot/A1"), started(2)), 1),
        ((rule(1, robot="robot/A1", scope="fleet"), started(2)), 0),
        ((rule(1, scope="fleet"), started(2)), 1),
        ((rule(1, robot=None, scope="fleet"), started(2)), 1),
    ),
    "although another rule allows": (
        ((rule(1), rule(2, "allow", capability=DOOR), started(3)), 1),
        ((rule(1), rule(2, "allow", scope="fleet"), started(3)), 1),
    ),
}


@pytest.mark.parametrize("name", VIOLATIONS)
def test_what_starts_under_a_rule_is_a_violation(name: str) -> None:
    for events, count in VIOLATIONS[name]:
        assert violations(*events) == count


@pytest.mark.parametrize(("approves", "count"), [(True, 0), (None, 0), (False, 1)])
def test_a_disapproval_is_no_approval(approves: bool | None, count: int) -> None:
    history = (rule(1, "review"), reviewed(2, approves), started(3))
    assert violations(*history) == len(broken("a3", *history)) == count
    assert answer("facts/review_answers", run(*history), columns=("is_approved",)) == [(count == 0,)]
    assert len(asked("unapproved_executions", "action_id", *history)) == count


ASKED = act("RequestIssued", 3, "t1/1", capability=DOOR, carried_policy="allow")
REFUSED = act("RequestDenied", 6, "t1/1", executed_by="robot/B1", decided_by="robot/B1", reason="policy")
FLEETS, LIFTED = rule(1, scope="fleet"), rule(3, "allow", scope="fleet")
CARRIED = act("RequestIssued", 1, "t1/1", carried_policy="deny")
OPENED, SHUT = (
    event(f"PolicyWindow{what}", 5, robot="robot/B1", scope="local", window="w1", outcome="deny")
    for what in ("Opened", "Closed")
)
OTHER = {"executed_by": None, "decided_by": "agent/B2/planning"}
HELD = event("ExecutionHeld", 2, robot="robot/B1", action_id="t1/1", outcome="deny")
BROKEN: dict[str, tuple[tuple[str, tuple[Row, ...], list[int]], ...]] = {
    "a start under the robot's own rule is known to be denied": (
        ("i3", (rule(1), started(2)), [2]),
        ("i3", (rule(1, "review"), started(2)), []),
        ("a3", (rule(1, "review"), started(2)), [2]),
        ("i3", (rule(1, capability="carry.package"), started(2)), []),
        ("i3", (rule(1), rule(2, "allow"), started(3)), []),
    ),
    "an approval lifts no denial that is known": (
        *(
            (name, (rule(1, scope=scope), reviewed(2, True), admitted(3), started(4)), [4])
            for scope in ("local", "fleet")
            for name in ("i3", "a3")
        ),
        ("i3", (CARRIED, reviewed(2, True), admitted(3), started(4)), [4]),
        ("a3", (rule(1, "review"), reviewed(2, True), admitted(3), started(4)), []),
        ("a3", (reviewed(1, True), admitted(2), rule(3, "review"), started(4)), [4]),
    ),
    "a rule of the fleet counts as known at the start": (
        ("i3", (FLEETS, admitted(2), started(3)), [3]),
        ("i3", (admitted(1), rule(2, scope="fleet"), started(3)), [3]),  # set after the executor had admitted it
        ("i3", (FLEETS, rule(2, "allow", scope="fleet"), admitted(3), started(4)), []),
        ("i3", (FLEETS, admitted(2), LIFTED, started(4)), []),
        ("i3", (rule(1, robot=None, scope="fleet"), started(2, on_behalf_of="robot/B1")), [2]),  # its own step
        ("i3", (rule(1, robot="robot/A1", scope="fleet"), started(2)), []),
    ),
    "a hold ends when a rule is set for the robot": (
        ("a3", (HELD, started(4)), [4]),
        ("a3", (HELD, rule(3, "allow"), started(4)), []),
        ("a3", (HELD, rule(3, "allow", robot=None, scope="fleet"), started(4)), []),
        ("a3", (HELD, rule(3, "allow", robot="robot/A1"), started(4)), [4]),
        ("a3", (HELD, reviewed(3, False), started(4)), [4]),  # a disapproval ends no hold
    ),
    "of several answers to a review the last before the start counts": tuple(
        ("a3", (*before, reviewed(3, first), reviewed(4, last), *then, started(6)), [] if last else times)
        for first, last in ((True, False), (False, True))
        for before, then, times in (
            ((HELD,), (), [6]),
            ((rule(1, "review"),), (), [6]),
            (({**CARRIED, "carried_policy": "review"},), (admitted(5),), [5, 6]),
        )
    ),
    "a window of its own is known from its opening on, at one time in the order of the log": tuple(
        (name, events, times)
        for name in ("i3", "a3")
        for events, times in (
            ((OPENED, started(5)), [5]),
            ((started(5), OPENED), []),
            ((OPENED, started(5), SHUT), [5]),
            ((OPENED, SHUT, started(5)), []),
        )
    ),
    "a refusal is that of its robot": tuple(
        (name, events, times)
        for name in ("i3", "a3")
        for events, times in (
            ((ASKED, admitted(4), REFUSED, started(9)), [9]),
            ((ASKED, admitted(4), {**REFUSED, **OTHER}, started(9)), []),
            ((ASKED, admitted(4), {**REFUSED, "executed_by": None, "decided_by": H_F}, started(9)), [9]),
            ((ASKED, REFUSED, admitted(7), started(9)), []),
        )
    ),
    "what the last request carried is known, and what was relayed of it": tuple(
        (name, events, times)
        for name in ("i3", "a3")
        for events, times in (
            ((CARRIED, ASKED, admitted(4), started(5)), []),
            (({**CARRIED, "type": "RequestRelayed.v1"}, ASKED, admitted(4), started(5)), []),
            ((ASKED, {**CARRIED, "time_us": 3}, started(5)), [5]),
            ((ASKED, {**CARRIED, "time_us": 3, "type": "RequestRelayed.v1"}, started(5)), [5]),
        )
    ),
}


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_known_of_rules_is_heeded(name: str) -> None:
    for invariant, events, times in BROKEN[name]:
        assert broken(invariant, *events) == times


ESCALATED = act(
    "PolicyConflictEscalated", 6, "t1/1", decided_by=POLICY, requested_by="robot/A1", executed_by="robot/B1"
)
MANDATE = rule(1, "allow", robot=None, scope="fleet")


TOLD = {**ESCALATED, "supervised_by": H_F}
QUEUED = act("ExecutionQueued", 4, "t1/1", robot="robot/B1", capability=DOOR)
NOT_STARTED = {**HELD, "time_us": 6, "task_id": "t1", "reason": "local-policy"}


@pytest.mark.parametrize(
    ("events", "times"),
    [
        ((MANDATE, rule(2), ASKED, REFUSED), [6]),
        ((MANDATE, rule(2), ASKED, TOLD, REFUSED), []),
        ((MANDATE, QUEUED, rule(5), NOT_STARTED), [6]),
        ((MANDATE, QUEUED, rule(5), TOLD, NOT_STARTED), []),
        ((QUEUED, rule(5), NOT_STARTED), []),
        ((MANDATE, QUEUED, rule(5, "review"), {**NOT_STARTED, "outcome": "review"}), []),
        ((MANDATE, rule(2), ASKED, TOLD, REFUSED, {**REFUSED, "time_us": 8}), [8]),
        ((MANDATE, rule(2), ASKED, TOLD, REFUSED, {**TOLD, "time_us": 8}, {**REFUSED, "time_us": 8}), []),
        ((MANDATE, rule(2), ASKED, TOLD, REFUSED, {**QUEUED, "time_us": 8}, {**NOT_STARTED, "time_us": 9}), [9]),
    ],
)
def test_each_conflict_of_mandate_and_own_denial_must_be_escalated_at_the_request_and_at_the_start(
    events: tuple[Row, ...], times: list[int]
) -> None:
    assert broken("a3", *events) == times


@pytest.mark.parametrize(
    "before",
    [
        (rule(2),),
        (MANDATE,),
        (MANDATE, rule(2, "review")),
        (MANDATE, rule(2), rule(2, scope="fleet", capability=DOOR)),
        (rule(1, "allow", scope="fleet", capability="carry.package"), rule(2)),
        (rule(1, "allow", scope="fleet"), rule(2, "review", scope="fleet"), rule(2)),
        (MANDATE, rule(2, context="t2")),
        (MANDATE, rule(2), event("FleetRuleLearned", 2, robot="robot/B1", outcome="deny", as_of_us=1)),
    ],
    ids=[
        *("no mandate", "no denial", "own review", "fleet denies this"),
        *("mandate for another", "mandate replaced", "denies another task", "zone denies"),
    ],
)
def test_other_refusals_are_no_conflict(before: tuple[Row, ...]) -> None:
    assert answer("facts/mandate_conflicts", run(*ROBOTS, *before, ASKED, REFUSED)) == []
