"""What an architecture that keeps silent cannot win: success under true policy, effects, true principals, knowing."""

from typing import Any

import pytest

from tests.queries.histories import Row, S, act, answer, event, measured, run

A, B, C = "robot/A1", "robot/B1", "robot/C1"
H_A = "supervisor/A1"
STEP = "A1-1/1.1"


def arrived(task: str, budget_s: int = 60) -> Row:
    return event("TaskArrived", 0, task_id=task, robot=A, budget_us=budget_s * S)


def completed(task: str, at_s: int) -> Row:
    return event("TaskCompleted", at_s * S, task_id=task)


def started(at_s: int, action: str = STEP, robot: str = A, **fields: Any) -> Row:
    return act("ExecutionStarted", at_s * S, action, robot=robot, **{"on_behalf_of": A, "ends_us": 99 * S, **fields})


def window(at_s: int, outcome: str = "deny", robot: str = A) -> Row:
    return event("PolicyWindowOpened", at_s * S, robot=robot, scope="local", window="w", outcome=outcome)


# --- success without violation ---


def test_a_task_that_started_anything_against_policy_is_no_clean_success() -> None:
    story = [arrived("A1-1"), arrived("A2-1"), started(1, "A2-1/1.1"), window(2), started(3)]
    ended = [completed("A1-1", 10), completed("A2-1", 10)]
    assert measured("success_without_violation", *story, *ended) == (1, 2, 0.5)


def test_a_late_task_is_no_success_however_clean() -> None:
    assert measured("success_without_violation", arrived("A1-1", 5), completed("A1-1", 6)) == (0, 1, 0.0)
    assert measured("success_without_violation", event("RobotWentOff", robot=A)) == (0, 0, None)


# --- conflicts of effect ---


def test_a_body_that_serves_two_actions_at_once_is_a_conflict_whether_or_not_anybody_claims() -> None:
    story = [started(1), started(2, "B1-1/1.1"), act("ExecutionFinished", 3 * S, STEP, robot=A)]
    assert measured("effect_conflicts", *story) == (1, 1, 1.0)


def test_two_bodies_that_serve_one_action_at_once_are_a_conflict() -> None:
    story = [started(1), act("ApproachStarted", 2 * S, STEP, robot=B), started(3, robot=B)]
    assert measured("effect_conflicts", *story) == (1, 1, 1.0)
    assert measured("effect_conflicts", *story, started(4, robot=C)) == (1, 1, 1.0), "however many"


def test_two_bodies_that_do_the_same_step_under_two_names_are_a_conflict_too() -> None:
    names = {STEP: A, "A1-1/1.1:B1": B, "A1-1/2.1": C}
    queues = [
        act("ExecutionQueued", 0, name, robot=robot, step=int(name.partition("/")[2][0]), attempt=1)
        for name, robot in names.items()
    ]
    starts = [started(at, name, robot) for at, (name, robot) in enumerate(names.items(), 1)]
    assert measured("effect_conflicts", *queues, *starts) == (1, 1, 1.0)


def test_what_follows_the_end_of_another_is_no_conflict() -> None:
    ends = ("ExecutionFinished", "ExecutionWithdrawn", "ExecutionFailed", "ExecutionPaused", "ExecutionHalted")
    for end in ends:
        story = [started(1), act(end, 2 * S, STEP, robot=A), started(2, "B1-1/1.1"), started(2, STEP, robot=B)]
        assert measured("effect_conflicts", *story) == (0, 1, 0.0), end


def test_what_nothing_ends_on_record_lasts_as_planned() -> None:
    story = [started(1, ends_us=2 * S), started(3, "B1-1/1.1", ends_us=4 * S)]
    assert measured("effect_conflicts", *story) == (0, 1, 0.0)


def test_a_helper_that_serves_another_action_is_a_conflict() -> None:
    helps = act("AssistanceAdmitted", 2 * S, STEP, robot=A, helper=B, failure=1)
    assert measured("effect_conflicts", started(1, "B1-1/1.1", robot=B), helps) == (1, 1, 1.0)


def test_motions_of_a_body_that_serves_an_action_are_told_apart() -> None:
    moved, sensed = (event("RoutinePerformed", 2 * S, robot=A, operation=name) for name in ("motion", "sensing"))
    columns = ("numerator", "numerator_without_routine")
    assert answer("metrics/effect_conflicts", run(started(1), moved, sensed), columns=columns) == [(1, 0)]
    assert answer("metrics/effect_conflicts", run(moved, sensed, started(3)), columns=columns) == [(0, 0)]


# --- attribution to who it was ---


def joined(supervisor: str | None = H_A) -> Row:
    return event("RobotJoined", robot=A, role="A", team=1, supervisor=supervisor)


def named(by: str | None, executor: str | None, supervisor: str | None) -> Row:
    about: dict[str, Any] = {
        "on_behalf_of": B,
        "requested_by": by,
        "executed_by": executor,
        "supervised_by": supervisor,
    }
    return started(5, robot=A, **about)


@pytest.mark.parametrize(
    ("record", "right"),
    [
        ((B, A, H_A), 1),
        ((B, A, "supervisor/fleet"), 1),  # H_F may stand for the robot's own
        ((C, A, H_A), 0),  # a wrong name is none
        ((None, A, H_A), 0),
        ((B, None, H_A), 0),
        ((B, A, None), 0),
        ((B, A, "supervisor/C1"), 0),
    ],
)
def test_a_record_names_who_it_was_or_it_does_not_count(record: tuple[str | None, ...], right: int) -> None:
    assert measured("true_attribution", joined(), named(*record)) == (right, 1, float(right))


def test_nobody_has_to_name_a_supervisor_where_none_is_on_shift() -> None:
    left, back = (event(f"Supervisor{name}", at * S, supervisor=H_A) for name, at in (("Left", 1), ("Returned", 3)))
    assert measured("true_attribution", joined(None), named(B, A, None))[:2] == (1, 1)
    assert measured("true_attribution", joined(), left, named(B, A, None))[:2] == (1, 1)
    assert measured("true_attribution", joined(), left, back, named(B, A, None))[:2] == (0, 1)


def test_each_field_is_told() -> None:
    columns = ("origin_is_named", "executor_is_named", "supervisor_is_named")
    assert answer("facts/true_principals", run(joined(), named(C, A, None)), columns=columns) == [(False, True, False)]
    assert answer("facts/true_principals", run(joined(None), named(B, None, None)), columns=columns) == [
        (True, False, None)
    ]


# --- reviews that nobody asked for ---


def test_what_starts_under_review_without_an_approval_was_not_asked_for() -> None:
    approved = act("SupervisorResponded", 3 * S, STEP, purpose="review", approves=True, decided_by=H_A)
    assert measured("missed_reviews", window(1, "review"), started(4)) == (1, 1, 1.0)
    assert measured("missed_reviews", window(1, "review"), approved, started(4)) == (0, 1, 0.0)
    assert measured("missed_reviews", window(1, "deny"), started(4)) == (0, 1, 0.0)
    moved = event("RoutinePerformed", 4 * S, robot=A, operation="motion")
    columns = ("numerator", "numerator_without_routine")
    assert answer("metrics/missed_reviews", run(window(1, "review"), moved), columns=columns) == [(1, 0)]


# --- time to know ---


def failed(at_s: int) -> Row:
    return act("ExecutionFailed", at_s * S, STEP, robot=A, failure=1, cause="obstruction")


def test_a_failure_is_its_robots_alone_until_somebody_else_decides_or_is_called() -> None:
    own = act("RecoveryAttempted", 2 * S, STEP, robot=A, failure=1, decided_by="agent/A1/recovery", failed_action=STEP)
    other = act("ReassignmentDecided", 5 * S, STEP, robot=A, failure=1, decided_by="service/recovery")
    called = act("SupervisorCalled", 4 * S, STEP, supervisor=H_A, purpose="recovery")
    resolved = act("FailureResolved", 3 * S, STEP, robot=A, failure=1, level="local")
    assert measured("time_to_know_s", failed(1), own, other) == (4 * S, 1, 4.0)
    assert measured("time_to_know_s", failed(1), own, called, other) == (3 * S, 1, 3.0)
    assert measured("time_to_know_s", failed(1), own, resolved, other) == (2 * S, 1, 2.0)


def test_whoever_was_asked_to_help_knows_once_it_has_answered_whether_or_not_a_record_names_it() -> None:
    asked = act("AssistanceRequested", 2 * S, STEP, robot=A, helper=B, failure=1, decided_by=A, failed_action=STEP)
    resolved = act("FailureResolved", 9 * S, STEP, robot=A, failure=1, level="peer")
    for answer_of_b in ("AssistanceAdmitted", "AssistanceDeclined"):
        answered = act(answer_of_b, 4 * S, STEP, robot=A, helper=B, failure=1)
        assert measured("time_to_know_s", failed(1), asked, answered, resolved) == (3 * S, 1, 3.0)
    assert measured("time_to_know_s", failed(1), asked, resolved) == (8 * S, 1, 8.0)


def test_a_failure_is_over_when_its_task_goes_on_or_is_given_up() -> None:
    other = event("TaskCompleted", 2 * S, task_id="B1-1")
    for name in ("StepCompleted", "TaskCompleted", "TaskAbandoned"):
        over = event(name, 6 * S, task_id="A1-1")
        assert measured("time_to_know_s", failed(1), other, over, event("RobotWentOff", 9 * S, robot=B))[0] == 5 * S


def test_a_failure_of_which_nobody_hears_lasts_until_the_run_ends() -> None:
    assert measured("time_to_know_s", failed(1), event("TaskCompleted", 9 * S, task_id="B1-1")) == (8 * S, 1, 8.0)
    assert measured("time_to_know_s", event("RobotWentOff", 9 * S, robot=B)) == (0, 0, None)


def test_nobody_is_said_to_lack_trust_or_to_offer_nothing_where_that_is_not_observed() -> None:
    joined = [event("RobotJoined", robot=robot) for robot in (A, B)]
    asked = act("RegistryQueried", S, STEP, requested_by=A, capability="lift", candidates=[])
    for observes in (["fleet"], ["fleet", "registry"], ["fleet", "registry", "trust"]):
        history = run(*joined, asked, kind="foreign", observes=observes)
        (reason,) = answer("audit/query_candidates", history, columns=("reason",))
        assert reason == ("does not offer it" if "registry" in observes else "the record gives no reason",)
    shown = event("CapabilityAdvertised", robot=B, capability="lift")
    for observes in (["fleet", "registry"], ["fleet", "registry", "trust"]):
        history = run(*joined, shown, asked, kind="foreign", observes=observes)
        (reason,) = answer("audit/query_candidates", history, columns=("reason",))
        assert reason == ("no trust in the requester" if "trust" in observes else "the record gives no reason",)


def test_that_nobody_could_be_asked_is_said_of_what_the_registry_had_answered_by_then() -> None:
    def found(*events: Row, **given: Any) -> list[Any]:
        history = run(act("RequestIssued", 0, STEP, decided_by=A), *events, **given)
        columns = (("audit/refusals", "reason"), ("audit/requests", "result"))
        return [answer(name, history, columns=(column,))[0][0] for name, column in columns]

    unanswered = act("RequestUnanswered", 2 * S, STEP, decided_by=A)
    offered = act("RegistryQueried", S, STEP, requested_by=A, capability="lift", candidates=[B])
    assert found(offered, unanswered) == ["no answer", "no answer"]
    assert found(unanswered, {**offered, "time_us": 3 * S}) == ["no candidate", "nobody to ask"]
    assert found(unanswered, kind="foreign", observes=["request", "execution"]) == [None, None]
