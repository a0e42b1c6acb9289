"""The ten invariants: real FSAR runs satisfy them, and every seeded defect is caught at its event."""

import re
from collections import Counter
from functools import cache
from typing import Any, NamedTuple

import pytest

from fsar_ledger.events.configuration import Configuration
from fsar_ledger.events.envelope import Architecture, Scenario
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.ledger.rows.schema import LAYOUTS
from fsar_ledger.metrics.invariants import audit_rows, chosen, invariants
from fsar_ledger.metrics.library import library
from fsar_ledger.runtime.architectures import HandlerTable
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from tests.queries.defects import (
    Row,
    Seeds,
    an_hour_later,
    at_its_start,
    before_start,
    beyond,
    carried,
    delegated_end,
    finished_by_another,
    forged,
    in_place_before,
    is_free,
    joined_again,
    lost,
    never_closed,
    of_delegated_start,
    revoked_before_admission,
    swapped,
    under_its_own_deny,
    where,
    without,
)
from tests.queries.histories import S, act, answer, event, run
from tests.quick import few
from tests.recycled import from_rows
from tests.runtime.pinned import PINNED

RUNS: tuple[tuple[Scenario, int], ...] = (
    ("failure-recovery-chain", 12),
    ("failure-recovery-chain", 18),
    ("collaborative-delivery", 2),
    ("collaborative-delivery", 15),
)
"""Between them: relays, holds, reviews, an absent supervisor at an execution, and recovery at all four levels."""


def record(
    scenario: Scenario,
    run: int,
    architecture: Architecture = "fsar",
    configuration: Configuration = "full",
    structure: HandlerTable | None = None,
) -> Any:
    return simulate_run(RunSpec(42, architecture, configuration, scenario, 4, run), PINNED, structure)


@cache
def history() -> tuple[Row, ...]:
    return tuple(encode([record(*run) for run in RUNS]).to_pylist())


class Defect(NamedTuple):
    """What is done to the rows, and the invariant that must say so."""

    invariant: str
    name: str
    seed: Seeds


AGENT = "agent/A1/execution"
DEFECTS = (
    Defect("i1", "a part of the robot accepts", forged("RequestAccepted", {"decided_by": AGENT})),
    Defect("i1", "a part of the robot holds authority", forged("AuthorityClaimed", {"claimant": "agent/B1/planning"})),
    Defect("i1", "a part of the robot is on the path", forged("RoutinePerformed", {"path": [AGENT, "robot/A1"]})),
    Defect("i1", "a robot that never joined asks", forged("RequestIssued", {"requested_by": "robot/Z9"})),
    Defect("i1", "a robot joins twice", joined_again),
    Defect("i2", "the coordinator accepts", at_its_start(forged("RequestAccepted", {"decided_by": "coordinator"}))),
    Defect("i2", "the acceptance names no decider", at_its_start(forged("RequestAccepted", {"decided_by": None}))),
    Defect("i2", "the acceptance is lost", lost("RequestAccepted")),
    Defect("i2", "the execution comes before the acceptance", swapped("RequestAccepted", "ExecutionStarted")),
    Defect("i2", "the execution names another executor", of_delegated_start({"executed_by": "robot/Z1"})),
    Defect("i2", "admitted against a revocation", revoked_before_admission),
    Defect("i3", "a refusal before the start", before_start("RequestDenied", {"reason": "policy"})),
    Defect("i3", "the request carried a deny", at_its_start(carried("deny"))),
    Defect("i3", "the robot's own policy denies the execution", under_its_own_deny("ExecutionStarted")),
    Defect("i3", "the robot's own policy denies the motion", under_its_own_deny("RoutinePerformed")),
    Defect("i4", "a level is skipped", forged("RecoveryEscalated", {"to_level": "human"}, level="local")),
    Defect("i4", "recovery goes back", forged("RecoveryEscalated", {"to_level": "local"}, level="fleet")),
    Defect("i4", "an attempt at a level not reached", forged("RecoveryAttempted", {"level": "fleet"})),
    Defect("i4", "resolved below the level reached", forged("FailureResolved", {"level": "local"}, level="human")),
    Defect("i4", "the level is not recorded", forged("RecoveryEscalated", {"to_level": None})),
    Defect("i4", "recovery comes before the failure", swapped("ExecutionFailed", "RecoveryAttempted")),
    Defect(
        "i4",
        "a human is called before anything else",
        in_place_before("RecoveryAttempted", "SupervisorCalled", {"purpose": "recovery"}, ("action_id",)),
    ),
    Defect("i4", "more attempts than the level has", beyond("RecoveryAttempted", {"local_attempts": 0})),
    Defect("i4", "more helpers than the level has", beyond("AssistanceRequested", {"peer_helpers": 0})),
    Defect("i4", "an attempt takes an hour for itself", forged("RecoveryAttempted", {"deadline_us": 3_600_000_000})),
    Defect("i4", "an attempt after the time of its level", an_hour_later("RecoveryAttempted")),
    Defect("i4", "help is asked after the time of its level", an_hour_later("AssistanceRequested")),
    Defect("i4", "a reassignment after the time of its level", an_hour_later("ReassignmentDecided")),
    Defect("i4", "an hour at the level of the fleet", an_hour_later("RecoveryEscalated", to_level="human")),
    Defect("i4", "help that was never asked for", without("AssistanceRequested", "AssistanceAdmitted")),
    Defect("i4", "resolved by a peer who did not help", without("AssistanceAdmitted", "FailureResolved", level="peer")),
    Defect(
        "i4", "resolved by a human who never answered", without("SupervisorResponded", "FailureResolved", level="human")
    ),
    Defect("i5", "a routine without executor", forged("RoutinePerformed", {"executed_by": None})),
    Defect("i5", "a routine without requester", forged("RoutinePerformed", {"requested_by": None})),
    Defect(
        "i5",
        "a routine without supervisor on shift",
        forged("RoutinePerformed", {"supervised_by": None}, supervised_by=lambda found: found is not None),
    ),
    Defect("i5", "a gap that belongs to no action", forged("GapDetected", {"action_id": None})),
    Defect("a1", "the coordinator decides an own step", forged("OwnStepDecided", {"decided_by": "coordinator"})),
    Defect(
        "a1",
        "a service is on the path of a motion",
        forged("RoutinePerformed", {"path": ["service/coordination", "robot/A1"]}),
    ),
    Defect("a1", "nobody decides an own step", forged("OwnStepDecided", {"decided_by": None})),
    Defect("a1", "an own step is executed before it is decided", swapped("OwnStepDecided", "ExecutionStarted")),
    Defect("a2", "a service executes", forged("ExecutionStarted", {"executed_by": "service/coordination"})),
    Defect("a2", "the coordinator executes", forged("ExecutionFinished", {"executed_by": "coordinator"})),
    Defect("a2", "the registry is the body that moves", forged("ExecutionStarted", {"robot": "service/registry"})),
    Defect("a3", "admitted against a carried deny", carried("deny")),
    Defect("a3", "admitted without the review that was carried", carried("review")),
    Defect("a3", "admitted as deny", forged("RequestAdmitted", {"outcome": "deny"})),
    Defect("a3", "a hold that nothing ends", before_start("ExecutionHeld", {"outcome": "deny"})),
    Defect("a3", "a refusal before the start", before_start("RequestDenied", {"reason": "policy"})),
    Defect("a3", "the robot's own policy denies the execution", under_its_own_deny("ExecutionStarted")),
    Defect("a4", "a service accepts", forged("RequestAccepted", {"decided_by": "service/coordination"})),
    Defect("a4", "the requester admits", forged("RequestAdmitted", {"decided_by": "robot/Z1"})),
    Defect("a4", "nobody decides a motion", forged("RoutinePerformed", {"decided_by": None})),
    Defect("a4", "the recovery service retries", forged("RecoveryAttempted", {"decided_by": "service/recovery"})),
    Defect("a4", "the asked robot's peer lends it", forged("AssistanceAdmitted", {"decided_by": "service/recovery"})),
    Defect("a5", "no requester", of_delegated_start({"requested_by": None})),
    Defect("a5", "no executor", of_delegated_start({"executed_by": None})),
    Defect("a5", "no supervisor on shift", of_delegated_start({"supervised_by": None})),
    Defect("a5", "another requester", of_delegated_start({"requested_by": "robot/Z1"})),
    Defect("a5", "the request is lost", lost("RequestIssued")),
    Defect("a5", "the acceptance is lost", lost("RequestAccepted")),
    Defect("a5", "the admission is lost", lost("RequestAdmitted")),
    Defect("a5", "accepted before it is admitted", at_its_start(swapped("RequestAdmitted", "RequestAccepted"))),
    Defect("a5", "ended by another robot than began it", finished_by_another),
    Defect("a5", "the task goes on and the request is never closed", never_closed),
    Defect(
        "a5",
        "help without any principal",
        forged("AssistanceAdmitted", {"requested_by": None, "executed_by": None, "supervised_by": None}),
    ),
)


def offending(name: str, rows: list[Row]) -> set[tuple[str, int]]:
    (query,) = chosen([name])
    with from_rows(rows, threads=1) as database:
        return {(row["run_id"], row["seq"]) for row in database.rows(f"SELECT run_id, seq FROM {query.relation}")}


def test_all_hold_on_the_untouched_history_which_has_what_they_judge() -> None:
    rows = list(history())
    for name in ("RequestRelayed", "ExecutionHeld", "AssistanceAdmitted", "ReassignmentDecided", "SupervisorResponded"):
        assert where(rows, name), name
    assert {rows[at]["to_level"] for at in where(rows, "RecoveryEscalated")} == {"peer", "fleet", "human"}
    assert where(rows, "ExecutionStarted", supervised_by=None)
    with from_rows(rows, threads=1) as database:
        assert [(row.invariant, row.events) for row in audit_rows(database, invariants())] == [
            (query.relation, 0) for query in invariants()
        ]


OFTEN = {defect.invariant: defect for defect in DEFECTS}.values()
"""A defect of each invariant, tried each time; the others with `make test-all`."""


@pytest.mark.parametrize("defect", few(DEFECTS, OFTEN), ids=lambda defect: f"{defect.invariant}: {defect.name}")
def test_a_seeded_defect_is_caught_at_its_event(defect: Defect) -> None:
    rows = [dict(row) for row in history()]
    (shows_at,) = defect.seed(rows)
    assert (rows[shows_at]["run_id"], rows[shows_at]["seq"]) in offending(defect.invariant, rows)


def test_every_invariant_yields_what_audit_reads() -> None:
    with from_rows([]) as database:
        for query in invariants():
            lacking = {"run_id", "seq", "type", "found"} - set(database.query(query.name).column_names)
            assert not lacking, f"queries/{query.name}.sql: it has no column {', '.join(sorted(lacking))}"


def test_every_invariant_has_at_least_three_seeded_defects() -> None:
    names = {query.relation.partition("_")[0] for query in invariants()}
    count = Counter(defect.invariant for defect in DEFECTS)
    assert count.keys() <= names
    assert {name: count[name] for name in names if count[name] < 3} == {}, "add as many to DEFECTS"


def test_types_that_are_left_out_unread_name_nobody_and_are_counted_nowhere() -> None:
    sql = library().relations["naming_events"].sql
    selected, _, listed = sql.partition("FROM event_principals")
    named = set(re.findall(r"\w+", selected.partition("action_id, ")[2]))
    assert {"robot", "decided_by", "path"} < named
    left_out = set(re.findall(r"'(.*?)'", listed))
    assert left_out == {tag for tag, layout in LAYOUTS.items() if not named & {field.name for field in layout.fields}}
    assert not any(f"'{tag}'" in library().relations["invariant_cases"].sql for tag in left_out)
    assert left_out.isdisjoint({row[0] for row in answer("facts/event_classes", columns=("type",))})


def test_i5_holds_where_the_registry_refuses_an_outsider_and_finds_when_it_does_not_say_whom() -> None:
    rows = encode([record("mixed-trust-inspection", 0)]).to_pylist()
    refused = where(rows, "RegistryQueried", candidates=[])
    assert refused
    assert offending("i5", rows) == set()
    for at in refused:
        rows[at] = {**rows[at], "executed_by": None}
    assert offending("i5", rows) == {(rows[at]["run_id"], rows[at]["seq"]) for at in refused}


def test_a5_holds_when_a_task_is_given_up_while_its_request_is_being_closed() -> None:
    rows = [dict(row) for row in history()]
    end = delegated_end(rows)
    (closed,) = where(rows, "RequestClosed", run_id=rows[end]["run_id"], action_id=rows[end]["action_id"])
    given_up = {"type": "TaskAbandoned.v1", "task_id": rows[end]["task_id"]}
    rows[end + 1] = in_place(rows[end + 1], given_up)
    assert end + 1 < closed
    assert offending("a5", rows) == set()
    rows[closed]["action_id"] = None
    assert offending("a5", rows) == {(rows[end]["run_id"], rows[end]["seq"])}


def test_a5_finds_an_offence_once_however_often_a_step_began_or_its_supervisor_left() -> None:
    door = event("RobotJoined", robot="robot/B1", role="B", supervisor="supervisor/B1")
    parties = {"robot": "robot/B1", "on_behalf_of": "robot/A1", "requested_by": "robot/A1", "executed_by": "robot/B1"}
    once = (
        event("SupervisorLeft", 1, supervisor="supervisor/B1"),
        act("StepBegan", 2, "t1/1", robot="robot/A1"),
    )
    ends = (act("ExecutionStarted", 3, "t1/1", **parties), act("ExecutionFinished", 4, "t1/1", **parties))
    helps = act("AssistanceAdmitted", 5, "t1/1", helper="robot/B1", robot="robot/A1", failure=1)
    found = answer("invariants/a5_audit_completeness", run(door, *once, *ends, helps), columns=("time_us", "found"))
    assert [time_us for time_us, _ in found] == [3, 4, 5]
    twice = run(door, *once, *once, *ends, helps)
    assert answer("invariants/a5_audit_completeness", twice, columns=("time_us", "found")) == found
    assert len(answer("facts/cross_robot_records", twice)) == len(ends)


@pytest.mark.parametrize(("on_behalf_of", "offences"), [("robot/B1", 0), (None, 0), ("robot/A1", 2)])
def test_a5_judges_no_end_of_an_execution_that_may_be_the_robots_own(on_behalf_of: str | None, offences: int) -> None:
    parties = {"robot": "robot/B1", "requested_by": "robot/B1", "executed_by": "robot/B1", "supervised_by": "x"}
    history = run(
        act("StepBegan", 1, "t1/1", robot="robot/B1"),
        act("ExecutionStarted", 2, "t1/1", **parties, on_behalf_of=on_behalf_of),
        act("ExecutionFinished", 3, "t1/1", **parties),
    )
    assert len(answer("invariants/a5_audit_completeness", history)) == offences


@pytest.mark.parametrize("is_broken", [False, True])
def test_a3_takes_an_approval_for_the_reviews_known_by_the_admission(is_broken: bool) -> None:
    rows = [dict(row) for row in history()]
    approved, admitted, start = reviewed_start(rows)
    window = {"type": "PolicyWindowOpened.v1", "scope": "local", "window": "seeded", "outcome": "review"}
    window["robot"] = rows[start]["robot"]
    if is_broken:  # it opens after the admission
        rows[admitted + 1] = in_place(rows[admitted + 1], window)
    else:  # it opens between the approval and the admission
        free = next(at for at in range(approved, 0, -1) if is_free(rows[at]))
        rows[free] = in_place(rows[free], {**rows[approved], **place_of(rows[free])})
        rows[approved] = in_place(rows[approved], window)
    assert offending("a3", rows) == ({(rows[start]["run_id"], rows[start]["seq"])} if is_broken else set())


def in_place(row: Row, change: Row) -> Row:
    """Return another event where this one was."""
    return {**dict.fromkeys(row), **place_of(row), **change}


def place_of(row: Row) -> Row:
    return {name: row[name] for name in ("run_id", "seq", "time_us", "caused_by")}


def reviewed_start(rows: list[Row]) -> tuple[int, int, int]:
    """Return where a review is approved, where its request is admitted, and where its execution starts."""
    for approved in where(rows, "SupervisorResponded", purpose="review", approves=True):
        about = {name: rows[approved][name] for name in ("run_id", "action_id")}
        starts, admitted = where(rows, "ExecutionStarted", **about), where(rows, "RequestAdmitted", **about)
        if starts and admitted and admitted[0] > approved and starts[0] > admitted[0] + 1:
            return approved, admitted[0], starts[0]
    raise AssertionError("no start after a review")


def test_who_decides_for_another_is_said_without_those_that_the_record_does_not_name() -> None:
    step = event("OwnStepDecided", 1, task_id="t1", executed_by="robot/A1")
    admitted = event("RequestAdmitted", 2, decided_by=AGENT)
    rows = run(
        {**step, "decided_by": "coordinator", "path": ["coordinator"]},
        {**step, "decided_by": "robot/A1", "path": [AGENT, "robot/A1"]},
        {**step, "decided_by": "robot/A1"},
        {**step, "decided_by": "robot/A1", "path": ["robot/A1", "robot/A1"]},  # asks itself: nobody else had a part
        step,
        admitted,
    )
    alone = "decides what is for robot/A1 alone to decide"
    assert answer("invariants/a1_local_runtime_self_sufficiency", rows, columns=("found",)) == [
        (f"coordinator {alone}",),
        (f"robot/A1 through {AGENT} {alone}",),
        (f"robot/A1 {alone}, and its path is not on record",),
        (f"nobody on record {alone}",),
    ]
    assert answer("invariants/a4_thin_federation_interface", rows, columns=("found",)) == [
        ("coordinator decides what robot/A1 executes",),
        ("nobody on record decides what robot/A1 executes",),
        (f"{AGENT} decides what an executor that is not on record executes",),
    ]


def test_who_is_asked_and_is_of_no_fleet_is_not_said_to_act() -> None:
    joined = event("RobotJoined", 1, robot="robot/A1", supervisor="supervisor/A1", role="A", team=1)
    asks = event("RequestIssued", 2, decided_by="robot/A1", requested_by="robot/A1", executed_by="robot/X9")
    assert answer("invariants/i1_local_agent_coherence", run(joined, asks), columns=("found",)) == [
        ("robot/X9 is named, and is neither a robot of the fleet nor one of its supervisors or services",)
    ]


@pytest.mark.parametrize("name", ["AssistanceRequested", "AssistanceEnded", "ReassignmentDecided"])
def test_a_service_or_coordinator_that_helps_a_robot_breaks_a2(name: str) -> None:
    for helper, found in (("robot/B1", []), ("service/recovery", ["helps"]), ("coordinator", ["helps"])):
        rows = run(event(name, 1, action_id="t/1", robot="robot/A1", helper=helper, failure=1))
        assert answer("invariants/a2_coordination_only_federation", rows, columns=("found",)) == [
            (f"{helper} is named as the one that {does}",) for does in found
        ]


def test_an_executor_that_stands_twice_on_its_path_accepted_alone() -> None:
    own = {"decided_by": "robot/B1", "requested_by": "robot/A1", "executed_by": "robot/B1", "action_id": "t/1"}
    starts = event("ExecutionStarted", 2, **own, robot="robot/B1", on_behalf_of="robot/A1")
    for path, found in ((["robot/B1", "robot/B1"], 0), (["robot/B1", "coordinator"], 1)):
        rows = run(event("RequestAccepted", 1, **own, path=path), starts)
        assert len(answer("invariants/i2_local_execution_ownership", rows, columns=("found",))) == found


@pytest.mark.parametrize(
    ("accepted", "found"),
    [
        ({"path": ["robot/B1", "coordinator"]}, "it had accepted through coordinator"),
        ({"path": []}, "it had accepted by a path that is not on record"),
        ({"executed_by": None}, "it had accepted, but the acceptance names nobody as executor"),
        ({"decided_by": "coordinator"}, "coordinator had accepted"),
        ({"decided_by": None}, "somebody not on record had accepted"),
    ],
)
def test_an_acceptance_that_is_not_the_executors_own_is_told_with_what_is_wrong_with_it(
    accepted: Row, found: str
) -> None:
    own = {"decided_by": "robot/B1", "requested_by": "robot/A1", "executed_by": "robot/B1", "action_id": "t/1"}
    starts = event("ExecutionStarted", 2, **own, robot="robot/B1", on_behalf_of="robot/A1")
    rows = run(event("RequestAccepted", 1, **{**own, "path": ["robot/B1"], **accepted}), starts)
    assert answer("invariants/i2_local_execution_ownership", rows, columns=("found",)) == [
        (f"robot/B1 executes for robot/A1 what {found}",)
    ]


def test_a_stranger_that_executes_offends_i1_also_where_the_record_leaves_its_executor_out() -> None:
    joined = event("RobotJoined", 0, robot="robot/A1", role="A")
    history = run(
        joined,
        act("ExecutionStarted", 1 * S, "t1/1", robot="robot/A1", capability="lift"),
        act("ExecutionStarted", 2 * S, "t1/2", robot="robot/X9", capability="lift"),
        act("ExecutionFinished", 3 * S, "t1/2", robot="robot/X9", result="success"),
        kind="foreign",
        records=["RobotJoined", "ExecutionStarted", "ExecutionFinished"],
    )
    assert answer("invariants/i1_local_agent_coherence", history, columns=("seq",)) == [(3,), (4,)]
    cases = answer("facts/invariant_cases", history, columns=("invariant", "cases"))
    assert ("i1_local_agent_coherence", 4) in cases
