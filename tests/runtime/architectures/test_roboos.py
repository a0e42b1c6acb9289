"""RoboOS: one test for each fact of its source, or choice of ours, that the master and the records rest on."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from fsar_ledger.designs.constants import Constants
from fsar_ledger.designs.dials import Roboos
from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed, AuthorityReleased
from fsar_ledger.events.envelope import COORDINATOR, RequestSubject, Scenario, Subject, flat
from fsar_ledger.events.execution import ExecutionFinished, ExecutionQueued, ExecutionStarted
from fsar_ledger.events.knowledge import StoreEntryWritten
from fsar_ledger.events.request import CommandIssued, RequestDenied
from fsar_ledger.events.task import StepBegan, StepCompleted, TaskAbandoned, TaskCompleted, TaskPlanned
from fsar_ledger.events.world import OutsiderRequestInjected, RobotCameBack, RobotWentOff, TaskArrived
from fsar_ledger.projections.fold import fold
from fsar_ledger.runtime.architectures.roboos import ROBOOS
from fsar_ledger.runtime.architectures.roboos.master import PlanTask, SendSubtask
from fsar_ledger.runtime.run_replay import replay_run
from fsar_ledger.runtime.simulation import SCENARIOS, RunSpec, simulate_run
from tests import past
from tests.foreign.verbs import ask
from tests.runtime.architectures.roboos import (
    ACTION,
    B2,
    DOOR,
    DOOR_TASK,
    MIXED,
    TASK,
    A,
    B,
    C,
    D,
    S,
    decided,
    given,
    planned,
    play,
    ran,
    sent,
    stored,
)
from tests.runtime.histories import happen
from tests.runtime.live import when
from tests.sure import only


def test_the_master_names_a_robot_for_every_step_before_the_first_begins() -> None:
    run = ran((S, TASK))
    [plan] = [event for event in run.events if isinstance(event, TaskPlanned)]
    assert plan.robots == (A, B)
    assert when(run, TaskPlanned)[0] < when(run, StepBegan)[0]
    assert [event.robot for event in run.events if isinstance(event, CommandIssued)] == [A, B]


def test_the_plan_names_a_robot_that_the_store_shows_idle() -> None:
    state = given(DOOR_TASK, fleet_size=8)
    assert only(TaskPlanned, decided(state, PlanTask("A1-1"))).robots == (B,)
    happen(state, stored(B, "busy"))
    assert only(TaskPlanned, decided(state, PlanTask("A1-1"))).robots == (B2,)


def test_the_store_is_read_before_the_planning_and_not_again() -> None:
    state = sent(stored(B, "ready"))
    assert only(TaskPlanned, decided(given(DOOR_TASK), PlanTask("A1-1"))).robots == (B,)
    state = given(DOOR_TASK, fleet_size=8)
    planned(state, B)
    happen(state, stored(B, "busy"), past.began(Subject("A1-1", ACTION), A, 1, DOOR, "B"))
    issued = play(state, SendSubtask(ACTION))[0]
    assert (issued.robot, issued.seen_busy) == (B, True)


def test_a_busy_robot_is_named_when_no_other_is_registered() -> None:
    state = given(DOOR_TASK, stored(B, "busy"))
    assert only(TaskPlanned, decided(state, PlanTask("A1-1"))).robots == (B,)


def test_planning_takes_its_time_once_a_task() -> None:
    for planning_us in (S, 10 * S):
        run = ran((S, TASK), planning_us=planning_us)
        begins = when(run, StepBegan)
        assert begins[0] == S + 1 + planning_us
        assert begins[1] == when(run, StepCompleted)[0] + 1


def test_tasks_are_planned_side_by_side() -> None:
    other = past.arrived("C1-1", C, ("C navigate.indoor",), budget_us=600 * S, due_us=601 * S)
    run = ran((S, TASK), (S + 1, other), planning_us=10 * S)
    assert when(run, StepBegan, step=1) == [11 * S + 1, 11 * S + 2]


def test_the_next_subtask_waits_for_the_result_of_the_one_before() -> None:
    run = ran((S, TASK))
    back = when(run, StoreEntryWritten, robot=A, availability="ready", written_by=COORDINATOR)[0]
    first, second = when(run, CommandIssued)
    assert first < when(run, ExecutionFinished)[0] < back < second


def test_a_subtask_is_one_message_out_and_one_message_back() -> None:
    state = sent()
    issued = CommandIssued(RequestSubject("A1-1", ACTION, None), past.principals(COORDINATOR), B, False)
    over = ExecutionFinished(Subject("A1-1", ACTION), past.parties(), B)
    for event, sender in ((issued, COORDINATOR), (over, B)):
        follows = [one for react in ROBOOS.reacts[type(event)] for one in react(state, event, 5)]
        asked = [ask.sender for one in follows for ask in one.waits if ask.what == "message"]
        assert asked == [sender]


def test_an_own_step_is_a_subtask_like_any_other() -> None:
    run = ran((S, TASK))
    kinds: list[type[Event]] = [
        CommandIssued,
        AuthorityClaimed,
        ExecutionQueued,
        ExecutionStarted,
        ExecutionFinished,
        AuthorityReleased,
    ]
    counts = {action: [len(when(run, kind, action_id=action)) for kind in kinds] for action in ("A1-1/1.1", "A1-1/2.1")}
    assert counts["A1-1/1.1"] == counts["A1-1/2.1"] == [1, 2, 1, 1, 1, 2]


def test_the_master_goes_on_without_the_robot_whose_task_it_is() -> None:
    """Tasks are published to the master; it tells the requester nothing."""
    run = ran((S, DOOR_TASK), (S + 1, RobotWentOff(A)))
    assert len(when(run, TaskCompleted)) == 1


def test_the_master_waits_for_a_result_without_a_time_out() -> None:
    run = ran((S, DOOR_TASK), (S + 2, RobotWentOff(B)), (500 * S, RobotCameBack(B)))
    assert len(when(run, CommandIssued)) == 1
    assert when(run, TaskCompleted)[0] > 500 * S


def test_a_task_without_a_registered_robot_is_planned_five_more_times_and_ignored() -> None:
    gone = StoreEntryWritten(robot=B, availability="ready", until_us=1, written_by=B)
    state = given(TASK, gone)
    plan = only(TaskPlanned, decided(state, PlanTask("A1-1", now_us=2)))
    assert (plan.robots, plan.ready_us) == ((), 2 + 6 * state.fleet.roboos.planning_us)
    run = ran((1, RobotWentOff(B)), (100 * S, TASK))
    assert when(run, TaskAbandoned) == [100 * S + 1 + 6 * 242_000]
    assert when(run, StepBegan) == []


def records(run: Sequence[Event]) -> list[dict[str, Any]]:
    return [columns for columns in map(flat, run) if "requested_by" in columns]


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_a_record_names_no_requester_and_no_supervisor(scenario: Scenario) -> None:
    found = records(simulate_run(RunSpec(7, "roboos", "full", scenario, 4, 1), Constants(outages=MIXED)).events)
    assert len(found) > 50
    assert {(columns["requested_by"], columns["supervised_by"]) for columns in found} == {(None, None)}
    subtasks = [columns for columns in found if columns.get("action_id") is not None]
    assert all(columns["executed_by"] is not None and columns["task_id"] is not None for columns in subtasks)


def test_the_master_claims_execution_and_override_from_dispatch_to_result() -> None:
    run = ran((S, DOOR_TASK))
    claims = [event for event in run.events if isinstance(event, AuthorityClaimed)]
    assert {(claim.claimant, claim.dimension) for claim in claims} == {
        (COORDINATOR, "execution"),
        (COORDINATOR, "override"),
    }
    assert when(run, AuthorityClaimed) == 2 * when(run, CommandIssued)
    assert when(run, AuthorityReleased) == 2 * when(run, StepCompleted)


def test_an_outsider_has_no_channel_and_nobody_decides_that() -> None:
    outsider = OutsiderRequestInjected(task_id="x1", robot=D, peer=C, capability="inspect.private_zone")
    run = ran((S, outsider))
    denied = only(RequestDenied, [event for event in run.events if isinstance(event, RequestDenied)])
    assert (denied.reason, denied.principals.decided_by, denied.principals.path) == ("no channel", None, ())
    assert when(run, ExecutionQueued) == when(run, CommandIssued) == []


@pytest.mark.parametrize("fleet_size", [4, 16])
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_every_task_ends_with_and_without_outages_and_the_run_is_replayed(scenario: Scenario, fleet_size: int) -> None:
    for constants in (Constants(), Constants(outages=MIXED)):
        record = simulate_run(RunSpec(7, "roboos", "full", scenario, fleet_size, 1), constants)
        arrived = {event.task_id for event in record.events if isinstance(event, TaskArrived)}
        ended = [event.task_id for event in record.events if isinstance(event, TaskCompleted | TaskAbandoned)]
        assert sorted(ended) == sorted(arrived)
        assert replay_run(record) is None
        state = fold(record.events)
        assert not any(state.authority.claims.values())
        assert not state.execution.actions or constants.outages is not None


def test_every_dial_gives_runs_that_end_and_are_replayed() -> None:
    ends = [{"manual_help": 0}, {"manual_help": 2}, {"worn_error": 303}, {"gate": 1}, {"max_steps": 1}]
    for dials in [*ends, {"planning_us": 10 * S}, {"expiry_us": 1, "refresh_us": 1}, {"planning_retries": 0}]:
        constants = Constants(roboos=Roboos(**dials), outages=MIXED)
        assert replay_run(simulate_run(RunSpec(7, "roboos", "full", "failure-recovery-chain", 4, 2), constants)) is None


@pytest.mark.slow
def test_the_verbs_that_read_a_run_answer_on_one_of_its_runs(tmp_path: Path) -> None:
    out = tmp_path / "out"
    ask("simulate", out, "--architecture", "roboos", "--scenario", "mixed-trust-inspection", "--runs", 1).good()
    page = tmp_path / "page.html"
    for verb in (
        ("state", out, "--run", 1, "--at", 40),
        ("view", out, "--out", page),
        ("why", out, "1:300"),
        ("explain", out, "--run", 1),
        ("explain", out, "--run", 1, "--request", "B1-1/2.1"),
        ("log", out, "--run", 1),
        ("metrics", out),
        ("verify", out, "--replay"),
    ):
        ask(*verb).good()
    audited = ask("audit", out)
    assert (audited.code, "requester missing, supervisor missing" in audited.out) == (1, True)
    assert page.stat().st_size > 1000
