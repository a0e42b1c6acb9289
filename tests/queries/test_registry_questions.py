"""Audit questions about the registry: what stood on a surface when, why a robot was no candidate, in which state it
was."""

from typing import Any

import pytest

from fsar_ledger.designs.constants import Constants
from fsar_ledger.events.registry import RegistryQueried
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.metrics.database import plain_rows
from fsar_ledger.projections.fold import State, apply
from fsar_ledger.projections.registry import surface
from fsar_ledger.runtime.handlers.candidates import FILTERS
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from tests.queries.histories import Row, answer, event, run
from tests.queries.test_audit_questions import ROBOTS, asked, offer, trust
from tests.recycled import from_table
from tests.runtime.robot_states import execution_state

B1 = {"robot": "robot/B1", "capability": "lift"}


def change(name: str, time_us: int, **fields: Any) -> Row:
    return event(name, time_us, **{**B1, **fields})


def surface_at(at_us: int, columns: str, *events: Row) -> list[tuple[Any, ...]]:
    return asked("capability_surface", columns, *ROBOTS, *events, at_us=at_us, robot="robot/B1")


LIFE = (
    change("CapabilityAdvertised", 5, version="1.0.0", visible_to=[]),
    change("AvailabilityChanged", 7, availability="busy"),
    change("AvailabilityChanged", 9, capability=None, availability="degraded"),
    change("AvailabilityChanged", 11, capability="open", availability="offline"),
    change("CapabilityDeprecated", 13, version="1.0.0", successor="2.0.0"),
    change("CapabilityAdvertised", 15, version="2.0.0", visible_to=["C"]),
    change("CapabilityWithdrawn", 17),
    change("AvailabilityChanged", 18, availability="ready"),
    change("CapabilityAdvertised", 19, version="2.1.0", visible_to=[], availability="restricted"),
    change("CapabilityRemoved", 21),
)


@pytest.mark.parametrize(
    ("at_us", "expected"),
    [
        (4, []),
        (5, [(5, "1.0.0", "ready", False, None, [])]),
        (6, [(5, "1.0.0", "ready", False, None, [])]),
        (7, [(7, "1.0.0", "busy", False, None, [])]),
        (9, [(9, "1.0.0", "degraded", False, None, [])]),
        (12, [(9, "1.0.0", "degraded", False, None, [])]),
        (13, [(13, "1.0.0", "degraded", True, "2.0.0", [])]),
        (15, [(15, "2.0.0", "ready", False, None, ["C"])]),
        (17, []),
        (18, []),
        (19, [(19, "2.1.0", "restricted", False, None, [])]),
        (21, []),
    ],
)
def test_the_surface_is_what_was_advertised_and_neither_withdrawn_nor_removed(
    at_us: int, expected: list[tuple[Any, ...]]
) -> None:
    assert surface_at(at_us, "since_us version availability is_deprecated successor visible_to", *LIFE) == expected


def test_the_periods_of_an_advertisement_follow_each_other_without_gap_or_overlap() -> None:
    periods = answer(
        "facts/advertisements", run(*ROBOTS, *LIFE), columns=("since_us", "until_us", "version", "availability")
    )
    assert periods == [
        (5, 7, "1.0.0", "ready"),
        (7, 9, "1.0.0", "busy"),
        (9, 13, "1.0.0", "degraded"),
        (13, 15, "1.0.0", "degraded"),
        (15, 17, "2.0.0", "ready"),
        (19, 21, "2.1.0", "restricted"),
    ]


def test_of_several_changes_at_one_moment_the_last_one_holds() -> None:
    events = (
        LIFE[0],
        change("AvailabilityChanged", 5, availability="busy"),
        change("AvailabilityChanged", 5, availability="offline"),
    )
    assert surface_at(5, "availability", *events) == [("offline",)]


@pytest.mark.parametrize(
    ("required", "scope", "may_ask"),
    [("capability", "capability", ["robot/A1"]), ("task", "capability", []), ("task", "persistent", ["robot/A1"])],
)
def test_those_may_ask_whose_trust_is_as_broad_as_required(required: str, scope: str, may_ask: list[str]) -> None:
    offered = change("CapabilityAdvertised", 5, trust_required=required, visible_to=[])
    assert surface_at(9, "may_ask", trust(1, "B1", "A1", scope), offered) == [(may_ask,)]


def test_what_a_robot_says_of_one_capability_goes_before_what_it_says_of_all() -> None:
    about = {**trust(1, "B1", "A1", "none"), "capability": "lift"}
    other = {**trust(1, "B1", "A1", "none"), "capability": "open"}
    general = trust(3, "B1", "A1", "session")
    offered = change("CapabilityAdvertised", 5, visible_to=[])
    assert surface_at(9, "may_ask", about, general, offered) == [([],)]
    assert surface_at(9, "may_ask", other, general, offered) == [(["robot/A1"],)]
    assert surface_at(9, "may_ask", {**general, "context": "t1"}, offered) == [([],)]


@pytest.mark.parametrize(
    ("visibility", "own", "asking", "may_ask"),
    [
        ("domain", "hall", "hall", ["robot/A1"]),
        ("domain", "hall", "hall/cell", ["robot/A1"]),
        ("domain", "hall", "hallway", []),
        ("domain", "hall", "", []),
        ("domain", "", "yard", ["robot/A1"]),
        ("global", "hall", "", ["robot/A1"]),
    ],
)
def test_only_those_in_its_domain_may_ask_for_what_is_shown_there(
    visibility: str, own: str, asking: str, may_ask: list[str]
) -> None:
    robots = (
        event("RobotJoined", robot="robot/A1", role="A", domain=asking),
        event("RobotJoined", robot="robot/B1", role="B", domain=own),
    )
    advertised = change("CapabilityAdvertised", 5, visible_to=[], visibility=visibility, trust_required="task")
    assert asked(
        "capability_surface", "may_ask", *robots, trust(1, "B1", "A1", "task"), advertised, robot="robot/B1"
    ) == [(may_ask,)]


def query(time_us: int, *rejected_by: str, **fields: Any) -> Row:
    """A1 asks; B1 is rejected by this filter."""
    rejected = ["robot/B1"] * len(rejected_by)
    asking = {
        "action_id": "t1/1",
        "requested_by": "robot/A1",
        "capability": "lift",
        "candidates": [],
        "rejected": rejected,
        "rejected_by": list(rejected_by),
    }
    return event("RegistryQueried", time_us, **{**asking, "domain": "", **fields})


REASONS = {
    "visibility": "not visible to role A",
    "version": "its version is out of range or deprecated",
    "contract": "its contract does not suit",
    "trust": "too little trust in the requester",
    "policy": "its declared policy does not allow it",
    "authority": "its authority profile does not allow the override",
    "availability": "offline or restricted",
    "embodiment": "not the body that is needed",
}


@pytest.mark.parametrize("name", FILTERS)
def test_the_filter_that_left_a_robot_out_is_the_answer(name: str) -> None:
    offered = offer(1, "B1", "C") if name == "visibility" else offer(1, "B1")
    rows = asked(
        "query_candidates",
        "robot is_candidate rejected_by reason",
        *ROBOTS,
        trust(1, "B1", "A1", "task"),
        offered,
        query(2, name),
        robot="robot/B1",
    )
    assert rows == [("robot/B1", False, name, REASONS[name])]


def test_a_robot_that_hides_from_other_domains_or_from_strangers_is_told_apart() -> None:
    def reasons(visibility: str) -> list[tuple[Any, ...]]:
        return asked(
            "query_candidates",
            "reason",
            *ROBOTS[:2],
            {**offer(1, "B1"), "visibility": visibility},
            query(2, "visibility"),
        )

    assert reasons("domain") == [("not visible outside its domain",)]
    assert reasons("trust-gated") == [("not visible outside its trust",)]


def test_who_matched_nothing_does_not_offer_it_or_lies_beyond_the_search() -> None:
    def reasons(*events: Row) -> dict[str, str]:
        return dict(asked("query_candidates", "robot reason", *ROBOTS, *events))

    trusting = trust(1, "C1", "A1", "task")
    assert reasons(query(2, "trust"), trusting)["robot/C1"] == "does not offer it"
    found = reasons(offer(1, "C1"), change("CapabilityWithdrawn", 1, robot="robot/C1"), query(2))["robot/C1"]
    assert found == "does not offer it"
    assert reasons(offer(1, "C1"), trusting, query(2, domain="hall"))["robot/C1"] == "not reached by the search"
    assert reasons(offer(1, "C1"), trusting, query(2, candidates=["robot/C1"]))["robot/C1"] == "candidate"


def test_trust_is_that_of_the_capability_and_context_that_was_asked_for() -> None:
    def scope(*events: Row) -> list[tuple[Any, ...]]:
        return asked(
            "query_candidates", "trust_scope", *ROBOTS[:2], offer(1, "B1"), *events, query(9, "trust", task_id="t1")
        )

    general, about = trust(3, "B1", "A1", "task"), {**trust(1, "B1", "A1", "capability"), "capability": "lift"}
    assert scope(general) == [("task",)]
    assert scope(about, general) == [("capability",)]
    assert scope({**about, "capability": "open"}) == [(None,)]
    assert scope({**general, "context": "t1", "scope": "session"}, general) == [("session",)]
    assert scope({**general, "context": "t2"}) == [(None,)]


def test_a_group_of_capabilities_is_offered_by_who_offers_one_of_it() -> None:
    def reasons(capability: str) -> list[tuple[Any, ...]]:
        offered = change("CapabilityAdvertised", 1, capability=capability, visible_to=[])
        return asked("query_candidates", "reason", *ROBOTS[:2], offered, query(2, capability="grasp.*"))

    assert reasons("grasp.robust") == [("no trust in the requester",)]
    assert reasons("grasping") == reasons("lift") == [("does not offer it",)]


def doing(name: str, time_us: int, **fields: Any) -> Row:
    return event(name, time_us, **{"robot": "robot/B1", "action_id": "t1/1", **fields})


@pytest.mark.parametrize(
    ("at_us", "state", "action"),
    [
        *((0, "idle", None), (1, "executing", "t1/1"), (2, "executing", "t1/1")),
        *((3, "degraded", "t1/1"), (4, "failed", "t1/1"), (5, "failed", "t1/1"), (6, "failed", "t1/1")),
        *((7, "failed", "t1/1"), (8, "executing", "t1/1"), (9, "idle", None), (10, "degraded", None)),
        *((11, "idle", None), (12, "executing", "t9/1"), (13, "idle", None)),
        *((14, "off", None), (15, "idle", None)),
    ],
)
def test_a_robot_is_in_the_state_that_the_events_by_then_make(at_us: int, state: str, action: str | None) -> None:
    events = (
        doing("ExecutionQueued", 1),
        doing("ExecutionStarted", 2),
        doing("ActuatorDegraded", 3, action_id=None),
        doing("ExecutionFailed", 4, failure=1),
        doing("RecoveryEscalated", 5, failed_action="t1/1", level="local", to_level="peer"),
        doing("ExecutionResumed", 6),
        doing("ActuatorServiced", 7, action_id=None),
        doing("FailureResolved", 8),
        doing("ExecutionFinished", 9),
        change("CapabilityAdvertised", 10, availability="degraded", visible_to=[]),
        change("AvailabilityChanged", 11, capability=None, availability="ready"),
        doing("AssistanceAdmitted", 12, robot="robot/A1", helper="robot/B1", action_id="t9/1"),
        doing(
            "AssistanceFailed",
            13,
            robot="robot/A1",
            helper="robot/B1",
            action_id="t9/1",
            failure=1,
            cause="obstruction",
        ),
        doing("RobotWentOff", 14, action_id=None),
        doing("LinkWentDown", 14, action_id=None),
        doing("RobotCameBack", 15, action_id=None),
    )
    assert asked("robot_state_at", "state action_id", *ROBOTS[:2], *events, at_us=at_us, robot="robot/B1") == [
        (state, action)
    ]


def test_outages_are_spells_that_what_brings_them_back_ends() -> None:
    facts = (
        *("RobotWentOff", "LinkWentDown", "RobotCameBack", "ActuatorDegraded"),
        *("ActuatorDegraded", "LinkCameUp", "RobotWentOff", "ActuatorServiced"),
    )
    events = [doing(name, at, action_id=None) for at, name in enumerate(facts)]
    found = set(answer("facts/outages", run(*events), columns=("what", "since_us", "until_us")))
    expected = {("off", 0, 2), ("unlinked", 1, 5), ("degraded", 3, 4), ("degraded", 4, 7), ("off", 6, None)}
    assert found == expected


def test_a_robot_is_not_said_to_be_degraded_for_good_where_nobody_records_when_actuators_are_serviced() -> None:
    worn = doing("ActuatorDegraded", 1, action_id=None)
    for records, state in (([], None), (["ActuatorServiced"], "degraded")):
        rows = run(
            *ROBOTS[1:2], worn, kind="foreign", observes=[], records=["RobotJoined", "ActuatorDegraded", *records]
        )
        assert answer("audit/robot_state_at", rows, columns=("robot", "state")) == [("robot/B1", state)]


def test_help_for_a_failure_is_no_failure_of_the_helper() -> None:
    events = (
        doing("ExecutionFailed", 1, robot="robot/A1", action_id="t9/1", failure=1),
        doing("RecoveryEscalated", 2, robot="robot/A1", failed_action="t9/1", action_id="t9/1"),
        doing("AssistanceAdmitted", 3, robot="robot/A1", helper="robot/B1", action_id="t9/1"),
    )
    found = asked("robot_state_at", "robot state", *ROBOTS[:2], *events)
    assert found == [("robot/A1", "failed"), ("robot/B1", "executing")]


def test_what_waits_for_its_turn_is_not_what_a_robot_has_in_hand() -> None:
    events = (
        doing("ExecutionQueued", 1, action_id="t1/1"),
        doing("ExecutionQueued", 2, action_id="t2/1"),
        doing("ApproachStarted", 3, action_id="t2/1"),
        doing("ExecutionPreempted", 5, action_id="t2/1"),
        doing("ExecutionStarted", 6, action_id="t3/1"),
    )
    for at_us, action in ((1, "t1/1"), (3, "t2/1"), (6, "t3/1")):
        given: dict[str, Any] = {"at_us": at_us, "robot": "robot/B1"}
        assert asked("robot_state_at", "state action_id", *ROBOTS[:2], *events, **given) == [("executing", action)]


@pytest.mark.slow
def test_sql_and_the_fold_agree_on_states_and_surfaces_throughout_a_run_with_a_degraded_robot() -> None:
    record = simulate_run(RunSpec(42, "fsar", "full", "failure-recovery-chain", 4, 17), Constants())
    state, seen = State(), set()
    with from_table(encode([record]), threads=1) as database:
        for seq, one in enumerate(record.events):
            apply(state, one)
            is_last = seq + 1 == len(record.events) or record.times_us[seq + 1] > record.times_us[seq]
            is_telling = type(one).__name__.startswith(
                ("Availability", "Actuator", "ExecutionFailed", "Assistance", "Recovery")
            )
            if not is_last or record.times_us[seq] == 0 or (seq % 27 and not is_telling):
                continue
            given = {"at_us": str(record.times_us[seq])}
            states = {row["robot"]: row["state"] for row in plain_rows(database.query("audit/robot_state_at", given))}
            assert states == {robot: execution_state(state, robot) for robot in state.fleet.robots}, one
            shown = {
                (row["robot"], row["capability"]): row["availability"]
                for row in plain_rows(database.query("audit/capability_surface", given))
            }
            folded = [record for robot in state.fleet.robots for record in surface(state.registry, robot)]
            assert shown == {(record.robot, record.capability): record.availability for record in folded}
            seen |= set(states.values()) | set(shown.values())
    assert {"idle", "executing", "degraded", "failed", "ready"} <= seen


def test_every_robot_that_offers_what_a_run_of_two_teams_asked_for_was_candidate_or_has_its_filter() -> None:
    record = simulate_run(RunSpec(42, "fsar", "full", "mixed-trust-inspection", 8, 0), Constants())
    assert any(isinstance(one, RegistryQueried) and one.rejected for one in record.events)
    with from_table(encode([record]), threads=1) as database:
        rows = [
            row
            for row in plain_rows(database.query("audit/query_candidates"))
            if not row["action_id"].startswith("injected")
        ]
    offering = [row for row in rows if row["reason"] != "does not offer it"]
    assert offering
    relayed = {row["seq"] for row in rows if row["relay"]}
    assert all(row["is_candidate"] != (row["rejected_by"] is not None) for row in offering if row["seq"] not in relayed)
    assert all(row["is_candidate"] or row["rejected_by"] for row in offering)


AWAY = event("RobotDeparted", 4, robot="robot/A1", reason="silent", fence=1)
BACK = event("RobotReturned", 8, robot="robot/A1", fence=1)


@pytest.mark.parametrize(("at_us", "may_ask"), [(3, ["robot/A1"]), (4, []), (7, []), (8, ["robot/A1"])])
def test_who_has_departed_may_not_ask_until_it_has_returned(at_us: int, may_ask: list[str]) -> None:
    offered = change("CapabilityAdvertised", 2, visible_to=[])
    assert surface_at(at_us, "may_ask", trust(1, "B1", "A1", "task"), offered, AWAY, BACK) == [(may_ask,)]


@pytest.mark.parametrize(("records", "availability"), [([], None), (["AvailabilityChanged"], "ready")])
def test_an_offer_is_not_said_to_be_ready_for_good_where_nobody_records_how_that_changes(
    records: list[str], availability: str | None
) -> None:
    seen: dict[str, Any] = {"kind": "foreign", "observes": [], "records": ["CapabilityAdvertised", *records]}
    rows = run(change("CapabilityAdvertised", 2, visible_to=[]), {**AWAY, "robot": "robot/B1"}, **seen)
    columns = ("capability", "version", "availability", "may_ask")
    assert answer("audit/capability_surface", rows, columns=columns) == [("lift", None, availability, None)]


@pytest.mark.parametrize("back", ["RobotReturned", "RobotJoined"])
def test_a_robot_that_had_departed_is_told_apart_from_one_that_is_offline(back: str) -> None:
    gone = event("RobotDeparted", 2, robot="robot/B1", reason="silent", fence=1)
    found = query(3, candidates=["robot/B1"])

    def reasons(*events: Row) -> list[str]:
        rows = asked("query_candidates", "reason", *ROBOTS, trust(1, "B1", "A1", "task"), *events, robot="robot/B1")
        return [reason for (reason,) in rows]

    left = (offer(1, "B1"), gone)
    again = event(back, 4, robot="robot/B1", role="B")
    assert reasons(*left, query(3, "availability")) == ["it had departed"]
    assert reasons(*left, query(3)) == ["it had departed"]
    assert reasons(*left, found) == ["candidate, although it had departed"]
    assert reasons(*left, query(3, "version")) == [REASONS["version"]]
    assert reasons(gone, query(3)) == ["does not offer it"]
    assert reasons(*left, again, query(5, "availability")) == ["offline or restricted"]
    assert reasons(*left, again, found) == ["candidate"]
