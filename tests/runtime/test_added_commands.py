"""Commands that a change adds to a simulated run: decided as if the scenario had given them."""

import msgspec
import pytest

from fsar_ledger.base.errors import UsageError
from fsar_ledger.designs import OutsideCommand
from fsar_ledger.events.command import CommandGiven
from fsar_ledger.events.configuration import ARCHITECTURES
from fsar_ledger.events.envelope import FLEET_SUPERVISOR
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.events.task import TaskCompleted
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.rows.runs import parts_at
from fsar_ledger.runtime.change_texts import parsed
from fsar_ledger.runtime.forks import Fork, fork
from fsar_ledger.runtime.handlers.fleet import LeaveFleet
from fsar_ledger.runtime.handlers.public import PublicCommand, command_record, commands, given_in_file, speaker
from fsar_ledger.runtime.recipes import recorded_recipe
from fsar_ledger.runtime.run_replay import replay_run
from fsar_ledger.runtime.simulation import handler_table_of
from tests.runtime.commanded import COMMANDS
from tests.runtime.live import of
from tests.runtime.test_replay_refused import restarted
from tests.runtime.test_scenario_commands import REPORTS, ran, scheduled


def with_commands(record: LedgerRun, *outside: OutsideCommand, more: tuple[str, ...] = ()) -> Fork:
    """The run to which these commands come, too, each by a change."""
    texts = []
    for one in outside:
        fields = msgspec.json.decode(given_in_file(one.command, one.by, one.parameters).parameters)
        texts.append(
            f"add {one.at_s}s {msgspec.json.encode({'command': one.command, 'by': one.by, **fields}).decode()}"
        )
    started = record.events[0]
    assert isinstance(started, RunStarted)
    return fork(recorded_recipe(started, len(record.events)), record, "0" * 64, parsed([*more, *texts]))


def test_a_command_that_a_change_adds_is_decided_as_one_of_the_scenario() -> None:
    several = [
        command_record(one, speaker(one) or FLEET_SUPERVISOR) for _, one in COMMANDS if isinstance(one, PublicCommand)
    ]
    outside = [(one.command, f"{one.issued_by}", one.parameters) for one in several]
    outside += [(name, by, msgspec.json.encode(fields).decode()) for name, by, fields in REPORTS]
    given_at = [OutsideCommand(1.5 + 1.25 * number, *one) for number, one in enumerate(outside)]
    assert {one.command for one in given_at} == set(commands())
    added = with_commands(ran(scheduled()), *given_at)
    assert parts_at(added.record, ran(scheduled(*given_at))) is None
    assert len(of(added.record, CommandGiven)) == len(given_at)
    assert replay_run(added.record) is None
    assert replay_run(added.record, is_recorded=True) is None


WORK = OutsideCommand(
    20.0,
    "SubmitTask",
    "service/desk",
    '{"robot":"robot/C1","task_id":"round","steps":["C navigate.indoor"],"budget_us":60000000}',
)
LEAVE = OutsideCommand(20.0, "LeaveFleet", "robot/D1", '{"robot":"robot/D1"}')


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_every_architecture_takes_work_that_a_change_adds(architecture: str) -> None:
    added = with_commands(ran(scheduled(), architecture), WORK)
    assert parts_at(added.record, ran(scheduled(WORK), architecture)) is None
    assert "round" in [one.task_id for _, one in of(added.record, TaskCompleted)]
    assert replay_run(added.record) is None


WITHOUT_MEMBERSHIP = [one for one in ARCHITECTURES if LeaveFleet not in handler_table_of(one).decides]


@pytest.mark.parametrize("architecture", WITHOUT_MEMBERSHIP)
def test_what_an_architecture_does_not_decide_is_refused_before_the_run(
    architecture: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    records = ran(scheduled(), architecture), ran(scheduled())
    monkeypatch.setattr("fsar_ledger.runtime.kernel.Kernel.run", None)
    for record, more in zip(records, ((), (f"architecture {architecture}",)), strict=True):
        with pytest.raises(UsageError) as refused:
            with_commands(record, LEAVE, more=more)
        _, said, expected = str(refused.value).partition(f"{architecture} decides no LeaveFleet, expected one of ")
        assert said
        assert {"RespondToCall", "SetSupervisionDensity", "SubmitTask"} < {*expected.split(", ")}


def test_a_record_that_says_otherwise_which_command_was_added_is_found() -> None:
    record = with_commands(ran(scheduled()), LEAVE).record
    started = record.events[0]
    assert isinstance(started, RunStarted)
    assert started.changes is not None
    for changes in ((started.changes[0].replace("20s", "21s"),), (started.changes[0].replace("D1", "C1"),), ()):
        assert replay_run(restarted(record, changes=changes)) is not None
    cfc = with_commands(ran(scheduled(), "cfc"), WORK).record
    difference = replay_run(restarted(cfc, changes=started.changes))
    assert difference is not None
    assert "cfc decides no LeaveFleet" in str(difference)


def test_text_within_a_command_is_its_own() -> None:
    fields = '"issued_by":"supervisor/fleet","robot":null,"review_every":1,"reason":"a visit instead of rest"'
    said = f'add 20s {{"command":"SetSupervisionDensity","by":"supervisor/fleet",{fields}}}'
    [change] = parsed([said])
    assert str(change) == said
    assert parsed([str(change)]) == (change,)
