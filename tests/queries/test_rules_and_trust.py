"""Policy rules, refusals and disapprovals: given rows, expected rows."""

from typing import Any

import pytest

from fsar_ledger.events.envelope import POLICY, Supervisor
from fsar_ledger.metrics.database import plain_rows
from fsar_ledger.metrics.invariants import chosen
from tests.queries.histories import Row, answer, event, measured, run
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
    return event("RequestAdmitted", time_us, task_id="t1", action_id="t1/1", outcome="allow", decided_by="robot/B1")


def asked(name: str, columns: str, *events: Row, **given: Any) -> list[tuple[Any, ...]]:
    """These columns of the answer to a question over one run of two robots with these events."""
    with from_rows(run(*ROBOTS, *events)) as database:
        rows = plain_rows(database.query(f"audit/{name}", {key: str(value) for key, value in given.items()}))
    return [tuple(row[column] for column in columns.split()) for row in rows]


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


@pytest.mark.parametrize(("time_us", "count"), [(4, 0), (5, 1), (8, 1), (9, 0)])
def test_a_start_under_a_rule_that_denies_is_a_violation_from_its_setting_until_just_before_its_replacement(
    time_us: int, count: int
) -> None:
    assert violations(rule(5), started(time_us), rule(9, "allow")) == count


def test_a_rule_about_another_capability_or_task_does_not_count() -> None:
    assert violations(rule(1, capability=DOOR), started(2)) == 1
    assert violations(rule(1, capability="carry.package"), started(2)) == 0
    assert violations(rule(1, context="t1"), started(2)) == 1
    assert violations(rule(1, context="t2"), started(2)) == 0
    assert violations(rule(1, capability=DOOR, context="t2"), started(2)) == 0


def test_a_motion_is_about_no_capability_and_no_task() -> None:
    assert violations(rule(1), motion(2)) == 1
    assert violations(rule(1, capability=DOOR), motion(2)) == 0
    assert violations(rule(1, context="t1"), motion(2)) == 0


def test_own_rules_of_executor_and_requester_and_fleet_rules_of_the_executor_count() -> None:
    assert violations(rule(1, robot="robot/A1"), started(2)) == 1
    assert violations(rule(1, robot="robot/A1", scope="fleet"), started(2)) == 0
    assert violations(rule(1, scope="fleet"), started(2)) == 1
    assert violations(rule(1, robot=None, scope="fleet"), started(2)) == 1


def test_a_rule_that_allows_lifts_no_other() -> None:
    assert violations(rule(1), rule(2, "allow", capability=DOOR), started(3)) == 1
    assert violations(rule(1), rule(2, "allow", scope="fleet"), started(3)) == 1


@pytest.mark.parametrize(("approves", "count"), [(True, 0), (None, 0), (False, 1)])
def test_a_disapproval_is_no_approval(approves: bool | None, count: int) -> None:
    history = (rule(1, "review"), reviewed(2, approves), started(3))
    assert violations(*history) == len(broken("a3", *history)) == count
    assert len(answer("facts/hold_ends", run(*history))) == 1 - count
    assert len(asked("unapproved_executions", "action_id", *history)) == count


def test_a_start_under_the_robots_own_rule_is_known_to_be_denied() -> None:
    assert broken("i3", rule(1), started(2)) == [2]
    assert broken("i3", rule(1, "review"), started(2)) == []
    assert broken("a3", rule(1, "review"), started(2)) == [2]
    assert broken("i3", rule(1, capability="carry.package"), started(2)) == []
    assert broken("i3", rule(1), rule(2, "allow"), started(3)) == []


def test_an_approval_lifts_no_denial_that_is_known() -> None:
    for robots in ("local", "fleet"):
        history = (rule(1, scope=robots), reviewed(2, True), admitted(3), started(4))
        assert broken("i3", *history) == broken("a3", *history) == [4]
    carried = event("RequestIssued", 1, task_id="t1", action_id="t1/1", carried_policy="deny")
    assert broken("i3", carried, reviewed(2, True), admitted(3), started(4)) == [4]
    assert broken("a3", rule(1, "review"), reviewed(2, True), admitted(3), started(4)) == []
    assert broken("a3", reviewed(1, True), admitted(2), rule(3, "review"), started(4)) == [4]


def test_a_rule_of_the_fleet_counts_as_known_at_the_decision() -> None:
    assert broken("i3", rule(1, scope="fleet"), admitted(2), started(3)) == [3]
    assert broken("i3", admitted(1), rule(2, scope="fleet"), started(3)) == [], "set after the executor had decided"
    assert broken("i3", rule(1, scope="fleet"), rule(2, "allow", scope="fleet"), admitted(3), started(4)) == []
    assert broken("i3", rule(1, scope="fleet"), admitted(2), rule(3, "allow", scope="fleet"), started(4)) == [4]
    assert broken("i3", rule(1, robot=None, scope="fleet"), started(2, robot="robot/B1", on_behalf_of="robot/B1")) == [
        2
    ], "its own step"
    assert broken("i3", rule(1, robot="robot/A1", scope="fleet"), started(2)) == []


def test_a_hold_ends_when_a_rule_is_set_for_the_robot() -> None:
    held = event("ExecutionHeld", 2, robot="robot/B1", action_id="t1/1", outcome="deny")
    assert broken("a3", held, started(4)) == [4]
    assert broken("a3", held, rule(3, "allow"), started(4)) == []
    assert broken("a3", held, rule(3, "allow", robot=None, scope="fleet"), started(4)) == []
    assert broken("a3", held, rule(3, "allow", robot="robot/A1"), started(4)) == [4]
    assert broken("a3", held, reviewed(3, False), started(4)) == [4], "a disapproval ends no hold"


ASKED = event("RequestIssued", 3, task_id="t1", action_id="t1/1", capability=DOOR, carried_policy="allow")
REFUSED = event(
    "RequestDenied", 6, task_id="t1", action_id="t1/1", executed_by="robot/B1", decided_by="robot/B1", reason="policy"
)
ESCALATED = event(
    "PolicyConflictEscalated",
    6,
    task_id="t1",
    action_id="t1/1",
    decided_by=POLICY,
    requested_by="robot/A1",
    executed_by="robot/B1",
)
MANDATE = rule(1, "allow", robot=None, scope="fleet")


def test_a_conflict_of_mandate_and_own_denial_must_be_escalated() -> None:
    assert broken("a3", MANDATE, rule(2), ASKED, REFUSED) == [6]
    assert broken("a3", MANDATE, rule(2), ASKED, {**ESCALATED, "supervised_by": H_F}, REFUSED) == []


def test_a_conflict_of_mandate_and_own_denial_at_the_start_must_be_escalated() -> None:
    queued = event("ExecutionQueued", 4, task_id="t1", action_id="t1/1", robot="robot/B1", capability=DOOR)
    held = event(
        "ExecutionHeld", 6, task_id="t1", action_id="t1/1", robot="robot/B1", outcome="deny", reason="local-policy"
    )
    told = {**ESCALATED, "supervised_by": H_F}
    assert broken("a3", MANDATE, queued, rule(5), held) == [6]
    assert broken("a3", MANDATE, queued, rule(5), told, held) == []
    assert broken("a3", queued, rule(5), held) == []
    assert broken("a3", MANDATE, queued, rule(5, "review"), {**held, "outcome": "review"}) == []


def test_every_refusal_is_told_of_by_itself() -> None:
    told = {**ESCALATED, "supervised_by": H_F}
    again, held = (
        {**REFUSED, "time_us": 8},
        event(
            "ExecutionHeld", 9, task_id="t1", action_id="t1/1", robot="robot/B1", outcome="deny", reason="local-policy"
        ),
    )
    queued = event("ExecutionQueued", 8, task_id="t1", action_id="t1/1", robot="robot/B1", capability=DOOR)
    assert broken("a3", MANDATE, rule(2), ASKED, told, REFUSED, again) == [8]
    assert broken("a3", MANDATE, rule(2), ASKED, told, REFUSED, {**told, "time_us": 8}, again) == []
    assert broken("a3", MANDATE, rule(2), ASKED, told, REFUSED, queued, held) == [9]


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
        "no mandate",
        "no denial",
        "own review",
        "fleet denies this",
        "mandate for another",
        "mandate replaced",
        "denies another task",
        "zone denies",
    ],
)
def test_other_refusals_are_no_conflict(before: tuple[Row, ...]) -> None:
    assert answer("facts/mandate_conflicts", run(*ROBOTS, *before, ASKED, REFUSED)) == []
