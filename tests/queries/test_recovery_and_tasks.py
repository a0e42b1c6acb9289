"""Failures, containment, latency, success and human intervention, by the judging rules."""

import pytest

from tests.queries.histories import Row, S, answer, event, measured, run


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


@pytest.mark.parametrize(("level", "contained"), [("local", 1), ("peer", 1), ("fleet", 0), ("human", 0)])
def test_failures_resolved_at_local_or_peer_level_are_contained(level: str, contained: int) -> None:
    assert measured("recovery_containment", failed(1), resolved(2, level)) == (contained, 1, float(contained))


def test_an_unresolved_failure_is_not_contained() -> None:
    assert measured("recovery_containment", failed(1)) == (0, 1, 0.0)


def test_containment_of_a_run_without_failures_is_undefined() -> None:
    assert measured("recovery_containment") == (0, 0, None)


def test_failures_of_one_action_are_told_apart_by_their_number() -> None:
    assert measured("recovery_containment", failed(1), failed(2, failure=2), resolved(3, "local", failure=2)) == (
        1,
        2,
        0.5,
    )
    assert measured("recovery_containment", failed(1), resolved(3, "local", action_id="t1/2")) == (0, 1, 0.0)


def test_latency_of_a_local_resolution_runs_to_the_resolution() -> None:
    assert measured("reassignment_latency_s", failed(1 * S), resolved(4 * S, "local")) == (3 * S, 1, 3.0)


def test_latency_of_other_resolutions_runs_to_leaving_the_first_level() -> None:
    for name in ("RecoveryEscalated", "AssistanceRequested"):
        assert measured("reassignment_latency_s", failed(1 * S), left(3 * S, name), resolved(60 * S, "human")) == (
            2 * S,
            1,
            2.0,
        )
    assert measured("reassignment_latency_s", failed(1 * S), left(3 * S)) == (2 * S, 1, 2.0), "never resolved"


def test_a_level_that_the_reaction_to_the_failure_left_at_once_took_no_time() -> None:
    assert measured("reassignment_latency_s", failed(1 * S), left(1 * S + 1), resolved(60 * S, "human")) == (0, 1, 0.0)
    assert measured("reassignment_latency_s", failed(1 * S), left(1 * S + 2), resolved(60 * S, "human")) == (
        2,
        1,
        2e-06,
    )


def test_the_first_departure_counts() -> None:
    assert measured(
        "reassignment_latency_s", failed(0), left(5 * S), left(2 * S, "AssistanceRequested"), resolved(9 * S, "peer")
    ) == (2 * S, 1, 2.0)


def test_a_local_resolution_counts_to_its_end_even_if_the_level_was_left_meanwhile() -> None:
    assert measured("reassignment_latency_s", failed(0), left(2 * S), resolved(9 * S, "local")) == (9 * S, 1, 9.0)


def test_a_departure_names_the_failed_action_and_may_carry_another_action() -> None:
    assert measured("reassignment_latency_s", failed(0), left(2 * S, action_id=None)) == (2 * S, 1, 2.0)
    assert measured("reassignment_latency_s", failed(0), left(2 * S, failed_action="t1/2", action_id="t1/1")) == (
        0,
        0,
        None,
    )


def test_latency_of_a_failure_that_was_neither_resolved_nor_left_is_undefined() -> None:
    assert measured("reassignment_latency_s", failed(1)) == (0, 0, None)
    assert measured(
        "reassignment_latency_s", failed(1), failed(2 * S, failure=2), resolved(3 * S, "local", failure=2)
    ) == (S, 1, 1.0)


def test_a_failure_shows_its_first_resolution() -> None:
    rows = answer(
        "facts/failures",
        run(failed(1), resolved(5, "human"), resolved(7, "local")),
        columns=("resolved_us", "resolved_level", "left_us", "latency_us"),
    )
    assert rows == [(5, "human", None, None)]


def arrived(time_us: int, task_id: str = "t1") -> Row:
    return event("TaskArrived", time_us, task_id=task_id, budget_us=10)


def completed(time_us: int, task_id: str = "t1") -> Row:
    return event("TaskCompleted", time_us, task_id=task_id)


@pytest.mark.parametrize(("time_us", "succeeded"), [(14, 1), (15, 1), (16, 0)])
def test_a_task_succeeds_if_it_takes_at_most_its_budget(time_us: int, succeeded: int) -> None:
    assert measured("coordination_success", arrived(5), completed(time_us)) == (succeeded, 1, float(succeeded))


def test_an_uncompleted_or_abandoned_task_does_not_succeed() -> None:
    assert measured(
        "coordination_success",
        arrived(5),
        arrived(6, "t2"),
        completed(7, "t2"),
        event("TaskAbandoned", 9, task_id="t1"),
    ) == (1, 2, 0.5)


def test_the_first_completion_of_a_task_counts() -> None:
    assert measured("coordination_success", arrived(5), completed(9), completed(99)) == (1, 1, 1.0)


def test_success_of_a_run_without_tasks_is_undefined() -> None:
    assert measured("coordination_success") == (0, 0, None)


def test_a_run_in_which_the_fleet_supervisor_is_called_has_one_human_intervention() -> None:
    def called(supervisor: str) -> Row:
        return event("SupervisorCalled", 1, supervisor=supervisor, purpose="review", action_id="t1/1")

    assert measured("human_intervention", called("supervisor/fleet"), called("supervisor/fleet")) == (1, 1, 1.0)
    assert measured("human_intervention", called("supervisor/A1")) == (0, 1, 0.0)
    assert measured("human_intervention") == (0, 1, 0.0)


def test_executions_are_the_starts() -> None:
    rows = answer(
        "facts/executions",
        run(event("ExecutionStarted", 3, robot="robot/B1", on_behalf_of="robot/A1", action_id="t1/1", ends_us=9)),
    )
    assert rows == [("r1", 1, None, "t1/1", "robot/B1", "robot/A1", None, 3, 9)]
