"""What coordination costs is counted for each request, and what nobody observed is not counted as nothing."""

from fsar_ledger.events import CONCERNS
from tests.queries.histories import Row, answer, event, run

COUNTED = ("requests", "messages", "decisions", "hops", "look_ups", "robots_named", "checks")
A, B, C = "robot/A1", "robot/B1", "robot/C1"
OWN = {"decided_by": A, "path": [A]}
ACTION = {"task_id": "t1", "action_id": "t1/1"}
GAP = event("GapDetected", capability="lift", requested_by=A, **ACTION)
ASKED = event("RegistryQueried", capability="lift", requested_by=A, candidates=[B], rejected=[C], **ACTION)
ISSUED = event("RequestIssued", 1, requested_by=A, executed_by=B, request_id="t1/1", **ACTION, **OWN)
ADMITTED = event("RequestAdmitted", 2, executed_by=B, decided_by="agent/B1/exec", path=[B, "agent/B1/exec"], **ACTION)
ROUTINE = event("RoutinePerformed", 3, robot=A, operation="sensing", **OWN)
TASK = event("TaskArrived", task_id="t1", robot=A, budget_us=10, due_us=10, steps=[])


def costs(*events: Row, **dimensions: object) -> list[tuple[object, ...]]:
    return answer("metrics/coordination_cost", run(*events, **dimensions), columns=COUNTED)  # type: ignore[arg-type]


def test_everything_is_counted_for_each_request() -> None:
    # Two messages to and from the registry and one request; deciding what to answer is no message.
    assert costs(GAP, ASKED, ISSUED, ADMITTED) == [(1, 3.0, 2.0, 3.0, 1.0, 2.0, 1.0)]
    assert costs(GAP, GAP, ASKED, ISSUED, ADMITTED) == [(2, 1.5, 1.0, 1.5, 0.5, 1.0, 0.5)]


def test_routine_and_own_steps_are_no_coordination() -> None:
    own_step = event("OwnStepDecided", 3, **ACTION, **OWN)
    assert costs(GAP, ASKED, ISSUED, ADMITTED, ROUTINE, own_step) == costs(GAP, ASKED, ISSUED, ADMITTED)


def test_without_a_request_there_is_nothing_to_divide_by() -> None:
    assert costs(ROUTINE) == [(0, None, None, None, None, None, None)]


def test_a_run_that_does_not_observe_messages_is_left_out() -> None:
    assert costs(GAP, ASKED, observes=[one for one in CONCERNS if one != "message"]) == []


def test_runs_of_one_setting_are_summed_and_fleets_are_kept_apart() -> None:
    done = event("TaskCompleted", 5, task_id="t1")
    rows = answer(
        "metrics/coordination_cost",
        run(TASK, GAP, ISSUED, done, run_id="r1"),
        run(TASK, GAP, run_id="r2", seed=43),
        run(TASK, GAP, run_id="r3", fleet_size=8),
        columns=("fleet_size", "runs", "tasks", "completed", "requests", "messages"),
    )
    assert sorted(rows, key=str) == [(4, 2, 2, 0.5, 2, 0.5), (8, 1, 1, 0.0, 1, None)]
