"""Audit questions about requests and rights: evaluations, refusals by conjunct, chains, revocations; given rows,
expected rows."""

from typing import Any

import pytest

from fsar_ledger.events import CONCERNS
from tests.queries.histories import Row, answer, event, run
from tests.queries.test_audit_questions import ROBOTS, asked
from tests.recycled import from_rows


def request(time_us: int, action_id: str, requester: str, executor: str, **fields: Any) -> Row:
    about = {"task_id": "visit", "capability": "lift", "override": "none", "decided_by": f"robot/{requester}", **fields}
    return event(
        "RequestIssued",
        time_us,
        action_id=action_id,
        requested_by=f"robot/{requester}",
        executed_by=f"robot/{executor}",
        **about,
    )


def judged(time_us: int, action_id: str, verdict: str, executor: str, **fields: Any) -> Row:
    return event(
        f"Request{verdict}",
        time_us,
        action_id=action_id,
        decided_by=f"robot/{executor}",
        executed_by=f"robot/{executor}",
        **fields,
    )


def right(time_us: int, verb: str, requester: str, executor: str | None = None, **fields: Any) -> Row:
    about = {"executed_by": executor and f"robot/{executor}", "decided_by": "supervisor/fleet", **fields}
    return event(f"Authority{verb}", time_us, requested_by=f"robot/{requester}", **about)


def trust(time_us: int, robot: str, peer: str, scope: str, **about: Any) -> Row:
    return event("TrustSet", time_us, robot=f"robot/{robot}", peer=f"robot/{peer}", scope=scope, **about)


ADMITTED = {"trust": "task", "may_request": True, "may_execute": True, "override": "none", "is_audited": True}


def test_an_evaluation_stands_beside_the_last_request_of_its_action() -> None:
    events = (
        judged(1, "q1", "Denied", "B1", reason="policy"),
        request(2, "q1", "A1", "B1", override="hard-preempt"),
        judged(3, "q1", "Countered", "B1", override="soft-priority"),
        request(4, "q1", "A1", "B1", override="soft-priority"),
        judged(5, "q1", "Admitted", "B1", **{**ADMITTED, "override": "soft-priority"}),
        judged(6, "q2", "Admitted", "B1", **ADMITTED),
    )
    columns = ("seq", "asked_seq", "verdict", "override_asked", "override", "may_request", "trust", "context")
    assert sorted(answer("facts/evaluations", run(*events), columns=columns)) == [
        (3, 2, "countered", "hard-preempt", "soft-priority", None, None, "visit"),
        (5, 4, "admitted", "soft-priority", "soft-priority", True, "task", "visit"),
    ]


@pytest.mark.parametrize(
    ("reason", "conjunct"),
    [
        ("possession", "possession"),
        ("advertisement", "advertisement"),
        ("trust", "trust"),
        ("policy", "policy"),
        ("review", "policy"),
        ("local-execution", "local-execution"),
        ("authority", "authority"),
        ("negotiation", "authority"),
        ("bid", None),
    ],
)
def test_a_denial_counts_for_the_conjunct_that_failed(reason: str, conjunct: str | None) -> None:
    denied = judged(2, "q1", "Denied", "B1", reason=reason)
    assert asked("refusals", "type reason conjunct decided_by refusals", request(1, "q1", "A1", "B1"), denied) == [
        ("RequestDenied.v1", reason, conjunct, "robot/B1", 1)
    ]


def test_counter_offers_holds_and_rejected_commands_are_refusals_too() -> None:
    events = (
        judged(1, "q1", "Countered", "B1", override="none"),
        event("ExecutionHeld", 2, reason="fleet-rule", robot="robot/B1"),
        event("CommandRejected", 3, command="ReportResult", subject="q1", reason="policy", issued_by="robot/A1"),
    )
    assert sorted(asked("refusals", "type reason conjunct", *events), key=str) == [
        ("CommandRejected.v1", "policy", None),
        ("ExecutionHeld.v1", "fleet-rule", "policy"),
        ("RequestCountered.v1", "override", "authority"),
    ]


def test_a_right_is_revoked_at_the_next_evaluation_that_it_is_about() -> None:
    columns = "revoked_by revoked_from reason revoked_us effective_us waited_us action_id boundary"
    before = (request(1, "q1", "A1", "B1"), judged(2, "q1", "Admitted", "B1", **ADMITTED))
    revoked = right(3, "Revoked", "A1", "B1", reason="human override")
    others = (
        request(4, "q2", "C1", "B1"),
        judged(5, "q2", "Admitted", "B1", **ADMITTED),
        request(5, "q3", "A1", "C1"),
        judged(6, "q3", "Admitted", "C1", **ADMITTED),
    )
    after = (
        request(7, "q4", "A1", "B1"),
        judged(9, "q4", "Denied", "B1", reason="authority"),
        judged(10, "q4", "Denied", "B1", reason="authority"),
    )
    row = ("supervisor/fleet", "robot/A1", "human override", 3)
    assert asked("revocations", columns, *before, revoked, *others) == [(*row, None, None, None, None)]
    assert asked("revocations", columns, *before, revoked, *others, *after) == [(*row, 9, 6, "q4", "RequestDenied.v1")]


@pytest.mark.parametrize(
    ("about", "effective_us"),
    [
        ({}, 5),
        ({"capability": "lift"}, 5),
        ({"context": "visit"}, 5),
        ({"capability": "grasp"}, None),
        ({"context": "rounds"}, None),
    ],
)
def test_a_right_for_another_capability_or_context_is_another_right(
    about: dict[str, str], effective_us: int | None
) -> None:
    events = (
        right(1, "Revoked", "A1", reason="context expired", **about),
        request(4, "q1", "A1", "B1"),
        judged(5, "q1", "Denied", "B1", reason="authority"),
    )
    assert asked("revocations", "effective_us capability context", *events) == [
        (effective_us, about.get("capability"), about.get("context"))
    ]


def i2_found(*events: Row) -> list[tuple[Any, ...]]:
    return answer("invariants/i2_local_execution_ownership", run(*events), columns=("time_us", "found"))


def test_a_revocation_that_a_grant_lifted_or_that_nobody_was_denied_for_never_took_effect() -> None:
    revoked, granted = (
        right(1, "Revoked", "A1", "B1", reason="human override"),
        right(2, "Granted", "A1", "B1", override="none"),
    )
    asking, admitted = request(4, "q1", "A1", "B1"), judged(5, "q1", "Admitted", "B1", **ADMITTED)
    assert asked("revocations", "effective_us boundary", revoked, granted, asking, admitted) == [(None, None)]
    assert asked(
        "revocations", "effective_us boundary", revoked, asking, judged(5, "q1", "Denied", "B1", reason="trust")
    ) == [(None, None)]
    assert i2_found(revoked, granted, asking, admitted) == []
    assert i2_found(revoked, asking, admitted) == [(5, "robot/B1 admits what robot/A1 may not ask since seq 1")]


def test_a_request_through_a_relay_rests_on_the_right_of_the_relay_as_well() -> None:
    asking, admitted = request(4, "q1", "A1", "B1", relay="robot/D1"), judged(5, "q1", "Admitted", "B1", **ADMITTED)
    of_relay = right(1, "Revoked", "D1", reason="human override")
    assert len(i2_found(of_relay, asking, admitted)) == 1
    assert i2_found(right(1, "Revoked", "C1", reason="human override"), asking, admitted) == []


def test_the_authority_chain_starts_with_the_rights_that_the_request_rested_on() -> None:
    events = (
        right(1, "Granted", "A1", override="emergency-only"),
        right(2, "Granted", "C1", override="emergency-only"),
        right(3, "Granted", "A1", "B1", capability="grasp", override="none"),
        request(4, "q1", "A1", "B1", override="hard-preempt"),
        judged(5, "q1", "Countered", "B1", override="soft-priority"),
        event("OfferAnswered", 6, action_id="q1", decided_by="robot/A1", is_accepted=True, override="soft-priority"),
        judged(7, "q1", "Admitted", "B1", **{**ADMITTED, "override": "soft-priority"}),
        event("ExecutionPreempted", 8, action_id="q1", robot="robot/B1", preempted_by="q2"),
        right(9, "Revoked", "A1", reason="human override"),
    )
    rows = asked(
        "authority_chain",
        "time_us deed principal trust may_request may_execute override is_audited",
        *events,
        action="q1",
    )
    assert sorted(rows) == [
        (1, "granted", "supervisor/fleet", None, None, None, "emergency-only", None),
        (4, "asked", "robot/A1", None, None, None, "hard-preempt", None),
        (5, "countered", "robot/B1", None, None, None, "soft-priority", None),
        (6, "answered", "robot/A1", None, None, None, "soft-priority", None),
        (7, "admitted", "robot/B1", "task", True, True, "soft-priority", True),
        (8, "interrupted", None, None, None, None, None, None),
    ]


def test_a_right_for_one_executor_or_capability_is_no_part_of_a_chain_whose_record_names_none() -> None:
    rights = (
        right(1, "Granted", "A1", "C1", override="none"),
        right(2, "Granted", "A1", capability="grasp", override="none"),
        right(3, "Granted", "A1", override="none"),
    )
    issued = event("RequestIssued", 4, action_id="q1", decided_by="robot/A1", requested_by="robot/A1")
    admitted = event("RequestAdmitted", 5, action_id="q1", outcome="allow")
    assert [at for (at,) in asked("authority_chain", "time_us", *rights, issued, admitted)] == [3, 4, 5]


def test_the_authority_chain_has_the_right_of_the_relay_as_well() -> None:
    of_relay, of_another = (
        right(at, "Revoked", robot, reason="human override") for at, robot in ((1, "D1"), (2, "C1"))
    )
    through = request(4, "q1", "A1", "B1", relay="robot/D1"), judged(5, "q1", "Admitted", "B1", **ADMITTED)
    told = asked("authority_chain", "time_us deed", of_relay, of_another, *through)
    assert told == [(1, "revoked"), (4, "asked"), (5, "admitted")]


CHAIN = (
    trust(1, "B1", "A1", "task"),
    trust(2, "C1", "B1", "session"),
    request(3, "q1", "A1", "B1"),
    judged(4, "q1", "Admitted", "B1", **ADMITTED),
    request(5, "q2", "B1", "C1", parent="q1"),
)
LINKS = "chain link action_id requested_by executed_by verdict conjunct is_well_formed end_scope"


def test_a_chain_is_well_formed_when_each_link_was_admitted_by_itself() -> None:
    admitted = judged(6, "q2", "Admitted", "C1", **{**ADMITTED, "trust": "session"})
    assert sorted(asked("delegation_chains", LINKS, *CHAIN, admitted)) == [
        ("q1", 1, "q1", "robot/A1", "robot/B1", "admitted", None, True, "task"),
        ("q1", 2, "q2", "robot/B1", "robot/C1", "admitted", None, True, None),
    ]
    denied = judged(6, "q2", "Denied", "C1", reason="trust")
    found = sorted(asked("delegation_chains", "link verdict conjunct is_well_formed", *CHAIN, denied))
    assert found == [(1, "admitted", None, False), (2, "denied", "trust", False)]
    told = sorted(asked("delegation_chains", "link verdict is_well_formed", *CHAIN))
    assert told == [(1, "admitted", False), (2, None, False)]


def test_a_chain_is_not_said_to_be_malformed_where_nobody_records_how_its_links_were_judged() -> None:
    events, some = (*ROBOTS, *CHAIN), [one for one in CONCERNS if one != "request"]
    for judgement, expected in (((), None), ((judged(6, "q2", "Denied", "C1", reason="trust"),), False)):
        with from_rows(run(*events, *judgement, observes=some)) as database:
            found = {row["is_well_formed"] for row in database.query("audit/delegation_chains").to_pylist()}
        assert found == {expected}


def test_an_action_that_is_asked_for_again_is_one_link_as_it_was_asked_last() -> None:
    again = (
        *CHAIN[:3],
        judged(4, "q1", "Countered", "B1", override="none"),
        request(5, "q2", "B1", "C1", parent="q1"),
        judged(6, "q2", "Denied", "C1", reason="trust"),
        request(7, "q1", "A1", "B1"),
        judged(8, "q1", "Admitted", "B1", **ADMITTED),
        request(9, "q2", "B1", "D1", parent="q1"),
        judged(10, "q2", "Admitted", "D1", **ADMITTED),
    )
    assert sorted(asked("delegation_chains", LINKS, *again)) == [
        ("q1", 1, "q1", "robot/A1", "robot/B1", "admitted", None, True, "task"),
        ("q1", 2, "q2", "robot/B1", "robot/D1", "admitted", None, True, None),
    ]


@pytest.mark.slow
def test_a_chain_whose_link_still_waits_for_an_answer_is_not_malformed() -> None:
    admitted = judged(6, "q2", "Admitted", "C1", **ADMITTED)
    cases: tuple[tuple[tuple[Row, ...], bool | None], ...] = (
        ((), None),
        ((judged(6, "q2", "Countered", "C1", override="none"),), None),
        ((admitted,), True),
        ((judged(6, "q2", "Denied", "C1", reason="trust"),), False),
        ((event("RequestUnanswered", 6, action_id="q2", executed_by="robot/C1"),), False),
        ((event("ExecutionStarted", 6, action_id="q2", executed_by="robot/C1"),), False),
    )
    for kind in ("live", "foreign"):
        for more, expected in cases:
            with from_rows(run(*ROBOTS, *CHAIN, *more, kind=kind)) as database:
                found = {row["is_well_formed"] for row in database.query("audit/delegation_chains").to_pylist()}
            assert found == {expected}


def test_a_request_that_serves_none_and_is_served_by_none_is_no_chain() -> None:
    assert asked("delegation_chains", LINKS, *CHAIN[:4]) == []
    assert asked("delegation_chains", LINKS, *CHAIN, action="q2") == []
    forged = (request(3, "q1", "A1", "B1", parent="q2"), request(4, "q2", "B1", "A1", parent="q1"))
    assert asked("delegation_chains", LINKS, *forged) == [], "a circle begins nowhere"
    assert asked("delegation_chains", LINKS, CHAIN[4], CHAIN[2]) == [], (
        "a request before the one that it serves is no link"
    )


def test_a_chain_whose_first_request_is_not_on_record_begins_with_what_is_and_is_not_said_to_be_well_formed() -> None:
    admitted = judged(6, "q2", "Admitted", "C1", **{**ADMITTED, "trust": "session"})
    on, then = request(7, "q3", "C1", "D1", parent="q2"), judged(8, "q3", "Admitted", "D1", **ADMITTED)
    trusts = trust(1, "D1", "B1", "task")  # not in the chain's first requester, whom no record names
    assert sorted(asked("delegation_chains", LINKS, trusts, CHAIN[4], admitted, on, then)) == [
        ("q2", 1, "q2", "robot/B1", "robot/C1", "admitted", None, None, None),
        ("q2", 2, "q3", "robot/C1", "robot/D1", "admitted", None, None, None),
    ]
    assert asked("delegation_chains", "chain link is_well_formed", CHAIN[4], admitted) == [("q2", 1, None)]
    denied = judged(6, "q2", "Denied", "C1", reason="trust")
    assert asked("delegation_chains", "chain link is_well_formed", CHAIN[4], denied) == [("q2", 1, False)]


def test_the_trust_of_the_last_in_the_first_is_that_for_the_capability() -> None:
    about = (
        trust(1, "C1", "A1", "none"),
        trust(1, "C1", "A1", "task", capability="lift"),
        trust(2, "C1", "A1", "capability"),
    )
    assert sorted(asked("delegation_chains", "link end_scope", *about, *CHAIN)) == [(1, "task"), (2, "task")]
    other = trust(1, "C1", "A1", "task", capability="grasp")
    assert sorted(asked("delegation_chains", "link end_scope", other, *CHAIN), key=str) == [(1, "task"), (2, None)]


def test_a_relay_link_is_judged_by_the_trust_that_is_most_specific() -> None:
    relayed = (request(5, "q1", "D1", "B1", relay="robot/A1"), event("RequestRelayed", 6, action_id="q1"))
    broad = (trust(1, "A1", "D1", "task"), trust(1, "B1", "A1", "task"))
    columns = "link link_scope is_trusted"
    for about in ({"capability": "lift"}, {"context": "visit"}, {"capability": "lift", "context": "visit"}):
        narrow = trust(2, "B1", "A1", "none", **about)
        found = asked("relay_links", columns, *broad, narrow, trust(3, "B1", "A1", "session"), *relayed)
        assert found == [(1, "task", True), (2, "none", False)]
    for about in ({"capability": "grasp"}, {"context": "rounds"}):
        told = asked("relay_links", columns, *broad, trust(2, "B1", "A1", "none", **about), *relayed)
        assert told == [(1, "task", True), (2, "task", True)]
    both = (trust(1, "B1", "A1", "none", capability="lift"), trust(2, "B1", "A1", "session", context="visit"))
    assert asked("relay_links", columns, *broad, *both, *relayed)[1] == (2, "none", False), (
        "the capability's before the context's"
    )


def test_a_relay_passes_on_what_it_was_asked_to_itself() -> None:
    in_vain, relayed = request(5, "q1", "D1", "B1", relay="robot/C1"), request(7, "q1", "D1", "B1", relay="robot/A1")
    columns = "asked_seq link seq sender"
    for by in ({}, {"decided_by": "robot/A1"}):
        assert asked("relay_links", columns, in_vain, relayed, event("RequestRelayed", 8, action_id="q1", **by)) == [
            (1, 1, 1, "robot/D1"),
            (1, 2, None, "robot/C1"),
            (2, 1, 2, "robot/D1"),
            (2, 2, 3, "robot/A1"),
        ]
