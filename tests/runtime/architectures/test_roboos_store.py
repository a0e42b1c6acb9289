"""RoboOS: one test for each fact of its source that the shared store rests on."""

from fsar_ledger.events.envelope import COORDINATOR, Subject
from fsar_ledger.events.execution import ExecutionFinished
from fsar_ledger.events.knowledge import StoreEntryWritten
from fsar_ledger.events.request import CommandIssued
from fsar_ledger.events.task import StepCompleted, TaskAbandoned, TaskCompleted
from fsar_ledger.events.world import LinkCameUp, LinkWentDown, RobotCameBack, RobotWentOff, SnapshotPhaseSet
from fsar_ledger.runtime.architectures.roboos.master import (
    Heartbeat,
    SendSubtask,
    TakeResult,
    TakeSubtask,
    entry,
    is_shown_idle,
    is_stored,
)
from tests import past
from tests.runtime.architectures.roboos import (
    ACTION,
    DOOR,
    DOOR_TASK,
    A,
    B,
    S,
    decided,
    given,
    planned,
    play,
    ran,
    running,
    sent,
)
from tests.runtime.histories import happen, types
from tests.runtime.live import when


def test_the_store_is_written_busy_at_dispatch_and_idle_at_the_result() -> None:
    run = ran((S, DOOR_TASK))
    by = {"robot": B, "written_by": COORDINATOR}
    assert when(run, StoreEntryWritten, availability="busy", **by) == when(run, CommandIssued)
    assert when(run, StoreEntryWritten, availability="ready", **by) == when(run, StepCompleted)


def test_a_failed_result_sets_the_robot_idle_too() -> None:
    state = running()
    happen(state, ExecutionFinished(Subject("A1-1", ACTION), past.parties(), B, "failure"))
    assert not is_shown_idle(state, B, 20 * S)
    play(state, TakeResult(ACTION, "A1-1", B, now_us=20 * S))
    assert is_shown_idle(state, B, 20 * S)


def test_a_result_sets_a_robot_idle_that_serves_another_subtask() -> None:
    state = running()
    other = past.arrived("A1-2", A, (f"A {DOOR} B",))
    happen(state, other)
    planned(state, B, task_id="A1-2")
    happen(state, past.began(Subject("A1-2", "A1-2/1.1"), A, 1, DOOR, "B"))
    play(state, SendSubtask("A1-2/1.1"), TakeSubtask("A1-2/1.1", "A1-2", B))
    happen(state, ExecutionFinished(Subject("A1-1", ACTION), past.parties(), B))
    play(state, TakeResult(ACTION, "A1-1", B, now_us=20 * S))
    assert state.execution.current[B] == "A1-2/1.1"
    assert is_shown_idle(state, B, 20 * S)


def test_an_entry_expires_after_its_time_without_a_heartbeat() -> None:
    state = given()
    assert is_stored(state, B, 60 * S - 1)
    assert not is_stored(state, B, 60 * S)
    play(state, Heartbeat(B, 60 * S, now_us=40 * S))
    assert is_stored(state, B, 100 * S - 1)
    assert not is_stored(state, B, 100 * S)


def test_heartbeats_come_every_refresh_while_there_is_a_task() -> None:
    run = ran((1, SnapshotPhaseSet(B, 500_000)), (S, DOOR_TASK))
    assert when(run, StoreEntryWritten, written_by=B) == [1 + (15 + 30 * beat) * S for beat in range(4)]


def test_an_entry_does_not_expire_while_heartbeats_are_not_recorded() -> None:
    run = ran((1, SnapshotPhaseSet(B, 500_000)), (900 * S, DOOR_TASK))
    assert len(when(run, TaskCompleted)) == 1
    beats = when(run, StoreEntryWritten, written_by=B)
    assert [beat for beat in beats if 200 * S < beat < 950 * S] == [900 * S + 2, 930 * S + 2]
    silent = ran((900 * S, DOOR_TASK))
    assert len(when(silent, TaskAbandoned)) == 1


def test_the_writing_of_the_master_removes_the_expiry_until_the_next_heartbeat() -> None:
    state = sent()
    assert entry(state, B).until_us is None
    play(state, Heartbeat(B, 60 * S, now_us=30 * S))
    assert (entry(state, B).until_us, entry(state, B).availability) == (90 * S, "busy")


def test_an_expired_entry_comes_back_only_when_the_robot_connects() -> None:
    state = given(DOOR_TASK)
    assert decided(state, Heartbeat(B, 60 * S, now_us=61 * S)) == ()
    planned(state, B)
    happen(state, past.began(Subject("A1-1", ACTION), A, 1, DOOR, "B"))
    assert types(decided(state, SendSubtask(ACTION, now_us=61 * S))) == ["CommandIssued"] + 2 * ["AuthorityClaimed"]
    away = ((1, SnapshotPhaseSet(B, 0)), (2 * S, LinkWentDown(B)), (70 * S, LinkCameUp(B)))
    assert not is_stored(ran(*away).state, B, 71 * S)
    off = ((1, SnapshotPhaseSet(B, 0)), (2 * S, RobotWentOff(B)), (70 * S, RobotCameBack(B)))
    assert when(ran(*off), StoreEntryWritten, written_by=B)[1] == 70 * S + 1
