"""The paper's table of features: given rows, the grade; and rows that change each."""

from typing import Any

import pytest

from fsar_ledger.events.configuration import CONFIGURATIONS
from fsar_ledger.events.envelope import Scenario
from fsar_ledger.metrics.database import connect, plain_rows
from fsar_ledger.runtime.experiment import Experiment, run_experiment
from tests.queries.histories import Row, S, act, event, run
from tests.recycled import from_rows

A, B, C = "robot/A1", "robot/B1", "robot/C1"
JOINED = tuple(event("RobotJoined", robot=robot, role=robot[6], team=1, supervisor=None) for robot in (A, B, C))


def grades(*events: Row, **dimensions: Any) -> dict[str, str | None]:
    """The grade of every feature over one run with these events."""
    with from_rows(run(*events, **dimensions)) as database:
        return {row["feature"]: row["grade"] for row in plain_rows(database.query("tables/architecture_features"))}


def evidence(feature: str, *events: Row) -> str:
    with from_rows(run(*events)) as database:
        rows = plain_rows(database.query("tables/architecture_features"))
    (found,) = [row["evidence"] for row in rows if row["feature"] == feature]
    return str(found)


def about(by: str | None, action: str = "t1/1.1", **fields: Any) -> dict[str, Any]:
    """The envelope of an event about an action that A asks of B; complete for an auditor."""
    principals = {"requested_by": A, "executed_by": B, "supervised_by": "supervisor/B1"}
    return {
        "task_id": action.partition("/")[0],
        "action_id": action,
        **principals,
        "decided_by": by,
        "path": [by],
        **fields,
    }


def asked(by: str = A, carried: str | None = "allow", action: str = "t1/1.1") -> Row:
    return event("RequestIssued", 2 * S, **about(by, action), capability="lift", carried_policy=carried)


def admitted(by: str = B, action: str = "t1/1.1") -> Row:
    return event("RequestAdmitted", 3 * S, **about(by, action), outcome="allow")


def started(action: str = "t1/1.1") -> Row:
    return event(
        "ExecutionStarted", 4 * S, **about(None, action), robot=B, on_behalf_of=A, capability="lift", ends_us=5 * S
    )


def trusts(robot: str, peer: str, scope: str = "task", **narrower: str) -> Row:
    return event("TrustSet", robot=robot, peer=peer, scope=scope, **narrower)


FOUND = event("RegistryQueried", 1 * S, **about(None), capability="lift", candidates=[B])


def test_nothing_is_graded_that_no_event_could_show() -> None:
    assert set(grades().values()) == {None}
    assert len(grades()) == 8


def test_a_robot_is_one_agent_until_an_agent_in_it_appears() -> None:
    assert grades(*JOINED, asked())["single_agent_robot"] == "full"
    assert grades(*JOINED, asked("agent/A1/planning"))["single_agent_robot"] == "none"
    robots = [f"robot/A{number}" for number in range(1, 6)]
    many = (
        *(event("RobotJoined", robot=robot, role="A", team=1, supervisor=None) for robot in robots),
        *({**asked("agent/A1/planning"), "requested_by": robot} for robot in robots),
    )
    assert grades(*many)["single_agent_robot"] == "partial"


def test_a_robot_that_no_record_names_appears_as_nobody() -> None:
    assert evidence("single_agent_robot", *JOINED, asked()) == "robots that appear as one principal 2/2"
    assert evidence("single_agent_robot", *JOINED) == "robots that appear as one principal not shown"


def test_agents_are_within_robots_when_a_robot_has_two() -> None:
    one = [asked(f"agent/{name}/planning") for name in ("A1", "B1", "C1")]
    two = [
        event("InternalHandoff", 1 * S, sender=f"agent/{name}/planning", receiver=f"agent/{name}/execution")
        for name in ("A1", "B1", "C1")
    ]
    assert grades(*JOINED, *one)["intra_robot_agents"] == "none"
    assert grades(*JOINED, *two)["intra_robot_agents"] == "full"


def test_coordination_is_central_when_one_principal_that_is_no_robot_assigns() -> None:
    commanded = [event("CommandIssued", 3 * S, **about("coordinator", f"t{number}/1"), robot=B) for number in range(20)]
    assert grades(*commanded)["centralized_coordination"] == "full"
    found = grades(*commanded, *(admitted(action=f"u{number}/1") for number in range(5)))["centralized_coordination"]
    assert found == "partial"
    assert (
        grades(admitted(), event("CommandIssued", 3 * S, **about("coordinator"), robot=B))["centralized_coordination"]
        == "none"
    )
    assert grades(admitted("supervisor/fleet"))["centralized_coordination"] == "none"


def test_two_centres_are_no_single_one() -> None:
    split = [
        event("CommandIssued", 3 * S, **about(f"service/{name}", f"t{number}/1"), robot=B)
        for number in range(4)
        for name in ("one", "two")
    ]
    assert grades(*split)["centralized_coordination"] == "none"


OUTSIDER = event("OutsiderRequestInjected", 1 * S, task_id="x1", robot=C, peer=B, capability="lift")
RELAYED = event("RequestRelayed", 2 * S, **about(C), carried_policy="allow")


def test_delegation_is_trust_scoped_when_what_lacks_trust_goes_through_trusted_links_or_not_at_all() -> None:
    chain = (trusts(B, C), trusts(C, A))
    assert grades(*chain, asked(), RELAYED, started(), OUTSIDER)["trust_scoped_delegation"] == "full"
    assert grades(*chain, asked(), started(), OUTSIDER)["trust_scoped_delegation"] == "none"
    assert grades(trusts(B, C), asked(), RELAYED, started(), OUTSIDER)["trust_scoped_delegation"] == "none"
    assert grades(*chain, asked(), RELAYED, started(), OUTSIDER, started("x1/1"))["trust_scoped_delegation"] == "none"


def test_an_outsider_who_is_served_through_a_chain_leaves_trust_partial() -> None:
    served = ({**RELAYED, "action_id": "x1/1", "task_id": "x1"}, started("x1/1"))
    assert (
        grades(trusts(B, C), trusts(C, A), asked(), RELAYED, started(), OUTSIDER, *served)["trust_scoped_delegation"]
        == "partial"
    )


def test_delegation_that_trust_allows_shows_nothing_about_trust() -> None:
    assert grades(trusts(B, A), asked(), started(), OUTSIDER)["trust_scoped_delegation"] is None
    assert "not shown; outsiders refused 1/1" in evidence(
        "trust_scoped_delegation", trusts(B, A), asked(), started(), OUTSIDER
    )


@pytest.mark.parametrize(
    ("narrower", "untrusted"),
    [
        ({"capability": "lift"}, "0/1"),
        ({"context": "t1"}, "0/1"),
        ({"capability": "carry"}, "not shown"),
        ({"context": "t2"}, "not shown"),
    ],
)
def test_the_most_specific_trust_holds(narrower: dict[str, str], untrusted: str) -> None:
    said = evidence("trust_scoped_delegation", trusts(B, A, "none", **narrower), trusts(B, A), started())
    assert said.startswith(f"untrusted delegations that went through trusted links {untrusted};")


def failed(*steps: Row) -> tuple[Row, ...]:
    return (
        act("ExecutionFailed", 10 * S, "t1/1.1", robot=B, failure=1, cause="obstruction", detected_us=10 * S),
        *steps,
    )


def recovery(name: str, by: str, level: str | None = None, **fields: Any) -> Row:
    return event(name, 11 * S, **about(by, robot=B, failure=1, level=level, failed_action="t1/1.1"), **fields)


def tried(by: str) -> Row:
    return recovery("RecoveryAttempted", by, "local", number=1, deadline_us=40 * S)


def left(level: str, to_level: str, by: str = "service/recovery") -> Row:
    return recovery("RecoveryEscalated", by, level, to_level=to_level)


@pytest.mark.slow
def test_recovery_is_layered_when_the_robot_begins_and_all_four_levels_follow_in_order() -> None:
    whole = (left("local", "peer"), left("peer", "fleet"), left("fleet", "human"))
    assert grades(*failed(tried(B), *whole))["layered_recovery"] == "full"
    assert grades(*failed(tried("agent/B1/recovery"), *whole))["layered_recovery"] == "full"
    assert grades(*failed(tried(B), left("local", "human")))["layered_recovery"] == "partial"
    assert grades(*failed(tried(B)))["layered_recovery"] == "partial"
    assert grades(*failed(tried("coordinator"), *whole))["layered_recovery"] == "none"


BEGAN = act("StepBegan", 0, "t1/1.1", robot=A, step=1, attempt=1, capability="lift", target_role="B")
OWN = event("PolicyWindowOpened", 0, robot=A, scope="local", window="w1", outcome="deny")
RULE = event("PolicyWindowOpened", 0, robot=B, scope="fleet", window="w2", outcome="review")
DENIED = event("RequestDenied", 3 * S, **about(B), reason="policy")
REVIEW = act("SupervisorCalled", 3 * S, "t1/1.1", supervisor="supervisor/fleet", purpose="review", robot=B)
APPROVED = event("SupervisorResponded", 3 * S, **about("supervisor/fleet"), purpose="review", approves=True)


@pytest.mark.slow
def test_policy_is_composed_when_executor_requester_and_fleet_are_each_heeded() -> None:
    decided = (BEGAN, OWN, RULE, DENIED)
    assert (
        grades(*decided, event("RequestAdmitted", 9 * S, **about(B, "t9/1"), outcome="allow"))["policy_composition"]
        == "full"
    )
    assert grades(*decided, admitted())["policy_composition"] == "partial"
    assert grades(*decided, admitted("coordinator"))["policy_composition"] == "none"
    synced = event(
        "CopySynced", 1 * S, fleet_deny=[], fleet_review=[], local_deny=[], local_review=[], busy=[], degraded=[]
    )
    assert grades(synced, *decided, admitted("coordinator"))["policy_composition"] == "partial"
    assert grades(BEGAN, admitted())["policy_composition"] is None


@pytest.mark.parametrize(
    ("events", "requester", "fleet"),
    [
        ((OWN, admitted()), "0/1", "not shown"),
        ((RULE, admitted()), "not shown", "0/1"),
        ((OWN, RULE, REVIEW), "1/1", "1/1"),
        ((RULE, REVIEW, APPROVED, admitted()), "not shown", "2/2"),
        ((RULE, REVIEW, {**APPROVED, "approves": False}, admitted()), "not shown", "1/2"),
        ((RULE, REVIEW, APPROVED, {**APPROVED, "approves": False}, admitted()), "not shown", "1/2"),
        ((RULE, REVIEW, {**APPROVED, "approves": None}, admitted()), "not shown", "2/2"),
        (({**OWN, "time_us": 2 * S + 1}, admitted()), "not shown", "not shown"),
        (
            (OWN, event("PolicyWindowClosed", 3 * S, robot=A, scope="local", window="w1"), admitted()),
            "not shown",
            "not shown",
        ),
        (({**OWN, "robot": C}, admitted()), "not shown", "not shown"),
    ],
)
def test_a_policy_is_heeded_when_the_decision_refuses_or_is_reviewed(
    events: tuple[Row, ...], requester: str, fleet: str
) -> None:
    said = evidence("policy_composition", BEGAN, *events)
    assert f"the requester's policy heeded {requester}" in said
    assert f"the fleet's rule heeded {fleet}" in said


@pytest.mark.slow
def test_a_registry_governs_when_delegations_are_found_in_it_and_hidden_capabilities_stay_hidden() -> None:
    assert grades(OUTSIDER, FOUND, started())["governed_registry"] == "full"
    assert grades(OUTSIDER, FOUND, started(), started("x1/1"))["governed_registry"] == "none"
    found_both = {**FOUND, "task_id": "x1"}
    assert grades(OUTSIDER, FOUND, found_both, started(), started("x1/1"))["governed_registry"] == "partial"
    assert grades(OUTSIDER, started())["governed_registry"] == "none"
    assert grades(FOUND, started())["governed_registry"] is None
    met = event("PeerRemembered", 0, robot=A, peer=B, until_us=60 * S)
    assert grades(OUTSIDER, met, FOUND, started())["governed_registry"] == "none"
    assert grades(OUTSIDER, {**met, "until_us": 0}, FOUND, started())["governed_registry"] == "full"


def test_audit_attribution_follows_the_share_of_complete_records() -> None:
    whole = [event("OwnStepDecided", 1 * S, **about(A, f"t{number}/1"), capability="lift") for number in range(20)]
    lost = event("InternalHandoff", 1 * S, sender="x", receiver="y")
    assert grades(*whole, lost)["audit_attribution"] == "full"
    assert grades(*whole, lost, lost)["audit_attribution"] == "partial"
    assert grades(*whole, *[lost] * 9)["audit_attribution"] == "none"


def test_grades_do_not_look_at_the_architecture_and_stand_for_each_configuration() -> None:
    assert (
        grades(*JOINED, asked(), architecture="cfc")
        == grades(*JOINED, asked(), architecture="dhma")
        == grades(*JOINED, asked())
    )
    runs = [
        *run(*JOINED, asked()),
        *run(*JOINED, asked("agent/A1/x"), run_id="r2", configuration="without-shared-registry"),
    ]
    with from_rows(runs) as database:
        rows = plain_rows(database.query("tables/architecture_features"))
    assert (
        [row["configuration"] for row in rows].count("full")
        == [row["configuration"] for row in rows].count("without-shared-registry")
        == 8
    )


@pytest.fixture(scope="module")
def marked(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, str], str | None]:
    """The grades of FSAR and of FSAR without one mechanism each, on three scenarios that need all of them."""
    path = tmp_path_factory.mktemp("ablations") / "ledger"
    scenarios: tuple[Scenario, ...] = ("collaborative-delivery", "failure-recovery-chain", "mixed-trust-inspection")
    run_experiment(path, Experiment(("fsar",), scenarios, 20, configurations=CONFIGURATIONS), 1)
    with connect(path) as database:
        rows = plain_rows(database.query("tables/architecture_features"))
    return {(row["configuration"], row["feature"]): row["grade"] for row in rows}


@pytest.mark.slow  # 300 runs
@pytest.mark.parametrize(
    ("mechanism", "feature", "grade"),
    [
        ("trust-evaluation", "trust_scoped_delegation", "none"),
        ("policy-composition", "policy_composition", "partial"),
        ("layered-recovery", "layered_recovery", "partial"),
        ("shared-registry", "governed_registry", "none"),
    ],
)
def test_who_loses_a_mechanism_loses_its_mark(
    marked: dict[tuple[str, str], str | None], mechanism: str, feature: str, grade: str
) -> None:
    assert marked["full", feature] == "full"
    assert marked[f"without-{mechanism}", feature] == grade
