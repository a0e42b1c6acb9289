"""A live run with a change: its commands make it again, as far as they still answer what is asked there."""

from collections.abc import Iterator
from typing import Any

import pytest

from fsar_ledger.analysis.fork_base import Rerun, base_of_record, rerun
from fsar_ledger.base.errors import UsageError
from fsar_ledger.events import Event
from fsar_ledger.events.command import CommandGiven, CommandRejected
from fsar_ledger.events.execution import ExecutionFinished, ExecutionResumed, ExecutionStarted
from fsar_ledger.events.policy import PolicyRuleSet
from fsar_ledger.events.recovery import RecoveryAttempted
from fsar_ledger.events.request import RequestAdmitted, RequestDenied, RequestUnanswered
from fsar_ledger.events.supervision import SupervisorResponded
from fsar_ledger.events.task import TaskAbandoned, TaskCompleted
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.projections.fleet import NEVER_US
from fsar_ledger.runtime.architectures.fsar.reports import JudgeRequest, ReportAttempt, ReportStart, ReportWindow
from fsar_ledger.runtime.change_texts import parsed
from fsar_ledger.runtime.forks import Fork
from fsar_ledger.runtime.handlers.recovery import ReportFailure
from fsar_ledger.runtime.handlers.supervision import RespondToCall
from fsar_ledger.runtime.handlers.task import SubmitTask
from tests.runtime.test_live import OPENING, STEPS, A, B, C, Play, S, done, failing, opening, relay
from tests.sure import known

DENIED = "rule fleet deny robot=B1 from 3.5s"
"""The fleet forbids the door to act before it judges the carrier's request."""


def again(play: Play) -> Rerun:
    """The run that was played, from its record, as a ledger holds it."""
    record = play.record
    parts = [*record.times_us], [*record.caused_by], [*record.events]
    return rerun(base_of_record(LedgerRun(record.run_id, *parts), "0" * 64))


def of(fork: Fork, *kinds: type[Event]) -> list[Any]:
    return [event for event in fork.record.events if isinstance(event, kinds)]


def left_out(fork: Fork) -> list[str]:
    return [command.command for command in fork.left_out]


def test_a_fork_without_a_change_has_the_same_events() -> None:
    for play in (relay(), failing(), opening(), opening().wait(900)):
        fork = again(play).fork(())
        assert (fork.parts_at, fork.end, fork.left_out) == (None, None, ())
        assert tuple(fork.record.events[1:]) == play.record.events[1:]
        assert tuple(fork.record.times_us) == play.record.times_us


def test_a_rule_flips_an_admission_and_the_fork_ends_where_the_door_is_asked_again() -> None:
    base = again(relay())
    assert [event.principals.executed_by for event in base.base.record.events if isinstance(event, RequestAdmitted)]
    fork = base.fork_with_effect(parsed([DENIED]))
    assert [event.reason for event in of(fork, RequestDenied)] == ["policy"]
    assert not of(fork, RequestAdmitted)
    end = known(fork.end)
    assert end.question == "admission:t/2.2"
    assert end.words == "the record does not say whether robot/B1 takes t/2.2"
    assert 11 * S < end.time_us < 12 * S, "the carrier asks again after its back-off of 7 s"
    assert fork.record.times_us[-1] <= end.time_us
    assert left_out(fork) == ["ReportStart", "ReportResult", "ReportStart", "ReportResult"]
    assert not of(fork, CommandRejected), "nobody is blamed for a command that it would not have given"


def test_a_rule_that_is_dropped_lets_the_door_act_and_nobody_says_when_it_begins() -> None:
    closed = ReportWindow(robot=B, scope="local", window="night", outcome="deny")
    play = Play().does(
        SubmitTask(robot=A, task_id="t", steps=STEPS, budget_us=600 * S),
        ReportStart(robot=A, action_id="t/1.1"),
        done(A, "t/1.1"),
        closed,
        JudgeRequest(robot=B, action_id=OPENING, accepts=True),
    )
    fork = again(play.wait(2_000)).fork_with_effect(parsed(["drop command:ReportWindow/0"]))
    assert of(fork, RequestAdmitted)
    assert not of(fork, RequestDenied)
    assert known(fork.end).question == f"approach:{OPENING}"


def repaired() -> Play:
    """The door fails, recovers at its first attempt, and the carrier goes on."""
    play = opening().does(ReportFailure(robot=B, action_id=OPENING, cause="hinge jammed"))
    play.does(ReportAttempt(robot=B, action_id=OPENING, succeeded=True), done(B, OPENING))
    return play.does(ReportStart(robot=A, action_id="t/3.1"), done(A, "t/3.1"))


FAILS = "answer command:ReportAttempt/0 succeeded=false"


def test_what_a_command_cannot_say_is_an_error_of_the_change() -> None:
    change = "answer command:ReportAttempt/0 succeeded=maybe"
    with pytest.raises(UsageError, match=rf"^change {change}: command ReportAttempt: Expected `bool`, got `str`"):
        again(repaired()).fork_with_effect(parsed([change]))


def test_the_model_answers_what_nobody_did_under_the_seed_that_is_named() -> None:
    base = again(repaired())
    assert known(base.fork_with_effect(parsed([FAILS])).end).question == f"retry:{OPENING}/1/2"
    seven, once_more, eight = (base.fork_with_effect(parsed([FAILS, f"answer * model:{seed}"])) for seed in (7, 7, 8))
    assert (seven.end, eight.end) == (None, None)
    assert len(of(seven, RecoveryAttempted)) == 2
    assert (len(of(seven, TaskCompleted)), of(seven, TaskAbandoned)) == (1, [])
    assert seven.record == once_more.record
    assert seven.record.times_us != eight.record.times_us


def test_with_the_model_a_refused_step_is_done_in_the_end() -> None:
    changes = ["answer command:JudgeRequest/0 accepts=false", "answer * model:7"]
    fork = again(relay()).fork_with_effect(parsed(changes))
    assert [event.reason for event in of(fork, RequestDenied)] == ["declined"]
    assert [event.subject.action_id for event in of(fork, ExecutionFinished)] == ["t/1.1", "t/2.2", "t/3.1"]
    assert (fork.end, len(of(fork, TaskCompleted)), of(fork, TaskAbandoned)) == (None, 1, [])


def test_an_execution_of_unknown_length_ends_by_the_record_or_by_the_change_and_never_by_itself() -> None:
    base = again(repaired())
    later = [FAILS, f"answer retry:{OPENING}/1/2 2s", f"answer attempt:retry/{OPENING}/1/2 hold"]
    end = known(base.fork_with_effect(parsed(later)).end)
    assert end.question == f"execution:{OPENING}/rest"
    assert end.words == f"the record does not say when robot/B1 ends {OPENING}"
    fork = base.fork_with_effect(parsed([*later, f"answer execution:{OPENING}/rest 3s"]))
    [resumed] = [time_us for time_us, event in pairs(fork) if isinstance(event, ExecutionResumed)]
    ended = [(time_us, event) for time_us, event in pairs(fork) if isinstance(event, ExecutionFinished)]
    assert [time_us for time_us, event in ended if event.subject.action_id == OPENING] == [resumed + 3 * S]
    sooner = again(failing()).fork_with_effect(parsed(["answer command:ReportAttempt/0 succeeded=true"]))
    assert known(sooner.end).question == f"execution:{OPENING}/rest", "it goes on a second sooner than on record"


def test_who_is_interrupted_ends_later_than_was_said_before() -> None:
    off, on = (
        f'{{"command":"ReportPresence","by":"robot/B1","robot":"robot/B1","is_on":{is_on}}}'
        for is_on in ("false", "true")
    )
    at_s = again(repaired()).base.record.times_us[-1] / S - 0.2
    changes = [FAILS, f"answer retry:{OPENING}/1/2 1s", f"answer attempt:retry/{OPENING}/1/2 hold"]
    changes += [f"answer execution:{OPENING}/rest 4s", f"add {at_s}s {off}", f"add {at_s + 0.1:.1f}s {on}"]
    fork = again(repaired()).fork_with_effect(parsed(changes))
    resumed = [time_us for time_us, event in pairs(fork) if isinstance(event, ExecutionResumed)]
    ended = [(time_us, event) for time_us, event in pairs(fork) if isinstance(event, ExecutionFinished)]
    assert len(resumed) == 2
    assert [time_us for time_us, event in ended if event.subject.action_id == OPENING] == [resumed[-1] + 4 * S]


def pairs(fork: Fork) -> Iterator[tuple[int, Event]]:
    return zip(fork.record.times_us, fork.record.events, strict=True)


def test_a_change_answers_for_one_question_and_the_next_one_ends_the_fork() -> None:
    asked = ["density all 1", f"answer response:{OPENING}/review/0 2s"]
    fork = again(relay()).fork(parsed(asked))
    assert known(fork.end).question == f"call:{OPENING}/review/0"
    fork = again(relay()).fork(parsed([*asked, f"answer call:{OPENING}/review/0 approve"]))
    assert [event.approves for event in of(fork, SupervisorResponded)] == [True]
    assert known(fork.end).question == f"approach:{OPENING}"
    fork = again(relay()).fork(parsed([*asked, f"answer call:{OPENING}/review/0 deny", "answer admission:* accept"]))
    assert [event.approves for event in of(fork, SupervisorResponded)][:1] == [False]
    assert of(fork, RequestDenied)


def test_a_supervisors_answer_on_record_can_be_changed() -> None:
    play = Play().does(
        SubmitTask(robot=A, task_id="t", steps=STEPS, budget_us=600 * S),
        ReportWindow(robot=B, scope="local", window="w", outcome="review"),
        ReportStart(robot=A, action_id="t/1.1"),
        done(A, "t/1.1"),
        JudgeRequest(robot=B, action_id=OPENING, accepts=True),
        RespondToCall(supervisor="supervisor/fleet", action_id=OPENING, approves=True),  # type: ignore[arg-type]
        ReportStart(robot=B, action_id=OPENING),
    )
    fork = again(play).fork_with_effect(parsed(["answer command:RespondToCall/0 approves=false"]))
    assert [event.approves for event in of(fork, SupervisorResponded)] == [False]
    assert [event.reason for event in of(fork, RequestDenied)] == ["review"]
    assert left_out(fork)[:1] == ["ReportStart"]


def test_a_budget_is_changed_as_if_its_supervisor_had_given_the_command() -> None:
    base = again(failing())
    fork = base.fork_with_effect(parsed(["budget B1 local 60s 1 from 1s"]))
    assert len(of(fork, RecoveryAttempted)) == 1
    given = of(fork, CommandGiven)
    assert [one.command for one in given if one not in base.base.record.events] == ["SetRecoveryBudget"]
    fork = base.fork_with_effect(parsed(["set structure.local_attempts=1"]))
    assert len(of(fork, RecoveryAttempted)) == 1
    assert known(fork.end).question is not None


def test_a_rule_is_on_record_as_a_command_of_who_is_in_charge() -> None:
    fork = again(relay()).fork_with_effect(parsed(["rule local deny robot=B1 from 3.5s"]))
    [rule] = of(fork, PolicyRuleSet)
    seq = fork.record.events.index(rule)
    given = fork.record.events[known(fork.record.caused_by[seq])]
    assert isinstance(given, CommandGiven)
    assert (given.command, given.issued_by) == ("SetPolicyRule", "supervisor/B1")


def test_a_task_that_is_not_given_leaves_the_others_as_they_are() -> None:
    steps = ("C navigate.indoor", "C inspect.visual")
    play = relay().does(
        SubmitTask(robot=C, task_id="u", steps=steps, budget_us=600 * S),
        ReportStart(robot=C, action_id="u/1.1"),
        done(C, "u/1.1"),
        ReportStart(robot=C, action_id="u/2.1"),
        done(C, "u/2.1"),
    )
    fork = again(play).fork_with_effect(parsed(["drop command:SubmitTask/0"]))
    assert fork.end is None
    assert [event.task_id for event in of(fork, TaskCompleted)] == ["u"]
    assert not of(fork, CommandRejected)
    assert len(left_out(fork)) == 7


def test_who_is_silent_by_a_change_stays_silent() -> None:
    fork = again(relay()).fork_with_effect(parsed(["drop command:JudgeRequest/0"]))
    assert of(fork, RequestUnanswered)
    assert left_out(fork)[:1] == ["ReportStart"]


def test_who_is_asked_at_another_time_has_not_answered_on_record() -> None:
    fork = again(relay()).fork_with_effect(parsed(["move command:SubmitTask/0 +2.5s"]))
    assert known(fork.end).question == "execution:t/1.1"
    assert left_out(fork)[:2] == ["ReportStart", "ReportResult"]
    sooner = again(relay()).fork_with_effect(parsed(["move command:SubmitTask/0 -0.5s"]))
    assert known(sooner.end).question == "execution:t/1.1"
    at_once = again(relay()).fork_with_effect(parsed(["move command:SubmitTask/0 -0.0005s"]))
    assert (at_once.end, len(of(at_once, TaskCompleted))) == (None, 1), "within a millisecond it is the same time"


def test_of_what_a_change_has_answered_the_record_has_nothing_more_to_say() -> None:
    play = relay()
    asked = ["density all 1", f"answer response:{OPENING}/review/0 0.5s", f"answer call:{OPENING}/review/0 approve"]
    begins = f"answer approach:{OPENING} 3s"
    fork = again(play).fork_with_effect(parsed([*asked, begins, f"answer execution:{OPENING} 5s", "answer * model:7"]))
    started = next(
        (time_us, event.ends_us)
        for time_us, event in pairs(fork)
        if isinstance(event, ExecutionStarted) and event.subject.action_id == OPENING
    )
    accepted = next(time_us for time_us, event in pairs(fork) if isinstance(event, RequestAdmitted))
    assert 3 * S <= started[0] - accepted < 3 * S + 10
    assert started[1] == started[0] + 5 * S
    ends = [time_us for time_us, event in pairs(fork) if isinstance(event, ExecutionFinished)]
    assert started[1] in ends, "and not when the report on record came"


def test_nobody_is_silent_about_what_a_change_has_answered_even_if_it_is_asked_as_on_record() -> None:
    base = again(repaired())
    resumed_s = next(time_us for time_us, event in pairs(base.fork(())) if isinstance(event, ExecutionResumed)) / S

    def sooner(retry_s: float) -> Fork:
        """The door fails half a second sooner, and its attempt takes so long."""
        changes = ["move command:ReportFailure/0 -0.5s", f"answer retry:{OPENING}/1/1 {retry_s:.6f}s"]
        return base.fork_with_effect(parsed([*changes, f"answer attempt:retry/{OPENING}/1/1 hold"]))

    late_s = known(sooner(0.5).end).time_us / S
    fork = sooner(0.5 + resumed_s - late_s - 0.0005)
    assert known(fork.end).question == f"execution:{OPENING}/rest"
    assert 0 < resumed_s - known(fork.end).time_us / S < 0.001


def test_a_command_of_which_something_came_on_record_and_nothing_would_here_is_left_out() -> None:
    judged = '{"command":"JudgeRequest","by":"robot/B1","robot":"robot/B1","action_id":"t/2.1","accepts":true}'
    answered = f"answer response:{OPENING}/review/0 never"
    fork = again(relay()).fork_with_effect(parsed(["density all 1", f"add 3.5s {judged}", answered]))
    assert left_out(fork)[:1] == ["JudgeRequest"], "it is before the supervisor already, who never answers"
    assert (fork.end, len(of(fork, TaskAbandoned))) == (None, 1)


def test_a_question_of_which_nothing_can_come_any_more_ends_no_fork() -> None:
    task = SubmitTask(robot=A, task_id="t", steps=STEPS[:1], budget_us=600 * S)
    play = Play().does(task, ReportStart(robot=A, action_id="t/1.1", lasts_us=1_500_000))
    play.wait(1).does(done(A, "t/1.1"))  # half a second after the planned end
    fork = again(play).fork_with_effect(parsed(["answer command:ReportStart/0 lasts_us=2500000"]))
    assert (fork.end, len(of(fork, TaskCompleted))) == (None, 1)


def test_a_command_of_which_nothing_came_is_given_in_a_fork_too_unless_it_is_rejected_there() -> None:
    review = ReportWindow(robot=B, scope="local", window="w", outcome="review")
    twice = JudgeRequest(robot=B, action_id=OPENING, accepts=True)
    before = SubmitTask(robot=A, task_id="t", steps=STEPS, budget_us=600 * S)
    play = Play().does(before, review, ReportStart(robot=A, action_id="t/1.1"), done(A, "t/1.1"), twice, twice)
    base = again(play.wait(2_000))
    assert base.fork(()).record.events[1:] == base.base.record.events[1:]
    fork = base.fork_with_effect(parsed(["answer command:JudgeRequest/0 accepts=false"]))
    assert left_out(fork) == ["JudgeRequest"]
    assert not of(fork, CommandRejected)


def test_the_fork_of_a_run_that_goes_on_ends_with_its_record() -> None:
    base = again(opening())  # the door opens, and its task has a budget
    assert known(base.base.recipe.live).until_us != NEVER_US
    fork = base.fork_with_effect(parsed([DENIED]))
    assert known(fork.end) == (base.base.record.times_us[-1], None, "the record ends there, and the run continues")
    assert known(again(relay()).base.recipe.live).until_us == NEVER_US


def test_a_command_that_the_change_adds_is_given_and_one_that_is_rejected_is_refused_in_words() -> None:
    line = '{"command":"ReportWindow","by":"robot/B1","robot":"robot/B1","scope":"local","window":"w","outcome":"deny"}'
    fork = again(relay()).fork_with_effect(parsed([f"add 3.5s {line}"]))
    assert [event.reason for event in of(fork, RequestDenied)] == ["policy"]
    with pytest.raises(UsageError, match="ReportPresence about robot/B1 is rejected: robot/B1 is on already"):
        again(relay()).fork_with_effect(
            parsed(['add 3.5s {"command":"ReportPresence","by":"robot/B1","robot":"robot/B1","is_on":true}'])
        )


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (["architecture cfc"], "robots speak for themselves under FSAR"),
        (["without shared-registry"], "robots speak for themselves under FSAR"),
        (["set world.review_share=0.5 from 2s"], "whose world no constant makes"),
        (["add obstruction:B1 2s for 3s"], "found a fact of the world, expected a command"),
        (["drop command:JudgeRequest/7"], "no fact command:JudgeRequest/7; did you mean command:JudgeRequest/0"),
        (["answer command:JudgeRequest/7 accepts=false"], "no command command:JudgeRequest/7; did you mean"),
        (["answer command:JudgeRequest/0 accept=false"], "found accept, expected some of robot, action_id, accepts"),
        (["answer command:JudgeRequest/0 no"], "found no where FIELD=VALUE belongs"),
        (["answer admission:t/2.1 accept"], "was also asked on record; expected a change of the command"),
        ([DENIED, "answer admission:t/9.9 accept"], "nobody is asked this in the fork"),
        ([DENIED, "answer admission:t/2.2 maybe"], "found maybe, expected accept, or model: and a seed"),
        ([DENIED, "answer message:x 2s"], "no question message:x"),
        ([DENIED, "answer nobody:* model:7"], r"no question nobody:\*"),
        (["density all 1", "answer call:1 approve"], "found a number, expected the name of the call"),
        (["move command:ReportStart/0 -1.5s"], "ReportStart about t/1.1 is rejected: unknown or finished action"),
        ([DENIED, "answer * model:x"], "found model:x, expected model: and a seed"),
        (["rule local deny robot=B1 from 9h"], "where a time belongs"),
        (["rule local deny robot=B1 from 900s"], "the run has ended by then"),
        (["rule local deny robot=Z9"], "unknown robot robot/Z9"),
        (["set structure.local_attempts=5"], "has no effect"),
    ],
)
def test_what_means_nothing_in_a_live_run_is_refused_in_words(changes: list[str], said: str) -> None:
    base = again(relay())
    with pytest.raises(UsageError, match=said):
        base.fork_with_effect(parsed(changes))
