"""Failures, containment, latency, success and human intervention, by the judging rules."""

import pytest

from tests.queries.histories import Row, S, answer, event, measured, run

Measured = tuple[tuple[Row, ...], tuple[int, int, float | None]]


def failed(time_us: int, action_id: str = "t1/1", failure: int = 1) -> Row:
    return event(
        "ExecutionFailed", time_us, action_id=action_id, failure=failure, robot="robot/D1", cause="obstruction"
    )


def resolved(time_us: int, level: str, action_id: str = "t1/1", failure: int = 1) -> Row:
    return event("FailureResolved", time_us, action_id=action_id, failure=failure, level=level)


def left(
    time_us: int, name: str = "RecoveryEscalated", failed_action: str = "t1/1", failure: int = 1, **fields: str | None
) -> Row:
    return event(name, time_us, failed_action=failed_action, failure=failure, **fields)


def arrived(time_us: int, task_id: str = "t1") -> Row:
    return event("TaskArrived", time_us, task_id=task_id, budget_us=10)


def completed(time_us: int, task_id: str = "t1") -> Row:
    return event("TaskCompleted", time_us, task_id=task_id)


def called(supervisor: str) -> Row:
    return event("SupervisorCalled", 1, supervisor=supervisor, purpose="review", action_id="t1/1")


HUMAN, OTHERS = resolved(60 * S, "human"), resolved(3, "local", action_id="t1/2")
SECOND = (failed(2 * S, failure=2), resolved(3 * S, "local", failure=2))
CONTAINED: dict[str, tuple[Measured, ...]] = {
    "a failure resolved at local or peer level is": (
        *(((failed(1), resolved(2, level)), (1, 1, 1.0)) for level in ("local", "peer")),
        *(((failed(1), resolved(2, level)), (0, 1, 0.0)) for level in ("fleet", "human")),
    ),
    "an unresolved failure is not": (((failed(1),), (0, 1, 0.0)),),
    "of a run without failures it is undefined": (((), (0, 0, None)),),
    "failures of one action are told apart by their number": (
        ((failed(1), failed(2, failure=2), resolved(3, "local", failure=2)), (1, 2, 0.5)),
        ((failed(1), OTHERS), (0, 1, 0.0)),
    ),
}
LATENCY: dict[str, tuple[Measured, ...]] = {
    "of a local resolution runs to the resolution": (((failed(1 * S), resolved(4 * S, "local")), (3 * S, 1, 3.0)),),
    "of other resolutions runs to leaving the first level": (
        ((failed(1 * S), left(3 * S), HUMAN), (2 * S, 1, 2.0)),
        ((failed(1 * S), left(3 * S, "AssistanceRequested"), HUMAN), (2 * S, 1, 2.0)),
        ((failed(1 * S), left(3 * S)), (2 * S, 1, 2.0)),  # never resolved
    ),
    "of a level that the reaction to the failure left at once is no time": (
        ((failed(1 * S), left(1 * S + 1), HUMAN), (0, 1, 0.0)),
        ((failed(1 * S), left(1 * S + 2), HUMAN), (2, 1, 2e-06)),
    ),
    "runs to the first departure": (
        ((failed(0), left(5 * S), left(2 * S, "AssistanceRequested"), resolved(9 * S, "peer")), (2 * S, 1, 2.0)),
    ),
    "runs to the end of a local resolution even if the level was left meanwhile": (
        ((failed(0), left(2 * S), resolved(9 * S, "local")), (9 * S, 1, 9.0)),
    ),
    "of a departure is that of the failed action, and it may carry another action": (
        ((failed(0), left(2 * S, action_id=None)), (2 * S, 1, 2.0)),
        ((failed(0), left(2 * S, failed_action="t1/2", action_id="t1/1")), (0, 0, None)),
    ),
    "of a failure that was neither resolved nor left is undefined": (
        ((failed(1),), (0, 0, None)),
        ((failed(1), *SECOND), (S, 1, 1.0)),
    ),
}
SUCCESS: dict[str, tuple[Measured, ...]] = {
    "a task that takes at most its budget succeeds": (
        *(((arrived(5), completed(time_us)), (1, 1, 1.0)) for time_us in (14, 15)),
        ((arrived(5), completed(16)), (0, 1, 0.0)),
    ),
    "an uncompleted or abandoned task does not": (
        ((arrived(5), arrived(6, "t2"), completed(7, "t2"), event("TaskAbandoned", 9, task_id="t1")), (1, 2, 0.5)),
    ),
    "the first completion of a task counts": (((arrived(5), completed(9), completed(99)), (1, 1, 1.0)),),
    "of a run without tasks it is undefined": (((), (0, 0, None)),),
}
INTERVENTION: dict[str, tuple[Measured, ...]] = {
    "a run in which the fleet supervisor is called has one, however often": (
        ((called("supervisor/fleet"), called("supervisor/fleet")), (1, 1, 1.0)),
    ),
    "a robot's own supervisor is none": (((called("supervisor/A1"),), (0, 1, 0.0)),),
    "a run without calls has none": (((), (0, 1, 0.0)),),
}
METRICS = {
    "recovery_containment": CONTAINED,
    "reassignment_latency_s": LATENCY,
    "coordination_success": SUCCESS,
    "human_intervention": INTERVENTION,
}


@pytest.mark.parametrize(("metric", "case"), [(metric, case) for metric, cases in METRICS.items() for case in cases])
def test_a_metric_has_this_numerator_denominator_and_value(metric: str, case: str) -> None:
    for events, expected in METRICS[metric][case]:
        assert measured(metric, *events) == expected


def test_a_failure_shows_its_first_resolution() -> None:
    rows = answer(
        "facts/failures",
        run(failed(1), resolved(5, "human"), resolved(7, "local")),
        columns=("resolved_us", "resolved_level", "left_us", "latency_us"),
    )
    assert rows == [(5, "human", None, None)]


def test_executions_are_the_starts() -> None:
    rows = answer(
        "facts/executions",
        run(event("ExecutionStarted", 3, robot="robot/B1", on_behalf_of="robot/A1", action_id="t1/1", ends_us=9)),
    )
    assert rows == [("r1", 1, None, "t1/1", "robot/B1", "robot/A1", None, 3, 9)]
