"""The audit questions about authority, recovery, claims and refusals: given rows, expected rows, the boundary first."""

from typing import Any

import pytest

from fsar_ledger.metrics.database import plain_rows
from tests.queries.histories import Row, S, answer, event, run
from tests.queries.test_audit_questions import asked, trust
from tests.recycled import from_rows


def claimed(
    name: str,
    time_s: int,
    claimant: str,
    reason: str = "acceptance",
    dimension: str = "override",
    action_id: str = "t1/1",
) -> Row:
    return event(
        f"Authority{name}", time_s * S, action_id=action_id, dimension=dimension, claimant=claimant, reason=reason
    )


def failure(name: str, time_us: int, **fields: Any) -> Row:
    return event(name, time_us, **{"failure": 1, "failed_action": "t1/1", **fields})


FAILED = event("ExecutionFailed", 10, action_id="t1/1", failure=1, robot="robot/B1")


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


def test_the_authority_chain_has_what_only_its_cause_or_its_effect_ties_to_the_action() -> None:
    events = (
        event("GapDetected", 1, action_id="t1/1"),
        event("RequestDenied", 2, decided_by="coordinator", reason="policy"),  # its cause names the action
        event("OwnStepDecided", 3, decided_by="coordinator"),  # what it caused does
        event("ExecutionStarted", 4, action_id="t1/1", executed_by="robot/B1"),
        event("OutsiderRequestInjected", 5, task_id="t2", robot="robot/X1"),
        event("RequestDenied", 6, task_id="t2", decided_by="robot/B1", reason="trust"),
    )
    assert asked("authority_chain", "time_us action_id deed principal", *events) == [
        (2, "t1/1", "denied", "coordinator"),
        (3, "t1/1", "decided", "coordinator"),
        (4, "t1/1", "acted", "robot/B1"),
        (6, "t2", "denied", "robot/B1"),
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


@pytest.mark.parametrize(
    ("kind", "owner"),
    [
        ("foreign", (1, "RequestAdmitted.v1", None, None)),  # somebody decided, whom the other system does not name
        ("simulated", (2, "RequestIssued.v1", "robot/A1", True)),  # what has no path is no decision
    ],
)
def test_a_decision_of_whom_the_record_names_nobody_is_not_laid_to_who_decided_before(
    kind: str, owner: tuple[object, ...]
) -> None:
    events = (
        event("RequestIssued", 1, decided_by="robot/A1", path=["robot/A1"]),
        event("RequestAdmitted", 2, path=[]),
        event("ApproachStarted", 3),
    )
    with from_rows(run(*events, kind=kind)) as database:
        [found] = plain_rows(database.query("audit/decision_owner", {"seq": "3"}))
    assert (found["steps"], found["decision_type"], found["decided_by"], found["is_local"]) == owner


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
    found = asked("relay_links", links, *chain, relayed)
    assert found == [first, (2, "robot/B1", "robot/C1", "session", True, None, 6)]
    assert asked("relay_links", links, *chain) == [first, (2, "robot/B1", "robot/C1", "session", True, None, None)]
    told = asked("relay_links", links, *chain, trust(5, "C1", "B1", "none"), relayed)[1]
    assert told == (2, "robot/B1", "robot/C1", "none", False, None, 6)
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
    found = asked("recovery_moves", "move time_us from_level level", *events)
    assert found == [(1, 11, None, "local"), (2, 20, "local", "peer")]


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


@pytest.mark.parametrize(("other_s", "expected"), [(4, [(4 * S, 5 * S)]), (5, []), (6, [])])
def test_claims_overlap_until_just_before_the_release(other_s: int, expected: list[tuple[int, int]]) -> None:
    events = [
        claimed("Claimed", 1, "robot/A1"),
        claimed("Released", 5, "robot/A1"),
        claimed("Claimed", other_s, "robot/B1"),
    ]
    found = asked("overlapping_claims", "from_us until_us", *sorted(events, key=lambda row: str(row["time_us"])))
    assert found == expected


def test_claims_of_one_claimant_other_dimensions_or_other_actions_do_not_overlap() -> None:
    one = claimed("Claimed", 1, "robot/A1")
    for other in (
        claimed("Claimed", 2, "robot/A1", "again"),
        claimed("Claimed", 2, "robot/B1", dimension="audit"),
        claimed("Claimed", 2, "robot/B1", action_id="t1/2"),
    ):
        assert asked("overlapping_claims", "from_us", one, other) == []
    assert asked("overlapping_claims", "from_us until_us", one, claimed("Claimed", 2, "robot/B1")) == [(2 * S, None)]
    assert (
        asked(
            "overlapping_claims", "from_us", one, claimed("Claimed", 2, "robot/B1"), claimed("Released", 2, "robot/B1")
        )
        == []
    ), "never held"


def test_no_two_claims_overlap_where_the_run_does_not_record_when_claims_end() -> None:
    both = (claimed("Claimed", 1, "robot/A1"), claimed("Claimed", 2, "robot/B1"))
    for records, found in ((["AuthorityClaimed"], []), (["AuthorityClaimed", "AuthorityReleased"], [(2 * S,)])):
        rows = run(*both, kind="foreign", observes=[], records=records)
        assert answer("overlapping_claims", rows, columns=("from_us",)) == found


def test_a_revocation_takes_effect_at_its_release_after_the_boundary() -> None:
    events = (
        claimed("Claimed", 1, "robot/B1", dimension="execution"),
        claimed("Claimed", 3, "robot/A1", "revocation"),
        event("ExecutionFinished", 8 * S, action_id="t1/1"),
        claimed("Released", 9, "robot/B1", dimension="execution"),
        claimed("Released", 9, "robot/A1", "revocation"),
    )
    columns = "revoked_by revoked_from revoked_us effective_us waited_us boundary"
    assert asked("revocations", columns, *events) == [
        ("robot/A1", "robot/B1", 3 * S, 9 * S, 6 * S, "ExecutionFinished.v1")
    ]
    assert asked("revocations", columns, *events[:3]) == [("robot/A1", "robot/B1", 3 * S, None, None, None)]
    assert asked("revocations", columns, events[1]) == [("robot/A1", None, 3 * S, None, None, None)]
    assert asked("revocations", columns, events[0]) == []


def test_refusals_are_counted_by_type_reason_and_decider() -> None:
    denied = event("RequestDenied", 1, reason="policy", decided_by="robot/B1")
    events = (denied, {**denied, "time_us": 2}, {**denied, "time_us": 3, "decided_by": "robot/C1"})
    others = (
        event("RequestUnanswered", 4, decided_by="robot/A1"),
        event("AssistanceDeclined", 5, helper="robot/C1", robot="robot/B1"),
    )
    assert asked("refusals", "reason decided_by refusals first_us last_us", *events, *others) == [
        ("helper declined", "robot/C1", 1, 5, 5),
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
