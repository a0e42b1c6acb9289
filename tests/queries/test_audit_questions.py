"""The named audit questions: given rows, expected rows, the boundary first; then a real ledger."""

import re
import shlex
from collections.abc import Iterator
from typing import Any

import pytest

from fsar_ledger.errors import QueryFailed
from fsar_ledger.metrics.database import Database, connect, plain_rows
from fsar_ledger.metrics.library import library
from fsar_ledger.runtime.experiment import Experiment, simulate
from tests.queries.histories import Row, event, run
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


def claimed(
    name: str,
    time_us: int,
    claimant: str,
    reason: str = "acceptance",
    dimension: str = "override",
    action_id: str = "t1/1",
) -> Row:
    return event(
        f"Authority{name}", time_us, action_id=action_id, dimension=dimension, claimant=claimant, reason=reason
    )


def failure(name: str, time_us: int, **fields: Any) -> Row:
    return event(name, time_us, **{"failure": 1, "failed_action": "t1/1", **fields})


FAILED = event("ExecutionFailed", 10, action_id="t1/1", failure=1, robot="robot/B1")


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
    ("at_us", "expected"),
    [
        (11, []),
        (12, [("deny", 10, "deny", False)]),
        (20, [("deny", 10, "allow", True)]),
        (22, [("allow", 20, "allow", False)]),
    ],
)
def test_a_robot_knows_the_fleet_rule_from_the_moment_it_is_told(at_us: int, expected: list[tuple[Any, ...]]) -> None:
    window = {"robot": "robot/B1", "scope": "fleet", "window": "w1"}
    events = (
        event("PolicyWindowOpened", 10, **window, outcome="deny"),
        event("FleetRuleLearned", 12, robot="robot/B1", outcome="deny", as_of_us=10),
        event("PolicyWindowClosed", 20, **window),
        event("FleetRuleLearned", 22, robot="robot/B1", outcome="allow", as_of_us=20),
    )
    assert asked("policy_known_at", "known_outcome as_of_us true_outcome is_wrong", *events, at_us=at_us) == expected


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


def test_the_authority_chain_names_each_part_in_order_and_no_other_action() -> None:
    parties = {"action_id": "t1/1", "requested_by": "robot/A1", "executed_by": "robot/B1"}
    events = (
        event("RequestIssued", 1, **parties, decided_by="robot/A1"),
        event("RequestRelayed", 2, **parties, decided_by="robot/C1"),
        event("RequestAdmitted", 3, **parties, decided_by="robot/B1"),
        event("RequestAccepted", 4, **parties, decided_by="robot/B1"),
        event("ApproachStarted", 5, action_id="t1/1"),
        event("ExecutionStarted", 6, **parties),
        event("RecoveryAttempted", 7, failed_action="t1/1", decided_by=None),
        event("RequestClosed", 8, **parties, decided_by="service/coordination"),
        event("RequestIssued", 9, action_id="t1/2", decided_by="robot/B1"),
    )
    assert asked("authority_chain", "time_us deed principal", *events, action="t1/1") == [
        (1, "asked", "robot/A1"),
        (2, "relayed", "robot/C1"),
        (3, "admitted", "robot/B1"),
        (4, "accepted", "robot/B1"),
        (6, "acted", "robot/B1"),
        (7, "recovered", None),
        (8, "closed", "service/coordination"),
    ]


def test_the_owner_is_the_nearest_decision_on_the_way_back() -> None:
    events = (
        event("RequestIssued", 1, decided_by="robot/A1", path=["robot/A1"]),
        event("RequestAdmitted", 2, decided_by="robot/B1", path=["robot/A1", "robot/B1"]),
        event("ApproachStarted", 3),
    )
    owner = "steps decision_type decided_by is_local"
    assert asked("decision_owner", owner, *events, seq=0) == [(None, None, None, None)]
    assert asked("decision_owner", owner, *events, seq=1) == [(0, "RequestIssued.v1", "robot/A1", True)]
    assert asked("decision_owner", owner, *events, seq=2) == [(0, "RequestAdmitted.v1", "robot/B1", False)]
    assert asked("decision_owner", owner, *events, seq=3) == [(1, "RequestAdmitted.v1", "robot/B1", False)]
    assert asked("decision_owner", owner, *events, seq=4) == []
    assert asked("decision_owner", owner, *events[:2], {**events[2], "caused_by": 1}, seq=3) == [
        (1, "RequestIssued.v1", "robot/A1", True)
    ]
    assert asked("decision_owner", "steps", {**event("ApproachStarted", 1), "caused_by": 1}, seq=1) == [(None,)], (
        "a forged circle ends"
    )


def test_a_supervisor_is_off_shift_from_leaving_until_returning() -> None:
    def record(time_us: int, supervisor: str | None = "supervisor/A1") -> Row:
        return event("RequestIssued", time_us, action_id="t1/1", supervised_by=supervisor)

    left, back = (
        event("SupervisorLeft", 2, supervisor="supervisor/A1"),
        event("SupervisorReturned", 4, supervisor="supervisor/A1"),
    )
    rows = asked(
        "supervisor_of",
        "supervised_by first_us last_us records records_off_shift",
        record(1),
        left,
        record(3),
        back,
        record(5),
        record(6, None),
    )
    assert sorted(rows, key=str) == [("supervisor/A1", 1, 5, 3, 1), (None, 6, 6, 1, None)]
    other = event("SupervisorLeft", 2, supervisor="supervisor/B1")
    assert asked("supervisor_of", "records_off_shift", other, record(3)) == [(0,)], "another supervisor left"


def test_executions_in_a_review_need_an_earlier_approval() -> None:
    window = {"robot": "robot/B1", "scope": "local", "window": "w1"}
    opened = event("PolicyWindowOpened", 1, **window, outcome="review")
    called = event("SupervisorCalled", 2, action_id="t1/1", purpose="review", supervisor="supervisor/fleet")
    approved = event("SupervisorResponded", 3, action_id="t1/1", purpose="review")
    started = event("ExecutionStarted", 4, action_id="t1/1", robot="robot/B1", on_behalf_of="robot/A1")
    unapproved = "started_us action_id called_us"
    assert asked("unapproved_executions", unapproved, opened, started) == [(4, "t1/1", None)]
    assert asked("unapproved_executions", unapproved, opened, called, started, approved) == [(4, "t1/1", 2)]
    assert asked("unapproved_executions", unapproved, opened, called, approved, started) == []
    assert asked("unapproved_executions", unapproved, started) == []
    assert asked("unapproved_executions", unapproved, {**opened, "outcome": "deny"}, started) == [], (
        "a denial is another question"
    )


def test_each_link_of_a_chain_is_judged_by_the_trust_of_its_receiver_as_of_then() -> None:
    request = event(
        "RequestIssued", 5, action_id="t1/1", requested_by="robot/A1", relay="robot/B1", executed_by="robot/C1"
    )
    relayed = event("RequestRelayed", 6, action_id="t1/1")
    links = "link sender receiver link_scope is_trusted direct_scope passed_us"
    chain = (trust(1, "B1", "A1", "task"), trust(1, "C1", "B1", "session"), request)
    first = (1, "robot/A1", "robot/B1", "task", True, None, 5)
    assert asked("relay_links", links, *chain, relayed) == [
        first,
        (2, "robot/B1", "robot/C1", "session", True, None, 6),
    ]
    assert asked("relay_links", links, *chain) == [first, (2, "robot/B1", "robot/C1", "session", True, None, None)]
    assert asked("relay_links", links, *chain, trust(5, "C1", "B1", "none"), relayed)[1] == (
        2,
        "robot/B1",
        "robot/C1",
        "none",
        False,
        None,
        6,
    )
    assert (
        asked(
            "relay_links",
            "is_trusted direct_scope",
            trust(1, "A1", "B1", "task"),
            trust(1, "C1", "A1", "task"),
            request,
        )
        == [(False, "task")] * 2
    )
    assert asked("relay_links", links, {**request, "relay": None}) == []


@pytest.mark.parametrize(
    ("level", "to_level", "expected"),
    [
        ("local", "peer", []),
        ("local", "fleet", [("local", "fleet", ["peer"], False)]),
        ("local", "human", [("local", "human", ["peer", "fleet"], False)]),
        ("local", "local", []),
    ],
)
def test_a_move_to_any_level_but_the_next_left_one_out(
    level: str, to_level: str, expected: list[tuple[Any, ...]]
) -> None:
    events = (
        FAILED,
        failure("RecoveryAttempted", 11, level=level),
        failure("RecoveryEscalated", 12, level=level, to_level=to_level),
    )
    assert asked("skipped_levels", "from_level to_level skipped is_backwards", *events) == expected


def test_recovery_that_starts_late_or_goes_back_is_found() -> None:
    moves = "from_level to_level skipped is_backwards"
    assert asked("skipped_levels", moves, FAILED, failure("AssistanceRequested", 11, level="peer")) == [
        (None, "peer", ["local"], False)
    ]
    back = (
        failure("RecoveryAttempted", 11, level="local"),
        failure("AssistanceRequested", 12, level="peer"),
        failure("RecoveryAttempted", 13, level="local"),
    )
    assert asked("skipped_levels", moves, FAILED, *back) == [("peer", "local", [], True)]
    assert asked("skipped_levels", moves, *back[:1], {**back[1], "failure": 2}) == [(None, "peer", ["local"], False)], (
        "another failure begins anew"
    )


def test_time_at_each_level_runs_from_detection_to_resolution() -> None:
    events = (
        FAILED,
        failure("RecoveryAttempted", 11, level="local", number=1),
        failure("RecoveryAttempted", 15, level="local", number=2),
        failure("RecoveryEscalated", 20, level="local", to_level="peer"),
        failure("AssistanceRequested", 21, level="peer"),
        event("FailureResolved", 27, action_id="t1/1", failure=1, level="peer"),
    )
    stays = "level entered_us left_us spent_us attempts is_resolved_here"
    assert asked("recovery_time", stays, *events) == [("local", 10, 20, 10, 2, False), ("peer", 20, 27, 7, 0, True)]
    assert asked("recovery_time", stays, *events[:-1])[1] == ("peer", 20, None, None, 0, False), "not resolved"
    assert asked("recovery_time", stays, *events[:2]) == [("local", 10, None, None, 1, False)]
    assert asked("recovery_moves", "move time_us from_level level", *events) == [
        (1, 11, None, "local"),
        (2, 20, "local", "peer"),
    ]


def test_records_without_a_principal_are_counted_by_kind() -> None:
    named = {"requested_by": "robot/A1", "executed_by": "robot/B1", "supervised_by": "supervisor/B1"}
    events = (
        event("BidSubmitted", 1, **named),
        event("BidSubmitted", 2, **{**named, "executed_by": None}),
        event("AwardMade", 3, **named),
    )
    columns = "record_kind records unattributed without_origin without_executor without_supervisor"
    assert asked("unattributed_records", columns, *events) == [("bid", 2, 1, 0, 1, 0)]
    assert asked("unattributed_records", columns, *events, kind="award") == []


@pytest.mark.parametrize(("other_us", "expected"), [(4, [(4, 5)]), (5, []), (6, [])])
def test_claims_overlap_until_just_before_the_release(other_us: int, expected: list[tuple[int, int]]) -> None:
    events = [
        claimed("Claimed", 1, "robot/A1"),
        claimed("Released", 5, "robot/A1"),
        claimed("Claimed", other_us, "robot/B1"),
    ]
    assert (
        asked("overlapping_claims", "from_us until_us", *sorted(events, key=lambda row: str(row["time_us"])))
        == expected
    )


def test_claims_of_one_claimant_other_dimensions_or_other_actions_do_not_overlap() -> None:
    one = claimed("Claimed", 1, "robot/A1")
    for other in (
        claimed("Claimed", 2, "robot/A1", "again"),
        claimed("Claimed", 2, "robot/B1", dimension="audit"),
        claimed("Claimed", 2, "robot/B1", action_id="t1/2"),
    ):
        assert asked("overlapping_claims", "from_us", one, other) == []
    assert asked("overlapping_claims", "from_us until_us", one, claimed("Claimed", 2, "robot/B1")) == [(2, None)]
    assert (
        asked(
            "overlapping_claims", "from_us", one, claimed("Claimed", 2, "robot/B1"), claimed("Released", 2, "robot/B1")
        )
        == []
    ), "never held"


def test_a_revocation_takes_effect_at_its_release_after_the_boundary() -> None:
    events = (
        claimed("Claimed", 1, "robot/B1", dimension="execution"),
        claimed("Claimed", 3, "robot/A1", "revocation"),
        event("ExecutionFinished", 8, action_id="t1/1"),
        claimed("Released", 9, "robot/B1", dimension="execution"),
        claimed("Released", 9, "robot/A1", "revocation"),
    )
    columns = "revoked_by revoked_from revoked_us effective_us waited_us boundary"
    assert asked("revocations", columns, *events) == [("robot/A1", "robot/B1", 3, 9, 6, "ExecutionFinished.v1")]
    assert asked("revocations", columns, *events[:3]) == [("robot/A1", "robot/B1", 3, None, None, None)]
    assert asked("revocations", columns, events[1]) == [("robot/A1", None, 3, None, None, None)]
    assert asked("revocations", columns, events[0]) == []


def test_refusals_are_counted_by_type_reason_and_decider() -> None:
    denied = event("RequestDenied", 1, reason="policy", decided_by="robot/B1")
    events = (denied, {**denied, "time_us": 2}, {**denied, "time_us": 3, "decided_by": "robot/C1"})
    others = (
        event("RequestUnanswered", 4, decided_by="robot/A1"),
        event("AssistanceDeclined", 5, helper="robot/C1", robot="robot/B1"),
    )
    assert asked("refusals", "reason decided_by refusals first_us last_us", *events, *others) == [
        ("helper busy", "robot/C1", 1, 5, 5),
        ("policy", "robot/B1", 2, 1, 2),
        ("policy", "robot/C1", 1, 3, 3),
        ("no candidate", "robot/A1", 1, 4, 4),
    ]
    assert asked("refusals", "refusals", *events, *others, reason="no candidate") == [(1,)]


def test_a_decision_of_a_supervisor_answers_the_last_call_for_its_purpose() -> None:
    def called(time_us: int, purpose: str = "review") -> Row:
        return event("SupervisorCalled", time_us, action_id="t1/1", purpose=purpose, supervisor="supervisor/fleet")

    decided = event("SupervisorResponded", 9, action_id="t1/1", purpose="review", decided_by="supervisor/fleet")
    columns = "decided_by called_us decided_us waited_us"
    assert asked("supervisor_decisions", columns, called(1), called(4), called(5, "recovery"), decided, called(10)) == [
        ("supervisor/fleet", 4, 9, 5)
    ]
    assert asked("supervisor_decisions", columns, called(5, "recovery"), decided) == [
        ("supervisor/fleet", None, 9, None)
    ]
    assert asked("supervisor_decisions", columns, decided, supervisor="supervisor/A1") == []


@pytest.mark.parametrize(
    ("at_us", "doing"),
    [
        (0, "idle"),
        (1, "queued"),
        (2, "held by policy"),
        (3, "executing"),
        (4, "recovering"),
        (5, "executing"),
        (6, "paused"),
        (7, "executing"),
        (8, "idle"),
    ],
)
def test_a_robot_does_what_its_last_event_by_then_says(at_us: int, doing: str) -> None:
    names = ("Queued", "Held", "Started", "Failed", "Resumed", "Paused", "Resumed", "Finished")
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


def test_a_time_that_is_no_number_is_refused() -> None:
    with pytest.raises(QueryFailed, match="noon"):
        asked("trust_at", "robot", trust(1, "A1", "B1", "task"), at_us="noon")


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Database]:
    """A small simulated history: three architectures, two scenarios."""
    ledger = tmp_path_factory.mktemp("audit") / "ledger"
    simulate(ledger, Experiment(("fsar", "cfc", "dhma"), ("mixed-trust-inspection", "collaborative-delivery"), 3), 1)
    with connect(ledger) as database:
        yield database


def everything(real: Database, name: str, **given: str) -> list[dict[str, Any]]:
    return plain_rows(real.query(f"audit/{name}", given))


def test_there_are_at_least_fifteen_questions_that_take_parameters() -> None:
    assert len([name for name in QUESTIONS if library().find(name).parameters]) >= 15


@pytest.mark.parametrize("name", QUESTIONS)
def test_the_example_of_each_question_runs_and_says_what_it_answers(real: Database, name: str) -> None:
    command, answers, text = library().find(name).header["Example"].partition(" answers ")
    call, options = shlex.split(command)[:4], shlex.split(command)[4:]
    assert (call, bool(answers and text)) == (["fsar-ledger", "query", name, "LEDGER"], True)
    given = dict(re.findall(r"--param (\w+)=(\S+)", " ".join(options)))
    assert len(options) == 2 * len(given)
    real.query(name, {key: "all" if value == "RUN" else value for key, value in given.items()})


@pytest.mark.parametrize("name", [name for name in QUESTIONS if "run" in library().find(name).parameters])
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
    assert (sum(row["spent_us"] for row in stays), sum(row["is_resolved_here"] for row in stays)) == (
        spent["us"],
        spent["failures"],
    )
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
