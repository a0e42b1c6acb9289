"""RoboOS: one test for each fact of its source, or choice of ours, that a robot and its checklist rest on."""

import msgspec

from fsar_ledger.events.envelope import COORDINATOR, FLEET_SUPERVISOR, Subject
from fsar_ledger.events.execution import (
    ExecutionFinished,
    ExecutionPaused,
    ExecutionQueued,
    ExecutionStarted,
    ExecutionWithdrawn,
)
from fsar_ledger.events.knowledge import StoreEntryWritten
from fsar_ledger.events.policy import PolicyRuleSet
from fsar_ledger.events.recovery import AssistanceRequested, FailureResolved, RecoveryAttempted, RecoveryEscalated
from fsar_ledger.events.request import CommandIssued, RequestDenied
from fsar_ledger.events.supervision import SupervisorCalled, SupervisorResponded
from fsar_ledger.events.task import StepBegan, TaskAbandoned
from fsar_ledger.events.world import (
    ActuatorDegraded,
    ContextChanged,
    LinkWentDown,
    ObstructionCleared,
    RobotCameBack,
    RobotWentOff,
)
from fsar_ledger.projections.fold import State
from fsar_ledger.runtime.architectures.roboos import ROBOOS, AskAnother, GoOnWithoutHelp, ReachHelper, checklist
from fsar_ledger.runtime.architectures.roboos.master import PlanTask, TakeSubtask, is_shown_idle
from fsar_ledger.runtime.handlers.commands import DecideRoutine, EndAttempt, Respond, StartAction, TakeTurn
from tests import past
from tests.runtime.architectures.roboos import (
    ACTION,
    DOOR,
    DOOR_TASK,
    A,
    B,
    C,
    D,
    S,
    decided,
    given,
    obstructed,
    play,
    ran,
    sent,
    stored,
    worn,
)
from tests.runtime.histories import happen, types, window
from tests.runtime.live import when
from tests.sure import only


def test_a_robot_serves_one_subtask_at_a_time_in_order_of_arrival() -> None:
    tasks = [
        (S + number, past.arrived(f"A1-{number}", A, (f"A {DOOR} B",), budget_us=600 * S, due_us=601 * S))
        for number in range(3)
    ]
    run = ran(*tasks)
    queued, starts, ends = (when(run, kind, robot=B) for kind in (ExecutionQueued, ExecutionStarted, ExecutionFinished))
    assert len(queued) == len(starts) == 3
    assert queued[2] < ends[0]
    assert all(end < start for end, start in zip(ends, starts[1:], strict=False))
    order = [event.subject for event in run.events if isinstance(event, ExecutionQueued)]
    assert order == [event.subject for event in run.events if isinstance(event, ExecutionFinished)]


def test_nothing_checks_a_policy_window_or_a_declared_rule() -> None:
    rule = PolicyRuleSet(
        scope="fleet", robot=None, capability=DOOR, context=None, outcome="deny", decided_by=FLEET_SUPERVISOR
    )
    for forbidden in (window(B), window(B, scope="fleet"), window(A), rule):
        assert types(decided(given(DOOR_TASK, forbidden), PlanTask("A1-1"))) == ["TaskPlanned"]
        state = sent(forbidden)
        assert types(play(state, TakeSubtask(ACTION, "A1-1", B))) == ["ExecutionQueued"]
        play(state, TakeTurn(ACTION))
        assert types(decided(state, StartAction(ACTION))) == ["ExecutionStarted"]
    assert types(decided(given(window(A)), DecideRoutine(A, "motion"))) == ["RoutinePerformed"]


def test_with_the_gate_a_robot_refuses_what_its_own_policy_denies() -> None:
    denied = only(RequestDenied, decided(sent(window(B), gate=1), TakeSubtask(ACTION, "A1-1", B)))
    assert (denied.principals.decided_by, denied.reason) == (B, "policy")
    for passed in (window(A), window(B, scope="fleet"), window(B, "review")):
        assert types(decided(sent(passed, gate=1), TakeSubtask(ACTION, "A1-1", B))) == ["ExecutionQueued"]
    assert types(decided(given(window(A), gate=1), DecideRoutine(A, "motion"))) == ["RoutineWithheld"]
    run = ran((1, window(B)), (S, DOOR_TASK), gate=1)
    assert when(run, TaskAbandoned) == when(run, StoreEntryWritten, availability="ready", written_by=COORDINATOR)


def test_a_robot_replans_by_itself_when_its_context_changes() -> None:
    [start] = when(ran((S, DOOR_TASK)), ExecutionStarted)
    run = ran((S, DOOR_TASK), (start + 1, ContextChanged(B)))
    [end], [undisturbed] = when(run, ExecutionFinished), when(ran((S, DOOR_TASK)), ExecutionFinished)
    assert len(when(run, ExecutionPaused)) == 1
    assert end == undisturbed + S  # replan_us
    assert len(when(run, CommandIssued)) == 1


def test_a_subtask_of_a_task_that_was_given_up_comes_back_as_a_result() -> None:
    short = past.arrived("A1-1", A, (f"A {DOOR} B",), budget_us=5 * S, due_us=6 * S)
    run = ran((S, short), (S + 2, RobotWentOff(B)), (60 * S, RobotCameBack(B)))
    assert len(when(run, TaskAbandoned)) == len(when(run, ExecutionWithdrawn)) == 1
    assert is_shown_idle(run.state, B, 70 * S)
    assert not run.state.authority.claims.get(ACTION)


def test_each_error_has_its_checklist() -> None:
    state = given()
    assert checklist(state.fleet, "obstruction") == ("another path", "another robot", "manual help", "brain")
    assert checklist(state.fleet, "degradation") == ("same tool",)
    vision = given(worn_error=303)
    assert checklist(vision.fleet, "degradation") == ("near position", "another robot", "brain")


def test_manual_help_is_in_the_checklist_of_an_obstruction_in_all_or_in_none() -> None:
    both = ("obstruction", "degradation")
    asks = [
        tuple("manual help" in checklist(given(manual_help=dial).fleet, cause) for cause in both) for dial in (0, 1, 2)
    ]
    assert asks == [(False, False), (True, False), (True, True)]
    assert checklist(given(manual_help=2, worn_error=303).fleet, "degradation")[-2:] == ("manual help", "brain")


def test_the_handler_stops_at_the_first_method_that_helps() -> None:
    state = obstructed()
    happen(state, ObstructionCleared(B, "o"))
    assert decided(state, EndAttempt(ACTION, 1)) == (FailureResolved(Subject("A1-1", ACTION), B, 1, "local"),)


def test_after_another_path_a_robot_is_asked_that_the_store_shows_idle() -> None:
    state = obstructed(stored(A, "busy"))
    *moved, asked = decided(state, EndAttempt(ACTION, 1, now_us=13 * S))
    assert types(tuple(moved)) == ["RecoveryAttemptFailed", "RecoveryEscalated"]
    assert isinstance(asked, AssistanceRequested)
    assert (asked.helper, asked.level, asked.principals.decided_by) == (D, "peer", B)


def test_a_robot_that_is_offline_cannot_read_the_store() -> None:
    state = obstructed()
    happen(state, LinkWentDown(B))
    assert types(decided(state, EndAttempt(ACTION, 1, now_us=13 * S)))[1:] == ["RecoveryEscalated", "SupervisorCalled"]


def test_a_robot_under_its_lock_declines_and_the_next_method_is_called() -> None:
    state = obstructed(stored(D, "busy"))
    *_, asked = play(state, EndAttempt(ACTION, 1, now_us=13 * S))
    state.execution = msgspec.structs.replace(state.execution, current={**state.execution.current, asked.helper: "x"})
    assert types(play(state, ReachHelper(ACTION, asked.helper))) == ["AssistanceDeclined"]
    assert types(decided(state, AskAnother(ACTION, 1, 1, now_us=14 * S))) == ["RecoveryEscalated", "SupervisorCalled"]


def test_a_robot_that_does_not_answer_is_not_waited_for() -> None:
    state = obstructed(stored(D, "busy"))
    *_, asked = play(state, EndAttempt(ACTION, 1, now_us=13 * S))
    late = GoOnWithoutHelp(ACTION, asked.helper, 1, now_us=18 * S)
    assert types(play(state, late)) == ["RecoveryEscalated", "SupervisorCalled"]
    assert decided(state, ReachHelper(ACTION, asked.helper)) == ()


def test_nothing_is_written_to_the_store_while_a_robot_helps() -> None:
    state = obstructed()
    *_, asked = play(state, EndAttempt(ACTION, 1, now_us=13 * S))
    assert types(play(state, ReachHelper(ACTION, asked.helper))) == ["AssistanceAdmitted"]
    assert is_shown_idle(state, asked.helper, 14 * S)


def test_manual_help_is_called_last_and_no_record_names_who_came() -> None:
    state = obstructed(stored(A, "busy"), stored(D, "busy"))
    _, escalated, called = play(state, EndAttempt(ACTION, 1, now_us=13 * S))
    assert (escalated.to_level, called.purpose) == ("human", "recovery")
    responded, resolved = play(state, Respond(1, now_us=40 * S))
    assert isinstance(responded, SupervisorResponded)
    named = responded.principals
    assert (named.decided_by, named.requested_by, named.executed_by, named.supervised_by) == (None, None, B, None)
    assert resolved.level == "human"


def test_the_brain_only_saves_the_error() -> None:
    state = obstructed(stored(A, "busy"), stored(D, "busy"), manual_help=0)
    _, saved, again = play(state, EndAttempt(ACTION, 1, now_us=13 * S))
    assert isinstance(saved, RecoveryEscalated)
    assert (saved.to_level, saved.reason) == ("fleet", "saved")
    assert isinstance(again, RecoveryAttempted)
    assert RecoveryEscalated not in ROBOOS.reacts


def attempts_of(state: State) -> int:
    """How often the robot tries until it gives up."""
    count, made = 1, play(state, EndAttempt(ACTION, 1, now_us=13 * S, answer=0))
    while isinstance(made[-1], RecoveryAttempted):
        count = made[-1].number
        made = play(state, EndAttempt(ACTION, count, now_us=(13 + count) * S, answer=0))
    assert isinstance(made[-1], ExecutionFinished)
    assert made[-1].result == "failure"
    return count


def test_the_agent_calls_a_tool_twenty_times_with_the_checklist_in_each_call() -> None:
    assert attempts_of(worn()) == 20 + 19
    assert attempts_of(worn(max_steps=1)) == 1
    assert attempts_of(worn(max_steps=3)) == 3 + 2


def test_near_position_is_tried_several_times_in_each_call() -> None:
    busy = (stored(A, "busy"), stored(C, "busy"), stored(D, "busy"))
    assert attempts_of(worn(*busy, worn_error=303, max_steps=2)) == 2 + 3


def test_a_task_is_given_up_with_its_failed_subtask_and_nobody_repeats_it() -> None:
    steps = ("A carry.package", "A navigate.indoor")
    task = past.arrived("A1-1", A, steps, budget_us=600 * S, due_us=601 * S)
    run = ran((1, ActuatorDegraded(A, "lost")), (S, task))
    assert when(run, TaskAbandoned) == when(run, StoreEntryWritten, availability="ready", written_by=COORDINATOR)
    assert len(when(run, StepBegan)) == len(when(run, CommandIssued)) == 1
    assert len(when(run, SupervisorCalled)) == 0
