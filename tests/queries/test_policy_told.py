"""Policy at a time, as it was and as it was known, and the grounds of reviews: no answer is silent, none is made up."""

from collections.abc import Iterator
from typing import Any

import pytest

from fsar_ledger.events import CONCERNS
from fsar_ledger.events.envelope import FLEET_SUPERVISOR
from fsar_ledger.ledger.rows.codec import LedgerRun, encode
from fsar_ledger.metrics.database import Database, from_table, plain_rows
from fsar_ledger.runtime.change_texts import parsed
from tests.analysis.conftest import simulated
from tests.analysis.test_causes import again
from tests.queries.histories import Row, S, event, run
from tests.queries.test_rules_and_trust import DOOR, ROBOTS, rule
from tests.recycled import from_rows
from tests.runtime.pinned import PINNED

LIFT, CARRY = "lift", "carry.package"
WITHOUT_POLICY = [one for one in CONCERNS if one != "policy"]


def answers(name: str, columns: str, *events: Row, observes: list[str] | None = None, **given: Any) -> list[Any]:
    """These columns of the answer over one run of two robots with these events, sorted."""
    seen = list(CONCERNS) if observes is None else observes
    with from_rows(run(*ROBOTS, *events, observes=seen)) as database:
        rows = plain_rows(database.query(f"audit/{name}", {key: str(value) for key, value in given.items()}))
    return sorted((tuple(row[column] for column in columns.split()) for row in rows), key=str)


def test_every_capability_and_context_with_a_rule_of_its_own_has_a_row_and_all_others_one() -> None:
    rules = (rule(1, "review", capability=DOOR), rule(2, "deny", context="t1"), rule(3, "deny", capability=LIFT))
    assert answers("policy_at", "capability context outcome", *rules, robot="robot/B1") == sorted(
        [
            (None, None, "allow"),  # the fleet's
            (None, None, "allow"),
            (DOOR, None, "review"),
            (LIFT, None, "deny"),
            (None, "t1", "deny"),
            (DOOR, "t1", "deny"),
            (LIFT, "t1", "deny"),
        ],
        key=str,
    )


@pytest.mark.parametrize("capability", [DOOR, LIFT, CARRY])
@pytest.mark.parametrize("context", ["t1", "t2"])
def test_the_row_that_is_about_a_question_says_what_the_question_alone_is_answered(
    capability: str, context: str
) -> None:
    rules = (
        rule(1, "review", capability=DOOR),
        rule(2, "deny", context="t1"),
        rule(3, "review", capability=LIFT, context="t1"),
        rule(4, "allow", capability=DOOR),
        rule(5, "review"),
    )
    columns = "capability context scope outcome since_us"
    asked = answers("policy_at", columns, *rules, robot="robot/B1", capability=capability, context=context)
    every = {row[:3]: row[3:] for row in answers("policy_at", columns, *rules, robot="robot/B1")}
    assert len(asked) == 2
    for about, on, scope, *said in asked:
        assert (about, on) == (capability, context)
        listed = {row[0] for row in every if row[2] == scope}, {row[1] for row in every if row[2] == scope}
        row = (about if about in listed[0] else None, on if on in listed[1] else None, scope)
        assert every[row] == tuple(said)


def test_policy_that_is_not_observed_is_never_said_to_allow() -> None:
    rows = answers("policy_at", "outcome since_us", observes=WITHOUT_POLICY)
    assert rows == [(None, None)] * 4
    told = event("FleetRuleLearned", 2, robot="robot/B1", outcome="allow", as_of_us=1)
    known = answers("policy_known_at", "known_outcome true_outcome is_wrong", told, observes=WITHOUT_POLICY)
    assert known == [("allow", None, None), *[(None, None, None)] * 3]


def test_what_was_recorded_against_an_action_stands_even_if_policy_is_not_observed() -> None:
    given: dict[str, Any] = {"robot": "robot/B1", "observes": WITHOUT_POLICY}
    assert answers("policy_at", "scope outcome", rule(1), **given) == [("fleet", None), ("local", "deny")]
    found = answers("policy_at", "scope outcome", rule(1), rule(2, "allow"), **given)
    assert found == [("fleet", None), ("local", None)]


@pytest.mark.parametrize(
    ("events", "observes", "at_s", "said"),
    [
        ((), None, 5, "fsar keeps no copies"),
        ((), [one for one in CONCERNS if one != "knowledge"], 5, "does not observe knowledge"),
        ((event("SnapshotTaken", 9 * S, robot="robot/B1", outcome="deny"),), None, 5, "the first is told at 9"),
    ],
)
def test_where_nothing_was_known_the_answer_says_why(
    events: tuple[Row, ...], observes: list[str] | None, at_s: int, said: str
) -> None:
    given = {"robot": "robot/B1", "at_us": at_s * S}
    rows = answers("policy_known_at", "scope known_by why_unknown", *events, observes=observes, **given)
    assert [row[:2] for row in rows] == [("fleet", None), ("local", None)]
    assert said in rows[1][2]
    assert all(row[2] for row in rows)


def test_somebody_who_was_told_needs_no_reason() -> None:
    copied = event("CopySynced", 1, local_deny=["robot/B1"])
    found = answers("policy_known_at", "known_by known_outcome why_unknown", copied, robot="robot/B1")
    assert found == [("coordinator", "allow", None), ("coordinator", "deny", None)]


def stranger(
    name: str,
    columns: str,
    *events: Row,
    observes: list[str] | None = None,
    records: list[str] | None = None,
    at_s: int = 5,
) -> list[Any]:
    """These columns about a robot of a foreign run that does not tell who joined."""
    observes = list(CONCERNS) if observes is None else observes
    seen: dict[str, Any] = {"kind": "foreign", "observes": observes, "records": records}
    acts = event("ExecutionStarted", 0, robot="robot/X1", capability=LIFT)
    with from_rows(run(acts, *events, **seen)) as database:
        given = {"robot": "robot/X1"} | ({"at_us": str(at_s * S)} if name.endswith("_at") else {})
        rows = database.query(f"audit/{name}", given).to_pylist()
    return [tuple(row[column] for column in columns.split()) for row in rows]


def test_a_robot_of_which_nobody_tells_that_it_joined_has_an_answer_where_the_run_tells_of_policy() -> None:
    window = {"robot": "robot/X1", "scope": "local", "window": "w"}
    opened = event("PolicyWindowOpened", S, **window, outcome="deny")
    closed = event("PolicyWindowClosed", 9 * S, **window)
    told = event("SnapshotTaken", 2 * S, robot="robot/X1", outcome="allow")
    known = "scope known_outcome true_outcome is_wrong"
    nothing = ("fleet", None, None, None)
    assert stranger("policy_known_at", known, opened) == [nothing, ("local", None, None, None)]
    assert stranger("policy_known_at", known, told, opened) == [("local", "allow", "deny", True), nothing]
    assert stranger("policy_at", "scope outcome", opened, closed) == [("fleet", "allow"), ("local", "deny")]
    assert stranger("policy_at", "scope outcome", opened, closed, at_s=9) == [("fleet", "allow"), ("local", "allow")]
    unseen = [("fleet", None), ("local", "deny")]
    assert stranger("policy_at", "scope outcome", opened, closed, observes=WITHOUT_POLICY) == unseen
    assert stranger("policy_known_at", "scope", observes=WITHOUT_POLICY) == []


@pytest.mark.parametrize(("records", "deny"), [([], None), (["PolicyWindowClosed"], "deny")])
def test_a_window_is_not_said_to_hold_for_good_where_nobody_records_that_windows_close(
    records: list[str], deny: str | None
) -> None:
    told = event("SnapshotTaken", 2 * S, robot="robot/X1", outcome="allow")
    window = {"robot": "robot/X1", "scope": "local", "outcome": "deny"}
    opened = [event("PolicyWindowOpened", at_s * S, **window, window=f"w{at_s}") for at_s in (1, 3)]
    seen: dict[str, Any] = {"observes": [], "records": ["PolicyWindowOpened", "RequestDenied", *records]}
    found = stranger("policy_at", "scope outcome since_us", *opened, **seen)
    assert found == [("fleet", None, None), ("local", deny, S if deny else None)]
    found = stranger("policy_known_at", "scope true_outcome is_wrong", told, *opened, **seen)
    assert found == [("local", deny, True if deny else None), ("fleet", None, None)]
    denied = event("RequestDenied", 4 * S, reason="policy", executed_by="robot/X1", decided_by="robot/X1")
    names = ["w1", "w3"] if deny else None
    assert stranger("denials", "denied_under", *opened, denied, **seen) == [(names,)]
    ruled = event("PolicyRuleSet", 4 * S, robot="robot/X1", scope="local", outcome="deny", decided_by="x")
    joined = event("RobotJoined", 4 * S, robot="robot/X1", role="X")
    assert ("local", "deny") in stranger("policy_at", "scope outcome", *opened, joined, ruled, **seen)


def test_a_rule_is_not_said_to_allow_what_it_may_deny_a_robot_of_which_nobody_tells_that_it_joined() -> None:
    denied = event("PolicyRuleSet", S, scope="local", outcome="deny", decided_by="x")
    assert stranger("policy_at", "scope outcome", denied) == [("fleet", None), ("local", None)]


def test_a_copy_tells_of_the_robots_that_it_names_and_of_those_that_another_one_has_named() -> None:
    copies = [event("CopySynced", 1 * S, local_deny=["robot/X1"]), event("CopySynced", 7 * S)]
    for at_s, outcome in ((5, "deny"), (8, "allow")):
        found = stranger("policy_known_at", "known_by scope known_outcome", *copies, at_s=at_s)
        assert found == [("coordinator", "fleet", "allow"), ("coordinator", "local", outcome)]


# --- reviews ---


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    with from_table(encode(list(records()))) as made:
        yield made


def records() -> Iterator[LedgerRun]:
    """Runs of each architecture with reviews, and the same with every admission reviewed."""
    for architecture, number in (("fsar", 0), ("cfc", 0), ("cfc", 1), ("dhma", 1), ("dhma", 12), ("fsar", 12)):
        for scenario in ("collaborative-delivery", "door-relay", "failure-recovery-chain"):
            record = simulated(architecture, number, PINNED, scenario)
            yield record
            if architecture == "fsar":
                yield again(record).fork(tuple(parsed(["density all 2 from 20s"]))).record


def test_every_call_for_review_has_a_window_or_rule_that_asked_for_it(database: Database) -> None:
    rows = database.rows("""
        SELECT runs.architecture, called.run_id, called.seq, grounds.ground_seqs, grounds.told
        FROM supervisor_called AS called
        INNER JOIN runs ON called.run_id = runs.run_id
        LEFT JOIN named_grounds AS grounds ON called.run_id = grounds.run_id AND called.seq = grounds.seq
        WHERE called.purpose = 'review'
    """)
    assert {row["architecture"] for row in rows} == {"fsar", "cfc", "dhma"}
    assert [row for row in rows if not row["ground_seqs"]] == []
    assert any("a review every 2 admissions" in row["told"] for row in rows)
    assert any("the fleet's policy for" in row["told"] for row in rows)


def test_interventions_decisions_and_messages_name_the_ground_of_a_review(database: Database) -> None:
    grounds = {
        (row["run_id"], row["seq"]): row["told"] for row in database.rows("SELECT run_id, seq, told FROM named_grounds")
    }
    calls = database.rows("SELECT run_id, seq, purpose FROM supervisor_called WHERE supervisor = 'supervisor/fleet'")
    listed = {(row["run_id"], row["seq"]): row for row in plain_rows(database.query("audit/interventions"))}
    notes = {
        (row["run_id"], row["seq"]): row["note"] for row in database.rows("SELECT run_id, seq, note FROM messages")
    }
    for row in calls:
        place = row["run_id"], row["seq"]
        assert listed[place]["called_under"] == (grounds[place] if row["purpose"] == "review" else None)
        assert (listed[place]["under_seqs"] is None) == (row["purpose"] != "review")
        if row["purpose"] == "review":
            assert f"under {grounds[place]}" in notes[place]
    decided = plain_rows(database.query("audit/supervisor_decisions"))
    answered = [row for row in decided if row["purpose"] == "review"]
    assert answered
    assert all(row["called_under"] in grounds.values() for row in answered)


def test_a_denial_after_a_review_is_under_what_asked_for_it_though_that_is_over() -> None:
    window = {"robot": "robot/B1", "scope": "local", "window": "w1"}
    about = {"task_id": "t1", "action_id": "t1/1"}
    events = (
        event("PolicyWindowOpened", 1 * S, outcome="review", **window),
        event("RequestIssued", 2 * S, capability=DOOR, executed_by="robot/B1", decided_by="robot/A1", **about),
        event("SupervisorCalled", 3 * S, supervisor=FLEET_SUPERVISOR, purpose="review", **about),
        event("PolicyWindowClosed", 4 * S, **window),
        event("SupervisorResponded", 9 * S, purpose="review", approves=False, decided_by=FLEET_SUPERVISOR, **about),
        event("RequestDenied", 9 * S, reason="review", executed_by="robot/B1", decided_by="robot/B1", **about),
    )
    assert answers("grounds_of_denials", "denied_under was_open", *events) == [("w1", False)]


def test_a_rule_is_named_with_its_capability_and_since_when() -> None:
    about = {"task_id": "t1", "action_id": "t1/1"}
    events = (
        rule(1 * S, "review", scope="fleet", capability=DOOR),
        event("RequestIssued", 2 * S, capability=DOOR, executed_by="robot/B1", decided_by="robot/A1", **about),
        event("SupervisorCalled", 3 * S, supervisor=FLEET_SUPERVISOR, purpose="review", **about),
    )
    assert answers("interventions", "called_under under_seqs", *events) == [
        (f"rule 3 of the fleet's policy for robot/B1 on {DOOR}, since 1.0 s", [3])
    ]


def test_the_answer_of_a_supervisor_always_goes_to_somebody(database: Database) -> None:
    lines = database.rows("SELECT * FROM messages WHERE type = 'SupervisorResponded.v1'")
    assert len({line["run_id"] for line in lines}) > 5
    assert [line for line in lines if line["receiver"] is None or line["receiver"] == line["sender"]] == []


@pytest.mark.parametrize("known", [(), ("decided_by",), ("decided_by", "requested_by"), ("supervised_by",)])
def test_an_answer_without_a_call_goes_to_whom_the_record_names_or_is_a_deed(known: tuple[str, ...]) -> None:
    names = {"decided_by": FLEET_SUPERVISOR, "requested_by": "robot/A1", "supervised_by": FLEET_SUPERVISOR}
    answer = event("SupervisorResponded", 1, purpose="review", action_id="t1/1", **{one: names[one] for one in known})
    with from_rows(run(*ROBOTS, answer)) as made:
        (line,) = made.rows("SELECT receiver FROM messages")
    assert line["receiver"] == (names[known[-1]] if known else None)


@pytest.mark.parametrize(("decider", "caller"), [("coordinator", "coordinator"), ("robot/A1", "robot/B1")])
def test_only_where_a_coordinator_decides_is_it_said_to_call_for_the_review_of_a_robot(
    decider: str, caller: str
) -> None:
    about = {"task_id": "t1", "action_id": "t1/1"}
    asked = event("RequestIssued", 1 * S, capability=DOOR, executed_by="robot/B1", decided_by=decider, **about)
    called = event("SupervisorCalled", 2 * S, supervisor=FLEET_SUPERVISOR, purpose="review", robot="robot/B1", **about)
    with from_rows(run(*ROBOTS, asked, called)) as made:
        assert made.rows("SELECT sender FROM messages WHERE type = 'SupervisorCalled.v1'") == [{"sender": caller}]


def test_a_call_of_a_coordinator_is_its_own_in_every_run_that_has_one(database: Database) -> None:
    callers = database.rows("""
        SELECT DISTINCT runs.architecture, messages.sender = 'coordinator' AS is_coordinator
        FROM messages
        INNER JOIN runs ON messages.run_id = runs.run_id
        INNER JOIN supervisor_called AS called ON messages.run_id = called.run_id AND messages.seq = called.seq
        WHERE called.purpose = 'review'
    """)
    assert {row["architecture"]: row["is_coordinator"] for row in callers} == {
        "cfc": True,
        "fsar": False,
        "dhma": False,
    }
    assert len(callers) == 3
