"""The timeline of a request and of a failure: given rows, expected rows."""

from typing import Any

import pytest

from fsar_ledger.ledger.rows.schema import LAYOUTS
from fsar_ledger.metrics.database import plain_rows
from tests.queries.histories import Row, S, act, event, run
from tests.queries.test_audit_questions import asked
from tests.recycled import from_rows

A, B, C = "robot/A1", "robot/B1", "robot/C1"


def about(action: str = "t1/1.1", by: str | None = None, **fields: Any) -> dict[str, Any]:
    """The envelope of an event about an action that A asks of B."""
    return {
        "task_id": "t1",
        "action_id": action,
        "requested_by": A,
        "executed_by": B,
        "supervised_by": "supervisor/B1",
        "decided_by": by,
        **fields,
    }


def request(override: str = "none", relay: str | None = None) -> Row:
    return event(
        "RequestIssued", 2 * S, **about(by=A), capability="lift", carried_policy="allow", override=override, relay=relay
    )


def admitted(**fields: Any) -> Row:
    return event("RequestAdmitted", 3 * S, **about(by=B), outcome="allow", **fields)


QUERY = event(
    "RegistryQueried", 1 * S, **about(), capability="lift", candidates=[B], rejected=[C], rejected_by=["trust"]
)
ACCEPTED = event("RequestAccepted", 3 * S, **about(by=B))
STARTED = event("ExecutionStarted", 4 * S, **about(), robot=B, on_behalf_of=A, capability="lift", ends_us=5 * S)
FINISHED = event("ExecutionFinished", 5 * S, **about(), robot=B, result="success", achieved=[])
CLOSED = event("RequestClosed", 6 * S, **about(by="service/coordination"), result="success")
TIMELINE = "step time_s sender receiver kind message note"


def test_a_delegation_is_told_from_the_question_to_the_result() -> None:
    lacks = event("GapDetected", 1 * S, **about(), capability="lift")
    assert asked("request_timeline", TIMELINE, lacks, QUERY, request(), ACCEPTED, STARTED, FINISHED, CLOSED) == [
        (1, 1.0, A, A, "deed", "lacks: lift", None),
        (2, 1.0, A, "service/registry", "message", "query: lift", None),
        (3, 1.0, "service/registry", A, "message", f"candidates: {B}", f"left out: {C} by trust"),
        (4, 2.0, A, B, "message", "request: lift", "carries policy allow"),
        (5, 3.0, B, A, "message", "accept", None),
        (6, 4.0, B, B, "deed", "executes: lift", f"for {A}"),
        (7, 5.0, B, A, "message", "result: success", None),
        (8, 6.0, "service/coordination", A, "message", "close: success", None),
    ]


def test_an_evaluation_shows_trust_and_authority_tuple() -> None:
    told = admitted(trust="task", may_request=True, may_execute=True, override="none", is_audited=True)
    assert asked("request_timeline", "kind message note", told) == [
        ("evaluation", "evaluate: policy allow", "trust task; authority (1, 1, 0, 1)")
    ]
    higher = admitted(trust="session", may_request=True, may_execute=False, override="soft-priority", is_audited=True)
    assert asked("request_timeline", "note", higher) == [("trust session; authority (1, 0, soft-priority, 1)",)]
    assert asked("request_timeline", "note", admitted()) == [(None,)]


def test_a_request_goes_to_its_relay_and_a_registry_that_shows_nobody_says_so() -> None:
    assert asked("request_timeline", "receiver note", request("hard-preempt", C)) == [
        (C, f"carries policy allow; through {C}; override hard-preempt")
    ]
    nobody = event("RegistryQueried", 1 * S, **about(), capability="lift", candidates=[], rejected=[], rejected_by=[])
    assert asked("request_timeline", "message note", nobody)[1] == ("candidates: none", None)


def test_records_without_an_action_belong_to_it_through_their_causes() -> None:
    rows = run(
        act("StepBegan", 1 * S, "t1/1.1", robot=A, step=1, attempt=1, capability="lift", target_role="B"),
        event("GapDetected", 1 * S, task_id="t1", capability="lift"),
        event(
            "CandidateMatched", 2 * S, task_id="t1", decided_by="coordinator", path=["coordinator"], capability="lift"
        ),
        event("CommandIssued", 3 * S, **about(by="coordinator"), robot=B, seen_busy=False),
        event("GapDetected", 9 * S, task_id="t2", capability="carry"),
    )
    rows[-1] = {**rows[-1], "caused_by": 0}
    with from_rows(rows) as database:
        told = plain_rows(database.query("audit/request_timeline", {"action": "t1/1.1"}))
    found = [(row["message"], row["is_tied"]) for row in told]
    assert found == [("lacks: lift", False), ("considers a candidate: lift", False), ("command", True)]


def test_what_the_record_does_not_say_stays_open() -> None:
    call = act("RequestIssued", 1 * S, "t1/1.1", requested_by=A, decided_by="agent/A1/communication", capability="lift")
    assert asked("request_timeline", "sender receiver kind", call) == [("agent/A1/communication", None, "message")]


def test_the_caller_of_a_supervisor_is_the_executor_the_last_decider_or_the_coordinator() -> None:
    review = act("SupervisorCalled", 4 * S, "t1/1.1", supervisor="supervisor/fleet", purpose="review")
    found = asked("request_timeline", "sender receiver message", request(), review)[-1]
    assert found == (B, "supervisor/fleet", "asks to decide: review")
    recovery = {**review, "purpose": "recovery"}
    assert asked("request_timeline", "sender", request(), recovery)[-1] == (A,)
    command = event("CommandIssued", 3 * S, **about(by="coordinator"), robot=C, seen_busy=False)
    of_c = {**review, "robot": C}
    assert asked("request_timeline", "sender", request(), command, of_c)[-1] == ("coordinator",)
    assert asked("request_timeline", "sender", request(), of_c)[-1] == (C,)  # where no coordinator decides


def test_an_order_of_two_requests_stands_in_both_timelines_and_chains() -> None:
    call = act(
        "SupervisorCalled",
        2 * S,
        "t1/1.1",
        supervisor="supervisor/fleet",
        purpose="ordering",
        robot=B,
        competing="t2/1.1",
    )
    answer = event(
        "SupervisorResponded",
        3 * S,
        **about(by="supervisor/fleet"),
        purpose="ordering",
        approves=True,
        preferred="t1/1.1",
    )
    other = event("RequestIssued", 1 * S, **about("t2/1.1", by=C), capability="lift")
    for action in ("t1/1.1", "t2/1.1"):
        told = asked("request_timeline", "message note", request(), other, call, answer, action=action)
        found = told[-2:]
        assert found == [("asks to decide: ordering", "t1/1.1 competes with t2/1.1"), ("decides: t1/1.1 first", None)]
        chain = asked("authority_chain", "deed principal", request(), other, call, answer, action=action)
        assert chain[-1] == ("supervised", "supervisor/fleet")
    assert asked("requests", "supervised_by", other, call, answer, action="t2/1.1") == [("supervisor/fleet",)]


PARTIES = "action_id asked_by allowed_by executed_by supervised_by failures result"


def test_a_request_has_its_parties_and_its_result() -> None:
    assert asked("requests", PARTIES, QUERY, request(), admitted(), STARTED, FINISHED) == [
        ("t1/1.1", A, B, B, "supervisor/B1", 0, "success")
    ]
    assert asked("requests", "began_s ended_s capability", QUERY, request(), admitted(), STARTED, FINISHED) == [
        (1.0, 5.0, "lift")
    ]


def test_what_a_robot_did_while_it_was_alone_has_its_result_once_the_fleet_accepts_it() -> None:
    queued = event("ExecutionQueued", S, **about(executed_by=B), robot=B)
    withdrawn = event("ExecutionWithdrawn", 9 * S, **about(), robot=B)
    for result, told in (("success", ("success", 9.0)), ("failure", ("not begun", None))):
        accepted = event("IsolatedResultAccepted", 9 * S, **about(), robot=B, isolated_run="alone", result=result)
        after = [withdrawn] if result == "success" else []
        assert asked("requests", "result ended_s", queued, accepted, *after, action="t1/1.1") == [told]


def test_a_request_without_an_end_is_told_by_how_far_it_came() -> None:
    denied = event("RequestDenied", 3 * S, **about(by=B), reason="trust")
    nobody = event("RequestUnanswered", 3 * S, **about(by=A, executed_by=None), capability="lift")
    silent = event("RequestUnanswered", 3 * S, **about(by=A), capability="lift")
    assert asked("requests", "result", request()) == [("not begun",)]
    assert asked("requests", "result", request(), STARTED) == [("not finished",)]
    assert asked("requests", "result", request(), denied) == [("denied: trust",)]
    assert asked("requests", "result", {**QUERY, "candidates": []}, nobody) == [("nobody to ask",)]
    assert asked("requests", "result", QUERY, silent) == [("no answer",)]
    assert asked("requests", "result", {**QUERY, "candidates": [B]}, nobody) == [("no answer",)], (
        "some were asked, and the record names none"
    )
    for candidates, reason in (([], "no candidate"), ([B], "no answer")):
        assert asked("refusals", "reason", {**QUERY, "candidates": candidates}, nobody) == [(reason,)]


def test_a_request_that_goes_on_after_a_refusal_or_a_result_has_neither_it_nor_its_end() -> None:
    denied = event("RequestDenied", 3 * S, **about(by=B), reason="trust")
    accepted = event("RequestAccepted", 4 * S, **about(by=C))
    again = {**STARTED, "time_us": 5 * S}
    columns = "result ended_s denied_by"
    assert asked("requests", columns, request(), denied) == [("denied: trust", 3.0, B)]
    assert asked("requests", columns, request(), denied, accepted) == [("not begun", None, B)]
    assert asked("requests", columns, request(), denied, accepted, again) == [("not finished", None, B)]
    departed = {**CLOSED, "time_us": 3 * S, "result": "failure", "cause": "departed"}
    assert asked("requests", columns, request(), departed, accepted, again) == [("not finished", None, None)]
    assert asked("requests", columns, request(), departed, accepted, again, FINISHED) == [("success", 5.0, None)]
    late = {**denied, "time_us": 9 * S}  # another system's record may refuse what was done
    assert asked("requests", columns, request(), STARTED, FINISHED, late) == [("success", 5.0, B)]
    assert asked("requests", columns, request(), STARTED, FINISHED, CLOSED, late) == [("success", 6.0, B)]


def test_a_request_that_its_robot_left_before_it_began_was_withdrawn_and_one_that_began_goes_on() -> None:
    accepted = event("RequestAccepted", 3 * S, **about(by=B))
    withdrawn = event("ExecutionWithdrawn", 4 * S, **about(), robot=B)
    queued = event("ExecutionQueued", 5 * S, **about(executed_by=C), robot=C)
    denied = event("RequestDenied", 5 * S, **about(by=C), reason="trust")
    columns = "result ended_s seq"
    assert asked("requests", columns, request(), accepted, withdrawn) == [("withdrawn", 4.0, 3)]
    assert asked("requests", columns, request(), accepted, withdrawn, queued) == [("not begun", None, None)]
    assert asked("requests", columns, request(), accepted, withdrawn, denied) == [("denied: trust", 5.0, 4)]
    assert asked("requests", columns, request(), withdrawn, denied) == [("denied: trust", 5.0, 3)]
    early = {**denied, "time_us": 2 * S}
    assert asked("requests", columns, request(), early, accepted, withdrawn) == [("withdrawn", 4.0, 4)]
    assert asked("requests", columns, request(), accepted, STARTED, withdrawn) == [("not finished", None, None)]


def test_a_request_that_ended_because_a_robot_departed_says_so() -> None:
    withdrawn = event("ExecutionWithdrawn", 6 * S, **about(), robot=B)
    departed = {**CLOSED, "result": "failure", "cause": "departed"}
    assert asked("requests", "result seq", request(), admitted(), withdrawn, departed) == [("failure(departed)", 4)]
    assert asked("request_timeline", "message", request(), departed)[-1] == ("close: failure(departed)",)


def test_who_orders_an_own_step_allows_it_and_does_not_do_it_itself() -> None:
    ordered = event("OwnStepDecided", 2 * S, task_id="t1", decided_by="coordinator", executed_by=B, capability="lift")
    claimed = event("AuthorityClaimed", 2 * S, **about(), dimension="execution", claimant="coordinator")
    told = asked("request_timeline", "sender receiver message", ordered, claimed)
    assert told == [("coordinator", B, "own step: lift")]
    failed = event("ExecutionFailed", 4 * S, **about(), robot=B, failure=1, cause="obstruction")
    assert asked("requests", "allowed_by", ordered, claimed, failed) == [("coordinator",)]
    own = event("OwnStepDecided", 2 * S, **about(by=A, executed_by=None), capability="lift")
    assert asked("request_timeline", "sender receiver message", own) == [(A, A, "own step: lift")]
    for_nobody = {**own, "decided_by": "coordinator"}
    assert asked("request_timeline", "sender receiver", for_nobody) == [("coordinator", None)]


def test_who_finishes_has_executed_though_the_record_began_later_or_named_no_supervisor_before() -> None:
    finished = event("ExecutionFinished", 5 * S, **{**about(), "executed_by": B, "supervised_by": "supervisor/B1"})
    done = [(B, "supervisor/B1")]
    assert asked("requests", "executed_by supervised_by", finished, action="t1/1.1") == done
    off_shift = {**STARTED, "executed_by": B, "supervised_by": None}
    assert asked("requests", "executed_by supervised_by", request(), off_shift, finished) == done
    unnamed = {**finished, "executed_by": None, "supervised_by": None}
    assert asked("requests", "executed_by supervised_by", unnamed, action="t1/1.1") == [(None, None)]


def test_only_approval_allows_and_unknown_principals_stay_open() -> None:
    refusal = event("SupervisorResponded", 4 * S, **about(by="supervisor/fleet"), purpose="review", approves=False)
    assert asked("requests", "allowed_by supervised_by", request(), refusal) == [(None, "supervisor/fleet")]
    approval = {**refusal, "approves": True}
    assert asked("requests", "allowed_by", request(), admitted(), approval) == [(f"{B} and supervisor/fleet",)]
    assert asked("requests", "executed_by", request(), {**STARTED, "executed_by": None}) == [(None,)]


def test_an_outsiders_attempt_is_a_request_even_where_no_record_names_an_action() -> None:
    attempt = event("OutsiderRequestInjected", 1 * S, task_id="x1", robot=C, peer=B, capability="lift")
    refused = event("RequestDenied", 2 * S, task_id="x1", decided_by="coordinator", reason="trust")
    assert asked("requests", "action_id asked_by result", attempt, refused) == [("x1", C, "denied: trust")]
    found = asked("request_timeline", "message", attempt, refused, action="x1")
    assert found == [("attempts without trust: lift",), ("deny: trust",)]


def test_an_own_step_is_listed_when_it_fails_or_is_asked_for() -> None:
    own = event("OwnStepDecided", 1 * S, **about(by=A), capability="walk")
    failed = act(
        "ExecutionFailed", 2 * S, "t1/1.1", robot=A, failure=1, cause="obstruction", remaining_us=1, detected_us=2 * S
    )
    assert asked("requests", "failures", own) == []
    assert asked("requests", "failures", own, action="t1/1.1") == [(0,)]
    assert asked("requests", "failures", own, failed) == [(1,)]


def test_a_failure_of_an_own_step_is_told_also_where_the_run_does_not_observe_all_failures() -> None:
    own = event("OwnStepDecided", 0, **about(by=A, executed_by=A, requested_by=A))
    for events, failures in (((own,), None), ((own, failed(S)), 1)):
        with from_rows(run(*events, kind="foreign", observes=[], records=["ExecutionFailed"])) as database:
            rows = database.query("audit/requests", {"action": "t1/1.1"}).to_pylist()
            assert [row["failures"] for row in rows] == [failures]
            assert len(database.query("audit/requests").to_pylist()) == (failures or 0)


def failed(time_us: int, number: int = 1) -> Row:
    return act("ExecutionFailed", time_us, "t1/1.1", robot=B, failure=number, cause="degradation", detected_us=time_us)


SILENT = {  # what names an action and is not told: claims, queues, plans and motivations are behind the deeds that are
    "ActivityBroadcast",
    "ActivityHeard",
    "AuthorityReleased",
    "BidReceived",
    "ExecutionQueued",
    "IsolatedResultAccepted",  # of a step of its own
    "IsolatedResultOvertaken",
    "MotivationBegan",
    "NeedEnded",
    "StepBegan",
    "StepCompleted",
    "WorkQueued",
}


def test_every_event_of_an_action_is_told_or_is_known_to_be_silent() -> None:
    with from_rows([]) as database:
        told = {row["type"] for row in database.rows("SELECT DISTINCT type FROM message_words")}
    acting = {
        tag
        for tag, layout in LAYOUTS.items()
        if {"action_id", "failed_action"} & {field.name for field in layout.fields}
    }
    assert {tag.partition(".")[0] for tag in acting - told} == SILENT
    assert told <= set(LAYOUTS)


@pytest.mark.parametrize(
    ("name", "fields", "expected"),
    [
        (
            "RequestCountered",
            {"decided_by": B, "override": "soft-priority", "round": 1},
            (B, A, "counter-offer: soft-priority"),
        ),
        ("OfferAnswered", {"decided_by": A, "is_accepted": True, "round": 1}, (A, B, "answers the offer: accepted")),
        ("OfferAnswered", {"decided_by": A, "is_accepted": False, "round": 1}, (A, B, "answers the offer: let go")),
        (
            "OfferAnswered",
            {"decided_by": A, "is_accepted": False, "override": "none", "round": 1},
            (A, B, "answers the offer: asks none"),
        ),
        ("RequestRelayed", {"decided_by": C, "carried_policy": "allow"}, (C, B, "passes the request on")),
        (
            "PolicyConflictEscalated",
            {"decided_by": "service/policy", "local": "deny", "fleet": "allow"},
            ("service/policy", "supervisor/B1", "policy conflict"),
        ),
        ("AuthorityClaimed", {"claimant": A, "dimension": "override", "reason": "revocation"}, (A, A, "revokes")),
        ("ExecutionPreempted", {"robot": B, "preempted_by": "t2/1.1"}, (B, B, "gives way")),
        (
            "ExecutionHeld",
            {"robot": B, "outcome": "deny", "reason": "local policy"},
            (B, B, "waits, policy says: deny"),
        ),
        (
            "SupervisorResponded",
            {"decided_by": "supervisor/fleet", "purpose": "review", "approves": True},
            ("supervisor/fleet", B, "decides: approved"),
        ),
        (
            "SupervisorResponded",
            {"decided_by": "supervisor/fleet", "purpose": "review", "approves": False},
            ("supervisor/fleet", B, "decides: refused"),
        ),
        ("AssistanceRequested", {"decided_by": B, "robot": B, "helper": C, "level": "peer"}, (B, C, "asks for help")),
        ("AssistanceAdmitted", {"decided_by": C, "robot": B, "helper": C, "level": "peer"}, (C, B, "agrees to help")),
        ("AssistanceDeclined", {"robot": B, "helper": C}, (C, B, "declines")),
        (
            "ReassignmentDecided",
            {"decided_by": "service/recovery", "robot": B, "helper": C, "checkpoint": "t1/2"},
            ("service/recovery", C, "reassigns: t1/2"),
        ),
        (
            "ReassignmentDecided",
            {"decided_by": "service/recovery", "robot": B},
            ("service/recovery", "service/recovery", "reassigns: not feasible"),
        ),
        ("TaskStateTransferred", {"robot": B, "helper": C, "checkpoint": "t1/2"}, (B, C, "state of the task: t1/2")),
        (
            "RecoveryEscalated",
            {"decided_by": B, "level": "local", "to_level": "peer"},
            (B, B, "recovery goes on: local to peer"),
        ),
        (
            "ExecutionFinished",
            {"robot": B, "result": "partial", "achieved": ["door.unlocked"]},
            (B, A, "result: partial"),
        ),
    ],
)
def test_each_event_is_told_by_whom_to_whom_in_its_words(
    name: str, fields: dict[str, Any], expected: tuple[str, str, str]
) -> None:
    assert asked("request_timeline", "sender receiver message", event(name, 1 * S, **{**about(), **fields})) == [
        expected
    ]


def test_a_claim_that_revokes_nothing_is_not_told() -> None:
    claim = act("AuthorityClaimed", 1 * S, "t1/1.1", claimant=A, dimension="override", reason="acceptance")
    assert asked("request_timeline", "message", claim) == []


def test_without_a_registry_the_requester_asks_itself_whom_it_met_and_a_copy_says_its_age() -> None:
    with from_rows(run(QUERY, configuration="without-shared-registry")) as database:
        found = [(row["sender"], row["receiver"]) for row in plain_rows(database.query("audit/request_timeline"))]
        assert found == [(A, A), (A, A)]
    copied = {**QUERY, "domain": "hall/cell", "as_of_us": S // 2, "rejected": [], "rejected_by": []}
    assert asked("request_timeline", "note", copied)[1] == ("in hall/cell; as of 0.5 s",)


def test_what_a_supervisor_denies_is_no_denial_of_the_robot_with_that_name() -> None:
    events = (
        event("RobotJoined", robot=B),
        act("RequestDenied", 1, "t1/1", executed_by=C, decided_by="supervisor/B1", reason="policy"),
        act("RequestDenied", 2, "t1/1", executed_by=C, decided_by="agent/B1/planning", reason="policy"),
    )
    assert asked("denials", "denied_by", *events, robot=B) == [("agent/B1/planning",)]
