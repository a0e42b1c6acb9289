"""Forks of live runs in which everybody says at random what is asked: each is the run of its own commands."""

import random
from collections.abc import Iterator

import pytest

from fsar_ledger.designs.constants import Constants
from fsar_ledger.events.command import CommandRejected
from fsar_ledger.events.request import RequestUnanswered
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.runtime.architectures.fsar import FSAR
from fsar_ledger.runtime.architectures.fsar.reports import (
    JudgeAssistance,
    JudgeRequest,
    ReportAssistance,
    ReportAttempt,
    ReportStart,
    ReportWindow,
)
from fsar_ledger.runtime.change_texts import parsed
from fsar_ledger.runtime.handlers.public import PublicCommand
from fsar_ledger.runtime.handlers.recovery import ReportFailure
from fsar_ledger.runtime.handlers.supervision import RespondToCall
from fsar_ledger.runtime.handlers.task import SubmitTask
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.live import commands_of, live_started
from fsar_ledger.runtime.ports import LiveEnvironment
from fsar_ledger.runtime.recipes import with_changes
from fsar_ledger.runtime.simulation import fleet_founding
from tests.quick import few
from tests.runtime.test_live import STEPS, A, B, C, Play, S, done
from tests.runtime.test_live_forks import again
from tests.sure import known


def busy(seed: int) -> Play:
    """A fleet with some tasks, in which each robot and supervisor says at random what it is asked."""
    draw, play, tasks = random.Random(seed), Play(), 0
    for _ in range(120):
        asked = list(answers(play, draw))
        if tasks < 6 and draw.random() < 0.2:
            tasks, who = tasks + 1, draw.choice((A, C))
            steps = STEPS if who == A else ("C navigate.indoor", "C door.open.secure B", "C inspect.visual")
            play.does(SubmitTask(robot=who, task_id=f"t{tasks}", steps=steps, budget_us=600 * S))
        elif draw.random() < 0.1:
            outcome = draw.choice((None, "deny"))
            play.give(ReportWindow(robot=draw.choice((A, B)), scope="local", window="w", outcome=outcome))  # type: ignore[arg-type]
        elif asked:
            play.give(draw.choice(asked))
        else:
            play.wait(3)
    return play.wait(2_000)


def answers(play: Play, draw: random.Random) -> Iterator[PublicCommand]:
    """What could be said now."""
    state = play.run.kernel.state
    for request in state.request.open.values():
        if not request.is_over and not request.is_accepted and request.candidates:
            yes = draw.random() < 0.8
            yield JudgeRequest(robot=request.candidates[0], action_id=request.action_id, accepts=yes)
    for action in state.execution.actions.values():
        robot, name, recovery = action.robot, action.action_id, state.recovery.get(action.action_id)
        if action.stage in ("approaching", "queued"):
            yield ReportStart(robot=robot, action_id=name, lasts_us=draw.choice((None, 4 * S)))
        if action.stage == "running":
            cause = draw.choice(("obstruction", "degradation", "rust"))
            yield done(robot, name) if draw.random() < 0.7 else ReportFailure(robot=robot, action_id=name, cause=cause)
        if recovery is not None and recovery.level == "local":
            yield ReportAttempt(robot=robot, action_id=name, succeeded=draw.random() < 0.4)
        if recovery is not None and recovery.awaited is not None:
            yield JudgeAssistance(robot=recovery.awaited, action_id=name, accepts=draw.random() < 0.6)
        elif recovery is not None and recovery.tried:
            yield ReportAssistance(robot=recovery.tried[-1], action_id=name, succeeded=draw.random() < 0.6)
    for call in state.supervision.calls.values():
        yield RespondToCall(supervisor=call.supervisor, action_id=call.subject.action_id, approves=True)


@pytest.mark.parametrize("seed", few(range(1, 20), [1, 2], range(4, 20, 2)))
def test_a_fork_is_the_run_of_its_own_commands_blames_nobody_and_with_the_model_it_is_whole(seed: int) -> None:
    base = again(busy(seed))
    record = base.base.record
    assert base.fork(()).record.events[1:] == record.events[1:]
    draw, names = random.Random(seed), list(base.base.facts_by_name)
    refused = {
        record.events[known(cause)]
        for event, cause in zip(record.events, record.caused_by, strict=True)
        if isinstance(event, CommandRejected)
    }
    ends = 0
    for text in (
        *(f"drop {draw.choice(names)}" for _ in range(3)),
        *(f"rule local deny robot={draw.choice('ABC')}1 from {draw.randrange(60)}s" for _ in range(3)),
        "density all 2",
        "set outages.answer_s=2",
        "set structure.local_attempts=0",
    ):
        fork, whole = base.fork(parsed([text])), base.fork(parsed([text, "answer * model:3"]))
        ends += fork.end is not None
        assert whole.end is None, text
        for one in (fork, whole):
            for event, cause in zip(one.record.events, one.record.caused_by, strict=True):
                if isinstance(event, CommandRejected) and cause:
                    assert one.record.events[cause] in refused, (text, event)
            if not text.startswith(("drop", "set outages")):
                assert unanswered(one.record) <= unanswered(record), text
        constants = with_changes(base.base.recipe, parsed([text])).constants
        made = played(constants, fork.record)
        count = len(fork.record.events)
        assert made.events[1:count] == fork.record.events[1:], text
        assert made.times_us[:count] == fork.record.times_us
    assert ends, "some forks end where nobody answers"


def unanswered(record: LedgerRun) -> set[tuple[str, str]]:
    """Which robots were asked in vain, by request."""
    events = (event for event in record.events if isinstance(event, RequestUnanswered))
    pairs = ((event.subject.action_id, event.principals.executed_by) for event in events)
    return {(action, robot) for action, robot in pairs if robot is not None}


def played(constants: Constants, record: LedgerRun) -> Kernel:
    """The live run with the commands of this record, and no change at all."""
    events, founded = fleet_founding(4, constants)
    started = live_started(constants, 4, "2026-03-01T10:00:00Z")
    one = Kernel(FSAR, LiveEnvironment(commands_of(record)), (started, *events), founded)
    one.run(record.times_us[-1])
    return one
