"""A live run: nobody answers for another, every command is on record, and the commands alone make the run again."""

import random
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fsar_ledger.api.ledger import Ledger
from fsar_ledger.designs.constants import Constants
from fsar_ledger.events import Event
from fsar_ledger.events.command import CommandGiven, CommandRejected
from fsar_ledger.events.envelope import FLEET_SUPERVISOR, Robot
from fsar_ledger.events.execution import ExecutionFailed, ExecutionFinished, ExecutionHalted, ExecutionStarted
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.events.recovery import (
    AssistanceAdmitted,
    AssistanceDeclined,
    AssistanceFailed,
    AssistanceRequested,
    FailureResolved,
    RecoveryAttempted,
    RecoveryEscalated,
)
from fsar_ledger.events.request import RequestAccepted, RequestAdmitted, RequestDenied, RequestIssued, RequestUnanswered
from fsar_ledger.events.supervision import SupervisorCalled, SupervisorResponded
from fsar_ledger.events.task import TaskAbandoned, TaskCompleted
from fsar_ledger.ledger.rows.runs import LedgerRun
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.runtime.architectures.fsar.reports import (
    JudgeAssistance,
    JudgeRequest,
    ReportAssistance,
    ReportAttempt,
    ReportPresence,
    ReportStart,
    ReportWindow,
)
from fsar_ledger.runtime.handlers.public import PublicCommand, command_record, commands, read, speaker
from fsar_ledger.runtime.handlers.recovery import ReportFailure
from fsar_ledger.runtime.handlers.request import ReportResult
from fsar_ledger.runtime.handlers.supervision import RespondToCall
from fsar_ledger.runtime.handlers.task import SubmitTask
from fsar_ledger.runtime.live import LiveRun, live_started
from fsar_ledger.runtime.run_replay import replay_run

S = 1_000_000
A, B, C, D = (Robot(f"robot/{name}1") for name in "ABCD")
STEPS = ("A navigate.indoor", "A door.open.secure B", "A navigate.indoor")
OPENING = "t/2.1"


class Play:
    """A live run of four robots; each command comes a second after the one before, and must be carried out."""

    def __init__(self) -> None:
        self.run = LiveRun(live_started(Constants(), 4, "2026-03-01T10:00:00Z"), Constants())
        self.now_s = 0

    def give(self, command: PublicCommand, by: str | None = None) -> str | None:
        """Give the command, by who speaks in it unless another is named."""
        self.now_s += 1
        decision = self.run.give(self.now_s * S, command_record(command, by or f"{speaker(command)}"))
        self.run.advance(self.now_s * S + S // 2)
        return decision.rejected

    def does(self, *commands: PublicCommand) -> "Play":
        for command in commands:
            assert self.give(command) is None, command
        return self

    def wait(self, seconds: int) -> "Play":
        self.now_s += seconds
        self.run.advance(self.now_s * S)
        return self

    def of(self, *kinds: type[Event]) -> list[Any]:
        return [event for event in self.run.kernel.events if isinstance(event, kinds)]

    @property
    def record(self) -> LedgerRun:
        kernel = self.run.kernel
        return LedgerRun("hall", tuple(kernel.times_us), tuple(kernel.caused_by), tuple(kernel.events))


def at_the_door() -> Play:
    """The carrier has gone to the door and has asked that it be opened."""
    task = SubmitTask(robot=A, task_id="t", steps=STEPS, budget_us=600 * S)
    return Play().does(task, ReportStart(robot=A, action_id="t/1.1"), done(A, "t/1.1"))


def done(robot: Robot, action_id: str) -> ReportResult:
    return ReportResult(executor=robot, action_id=action_id, result="success")


def opening() -> Play:
    """The door opens."""
    return at_the_door().does(
        JudgeRequest(robot=B, action_id=OPENING, accepts=True), ReportStart(robot=B, action_id=OPENING)
    )


def relay() -> Play:
    return opening().does(done(B, OPENING), ReportStart(robot=A, action_id="t/3.1"), done(A, "t/3.1"))


def test_a_live_run_is_on_record_as_one_of_fsar_with_every_mechanism() -> None:
    [started] = Play().of(RunStarted)
    assert (started.kind, started.architecture, started.configuration) == ("live", "fsar", "full")


def failing() -> Play:
    """The door's first attempt to recover fails, and the second succeeds."""
    play = opening().does(ReportFailure(robot=B, action_id=OPENING, cause="hinge jammed"))
    return play.does(
        ReportAttempt(robot=B, action_id=OPENING, succeeded=False),
        ReportAttempt(robot=B, action_id=OPENING, succeeded=True),
        done(B, OPENING),
    )


def test_a_relay_that_is_played_by_hand_completes_its_task() -> None:
    play = relay()
    assert [event.subject.action_id for event in play.of(ExecutionFinished)] == ["t/1.1", OPENING, "t/3.1"]
    assert play.of(TaskCompleted)
    assert {event.ends_us for event in play.of(ExecutionStarted)} == {None}
    assert [event.command for event in play.of(CommandGiven)].count("ReportStart") == 3
    assert not play.of(CommandRejected)


def test_nobody_is_admitted_started_or_finished_before_the_robot_itself_says_so() -> None:
    play = at_the_door().wait(3)
    assert play.of(RequestIssued)
    assert not play.of(RequestAdmitted)
    play.does(JudgeRequest(robot=B, action_id=OPENING, accepts=True)).wait(60)
    assert play.of(RequestAdmitted)
    assert OPENING not in {event.subject.action_id for event in play.of(ExecutionStarted)}
    play.does(ReportStart(robot=B, action_id=OPENING)).wait(300)
    assert OPENING not in {event.subject.action_id for event in play.of(ExecutionFinished)}


def test_a_robot_that_is_off_begins_nothing_of_which_its_acceptance_has_not_gone_out() -> None:
    off, start = ReportPresence(robot=B, is_on=False), ReportStart(robot=B, action_id=OPENING)
    play = at_the_door().does(off, JudgeRequest(robot=B, action_id=OPENING, accepts=True))
    assert play.give(start) == (
        "the acceptance of t/2.1 has not gone out to robot/A1, expected that first; a robot that is off sends nothing"
    )
    assert not play.of(RequestAccepted)
    play.does(ReportPresence(robot=B, is_on=True), start, done(B, OPENING))
    assert [event.principals.decided_by for event in play.of(RequestAccepted)] == [B]
    assert OPENING in {event.subject.action_id for event in play.of(ExecutionFinished)}


def test_a_request_that_nobody_judges_is_unanswered_after_its_time() -> None:
    play = at_the_door().wait(120)
    assert [event.principals.executed_by for event in play.of(RequestUnanswered)][:1] == [B]


def test_a_robot_may_refuse_what_every_rule_allows() -> None:
    play = at_the_door().does(JudgeRequest(robot=B, action_id=OPENING, accepts=False))
    [denied] = play.of(RequestDenied)
    assert (denied.reason, denied.principals.decided_by) == ("declined", B)
    assert (denied.principals.requested_by, denied.principals.executed_by) == (A, B)


def test_a_robot_cannot_allow_what_a_rule_denies() -> None:
    closed = ReportWindow(robot=B, scope="local", window="night", outcome="deny")
    play = at_the_door().does(closed, JudgeRequest(robot=B, action_id=OPENING, accepts=True))
    assert [event.reason for event in play.of(RequestDenied)] == ["policy"]
    assert not play.of(RequestAdmitted)


def test_a_reported_failure_is_over_when_the_robot_says_so_and_not_before() -> None:
    play = opening().does(ReportFailure(robot=B, action_id=OPENING, cause="hinge jammed")).wait(2)
    [failed] = play.of(ExecutionFailed)
    assert (failed.cause, failed.remaining_us) == ("hinge jammed", None)
    assert (len(play.of(RecoveryAttempted)), play.of(FailureResolved)) == (1, [])
    play = failing()
    assert (len(play.of(RecoveryAttempted)), len(play.of(FailureResolved))) == (2, 1)
    assert OPENING in {event.subject.action_id for event in play.of(ExecutionFinished)}


def at_the_peers(cause: str = "obstruction") -> Play:
    """The door's own attempts have failed; a peer is asked, if any can help with this."""
    play = opening().does(ReportFailure(robot=B, action_id=OPENING, cause=cause))
    while not play.of(RecoveryEscalated):
        play.does(ReportAttempt(robot=B, action_id=OPENING, succeeded=False))
    return play.wait(1)


def test_a_peer_helps_by_its_own_word_and_says_when_it_has() -> None:
    play = at_the_peers()
    assert not play.of(AssistanceAdmitted)
    helper = play.of(AssistanceRequested)[-1].helper
    play.does(JudgeAssistance(robot=helper, action_id=OPENING, accepts=True)).wait(60)
    assert [event.helper for event in play.of(AssistanceAdmitted)] == [helper]
    assert not play.of(FailureResolved)
    play.does(ReportAssistance(robot=helper, action_id=OPENING, succeeded=True))
    assert [event.level for event in play.of(FailureResolved)] == ["peer"]
    assert replay_run(play.record) is None


def test_a_peer_that_could_not_help_and_does_not_say_why_is_not_worn() -> None:
    play = at_the_peers()
    helper = play.of(AssistanceRequested)[-1].helper
    play.does(JudgeAssistance(robot=helper, action_id=OPENING, accepts=True))
    play.does(ReportAssistance(robot=helper, action_id=OPENING, succeeded=False))
    assert [event.cause for event in play.of(AssistanceFailed)] == ["not told"]
    assert replay_run(play.record) is None


def test_a_peer_that_declines_or_does_not_answer_is_passed_over() -> None:
    for answers in (True, False):
        play = at_the_peers()
        helper = play.of(AssistanceRequested)[-1].helper
        if answers:
            play.does(JudgeAssistance(robot=helper, action_id=OPENING, accepts=False)).wait(1)
            assert [(event.robot, event.helper) for event in play.of(AssistanceDeclined)] == [(B, helper)]
        else:
            play.wait(60)
            assert play.give(JudgeAssistance(robot=helper, action_id=OPENING, accepts=True)) is not None
        assert not play.of(AssistanceAdmitted)
        levels = {event.to_level for event in play.of(RecoveryEscalated)}
        assert len(play.of(AssistanceRequested)) > 1 or "fleet" in levels
        assert replay_run(play.record) is None


def test_a_supervisor_answers_the_call_by_command() -> None:
    play = at_the_peers("hinge jammed").wait(60)
    assert not play.wait(5).of(SupervisorResponded)
    called = play.of(SupervisorCalled)[-1]
    play.does(RespondToCall(supervisor=called.supervisor, action_id=OPENING, approves=True))
    assert [event.level for event in play.of(FailureResolved)] == ["human"]


def test_a_task_of_the_second_hour_is_given_up_after_its_own_budgets_and_not_at_once() -> None:
    play = Play().wait(7_200).does(SubmitTask(robot=A, task_id="late", steps=STEPS, budget_us=600 * S)).wait(500)
    assert not play.of(TaskAbandoned)
    assert play.wait(7_200).of(TaskAbandoned)


def test_a_robot_that_goes_off_is_halted_and_goes_on_when_it_is_back() -> None:
    play = opening().does(ReportPresence(robot=B, is_on=False))
    [halted] = play.of(ExecutionHalted)
    assert halted.remaining_us is None
    play.does(ReportPresence(robot=B, is_on=True), done(B, OPENING))
    assert OPENING in {event.subject.action_id for event in play.of(ExecutionFinished)}


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (JudgeRequest(robot=C, action_id=OPENING, accepts=True), "the request goes to robot/B1"),
        (JudgeRequest(robot=B, action_id="t/9", accepts=True), "unknown or settled request t/9"),
        (ReportStart(robot=C, action_id=OPENING), "unknown or finished action t/2.1"),
        (ReportStart(robot=Robot("robot/X9"), action_id=OPENING), "unknown robot robot/X9"),
        (ReportAttempt(robot=B, action_id=OPENING, succeeded=True), "unknown or finished action t/2.1"),
        (ReportAssistance(robot=D, action_id=OPENING, succeeded=True), "robot/D1 does not help with t/2.1"),
        (ReportPresence(robot=B, is_on=True), "robot/B1 is on already"),
        (JudgeAssistance(robot=D, action_id=OPENING, accepts=True), "robot/D1 is not asked about t/2.1"),
    ],
)
def test_what_a_robot_cannot_say_is_rejected_on_record_and_changes_nothing(command: PublicCommand, said: str) -> None:
    play = at_the_door()
    count = len(play.run.kernel.events)
    refused = play.give(command)
    assert refused is not None
    assert refused.startswith(said), refused
    assert [type(event) for event in play.run.kernel.events[count:]] == [CommandGiven, CommandRejected]


def test_the_commands_alone_make_the_run_again() -> None:
    for play in (relay(), failing(), at_the_door().wait(700)):
        assert replay_run(play.record) is None


def test_a_run_that_was_cut_off_anywhere_replays_too() -> None:
    whole = relay().record
    ends = [seq for seq, cause in enumerate(whole.caused_by) if cause == 0 and whole.times_us[seq]]
    for end in ends:
        cut = LedgerRun("hall", whole.times_us[:end], whole.caused_by[:end], whole.events[:end])
        assert replay_run(cut) is None or end == ends[0]  # before the first command it is no run of commands


@pytest.mark.parametrize("kind", [CommandGiven, RequestAdmitted, ExecutionFinished])
def test_an_event_that_was_taken_out_of_a_live_run_is_found(kind: type[Event]) -> None:
    whole = relay().record
    at = next(seq for seq, event in enumerate(whole.events) if isinstance(event, kind))
    causes = [cause if cause is None or cause < at else max(0, cause - 1) for cause in whole.caused_by]
    without = [[*some[:at], *some[at + 1 :]] for some in (whole.times_us, causes, whole.events)]
    assert replay_run(LedgerRun("hall", *map(tuple, without))) is not None  # type: ignore[arg-type]


def test_a_decision_that_the_handlers_do_not_make_is_found() -> None:
    whole = relay().record
    at = next(seq for seq, event in enumerate(whole.events) if isinstance(event, RequestAdmitted))
    other = msgspec.structs.replace(whole.events[at], outcome="deny")
    forged = (*whole.events[:at], other, *whole.events[at + 1 :])
    found = replay_run(msgspec.structs.replace(whole, events=forged))
    assert found is not None
    assert (found.seq, found.field) == (at, "outcome")


def test_commands_at_random_replay_and_every_kind_of_command_is_read_as_it_was_written() -> None:
    draw = random.Random(7)
    play = at_the_door()
    for _ in range(200):
        robot, action = draw.choice((A, B, C, D)), draw.choice(("t/1.1", OPENING, "t/2.2", "t/3.1"))
        command: PublicCommand = draw.choice(
            (
                JudgeRequest(robot=robot, action_id=action, accepts=draw.random() < 0.8),
                ReportStart(robot=robot, action_id=action, lasts_us=draw.choice((None, 5 * S))),
                ReportFailure(robot=robot, action_id=action, cause=draw.choice(("obstruction", "degradation", "rust"))),
                ReportAttempt(robot=robot, action_id=action, succeeded=draw.random() < 0.3),
                JudgeAssistance(robot=robot, action_id=action, accepts=draw.random() < 0.6),
                ReportAssistance(robot=robot, action_id=action, succeeded=draw.random() < 0.3),
                ReportPresence(robot=robot, is_on=draw.random() < 0.5),
                ReportWindow(robot=robot, scope="local", window="w", outcome=draw.choice((None, "deny", "review"))),
                RespondToCall(supervisor=FLEET_SUPERVISOR, action_id=action, approves=True),
                done(robot, action),
                SubmitTask(robot=A, task_id=f"t{draw.randrange(9)}", steps=STEPS, budget_us=60 * S),
            )
        )
        record = command_record(command, robot, key="k", source_time_us=1)
        assert read(commands()[record.command], record.parameters) == command
        play.give(command, robot)
        if draw.random() < 0.1:
            play.wait(draw.randrange(60))
    assert replay_run(play.record) is None
    assert len(play.of(CommandGiven)) == 203


def test_a_command_that_stamps_its_own_time_is_not_read() -> None:
    with pytest.raises(msgspec.ValidationError, match="now_us"):
        read(ReportStart, '{"robot":"robot/A1","action_id":"t","now_us":5}')


def test_a_live_run_on_record_is_verified_replayed_audited_and_measured(tmp_path: Path) -> None:
    with Writer(tmp_path / "ledger", "example.org/hall") as writer:
        writer.append(
            stage(tmp_path / "ledger", [relay().record, msgspec.structs.replace(failing().record, run_id="b")])
        )
    ledger = Ledger(tmp_path / "ledger")
    assert ledger.verify(replay=True).ok
    assert not [row for row in ledger.audit().rows if row.holds is False]
