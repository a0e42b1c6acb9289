"""Beside each number that hangs on routine operations stands the same number without them, and how much of all they
are."""

import pytest

from fsar_ledger.metrics.results import metric_rows
from tests.queries.histories import Row, answer, event, run
from tests.recycled import from_rows

BESIDE = (
    "numerator",
    "denominator",
    "value",
    "numerator_without_routine",
    "denominator_without_routine",
    "value_without_routine",
)
WHOLE = {"requested_by": "robot/A1", "executed_by": "robot/A1", "supervised_by": "supervisor/A1"}
OWN = {"decided_by": "robot/A1", "path": ["robot/A1"]}
SENSING = event("RoutinePerformed", robot="robot/A1", operation="sensing", **WHOLE, **OWN)
MOTION = event("RoutinePerformed", robot="robot/A1", operation="motion", **WHOLE, **OWN)
CLOSED = event("RequestClosed", decided_by="coordinator", path=["coordinator"])
WINDOW = event("PolicyWindowOpened", robot="robot/A1", scope="local", window="w", outcome="deny")


def beside(name: str, *events: Row) -> tuple[object, ...]:
    [row] = answer(f"metrics/{name}", run(*events), columns=BESIDE)
    return row


def test_locality_stands_beside_itself_without_routine() -> None:
    step = event("OwnStepDecided", **OWN)
    assert beside("governance_locality", SENSING, SENSING, step, CLOSED) == (3, 4, 0.75, 1, 2, 0.5)
    assert beside("governance_locality", SENSING) == (1, 1, 1.0, 0, 0, None)


def test_attributability_stands_beside_itself_without_routine() -> None:
    handoff = event("InternalHandoff", executed_by="robot/A1")
    reported = event("RoutineReported", robot="robot/A1", executed_by="robot/A1")
    assert beside("audit_attributability", SENSING, reported, handoff) == (1, 3, 1 / 3, 0, 1, 0.0)


def test_violations_stand_beside_themselves_without_motions() -> None:
    started = event("ExecutionStarted", action_id="t1/1", robot="robot/A1", on_behalf_of="robot/A1", **WHOLE)
    assert beside("policy_violations", WINDOW, MOTION, SENSING, started) == (2, 1, 2.0, 1, 1, 1.0)


def test_a_summary_has_both_means_where_routine_is_counted_and_one_elsewhere() -> None:
    rows = [run(SENSING, CLOSED, run_id="r1"), run(SENSING, run_id="r2")]
    with from_rows([row for one in rows for row in one]) as database:
        found = {row.metric: (row.mean, row.mean_without_routine) for row in metric_rows(database)}
    assert found["governance_locality"] == (0.75, 0.0)
    assert found["audit_attributability"] == (1.0, None)
    assert found["policy_violations"] == (0.0, 0.0)
    assert found["human_intervention"] == (0.0, None)


def shares(*events: Row) -> dict[str, object]:
    with from_rows(run(*events)) as database:
        [row] = database.query("metrics/background").to_pylist()
    return {
        name: value
        for name, value in row.items()
        if name
        not in ("architecture", "configuration", "fleet_size", "kind", "source", "model_version", "constants", "seed")
    }


def test_shares_of_routine_are_counted() -> None:
    assert shares(WINDOW, MOTION, SENSING, CLOSED, event("OwnStepDecided", **OWN)) == {
        "decisions": 4,
        "routine_share_of_decisions": 0.5,
        "local_decisions": 3,
        "routine_share_of_local_decisions": pytest.approx(2 / 3),
        "coordination_events": 3,
        "routine_share_of_coordination_events": pytest.approx(2 / 3),
        "policy_violations": 1,
        "routine_share_of_policy_violations": 1.0,
        "off_shift_share_of_coordination_events": 0.0,
    }


def test_runs_of_other_constants_have_a_row_of_their_own() -> None:
    one, other = run(SENSING, run_id="r1", parameters='{"a":1}'), run(CLOSED, run_id="r2", parameters='{"a":2}')
    rows = answer("metrics/background", one, other, columns=("decisions", "routine_share_of_decisions"))
    assert sorted(rows) == [(1, 0.0), (1, 1.0)]


def test_runs_of_another_seed_have_a_row_of_their_own() -> None:
    rows = answer(
        "metrics/background",
        run(SENSING, run_id="r1"),
        run(CLOSED, run_id="r2", seed=7),
        columns=("seed", "routine_share_of_decisions"),
    )
    assert sorted(rows) == [(7, 0.0), (42, 1.0)]


def test_a_share_of_nothing_is_null() -> None:
    found = shares()
    assert {name: value for name, value in found.items() if "share" not in name} == dict.fromkeys(
        ("decisions", "local_decisions", "coordination_events", "policy_violations"), 0
    )
    assert {value for name, value in found.items() if "share" in name} == {None}


def test_only_a_supervisor_who_is_recorded_as_absent_is_off_shift() -> None:
    lacking = event(
        "RoutinePerformed", robot="robot/A1", operation="sensing", **(WHOLE | {"supervised_by": None}), **OWN
    )
    nobody = event("RoutinePerformed", robot="robot/A1", operation="sensing", executed_by="robot/A1", **OWN)
    left, back = (
        event("SupervisorLeft", supervisor="supervisor/A1"),
        event("SupervisorReturned", supervisor="supervisor/A1"),
    )
    joined = event("RobotJoined", robot="robot/A1", supervisor="supervisor/A1")
    name = "off_shift_share_of_coordination_events"
    assert shares(joined, left, lacking, back, lacking)[name] == 0.5
    assert shares(joined, left, back, lacking)[name] == 0.0
    assert shares(joined, lacking, left)[name] == 0.0
    assert shares(left, lacking)[name] == 0.0, "nobody knows whose supervisor left"
    assert shares(joined, left, lacking, nobody)[name] == 1.0
    assert shares(joined, event("SupervisorLeft", supervisor="supervisor/B1"), lacking)[name] == 0.0
