"""The story of a denial tells what its event carries: who asked, denied and supervised, when, under which window."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from fsar_ledger import Ledger, open_ledger
from fsar_ledger.api.answers import Screen
from fsar_ledger.api.explain import _parties, account_lines, printable_rows
from fsar_ledger.metrics.database import plain_rows
from tests.cli.conftest import Call, made_in
from tests.queries.histories import Row, S, event, run
from tests.quick import few
from tests.recycled import from_rows

A, B, SUPERVISOR = "robot/A1", "robot/B1", "supervisor/B1"
PRINCIPALS = ("decided_by", "requested_by", "executed_by", "supervised_by")


LONG = ("--set", "world.window_mean_s=12", "--set", "world.context_window_share=0.6")
"""Windows that are often in force together, and over when whoever has a copy decides by them."""


@pytest.fixture(scope="module")
def windowed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_in(tmp_path_factory.mktemp("denials"), *LONG)


def story(ledger: Ledger, run_id: str, action: str) -> tuple[dict[str, Any], str]:
    """The row of the action and its story as text."""
    account = ledger.explain(run=run_id, request=action)
    screen = Screen(ledger)
    told = account_lines(screen, (account.run, action), printable_rows(account.timeline), account.parties, [])
    return account.parties, "\n".join(told)


def missing(ledger: Ledger) -> list[str]:
    """What events of denials carry and the story of their action does not say."""
    left_out = []
    sql = "SELECT d.*, a.action_id AS about FROM request_denied AS d JOIN denied_actions AS a USING (run_id, seq)"
    denials = ledger.sql(sql).rows()
    assert denials
    stories = {(row["run_id"], row["about"]): story(ledger, row["run_id"], row["about"]) for row in denials}
    for row in denials:
        parties, told = stories[row["run_id"], row["about"]]
        at = f"{row['run_id']}:{row['seq']}"
        (line,) = [line for line in told.splitlines() if line[13:19] == f"{row['seq']:>6}"]
        carried = [*(row[name] for name in PRINCIPALS), *row["path"]]
        left_out += [f"{at} line: {name}" for name in carried if name is not None and name not in line]
        if row["executed_by"] not in (None, row["decided_by"]) and f"asked of {row['executed_by']}" not in line:
            left_out.append(f"{at} line: asked of {row['executed_by']}")
        for column, name in (("denied_by", "decided_by"), ("supervised_by", "supervised_by")):
            if row[name] is not None and row[name] not in (parties[column] or "").split(" and "):
                left_out.append(f"{at} {column}: {row[name]}")
    return left_out


@pytest.mark.slow
def test_each_principal_that_a_denial_carries_is_in_the_story_of_its_action(ledger: Path) -> None:
    assert missing(open_ledger(ledger)) == []


def asked(name: str, columns: str, *events: Row) -> list[tuple[Any, ...]]:
    with from_rows(run(*events)) as database:
        rows = plain_rows(database.query(f"audit/{name}"))
    return [tuple(row[column] for column in columns.split()) for row in rows]


def about(by: str, **fields: Any) -> dict[str, Any]:
    parties = {"requested_by": A, "executed_by": B, "supervised_by": SUPERVISOR, "decided_by": by, "path": [by]}
    return {"task_id": "t1", "action_id": "t1/1.1", **parties, **fields}


def test_of_several_denials_it_is_not_said_that_those_who_are_named_made_each() -> None:
    denied = event("RequestDenied", 3 * S, **about(B), reason="trust")
    unknown = {**denied, "time_us": 4 * S, "decided_by": None}
    for events, told in (
        ((denied,), ", at 3.000 s (seq 1)"),
        ((denied, unknown), "; 2 denials, the last at 4.000 s (seq 2)"),
    ):
        with from_rows(run(*events)) as database:
            (parties,) = plain_rows(database.query("audit/requests"))
        assert dict(_parties(parties))["denied_by"] == f"{B}{told}"


def window(name: str, robot: str, opened_us: int, scope: str = "local", outcome: str = "deny") -> Row:
    return event("PolicyWindowOpened", opened_us, robot=robot, scope=scope, window=name, outcome=outcome)


def closed(name: str, robot: str, closed_us: int) -> Row:
    return event("PolicyWindowClosed", closed_us, robot=robot, scope="local", window=name)


def request(carried: str = "allow") -> Row:
    return event("RequestIssued", 4 * S, **about(A), capability="lift", carried_policy=carried)


DENIED = event("RequestDenied", 5 * S, **about(B), reason="policy")
GROUNDS = "grounds_of_denials"


def test_a_denial_names_the_window_in_force_and_who_supervised() -> None:
    history = (window("night-shift", B, 1 * S), request(), DENIED, closed("night-shift", B, 9 * S))
    columns = "denied_by denied_s reason denied_under"
    assert asked("denials", f"{columns} supervised_by", *history) == [(B, 5.0, "policy", ["night-shift"], SUPERVISOR)]
    when = "policy_of opened_s closed_s"
    assert asked(GROUNDS, f"{columns} {when}", *history) == [(B, 5.0, "policy", "night-shift", B, 1.0, 9.0)]


def test_a_window_that_closed_at_the_instant_of_the_denial_does_not_explain_it() -> None:
    history = (window("night-shift", B, 1 * S), request(), closed("night-shift", B, 5 * S), DENIED)
    assert asked("denials", "denied_under under_seqs", *history) == [(None, None)]
    assert asked(GROUNDS, "denied_under", *history) == []


def test_a_window_that_only_asks_for_review_does_not_explain_a_denial() -> None:
    history = (window("inspection", B, 1 * S, outcome="review"), request(), DENIED)
    assert asked("denials", "denied_under", *history) == [(None,)]


def test_the_requesters_window_explains_it_only_if_the_request_carried_a_denial() -> None:
    assert asked(GROUNDS, "denied_under policy_of", window("home", A, 1 * S), request("deny"), DENIED) == [("home", A)]
    assert asked("denials", "denied_under", window("home", A, 1 * S), request(), DENIED) == [(None,)]


def test_a_fleet_window_counts_as_the_executor_had_learned_of_it() -> None:
    def learned(as_of_us: int) -> Row:
        return event("FleetRuleLearned", 3 * S, robot=B, outcome="deny", as_of_us=as_of_us)

    zone = window("zone", B, 2 * S, scope="fleet")
    assert asked(GROUNDS, "denied_under scope", zone, learned(2 * S), request(), DENIED) == [("zone", "fleet")]
    assert asked("denials", "denied_under", zone, learned(1 * S), request(), DENIED) == [(None,)]


def test_a_denial_under_two_windows_is_one_denial_and_it_and_the_request_name_both() -> None:
    history = (window("first", B, 1 * S), window("second", B, 2 * S), request(), DENIED)
    assert asked("denials", "denied_under", *history) == [(["first", "second"],)]
    assert sorted(asked(GROUNDS, "denied_under", *history)) == [("first",), ("second",)]
    columns = "denied_by denied_s denied_under denials supervised_by result"
    assert asked("requests", columns, *history) == [(B, 5.0, "first and second", 1, SUPERVISOR, "denied: policy")]


def test_a_window_that_was_over_is_said_to_be_and_when_it_was_last_seen() -> None:
    def learned(at_us: int, outcome: str) -> Row:
        return event("FleetRuleLearned", at_us, robot=B, outcome=outcome, as_of_us=at_us)

    over = event("PolicyWindowClosed", 3 * S, robot=B, scope="fleet", window="zone")
    history = (window("zone", B, 1 * S, scope="fleet"), learned(2 * S, "deny"), over, request(), DENIED)
    columns = "denied_under closed_s seen_s was_open"
    assert asked(GROUNDS, columns, *history) == [("zone", 3.0, 2.0, False)]
    said = "under window zone of the fleet's policy for robot/B1, over since 3.0 s, last seen at 2.0 s; "
    with from_rows(run(*history)) as database:
        (row,) = database.rows("SELECT note FROM denied_actions")
    assert row["note"].startswith(said)
    (still,) = asked(GROUNDS, columns, *(one for one in history if one is not over))
    assert still == ("zone", None, 2.0, True)


def test_each_denial_is_under_what_was_open_or_had_been_seen_while_it_was(windowed: Path) -> None:
    rows = open_ledger(windowed).query(GROUNDS).rows()
    assert {row["was_open"] for row in rows} == {True, False}
    for row in rows:
        closed_s = row["denied_s"] + 1 if row["closed_s"] is None else row["closed_s"]
        assert row["opened_s"] <= row["seen_s"] < closed_s
        assert row["was_open"] == (row["denied_s"] < closed_s)


@pytest.mark.slow
def test_the_story_of_a_denial_tells_how_to_prove_the_window_too(call: Call, ledger: Path) -> None:
    opened = open_ledger(ledger)
    (denial, *_) = [row for row in opened.query("requests").rows() if row["result"] == "denied: policy"]
    said = call("explain", ledger, "--run", denial["run_id"], "--request", denial["action_id"]).out
    account, number = opened.explain(denial["run_id"], denial["action_id"]), opened.numbers()[denial["run_id"]]
    seq = account.grounds[-1]
    assert opened.query("denials", run=number, action=account.action).rows()[-1]["under_seqs"][-1] == seq
    assert said.splitlines()[-1] == (
        f"`fsar-ledger prove {ledger} {number}:{seq}` proves event {seq} (the window or rule) to others"
    )


def test_the_grounds_of_denials_are_those_that_each_denial_names_in_order(windowed: Path) -> None:
    opened = open_ledger(windowed)
    named = [
        (row["run_id"], row["seq"], name, seq)
        for row in opened.query("denials").rows()
        for name, seq in zip(row["denied_under"] or (), row["under_seqs"] or (), strict=True)
    ]
    grounds = opened.query(GROUNDS).rows()
    listed = {(row["run_id"], row["seq"], row["denied_under"], row["under_seq"]) for row in grounds}
    assert sorted(named) == sorted(listed)
    assert max(Counter((run_id, seq) for run_id, seq, *_ in named).values()) > 1


COUNTS = {
    "denials": "SELECT count(*) FROM request_denied",
    "interventions": "SELECT count(*) FROM supervisor_called WHERE supervisor = 'supervisor/fleet'",
    "requests WHERE is_request": "SELECT count(*) FROM action_records WHERE is_request",
    "revocations": """
        SELECT (SELECT count(*) FROM authority_revoked)
            + (SELECT count(DISTINCT (run_id, seq)) FROM authority_claimed WHERE reason = 'revocation')
    """,
    "unapproved_executions": """
        SELECT count(*) FROM event_principals
        WHERE (run_id, seq) IN (FROM governed_starts SELECT (run_id, seq) WHERE NOT is_approved AND outcome = 'review')
    """,
}
"""What the rows of a query count, by its title."""


@pytest.mark.parametrize("name", COUNTS)
def test_the_rows_of_a_query_count_what_its_title_names(ledger: Path, name: str) -> None:
    query, _, condition = name.partition(" WHERE ")
    opened = open_ledger(ledger)
    rows = [row for row in opened.query(query) if not condition or row[condition]]
    with opened.database() as database:
        assert database.rows(f"SELECT ({COUNTS[name]}) AS n") == [{"n": len(rows)}]


def test_denials_of_a_robot_are_those_that_it_asked_for_was_asked_for_or_decided() -> None:
    history = (
        event("RequestDenied", 5 * S, **about(B), reason="policy"),
        event("RequestDenied", 6 * S, **about("agent/C1/execution", action_id="t1/2.1"), reason="bid"),
    )
    with from_rows(run(*history)) as database:
        found = {
            robot: [row["denied_s"] for row in plain_rows(database.query("audit/denials", {"robot": f"robot/{robot}"}))]
            for robot in ("A1", "B1", "C1", "D1")
        }
    assert found == {"A1": [5.0, 6.0], "B1": [5.0, 6.0], "C1": [6.0], "D1": []}


@pytest.mark.slow
def test_denials_say_who_asked_as_the_story_of_the_action_does_where_the_denial_names_nobody(ledger: Path) -> None:
    opened = open_ledger(ledger)
    named = {(row["run_id"], row["action_id"]): row["asked_by"] for row in opened.query("audit/requests").rows()}
    carried = {(row["run_id"], row["seq"]): row["requested_by"] for row in opened.sql("FROM request_denied").rows()}
    rows = opened.query("denials").rows()
    assert [row["asked_by"] for row in rows] == [
        carried[row["run_id"], row["seq"]] or named[row["run_id"], row["action_id"]] for row in rows
    ]
    assert "coordinator" in {row["asked_by"] for row in rows}


def test_a_rule_is_named_by_the_event_that_set_it() -> None:
    founded = event("RobotJoined", 0, robot=B, role="B", team=1)
    rule = event("PolicyRuleSet", 1 * S, scope="local", robot=B, capability="lift", outcome="deny")
    ((names, seqs),) = asked("denials", "denied_under under_seqs", founded, rule, request(), DENIED)
    assert (names, len(seqs)) == ([f"rule {seqs[0]}"], 1)


def test_a_rule_about_a_role_that_is_the_policy_of_both_sides_is_named_once() -> None:
    founded = [event("RobotJoined", 0, robot=robot, role="lifter", domain="", team=1) for robot in (A, B)]
    rule = event("RolePolicyRuleSet", 1 * S, scope="local", role="lifter", domain="", capability="lift", outcome="deny")
    history = (*founded, rule, request("deny"), DENIED)
    ((names, seqs),) = asked("denials", "denied_under under_seqs", *history)
    assert (names, len(seqs)) == ([f"rule {seqs[0]}"], 1)
    assert asked(GROUNDS, "policy_of under_seq", *history) == [(A, seqs[0]), (B, seqs[0])]


def test_the_supervisor_of_a_denial_is_the_actions_with_the_seq_of_its_records() -> None:
    columns = "supervised_by first_seq last_seq records"
    (row,) = asked("supervisor_of", columns, DENIED)
    assert row[0] == SUPERVISOR
    assert row[1] == row[2]
    assert row[3] == 1


@pytest.mark.slow
def test_the_call_that_a_story_suggests_proves_its_decisive_event(call: Call, ledger: Path) -> None:
    listed, opened = json.loads(call("explain", ledger, "--json").out), open_ledger(ledger)
    one = listed["requests"][0]
    said = call("explain", ledger, "--run", listed["run"], "--request", one["action_id"]).out
    hint = said.splitlines()[-1].partition("`")[2].partition("`")[0]
    assert hint.endswith(f" {opened.numbers()[listed['run']]}:{one['seq']}")
    assert call(*hint.split()[1:]).out == str(opened.prove(f"{listed['run']}:{one['seq']}"))


@pytest.mark.parametrize("runs", few([1, 2], [], []))
def test_no_denial_of_any_scenario_leaves_a_principal_out(call: Call, tmp_path: Path, runs: int) -> None:
    path = tmp_path / "ledger"
    assert call("simulate", path, "--runs", runs).code == 0
    assert missing(open_ledger(path)) == []
