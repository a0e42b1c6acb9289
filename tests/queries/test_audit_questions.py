"""The audit questions about trust, policy and what robots may see: given rows, expected rows; then a real ledger."""

import re
import shlex
from collections.abc import Iterator
from typing import Any

import pytest

from fsar_ledger.api.lookup import parameters_of
from fsar_ledger.base.errors import QueryFailed
from fsar_ledger.metrics.database import Database, connect, plain_rows
from fsar_ledger.metrics.library import library
from fsar_ledger.runtime.experiment import Experiment, run_experiment
from tests.queries.histories import Row, event, run
from tests.quick import few
from tests.recycled import from_rows

QUESTIONS = [name for name in library().queries if name.startswith("audit/")]
ROBOTS = tuple(
    event("RobotJoined", robot=f"robot/{one}1", role=one, team=1, supervisor=f"supervisor/{one}1") for one in "ABC"
)


def asked(name: str, columns: str, *events: Row, configuration: str = "full", **given: Any) -> list[tuple[Any, ...]]:
    """These columns of the answer over one run with these events; the run starts with event 0."""
    with from_rows(run(*events, configuration=configuration)) as database:
        rows = plain_rows(database.query(f"audit/{name}", {key: str(value) for key, value in given.items()}))
    return [tuple(row[column] for column in columns.split()) for row in rows]


def trust(time_us: int, robot: str, peer: str, scope: str) -> Row:
    return event("TrustSet", time_us, robot=f"robot/{robot}", peer=f"robot/{peer}", scope=scope)


def offer(time_us: int, robot: str, *visible_to: str) -> Row:
    return event(
        "CapabilityAdvertised", time_us, robot=f"robot/{robot}", capability="lift", visible_to=list(visible_to)
    )


@pytest.mark.parametrize(("at_us", "scopes"), [(4, []), (5, ["task"]), (8, ["task"]), (9, ["none"])])
def test_trust_holds_from_its_setting_until_just_before_the_next(at_us: int, scopes: list[str]) -> None:
    events = (trust(5, "B1", "A1", "task"), trust(9, "B1", "A1", "none"))
    assert asked("trust_at", "trust_scope", *events, at_us=at_us) == [(scope,) for scope in scopes]


def test_trust_of_one_pair_is_that_of_one_direction() -> None:
    events = (trust(5, "B1", "A1", "task"), trust(5, "A1", "B1", "session"))
    assert asked("trust_at", "trust_scope", *events, robot="robot/A1", peer="robot/B1") == [("session",)]


@pytest.mark.parametrize(
    ("at_us", "outcome", "since_us", "until_us"),
    [(9, "allow", None, 10), (10, "deny", 10, 20), (19, "deny", 10, 20), (20, "allow", 20, None)],
)
def test_policy_is_that_of_the_window_that_holds_then(
    at_us: int, outcome: str, since_us: int | None, until_us: int | None
) -> None:
    window = {"robot": "robot/B1", "scope": "fleet", "window": "w1"}
    events = (
        *ROBOTS,
        event("PolicyWindowOpened", 10, **window, outcome="deny"),
        event("PolicyWindowClosed", 20, **window),
    )
    rows = asked("policy_at", "scope outcome since_us until_us", *events, at_us=at_us, robot="robot/B1")
    assert rows == [("fleet", outcome, since_us, until_us), ("local", "allow", None, None)]


@pytest.mark.parametrize(
    ("at_us", "outcome", "since_us", "until_us"),
    [(9, "review", 5, 10), (12, "deny", 10, 30), (19, "deny", 10, 30), (25, "deny", 10, 30), (30, "allow", 30, None)],
)
def test_policy_lasts_until_its_outcome_changes_whichever_windows_begin_and_end_before(
    at_us: int, outcome: str, since_us: int, until_us: int | None
) -> None:
    def opened(time_us: int, window: str, says: str) -> Row:
        return event("PolicyWindowOpened", time_us, robot="robot/B1", scope="fleet", window=window, outcome=says)

    def closed(time_us: int, window: str) -> Row:
        return event("PolicyWindowClosed", time_us, robot="robot/B1", scope="fleet", window=window)

    windows = (opened(5, "w0", "review"), opened(10, "w1", "deny"), closed(11, "w0"), opened(15, "w2", "deny"))
    events = (*ROBOTS, *windows, closed(20, "w1"), closed(30, "w2"))
    (row, _) = asked("policy_at", "outcome since_us until_us", *events, at_us=at_us, robot="robot/B1")
    assert row == (outcome, since_us, until_us)


@pytest.mark.parametrize(
    ("at_us", "expected"),
    [
        (11, ("fleet", None, None, None, None)),
        (12, ("fleet", "deny", 10, "deny", False)),
        (20, ("fleet", "deny", 10, "allow", True)),
        (22, ("fleet", "allow", 20, "allow", False)),
    ],
)
def test_a_robot_knows_the_fleet_rule_from_the_moment_it_is_told(at_us: int, expected: tuple[Any, ...]) -> None:
    window = {"robot": "robot/B1", "scope": "fleet", "window": "w1"}
    events = (
        event("PolicyWindowOpened", 10, **window, outcome="deny"),
        event("FleetRuleLearned", 12, robot="robot/B1", outcome="deny", as_of_us=10),
        event("PolicyWindowClosed", 20, **window),
        event("FleetRuleLearned", 22, robot="robot/B1", outcome="allow", as_of_us=20),
    )
    found = asked("policy_known_at", "scope known_outcome as_of_us true_outcome is_wrong", *events, at_us=at_us)
    assert [row for row in found if row[0] == "fleet"] == [expected]


@pytest.mark.parametrize(("at_us", "expected"), [(15, "allow"), (25, "deny"), (35, "allow")])
def test_a_window_that_opens_again_under_its_name_is_in_force_again(at_us: int, expected: str) -> None:
    window = {"robot": "robot/B1", "scope": "fleet", "window": "w1"}
    events = (
        event("FleetRuleLearned", 9, robot="robot/B1", outcome="allow", as_of_us=9),
        event("PolicyWindowOpened", 10, **window, outcome="deny"),
        event("PolicyWindowClosed", 12, **window),
        event("PolicyWindowOpened", 20, **window, outcome="deny"),
        event("PolicyWindowClosed", 30, **window),
    )
    told = asked("policy_known_at", "scope true_outcome is_wrong", *events, at_us=at_us)
    assert told == [("fleet", expected, expected != "allow"), ("local", None, None)]
    found = asked("policy_at", "scope outcome", *events, at_us=at_us, robot="robot/B1")
    assert found == [("fleet", expected), ("local", "allow")]


def test_a_coordinator_knows_its_last_copy_and_a_planner_its_last_snapshot() -> None:
    empty: dict[str, Any] = {"local_deny": [], "local_review": [], "fleet_deny": [], "fleet_review": []}
    events = (
        *ROBOTS[:2],
        event("CopySynced", 5, **{**empty, "local_deny": ["robot/A1"], "fleet_review": ["robot/A1"]}),
        event("CopySynced", 7, **{**empty, "local_review": ["robot/A1"], "fleet_deny": ["robot/B1"]}),
        event("SnapshotTaken", 6, robot="robot/A1", outcome="review"),
    )
    assert asked("policy_known_at", "known_by robot scope known_outcome", *events, at_us=6) == [
        ("agent/A1/planning", "robot/A1", "local", "review"),
        ("coordinator", "robot/A1", "fleet", "review"),
        ("coordinator", "robot/A1", "local", "deny"),
        ("coordinator", "robot/B1", "fleet", "allow"),
        ("coordinator", "robot/B1", "local", "allow"),
    ]
    later = asked("policy_known_at", "scope known_outcome", *events, at_us=7, robot="robot/A1")
    assert later == [("local", "review"), ("fleet", "allow"), ("local", "review")]


@pytest.mark.parametrize(
    ("at_us", "expected"), [(4, []), (5, [(["C"], [])]), (8, [([], [])]), (9, [([], ["robot/A1"])]), (12, [([], [])])]
)
def test_the_surface_is_the_last_advertisement_and_those_with_role_and_trust_may_ask(
    at_us: int, expected: list[tuple[Any, ...]]
) -> None:
    events = (
        *ROBOTS,
        trust(0, "A1", "B1", "task"),
        offer(5, "B1", "C"),
        offer(8, "B1"),
        trust(9, "B1", "A1", "task"),
        trust(12, "B1", "A1", "none"),
    )
    assert asked("capability_surface", "visible_to may_ask", *events, at_us=at_us, robot="robot/B1") == expected


def test_a_role_that_may_not_discover_it_may_not_ask_for_it() -> None:
    assert asked("capability_surface", "may_ask", *ROBOTS, trust(1, "B1", "A1", "task"), offer(2, "B1", "C")) == [([],)]


def query(time_us: int, *candidates: str, relay: str | None = None) -> Row:
    return event(
        "RegistryQueried",
        time_us,
        action_id="t1/1",
        requested_by="robot/A1",
        capability="lift",
        candidates=list(candidates),
        relay=relay,
    )


def test_why_a_robot_was_no_candidate() -> None:
    def reasons(*events: Row, **given: Any) -> list[Any]:
        return [reason for (reason,) in asked("query_candidates", "reason", *ROBOTS[:2], *events, **given)]

    trusted, shown = trust(1, "B1", "A1", "task"), offer(1, "B1")
    assert reasons(query(2)) == ["does not offer it"]
    assert reasons(query(2), shown, trusted) == ["does not offer it"], "offered too late"
    assert reasons(offer(1, "B1", "C"), trusted, query(2)) == ["not visible to role A"]
    assert reasons(shown, query(2), trusted) == ["no trust in the requester"], "trusted too late"
    assert reasons(shown, trusted, trust(1, "B1", "A1", "none"), query(2)) == ["no trust in the requester"]
    assert reasons(shown, trust(1, "A1", "B1", "task"), query(2)) == ["no trust in the requester"], (
        "only the other way round"
    )
    assert reasons(shown, trusted, query(2, "robot/B1")) == ["candidate"]
    assert reasons(shown, query(2, "robot/B1", relay="robot/C1")) == ["candidate through robot/C1"]
    assert reasons(shown, trusted, query(2)) == ["the record gives no reason"]
    assert reasons(shown, trusted, query(2), configuration="without-shared-registry") == ["not met lately"]
    assert reasons(query(2), action="t1/2") == []


@pytest.mark.parametrize(
    ("at_us", "doing"),
    [
        *((0, "idle"), (1, "queued"), (2, "held by policy"), (3, "executing"), (4, "recovering")),
        *((5, "executing"), (6, "paused"), (7, "executing"), (8, "preempted"), (9, "executing"), (10, "idle")),
    ],
)
def test_a_robot_does_what_its_last_event_by_then_says(at_us: int, doing: str) -> None:
    names = ("Queued", "Held", "Started", "Failed", "Resumed", "Paused", "Resumed", "Preempted", "Resumed", "Finished")
    events = [
        event(f"Execution{name}", number, action_id="t1/1", robot="robot/A1") for number, name in enumerate(names, 1)
    ]
    assert asked("robot_activity", "doing", *ROBOTS[:1], *events, at_us=at_us) == [(doing,)]


def test_a_robot_helps_another_beside_its_own_action() -> None:
    events = (
        event("ExecutionStarted", 1, action_id="t1/2", robot="robot/A1", on_behalf_of="robot/B1"),
        event("AssistanceAdmitted", 2, action_id="t1/1", robot="robot/B1", helper="robot/A1"),
        event("AssistanceEnded", 4, action_id="t1/1", robot="robot/B1", helper="robot/A1"),
    )
    columns = "doing action_id on_behalf_of"
    own = ("executing", "t1/2", "robot/B1")
    assert asked("robot_activity", columns, *ROBOTS[:1], *events, at_us=3) == [own, ("helping", "t1/1", None)]
    assert asked("robot_activity", columns, *ROBOTS[:1], *events, at_us=4) == [own]


def test_an_own_step_that_asks_for_help_after_it_failed_is_no_request() -> None:
    own = event("OwnStepDecided", 1, action_id="t1/1.1", decided_by="robot/A1", capability="lift")
    failed = event("ExecutionFailed", 2, action_id="t1/1.1", robot="robot/A1", failure=1)
    asks = event("RegistryQueried", 3, action_id="t1/1.1", requested_by="robot/A1", capability="lift", candidates=[])
    assert asked("requests", "is_request", own, failed, asks, action="t1/1.1") == [(False,)]
    assert asked("requests", "is_request", asks, action="t1/1.1") == [(True,)]


def test_a_robots_own_step_that_a_master_commands_is_no_request_for_another() -> None:
    began = event("StepBegan", 1, action_id="t1/1.1", robot="robot/A1", capability="lift")
    own, other = (event("CommandIssued", 2, action_id="t1/1.1", robot=f"robot/{name}") for name in ("A1", "B1"))
    assert asked("requests", "is_request", began, own, action="t1/1.1") == [(False,)]
    assert asked("requests", "is_request", began, other, action="t1/1.1") == [(True,)]
    assert asked("requests", "is_request", own, action="t1/1.1") == [(True,)]


def test_a_time_that_is_no_number_is_refused() -> None:
    with pytest.raises(QueryFailed, match="noon"):
        asked("trust_at", "robot", trust(1, "A1", "B1", "task"), at_us="noon")


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Database]:
    """A small simulated history: three architectures, two scenarios."""
    ledger = tmp_path_factory.mktemp("audit") / "ledger"
    run_experiment(
        ledger, Experiment(("fsar", "cfc", "dhma"), ("mixed-trust-inspection", "collaborative-delivery"), 3), 1
    )
    with connect(ledger) as database:
        yield database


def everything(real: Database, name: str, **given: str) -> list[dict[str, Any]]:
    return plain_rows(real.query(f"audit/{name}", given))


def test_there_are_at_least_fifteen_questions_that_take_parameters() -> None:
    assert len([name for name in QUESTIONS if library().find(name).parameters]) >= 15


@pytest.mark.parametrize("name", QUESTIONS)
def test_the_example_of_each_question_runs_and_says_what_it_answers(real: Database, name: str) -> None:
    command, _, text = library().find(name).header["Example"].partition(" answers ")
    call, options = shlex.split(command)[:4], shlex.split(command)[4:]
    assert call == ["fsar-ledger", "query", name, "LEDGER"]
    assert text, "the header's Example goes on with `answers` and a part of an answer"
    given = dict(re.findall(r"--param (\w+)=(\S+)", " ".join(options)))
    assert len(options) == 2 * len(given)
    shown = {key: "all" if value == "RUN" else value for key, value in given.items()}
    real.query(name, parameters_of(real, library().find(name), shown))


@pytest.mark.parametrize(
    "name",
    few(
        [name for name in QUESTIONS if "run" in library().find(name).parameters],
        ["audit/decision_owner", "audit/requests", "audit/policy_at", "audit/refusals", "audit/trust_at"],
    ),
)
def test_the_answer_for_one_run_is_that_part_of_the_answer_for_all(real: Database, name: str) -> None:
    given = {"seq": "60"} if name == "audit/decision_owner" else {}
    rows = plain_rows(real.query(name, given))
    one = next((row["run_id"] for row in reversed(rows)), "none")
    assert plain_rows(real.query(name, {**given, "run": one})) == [row for row in rows if row["run_id"] == one]
    assert real.query(name, {**given, "run": "no such run"}).num_rows == 0


def test_the_questions_agree_with_the_facts_on_a_real_ledger(real: Database) -> None:
    pairs = {(row["run_id"], row["action_id"], row["dimension"]) for row in everything(real, "overlapping_claims")}
    assert (
        pairs
        == {(row["run_id"], row["action_id"], row["dimension"]) for row in real.rows("SELECT * FROM conflicts")}
        != set()
    )
    stays = everything(real, "recovery_time")
    (spent,) = real.rows("SELECT sum(resolved_us - detected_us) AS us, count(*) AS failures FROM failures")
    assert sum(row["spent_us"] for row in stays) == spent["us"]
    assert sum(row["is_resolved_here"] for row in stays) == spent["failures"]
    (lacking,) = real.rows("SELECT count(*) AS n FROM coordination_events WHERE NOT is_attributable")
    assert sum(row["unattributed"] for row in everything(real, "unattributed_records")) == lacking["n"] > 0


def test_fsar_skips_no_level_and_each_link_is_trusted_where_the_others_skip(real: Database) -> None:
    skipped = {row["run_id"].partition(".")[0] for row in everything(real, "skipped_levels")}
    assert ("fsar" in skipped, "cfc" in skipped) == (False, True)
    assert {(row["is_trusted"], row["direct_scope"]) for row in everything(real, "relay_links")} == {(True, None)}


def test_every_outsider_of_fsar_was_shown_nobody_for_the_reason_that_the_role_may_not_see_it(real: Database) -> None:
    (injected,) = real.rows("SELECT count(*) AS n FROM outsider_request_injected WHERE run_id LIKE 'fsar.%'")
    reasons = [
        row
        for row in everything(real, "query_candidates")
        if row["action_id"].startswith("injected") and row["reason"] == "not visible to role D"
    ]
    assert len(reasons) == injected["n"] > 0
    assert not any(row["reason"] == "the record gives no reason" for row in everything(real, "query_candidates"))
