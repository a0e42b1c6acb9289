"""Trust by capability and context, interventions of supervisors and their absence: given rows, expected rows."""

from typing import Any

import pytest

from tests.queries.histories import Row, S, act, answer, event, run
from tests.queries.test_rules_and_trust import DOOR, H_B, admitted, asked, broken, reviewed, rule, started
from tests.runtime.governed import H_F


def trust(
    time_us: int, scope: str, capability: str | None = None, context: str | None = None, by: str | None = None
) -> Row:
    return event(
        "TrustSet",
        time_us,
        robot="robot/B1",
        peer="robot/A1",
        scope=scope,
        capability=capability,
        context=context,
        decided_by=by,
        reason="operator",
    )


def test_each_entry_of_trust_holds_until_it_is_set_again() -> None:
    events = (trust(1, "task"), trust(2, "none", DOOR, by=H_F), trust(3, "session", DOOR))
    columns = ("capability", "since_us", "until_us", "trust_scope", "set_by")
    rows = answer("facts/trust_in_force", run(*events), columns=columns)
    assert rows == [(DOOR, 2, 3, "none", H_F), (DOOR, 3, None, "session", None), (None, 1, None, "task", None)]


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, ["task", "session", "none", "capability"]),
        ({"capability": DOOR}, ["session"]),
        ({"capability": "carry.package"}, ["task"]),
        ({"context": "t1"}, ["none"]),
        ({"context": "t2"}, ["task"]),
        ({"capability": DOOR, "context": "t1"}, ["capability"]),
        ({"capability": DOOR, "context": "t2"}, ["session"]),
        ({"capability": "carry.package", "context": "t1"}, ["none"]),
        ({"capability": DOOR, "context": "t1", "at_us": 3}, ["session"]),
    ],
)
def test_of_several_entries_the_most_specific_one_holds(given: dict[str, Any], expected: list[str]) -> None:
    events = (
        trust(1, "task"),
        trust(2, "session", DOOR),
        trust(3, "none", None, "t1"),
        trust(4, "capability", DOOR, "t1"),
    )
    assert sorted(row[0] for row in asked("trust_at", "trust_scope", *events, **given)) == sorted(expected)


@pytest.mark.parametrize(
    ("given", "outcome"),
    [
        ({}, "allow"),
        ({"capability": DOOR}, "review"),
        ({"context": "t1"}, "deny"),
        ({"capability": DOOR, "context": "t1"}, "deny"),
        ({"context": "t2"}, "allow"),
    ],
)
def test_policy_at_a_time_is_the_strictest_of_what_is_about_the_question(given: dict[str, str], outcome: str) -> None:
    rules = (rule(1, "review", capability=DOOR), rule(2, context="t1"))
    rows = asked("policy_at", "capability context scope outcome", *rules, robot="robot/B1", at_us=5, **given)
    about = (given.get("capability"), given.get("context"))
    assert {row[2:] for row in rows if row[:2] == about} == {("fleet", "allow"), ("local", outcome)}


def test_what_was_told_is_compared_with_the_windows_of_the_world() -> None:
    told = event("FleetRuleLearned", 2, robot="robot/B1", outcome="allow", as_of_us=1)
    rows = asked("policy_known_at", "known_outcome true_outcome is_wrong", rule(1, scope="fleet"), told)
    assert [row for row in rows if row[0]] == [("allow", "allow", False)]


def test_every_intervention_of_a_supervisor_is_on_the_list() -> None:
    interventions = (
        trust(1, "none", DOOR, "t1", by=H_B),
        event("TrustThresholdsSet", 2, promote_after=3, downgrade_after=1, decided_by=H_F),
        rule(3, "review", context="t1"),
        event("SupervisionDensitySet", 4, robot="robot/B1", review_every=2, decided_by=H_B, reason="night"),
        event("AuthorityGranted", 5, requested_by="robot/A1", override="emergency-only", decided_by=H_F),
        event("AuthorityRevoked", 6, requested_by="robot/A1", reason="human override", decided_by=H_F),
        event("RecoveryBudgetSet", 7, robot="robot/B1", level="local", t_max_us=5, n_max=1, decided_by=H_B),
        reviewed(8, False),
        {**reviewed(9, True), "purpose": "ordering", "preferred": "t1/2"},
        {**reviewed(10, True), "purpose": "recovery"},
        reviewed(11, True),
    )
    others = (trust(1, "task"), trust(1, "task", by="service/trust"), admitted(2))
    assert [
        row[1:]
        for row in sorted(asked("supervisor_decisions", "decided_us decided_by decision", *interventions, *others))
    ] == [
        (H_B, "robot/A1 none in t1"),
        (H_F, "promote after 3, downgrade after 1"),
        (H_B, "local review in t1"),
        (H_B, "review every 2"),
        (H_F, "up to emergency-only"),
        (H_F, "human override"),
        (H_B, "local 1 in 5 us"),
        (H_F, "refused"),
        (H_F, "t1/2 first"),
        (H_F, "resolved"),
        (H_F, "approved"),
    ]
    assert len(asked("supervisor_decisions", "seq", *interventions, supervisor=H_B)) == 4


def test_a_decision_of_a_supervisor_that_has_no_words_of_its_own_reads_as_in_the_log() -> None:
    events = (event("SegmentTransferred", 1, decided_by=H_F), event("RequestDenied", 2, decided_by=H_F))
    assert asked("supervisor_decisions", "decision", *events) == [("gives the task on",), ("deny",)]


def test_who_wants_no_reviews_is_not_said_to_review_every_nothing() -> None:
    ended = event("SupervisionDensitySet", 1, robot="robot/B1", review_every=0, decided_by=H_B, reason="day")
    assert asked("supervisor_decisions", "decision", ended) == [("no reviews",)]


def test_each_call_of_the_fleet_supervisor_is_an_intervention_with_its_purpose_and_answer() -> None:
    def called(at: int, action: str, purpose: str, supervisor: str = H_F) -> dict[str, Any]:
        return event("SupervisorCalled", at, action_id=action, purpose=purpose, supervisor=supervisor)

    def answered(at: int, action: str, purpose: str, **fields: Any) -> dict[str, Any]:
        return event("SupervisorResponded", at, action_id=action, purpose=purpose, decided_by=H_F, **fields)

    history = (
        called(1 * S, "t1/1.1", "review"),
        called(2 * S, "t2/1.1", "ordering"),
        called(3 * S, "t3/1.1", "recovery"),
        called(3 * S, "t4/1.1", "recovery", H_B),
        answered(4 * S, "t1/1.1", "review", approves=False),
        answered(5 * S, "t2/1.1", "ordering", preferred="t9/1.1", approves=True),
    )
    columns = "called_s called purpose action_id decided_by decision decided_s"
    assert sorted(asked("interventions", columns, *history)) == [
        (1.0, H_F, "review", "t1/1.1", H_F, "refused", 4.0),
        (2.0, H_F, "ordering", "t2/1.1", H_F, "t9/1.1 first", 5.0),
        (3.0, H_F, "recovery", "t3/1.1", None, None, None),
    ]


@pytest.mark.parametrize(
    ("supervisor", "left", "count"),
    [("supervisor/night", "supervisor/night", 0), ("supervisor/night", "supervisor/X1", 1), (None, "supervisor/X1", 1)],
)
def test_the_absence_that_excuses_is_that_of_the_robots_own_supervisor(
    supervisor: str | None, left: str, count: int
) -> None:
    joined = event("RobotJoined", robot="robot/X1", role="A", team=1, supervisor=supervisor)
    alone = event(
        "RoutinePerformed",
        3,
        decided_by="robot/X1",
        requested_by="robot/X1",
        executed_by="robot/X1",
        robot="robot/X1",
        operation="sensing",
    )
    gone = event("SupervisorLeft", 2, supervisor=left)
    assert len(broken("i5", joined, gone, alone)) == count
    executed = started(3, robot="robot/X1", requested_by="robot/A1", executed_by="robot/X1")
    phases = tuple(event(name, 2, action_id="t1/1") for name in ("RequestIssued", "RequestAdmitted", "RequestAccepted"))
    assert len(broken("a5", joined, *phases, gone, executed)) == count


def test_the_entry_of_the_capability_goes_before_that_of_the_context_for_an_execution_too() -> None:
    events = (trust(1, "session", DOOR), trust(2, "none", None, "t1"))
    pair = {key: events[0][key] for key in ("robot", "peer")}
    began = act(
        "ExecutionStarted", 3, "t1/1", robot=pair["robot"], on_behalf_of=pair["peer"], capability=DOOR, ends_us=9
    )
    assert answer("facts/delegated_trust", run(*events, began), columns=("is_direct",)) == [(True,)]
    assert answer(
        "facts/delegated_trust", run(*events, {**began, "capability": "carry.package"}), columns=("is_direct",)
    ) == [(False,)]


@pytest.mark.parametrize(("admitted_by", "is_direct"), [("robot/B1", True), ("robot/C1", False), (None, False)])
def test_trust_counts_when_the_executor_admitted_the_request(admitted_by: str | None, is_direct: bool) -> None:
    admission = act("RequestAdmitted", 2, "t1/1", decided_by=admitted_by, executed_by=admitted_by)
    began = act("ExecutionStarted", 4, "t1/1", robot="robot/B1", on_behalf_of="robot/A1", capability=DOOR, ends_us=9)
    events = (trust(1, "session"), admission, trust(3, "none"), began)
    assert answer("facts/delegated_trust", run(*events), columns=("is_direct",)) == [(is_direct,)]


@pytest.mark.parametrize(
    ("relays", "is_chained"),
    [
        ({}, False),
        ({2: "robot/C1"}, True),
        ({4: "robot/C1"}, False),
        ({1: "robot/D1", 2: "robot/C1"}, True),
        ({1: "robot/C1", 2: "robot/D1"}, False),
    ],
    ids=["none", "trusted", "too late", "the last one is trusted", "the last one is not trusted"],
)
def test_trust_reaches_through_the_last_relay_before_the_start(relays: dict[int, str], is_chained: bool) -> None:
    links = ({**trust(0, "session"), "peer": "robot/C1"}, {**trust(0, "session"), "robot": "robot/C1"})
    relayed = {time_us: act("RequestRelayed", time_us, "t1/1", decided_by=by) for time_us, by in relays.items()}
    began = act("ExecutionStarted", 3, "t1/1", robot="robot/B1", on_behalf_of="robot/A1", capability=DOOR, ends_us=9)
    events = [one for _, one in sorted({**relayed, 3: began}.items())]
    assert answer("facts/delegated_trust", run(*links, *events), columns=("is_chained",)) == [(is_chained,)]


@pytest.mark.parametrize(
    ("about", "is_against"),
    [
        ({}, True),
        ({"capability": DOOR}, True),
        ({"context": "t1"}, True),
        ({"capability": "carry.package"}, False),
        ({"context": "t2"}, False),
    ],
)
def test_a_decision_is_against_a_rule_only_where_the_rule_is_about_it(about: dict[str, str], is_against: bool) -> None:
    joined = event("RobotJoined", robot="robot/A1", role="A")
    rule = event("PolicyRuleSet", 1, scope="local", robot="robot/A1", outcome="deny", **about)
    step = act("StepBegan", 5_000_000, "t1/1", robot="robot/A1", capability=DOOR, target_role="B")
    admitted = act("RequestAdmitted", 5_000_001, "t1/1", decided_by="robot/B1", executed_by="robot/B1")
    assert answer("facts/policy_decisions", run(joined, rule, step, admitted), columns=("is_against_requester",)) == [
        (is_against,)
    ]


def test_an_answer_answers_the_last_call_of_whoever_gives_it() -> None:
    def called(at_s: int, whom: str) -> Row:
        return act("SupervisorCalled", at_s * S, "t1/1", supervisor=whom, purpose="review")

    def answered(at_s: int, by: str, approves: bool) -> Row:
        return act("SupervisorResponded", at_s * S, "t1/1", decided_by=by, purpose="review", approves=approves)

    events = (
        *(called(10, H_F), called(15, H_F), called(16, H_B)),
        *(answered(20, H_B, approves=False), answered(60, H_F, approves=True)),
    )
    columns = ("called_s", "decided_by", "decision", "decided_s")
    assert answer("audit/interventions", run(*events), columns=columns) == [
        (10.0, None, None, None),
        (15.0, H_F, "approved", 60.0),
    ]
    decisions = answer("audit/supervisor_decisions", run(*events), columns=("decided_by", "called_us"))
    assert decisions == [(H_B, 16 * S), (H_F, 15 * S)]
    stranger = answer("facts/answered_calls", run(*events[:3], answered(60, "supervisor/X", approves=True)))
    assert stranger == [("r1", 4, 3, 16 * S)], "who was not called himself answers the last call"
