"""The ten invariants: real FSAR runs satisfy them, and every seeded defect is caught at its event."""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import msgspec
import pytest

from fsar_ledger.constants import Constants
from fsar_ledger.events.configuration import Configuration
from fsar_ledger.events.envelope import Architecture, Scenario
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.metrics.invariants import audit_rows, chosen, invariants
from fsar_ledger.runtime.architectures.handler_table import HandlerTable
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from tests.recycled import from_rows

Row = dict[str, Any]
Seeds = Callable[[list[Row]], list[int]]
"""Puts a defect into the rows and says at which positions it shows."""

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
    return simulate_run(RunSpec(42, architecture, configuration, scenario, 4, run), Constants(), structure)


@cache
def history() -> tuple[Row, ...]:
    return tuple(encode([record(*run) for run in RUNS]).to_pylist())


def where(rows: list[Row], name: str, **fields: Any) -> list[int]:
    """The positions of the events of this type with these values (a callable: that satisfy it), in order."""
    matches = {
        key: value if callable(value) else (lambda found, value=value: found == value) for key, value in fields.items()
    }
    return [
        at
        for at, row in enumerate(rows)
        if row["type"].partition(".")[0] == name and all(match(row[key]) for key, match in matches.items())
    ]


def robots(name: str | None) -> bool:
    return name is not None and name.startswith("robot/")


def forged(name: str, change: dict[str, Any], nth: int = 0, **fields: Any) -> Seeds:
    """One event of this type says something else."""

    def seed(rows: list[Row]) -> list[int]:
        at = where(rows, name, **fields)[nth]
        rows[at] = {**rows[at], **change}
        return [at]

    return seed


def delegated_start(rows: list[Row]) -> int:
    return next(at for at in where(rows, "ExecutionStarted") if rows[at]["robot"] != rows[at]["on_behalf_of"])


def of_delegated_start(change: dict[str, Any]) -> Seeds:
    """The record of an execution for another robot, whose supervisor is on shift, says something else."""

    def seed(rows: list[Row]) -> list[int]:
        at = next(
            at
            for at in where(rows, "ExecutionStarted", supervised_by=lambda found: found is not None)
            if rows[at]["robot"] != rows[at]["on_behalf_of"]
        )
        rows[at] = {**rows[at], **change}
        return [at]

    return seed


def lost(name: str) -> Seeds:
    """The events of this type of a delegated action are lost (they become an event that says nothing of it)."""

    def seed(rows: list[Row]) -> list[int]:
        start = delegated_start(rows)
        key = ("run_id", "action_id")
        for at in where(rows, name):
            if all(rows[at][column] == rows[start][column] for column in key):
                rows[at] = {**rows[at], "action_id": None}
        return [start]

    return seed


def swapped(name: str, other: str) -> Seeds:
    """An event of the first type and the next one of the other type of the same action have changed places."""

    def seed(rows: list[Row]) -> list[int]:
        for at in where(rows, name):
            key = (rows[at]["run_id"], rows[at]["action_id"])
            later = [
                place
                for place in where(rows, other)
                if place > at and (rows[place]["run_id"], rows[place]["action_id"]) == key
            ]
            if later and (name != "RequestAccepted" or rows[later[0]]["robot"] != rows[later[0]]["on_behalf_of"]):
                rows[at], rows[later[0]] = rows[later[0]], rows[at]
                for column in ("seq", "time_us"):
                    rows[at][column], rows[later[0]][column] = rows[later[0]][column], rows[at][column]
                return [at]
        raise AssertionError(f"no {name} before {other}")

    return seed


def before_start(name: str, change: dict[str, Any]) -> Seeds:
    """An event of this type about the action stands just before a delegated execution, in place of another action's event."""

    def seed(rows: list[Row]) -> list[int]:
        start = next(
            at
            for at in where(rows, "ExecutionStarted")
            if rows[at]["robot"] != rows[at]["on_behalf_of"] and is_free(rows[at - 1])
        )
        kept = {column: rows[start - 1][column] for column in ("run_id", "seq", "time_us", "caused_by")}
        empty = dict.fromkeys(rows[start])
        rows[start - 1] = {
            **empty,
            **kept,
            "type": f"{name}.v1",
            "action_id": rows[start]["action_id"],
            "robot": rows[start]["robot"],
            **change,
        }
        return [start]

    return seed


def is_free(row: Row) -> bool:
    return row["type"] in (
        "RoutineDue.v1",
        "RoutinePerformed.v1",
        "ContextChanged.v1",
        "PeersMet.v1",
        "ObstructionAppeared.v1",
        "ApproachStarted.v1",
    )


def under_its_own_deny(name: str) -> Seeds:
    """A window of the robot's own policy opened before this event, and nothing heeded it."""

    def seed(rows: list[Row]) -> list[int]:
        for start in where(rows, name, **({"operation": "motion"} if name == "RoutinePerformed" else {})):
            free = next(
                (
                    at
                    for at in range(start - 1, max(start - 6, 0), -1)
                    if is_free(rows[at]) and rows[at]["run_id"] == rows[start]["run_id"]
                ),
                None,
            )
            if free is not None:
                kept = {column: rows[free][column] for column in ("run_id", "seq", "time_us", "caused_by")}
                window = {
                    "type": "PolicyWindowOpened.v1",
                    "robot": rows[start]["robot"],
                    "scope": "local",
                    "window": "seeded",
                    "outcome": "deny",
                }
                rows[free] = {**dict.fromkeys(rows[free]), **kept, **window}
                return [start]
        raise AssertionError(f"no place before {name}")

    return seed


def carried(outcome: str) -> Seeds:
    """The request of an admitted action carried another policy than it said."""

    def seed(rows: list[Row]) -> list[int]:
        admitted = where(rows, "RequestAdmitted", outcome="allow")[0]
        key = (rows[admitted]["run_id"], rows[admitted]["action_id"])
        for at in where(rows, "RequestIssued"):
            if (rows[at]["run_id"], rows[at]["action_id"]) == key:
                rows[at] = {**rows[at], "carried_policy": outcome}
        return [admitted]

    return seed


def at_its_start(seed: Seeds) -> Seeds:
    """The same defect, which shows when the action of that event is executed."""

    def seed_and_follow(rows: list[Row]) -> list[int]:
        (at,) = seed(rows)
        key = {column: rows[at][column] for column in ("run_id", "action_id")}
        return [next(place for place in where(rows, "ExecutionStarted", **key) if place > at)]

    return seed_and_follow


def in_place_before(name: str, inserted: str, change: dict[str, Any], kept: tuple[str, ...], **fields: Any) -> Seeds:
    """An event that never was stands before one of this type, in place of another's that no invariant judges; it shows at itself."""

    def seed(rows: list[Row]) -> list[int]:
        for at in where(rows, name, **fields):
            free = next(
                (
                    place
                    for place in range(at - 1, max(at - 12, 0), -1)
                    if is_free(rows[place]) and rows[place]["run_id"] == rows[at]["run_id"]
                ),
                None,
            )
            if free is not None:
                place = {column: rows[free][column] for column in ("run_id", "seq", "time_us", "caused_by")}
                same = {column: rows[at][column] for column in kept}
                rows[free] = {**dict.fromkeys(rows[free]), **place, **same, "type": f"{inserted}.v1", **change}
                return [free]
        raise AssertionError(f"no place before {name}")

    return seed


def revoked_before_admission(rows: list[Row]) -> list[int]:
    """The right to ask was revoked before a request was admitted; it shows at the admission."""
    for at in where(rows, "RequestAdmitted"):
        free = next(
            (
                place
                for place in range(at - 1, max(at - 12, 0), -1)
                if is_free(rows[place]) and rows[place]["run_id"] == rows[at]["run_id"]
            ),
            None,
        )
        if free is not None:
            place = {column: rows[free][column] for column in ("run_id", "seq", "time_us", "caused_by")}
            said = {
                "type": "AuthorityRevoked.v1",
                "requested_by": rows[at]["requested_by"],
                "reason": "human override",
                "decided_by": "supervisor/fleet",
            }
            rows[free] = {**dict.fromkeys(rows[free]), **place, **said}
            return [at]
    raise AssertionError("no place before an admission")


def delegated_end(rows: list[Row]) -> int:
    start = delegated_start(rows)
    return next(
        at
        for at in where(rows, "ExecutionFinished", run_id=rows[start]["run_id"], action_id=rows[start]["action_id"])
        if at > start
    )


def finished_by_another(rows: list[Row]) -> list[int]:
    at = delegated_end(rows)
    rows[at] = {**rows[at], "robot": "robot/Z1", "executed_by": "robot/Z1"}
    return [at]


def never_closed(rows: list[Row]) -> list[int]:
    end = delegated_end(rows)
    (closed,) = where(rows, "RequestClosed", run_id=rows[end]["run_id"], action_id=rows[end]["action_id"])
    rows[closed] = {**rows[closed], "action_id": None}
    return [end]


def without(name: str, shows_at: str, **fields: Any) -> Seeds:
    """The last event of this type about an action is lost; it shows at the next one of the other type."""

    def seed(rows: list[Row]) -> list[int]:
        shown = where(rows, shows_at, **fields)[0]
        about = {rows[shown]["action_id"], rows[shown]["failed_action"]} - {None}
        key = rows[shown]["run_id"]
        lost = [
            at
            for at in where(rows, name)
            if at < shown and rows[at]["run_id"] == key and about & {rows[at]["action_id"], rows[at]["failed_action"]}
        ]
        assert lost, f"no {name} before {shows_at}"
        rows[lost[-1]] = {**rows[lost[-1]], "type": "PeersMet.v1", "action_id": None, "failed_action": None}
        return [shown]

    return seed


def an_hour_later(name: str, **fields: Any) -> Seeds:
    """This event and all that follows in its run come an hour later."""

    def seed(rows: list[Row]) -> list[int]:
        at = where(rows, name, **fields)[0]
        for row in rows[at:]:
            if row["run_id"] == rows[at]["run_id"]:
                row["time_us"] += 3_600_000_000
        return [at]

    return seed


def beyond(name: str, change: dict[str, int]) -> Seeds:
    """The fleet was founded with another budget, which what was done overran."""

    def seed(rows: list[Row]) -> list[int]:
        at = where(rows, name)[0]
        founded = next(place for place in where(rows, "RunStarted") if rows[place]["run_id"] == rows[at]["run_id"])
        parameters = msgspec.json.decode(rows[founded]["parameters"])
        parameters["structure"] |= change
        rows[founded] = {**rows[founded], "parameters": msgspec.json.encode(parameters).decode()}
        return [at]

    return seed


def joined_again(rows: list[Row]) -> list[int]:
    first, second = where(rows, "RobotJoined")[:2]
    rows[second] = {**rows[second], "robot": rows[first]["robot"]}
    return [second]


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


def test_all_ten_hold_on_the_untouched_history_which_has_what_they_judge() -> None:
    rows = list(history())
    for name in ("RequestRelayed", "ExecutionHeld", "AssistanceAdmitted", "ReassignmentDecided", "SupervisorResponded"):
        assert where(rows, name), name
    assert {rows[at]["to_level"] for at in where(rows, "RecoveryEscalated")} == {"peer", "fleet", "human"}
    assert where(rows, "ExecutionStarted", supervised_by=None)
    with from_rows(rows, threads=1) as database:
        assert [(row.invariant, row.events) for row in audit_rows(database, invariants())] == [
            (query.relation, 0) for query in invariants()
        ]
    assert len(invariants()) == 10


@pytest.mark.parametrize("defect", DEFECTS, ids=lambda defect: f"{defect.invariant}: {defect.name}")
def test_a_seeded_defect_is_caught_at_its_event(defect: Defect) -> None:
    rows = [dict(row) for row in history()]
    (shows_at,) = defect.seed(rows)
    assert (rows[shows_at]["run_id"], rows[shows_at]["seq"]) in offending(defect.invariant, rows)


def test_every_invariant_has_at_least_three_seeded_defects() -> None:
    count = {
        query.relation[:2]: sum(defect.invariant == query.relation[:2] for defect in DEFECTS) for query in invariants()
    }
    assert min(count.values()) >= 3, count


def test_i5_holds_where_the_registry_refuses_an_outsider_and_finds_when_it_does_not_say_whom() -> None:
    rows = encode([record("mixed-trust-inspection", 0)]).to_pylist()
    refused = where(rows, "RegistryQueried", candidates=[])
    assert refused
    assert offending("i5", rows) == set()
    for at in refused:
        rows[at] = {**rows[at], "executed_by": None}
    assert offending("i5", rows) == {(rows[at]["run_id"], rows[at]["seq"]) for at in refused}
