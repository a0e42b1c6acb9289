"""What a source does not record, of types and fields that no simulated run leaves out, is held against nobody."""

from typing import Any

import pytest

from fsar_ledger.events import CONCERNS
from fsar_ledger.ledger.rows.schema import RECORDS
from tests.queries.histories import Row, S, act, answer, event, run
from tests.recycled import from_rows

ASKER, DOER = "robot/A1", "robot/B1"


def recorded(*events: Row, lacks: str = "nothing") -> list[Row]:
    """The rows of a source that records every type and field but this one, which its rows do not have either."""
    kind, _, field = lacks.partition(".")
    left = [{**row, field: None} if field and row["type"] == f"{kind}.v1" else row for row in events]
    records = [name for name in RECORDS if not f"{name}.".startswith(f"{lacks}.")]
    told = [row for row in left if field or row["type"] != f"{kind}.v1"]
    return run(*told, kind="foreign", observes=[], records=records)


def accused(invariant: str, *events: Row, lacks: str = "nothing") -> list[str]:
    """What `audit` takes from the rows of an invariant, where the run can be accused at all."""
    with from_rows(recorded(*events, lacks=lacks)) as database:
        hidden = database.rows(f"SELECT * FROM unobservable WHERE judge = '{invariant}' AND hides_offences")
        return [] if hidden else [row["found"] for row in database.rows(f"SELECT found FROM {invariant}")]


def joined(robot: str, at: int = 0, **columns: Any) -> Row:
    return event("RobotJoined", at, robot=robot, role="r", domain="", supervisor="supervisor/A1", **columns)


def of_action(name: str, at: int, **columns: Any) -> Row:
    """One event of what B1 does for A1."""
    names = {"requested_by": ASKER, "executed_by": DOER, "supervised_by": "supervisor/A1"}
    return act(name, at, "t1/1", **{**names, "request_id": "q", **columns})


STARTS = of_action("ExecutionStarted", 9 * S, robot=DOER, on_behalf_of=ASKER, capability="lift")
OF_I1, OF_I2, OF_I3 = "i1_local_agent_coherence", "i2_local_execution_ownership", "i3_jointly_composed_policy"
OF_I5 = "i5_audit_attributability"
OF_A3, OF_A5 = "a3_no_silent_policy_override", "a5_audit_completeness"
OF_I4 = "i4_outward_recovery"
POLICIES = (
    *("PolicyWindowOpened", "PolicyRuleSet", "RolePolicyRuleSet", "RobotJoined", "FleetRuleLearned", "RequestRelayed"),
    *("RequestDenied.action_id", "RequestIssued", "RequestIssued.carried_policy"),
)
"""Records of policy without which an outcome that is known may be another."""


def test_a_robot_may_have_left_or_returned_where_that_is_not_recorded() -> None:
    left = event("RobotDeparted", S, robot=DOER, reason="announced", fence=1)
    back = event("RobotReturned", 2 * S, robot=DOER, fence=1)
    anew = (joined(ASKER), joined(DOER), left, joined(DOER, 3 * S), STARTS)
    returns = (joined(ASKER), joined(DOER), left, back, STARTS)
    for history in (anew, returns):
        assert accused(OF_I1, *history) == []
        for lacks in ("RobotDeparted", "RobotReturned"):
            assert accused(OF_I1, *history, lacks=lacks) == []
    assert accused(OF_I1, joined(ASKER), joined(DOER), left, STARTS) == ["robot/B1 acts after it departed"]
    twice = (joined(ASKER), joined(DOER), joined(DOER, S))
    assert accused(OF_I1, *twice) == ["robot/B1 joins although it is in the fleet"]


def test_a_refusal_may_have_been_lifted_or_be_anothers_where_the_record_does_not_say() -> None:
    denied = of_action("RequestDenied", 2 * S, reason="policy", decided_by="service/policy")
    admitted = of_action("RequestAdmitted", 3 * S, decided_by=DOER, outcome="allow")
    of_another = {**denied, "executed_by": "robot/C1"}
    stands = ["robot/B1 starts after the refusal at seq 1, which nothing lifted"]
    assert accused(OF_I3, denied, STARTS) == stands
    for history, lacks in (
        ((denied, admitted, STARTS), "RequestAdmitted.action_id"),
        ((of_another, STARTS), "RequestDenied.executed_by"),
    ):
        assert accused(OF_I3, *history) == accused(OF_A3, *history) == []
        assert accused(OF_I3, *history, lacks=lacks) == accused(OF_A3, *history, lacks=lacks) == []


def test_a_carried_policy_may_have_been_approved_or_replaced_where_that_is_not_recorded() -> None:
    review = of_action("RequestIssued", S, decided_by=ASKER, capability="lift", carried_policy="review")
    approved = of_action("SupervisorResponded", 2 * S, purpose="review", approves=True)
    admitted = of_action("RequestAdmitted", 3 * S, decided_by=DOER, outcome="allow")
    assert accused(OF_A3, review, approved, admitted) == []
    assert accused(OF_A3, review, approved, admitted, lacks="SupervisorResponded") == []
    assert accused(OF_A3, review, admitted) == ["admitted as allow although the request carried review"]
    again = {**review, "time_us": 2 * S, "carried_policy": "allow"}
    denies = {**review, "carried_policy": "deny"}
    assert accused(OF_I3, denies, STARTS) == ["robot/B1 starts although the outcome that it knows is deny"]
    assert accused(OF_I3, denies, again, STARTS) == []
    with from_rows(recorded(denies, {**again, "action_id": None}, STARTS, lacks="RequestIssued.action_id")) as database:
        (hidden,) = database.rows(f"SELECT hides_offences FROM unobservable WHERE judge = '{OF_I3}'")
    assert hidden["hides_offences"]


def test_a_takeover_and_its_reasons_are_not_judged_where_the_record_lacks_them() -> None:
    about = {"robot": DOER, "failed_action": "t1/1", "failure": 1}
    failed = of_action("ExecutionFailed", S, **about)
    moves = [
        of_action("RecoveryEscalated", S, **about, level="local", to_level="peer"),
        of_action("RecoveryEscalated", S, **about, level="peer", to_level="fleet"),
    ]
    taken = of_action("ReassignmentDecided", 2 * S, **about, helper="robot/C1")
    resolved = of_action("FailureResolved", 3 * S, **about, level="fleet")
    history = (failed, *moves, taken, resolved)
    assert accused(OF_I4, *history) == accused(OF_I4, *history, lacks="ReassignmentDecided.helper") == []
    nobody = (failed, *moves, {**taken, "helper": None}, resolved)
    assert accused(OF_I4, *nobody) == ["failure 1: resolved at level fleet, where nothing was done"]
    budget = event("RecoveryBudgetSet", 0, robot=DOER, level="peer", t_max_us=S, n_max=1)
    late = {**moves[1], "time_us": 5 * S, "reason": "budget exhausted"}
    assert accused(OF_I4, budget, failed, moves[0], late) == []
    assert accused(OF_I4, budget, failed, moves[0], late, lacks="RecoveryEscalated.reason") == []


def test_a_request_may_have_been_sent_again_where_requests_have_no_names_on_record() -> None:
    asked = of_action("RequestIssued", S, decided_by=ASKER, capability="lift")
    answers = [of_action(f"Request{name}", 2 * S, decided_by=DOER) for name in ("Admitted", "Accepted")]
    history = (joined(ASKER), joined(DOER), asked, *answers, {**asked, "time_us": 3 * S}, STARTS)
    assert accused(OF_A5, *history) == accused(OF_A5, *history, lacks="RequestIssued.request_id") == []
    other = {**asked, "time_us": 3 * S, "request_id": "other"}
    anew = (joined(ASKER), joined(DOER), asked, *answers, other, STARTS)
    assert accused(OF_A5, *anew) == ["robot/B1 for robot/A1: no admission of the request"]


@pytest.mark.parametrize("lacks", ["RequestIssued", "RequestUnanswered", "RequestClosed"])
def test_whom_a_search_came_to_may_stand_on_a_record_of_the_request_that_is_missing(lacks: str) -> None:
    gap = of_action("GapDetected", S, capability="lift", executed_by=None)
    asked = of_action("RequestIssued", 2 * S, decided_by=ASKER, capability="lift", executed_by=None)
    told = of_action(lacks, 3 * S, decided_by=ASKER, capability="lift", result="success")
    history = (joined(ASKER), joined(DOER), gap, *([] if lacks == "RequestIssued" else [asked]), told)
    assert accused(OF_I5, *history, lacks=lacks) == []
    assert accused(OF_I5, *history[:3]) == ["no executor can be recovered"]


@pytest.mark.parametrize(
    "lacks",
    [
        *("RequestClosed.executed_by", "RequestClosed.requested_by", "RequestIssued.action_id"),
        *("RegistryQueried.action_id", "RequestAdmitted.action_id"),
    ],
)
def test_whom_a_search_came_to_may_stand_in_a_field_that_is_missing(lacks: str) -> None:
    """Where bids are invited, only the end of the request names its executor; what is of no action has none."""
    named = {"capability": "lift", "executed_by": None}
    gap = of_action("GapDetected", S, **named)
    query = of_action("RegistryQueried", S, decided_by=ASKER, candidates=[DOER], **named)
    asked = of_action("RequestIssued", 2 * S, decided_by=ASKER, **named)
    admitted = of_action("RequestAdmitted", 2 * S, decided_by=ASKER, outcome="allow", executed_by=None)
    closed = of_action("RequestClosed", 3 * S, decided_by=ASKER, result="success")
    history = (joined(ASKER), joined(DOER), gap, query, asked, admitted, closed)
    assert accused(OF_I5, *history) == accused(OF_I5, *history, lacks=lacks) == []
    nobody = [*history[:6], {**closed, "executed_by": None}]
    assert set(accused(OF_I5, *nobody)) == {"no executor can be recovered"}


def test_a_right_may_have_been_granted_again_for_a_request_that_names_no_executor() -> None:
    revoked = event("AuthorityRevoked", S, requested_by=ASKER, reason="human override")
    granted = event("AuthorityGranted", 2 * S, requested_by=ASKER, executed_by=DOER, override="none")
    asked = of_action("RequestIssued", 3 * S, decided_by=ASKER, capability="lift")
    admitted = of_action("RequestAdmitted", 4 * S, decided_by=DOER, outcome="allow")
    unnamed = [{**row, "executed_by": None} for row in (asked, admitted)]
    assert accused(OF_I2, revoked, granted, asked, admitted) == accused(OF_I2, revoked, granted, *unnamed) == []
    elsewhere = {**granted, "executed_by": "robot/C1"}
    assert len(accused(OF_I2, revoked, elsewhere, asked, admitted)) == 1
    assert len(accused(OF_I2, revoked, *unnamed)) == 1


def test_a_hold_may_end_with_a_rule_for_a_role_where_nobody_knows_the_robots_role() -> None:
    held = of_action("ExecutionHeld", 2 * S, robot=DOER, outcome="deny", reason="local-policy", path=[DOER])
    rule = event("RolePolicyRuleSet", 3 * S, role="r", domain="", scope="local", outcome="allow")
    observes = [concern for concern in CONCERNS if concern != "fleet"]
    found = answer(f"invariants/{OF_A3}", run(held, rule, STARTS, kind="foreign", observes=observes))
    assert found == []
    of_others = {**rule, "role": "other"}
    assert len(answer(f"invariants/{OF_A3}", run(joined(DOER), held, of_others, STARTS))) == 1


def test_no_level_is_skipped_that_may_have_been_tried_unrecorded() -> None:
    about = {"robot": DOER, "failed_action": "t1/1", "failure": 1}
    failed = of_action("ExecutionFailed", S, **about)
    asks = of_action("AssistanceRequested", 2 * S, **about, level="peer", helper=ASKER)
    leaps = of_action("RecoveryEscalated", 2 * S, **about, level="local", to_level="human")
    for lacks in ("RecoveryAttempted", "RecoveryEscalated"):
        assert answer("audit/skipped_levels", recorded(failed, asks, lacks=lacks)) == []
    (skipped,) = answer("audit/skipped_levels", recorded(failed, asks), columns=("skipped",))
    assert skipped == (["local"],)
    assert len(answer("audit/skipped_levels", recorded(failed, leaps, lacks="RecoveryAttempted"))) == 1


def test_a_robot_does_nothing_of_which_no_end_is_recorded() -> None:
    helps = of_action("AssistanceAdmitted", S, robot=ASKER, helper=DOER, failure=1, level="peer")
    comes = of_action("ApproachStarted", S, robot=ASKER)
    history = (joined(ASKER), joined(DOER), helps, comes)
    activity = [answer("audit/robot_activity", recorded(*history, lacks=lacks), columns=("doing",)) for lacks in LACKS]
    assert activity == [[("approaching",), ("helping",)], [("approaching",), (None,)], [(None,), ("helping",)]]
    states = [answer("audit/robot_state_at", recorded(*history, lacks=lacks), columns=("state",)) for lacks in LACKS]
    assert states == [[("executing",), ("executing",)], [("executing",), (None,)], [(None,), ("executing",)]]


REVIEWED = event("PolicyWindowOpened", S, robot=DOER, scope="local", window="w", outcome="review")


def test_a_source_that_records_every_type_is_judged_by_reviews_as_one_that_observes_every_concern() -> None:
    found = ["starts under a known review that no supervisor had approved"]
    assert accused(OF_A3, joined(DOER), REVIEWED, STARTS) == found
    assert answer(f"invariants/{OF_A3}", run(joined(DOER), REVIEWED, STARTS), columns=("found",)) == [(found[0],)]


def test_no_number_of_violations_is_given_where_reviews_are_not_counted() -> None:
    """Whether a start was approved is known of the concern supervision, not of its types (facts/governed_starts)."""
    columns = ("numerator", "not_observed")
    for name in ("policy_violations", "missed_reviews"):
        whole = run(joined(DOER), REVIEWED, STARTS, kind="foreign")
        assert answer(f"metrics/{name}", whole, columns=columns) == [(1, None)]
        ((number, lacks),) = answer(f"metrics/{name}", recorded(joined(DOER), REVIEWED, STARTS), columns=columns)
        assert (number, lacks) == (None, "execution, fleet, policy, supervision")


@pytest.mark.parametrize(
    ("judge", "lacks"),
    [
        *((name, record) for name in (OF_I3, OF_A3) for record in POLICIES),
        *((OF_I4, record) for record in ("RecoveryAttemptFailed", "SupervisorCalled")),
        (OF_A3, "ExecutionHeld"),
        *((OF_I1, record) for record in ("RobotDeparted", "RobotReturned")),
        *((OF_I2, record) for record in ("AuthorityRevoked", "RequestAdmitted", "RequestIssued")),
    ],
)
def test_nothing_holds_where_a_source_does_not_record_what_could_break_it(judge: str, lacks: str) -> None:
    with from_rows(recorded(STARTS)) as database:
        assert database.rows(f"SELECT * FROM unobservable WHERE judge = '{judge}'") == []
    with from_rows(recorded(STARTS, lacks=lacks)) as database:
        (hidden,) = database.rows(f"SELECT not_observed FROM unobservable WHERE judge = '{judge}'")
    assert lacks in hidden["not_observed"].split(", ")


LACKS = ("nothing", "AssistanceEnded", "ExecutionFinished")
