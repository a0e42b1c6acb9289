"""Commands that a scenario's file gives: they come at their time, on record, and are decided as it is then."""

from pathlib import Path
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from fsar_ledger.base.errors import InvalidExperiment, UsageError
from fsar_ledger.designs import OutsideCommand, Scenario, Task, registered
from fsar_ledger.designs.constants import Constants, read_constants, write_constants
from fsar_ledger.events.authority import AuthorityGranted, AuthorityRevoked
from fsar_ledger.events.command import CommandGiven, CommandRejected
from fsar_ledger.events.configuration import ARCHITECTURES
from fsar_ledger.events.envelope import FLEET_SUPERVISOR
from fsar_ledger.events.fleet import RobotDeparted, RobotReturned, RunStarted
from fsar_ledger.events.registry import CapabilityAdvertised
from fsar_ledger.events.supervision import SupervisionDensitySet, SupervisorCalled
from fsar_ledger.events.task import TaskCompleted
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.runtime.change_texts import parsed
from fsar_ledger.runtime.experiment import Experiment
from fsar_ledger.runtime.forks import fork
from fsar_ledger.runtime.handlers.public import PublicCommand, command_record, commands, speaker
from fsar_ledger.runtime.own import problems_of_commands, with_own
from fsar_ledger.runtime.recipes import recorded_recipe
from fsar_ledger.runtime.run_replay import replay_run
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from tests.runtime.commanded import COMMANDS
from tests.runtime.live import of
from tests.runtime.test_replay_refused import restarted

S = 1_000_000
FILE = """
name = "visit"

[[tasks]]
owner = "A"
steps = ["A navigate.indoor", "A door.open.secure B", "A carry.package"]
"""
DENSITY = """
[[commands]]
at_s = 1
command = "SetSupervisionDensity"
by = "supervisor/fleet"
issued_by = "supervisor/fleet"
review_every = 1
reason = "a visitor"
"""
OTHERS = """
[[commands]]
at_s = 30.5
command = "UpgradeCapability"
by = "robot/C1"
robot = "robot/C1"
capability = "inspect.visual"
version = "1.1.0"

[[commands]]
at_s = 40
command = "GrantAuthority"
by = "supervisor/fleet"
supervisor = "supervisor/fleet"
requester = "robot/D1"
executor = "robot/B1"
override = "soft-priority"

[[commands]]
at_s = 41
command = "RevokeAuthority"
by = "supervisor/fleet"
supervisor = "supervisor/fleet"
requester = "robot/D1"
executor = "robot/B1"

[[commands]]
at_s = 50
command = "LeaveFleet"
by = "robot/D1"
robot = "robot/D1"

[[commands]]
at_s = 60
command = "JoinFleet"
by = "robot/D1"
robot = "robot/D1"
role = "D"
team = 1
supervisor = "supervisor/D1"
"""

B, H_B = "robot/B1", "supervisor/B1"
ABOUT = {"robot": B, "action_id": "A1-1/2.1"}
REPORTS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("JudgeRequest", B, ABOUT | {"accepts": True}),
    ("JudgeAssistance", B, ABOUT | {"accepts": False}),
    ("ReportStart", B, ABOUT | {"lasts_us": 2 * S}),
    ("ReportFailure", B, ABOUT | {"cause": "hinge jammed"}),
    ("ReportAttempt", B, ABOUT | {"succeeded": True}),
    ("ReportAssistance", B, ABOUT | {"succeeded": True}),
    ("ReportResult", B, {"executor": B, "action_id": "A1-1/2.1", "result": "success"}),
    ("RespondToCall", FLEET_SUPERVISOR, {"supervisor": FLEET_SUPERVISOR, "action_id": "A1-1/2.1", "approves": True}),
    ("ReleaseAuthority", B, {"claimant": B, "action_id": "A1-1/2.1", "dimension": "override"}),
    ("ReportContext", B, {"robot": B}),
    ("ReportWindow", B, {"robot": B, "scope": "local", "window": "quiet", "outcome": "deny"}),
    ("ReportWindow", B, {"robot": B, "scope": "local", "window": "quiet"}),
    ("ReportActuator", B, {"robot": B, "grade": "slipping"}),
    ("ReportActuator", B, {"robot": B}),
    ("ReportShift", H_B, {"supervisor": H_B, "is_on": False}),
    ("ReportShift", H_B, {"supervisor": H_B, "is_on": True}),
    ("HandOver", B, {"robot": B, "isolated_run": "B1", "isolated_seq": 9, "isolated_root": "0" * 64, "since_us": 0}),
    ("ReportPresence", B, {"robot": B, "is_on": False}),
    ("ReportPresence", B, {"robot": B, "is_on": True}),
    ("InstallCapability", B, {"robot": B, "capability": "carry.heavy", "version": "1.0.0"}),
    ("AdvertiseCapability", B, {"robot": B, "capability": "carry.heavy", "version": "1.0.0"}),
    ("ReportAvailability", B, {"robot": B, "availability": "busy", "reason": "cleaning"}),
    ("UpgradeCapability", B, {"robot": B, "capability": "carry.heavy", "version": "1.1.0"}),
    (
        "SetRoleTrust",
        FLEET_SUPERVISOR,
        {"issued_by": FLEET_SUPERVISOR, "role": "B", "peer_role": "C", "scope": "task", "reason": "worked well"},
    ),
)


def written(text: str, tmp_path: Path) -> Constants:
    """The constants with the scenario of this text."""
    file = tmp_path / "visit.toml"
    file.write_text(text)
    return with_own(Constants(), (str(file),))[0]


def ran(constants: Constants, architecture: str = "fsar", run: int = 0) -> LedgerRun:
    assert constants.scenario is not None
    return simulate_run(RunSpec(42, architecture, "full", constants.scenario.name, 4, run), constants)


def scheduled(*outside: OutsideCommand) -> Constants:
    """The constants with a scenario that gives these commands."""
    steps = ("A navigate.indoor", "A door.open.secure B")
    return Constants(scenario=Scenario("visit", (Task("A", steps),), commands=outside))


def test_a_command_comes_at_its_time_on_record_and_is_decided_then(tmp_path: Path) -> None:
    record = ran(written(FILE + DENSITY + OTHERS, tmp_path))
    commanded = [(time_us, one.command, one.issued_by) for time_us, one in of(record, CommandGiven)]
    assert commanded == [
        (1 * S, "SetSupervisionDensity", FLEET_SUPERVISOR),
        (30.5 * S, "UpgradeCapability", "robot/C1"),
        (40 * S, "GrantAuthority", FLEET_SUPERVISOR),
        (41 * S, "RevokeAuthority", FLEET_SUPERVISOR),
        (50 * S, "LeaveFleet", "robot/D1"),
        (60 * S, "JoinFleet", "robot/D1"),
    ]
    [(_, density)] = of(record, SupervisionDensitySet)
    assert (density.robot, density.review_every) == (None, 1)  # a file has no null: what may be null is left out
    assert [time_us // S for time_us, _ in of(record, AuthorityGranted)] == [40]
    assert [time_us // S for time_us, _ in of(record, AuthorityRevoked)] == [41]
    assert [time_us // S for time_us, _ in of(record, RobotDeparted)] == [50]
    assert [time_us // S for time_us, _ in of(record, RobotReturned)] == [60]
    assert ("robot/C1", "1.1.0") in [(one.robot, one.version) for _, one in of(record, CapabilityAdvertised)]
    for number, event in enumerate(record.events):
        if isinstance(event, RobotDeparted):
            cause = record.caused_by[number]
            assert cause is not None
            assert isinstance(record.events[cause], CommandGiven)


def test_a_command_changes_what_is_decided_after_it(tmp_path: Path) -> None:
    reviews = [call for _, call in of(ran(written(FILE + DENSITY, tmp_path)), SupervisorCalled)]
    assert "review" in {call.purpose for call in reviews}
    assert of(ran(written(FILE, tmp_path)), SupervisorCalled) == []
    late = DENSITY.replace("at_s = 1\n", "at_s = 200\n")
    assert of(ran(written(FILE + late, tmp_path)), SupervisorCalled) == []


def test_what_cannot_be_carried_out_is_rejected_on_record_and_so_is_the_word_of_another(tmp_path: Path) -> None:
    wrong = OTHERS.replace('by = "robot/C1"', 'by = "robot/B1"').replace('role = "D"', 'role = "C"')
    record = ran(written(FILE + wrong, tmp_path))
    reasons = {one.command: one.reason for _, one in of(record, CommandRejected)}
    assert reasons == {
        "UpgradeCapability": "robot/B1 speaks for robot/C1, expected its own word",
        "JoinFleet": "role C, expected D: robot/D1 has departed, and its name stays its own",
    }
    assert replay_run(record) is None


def test_every_command_can_be_scheduled_and_such_a_run_replays_in_its_world_and_in_that_of_its_record() -> None:
    several = [
        (time_us, command_record(one, speaker(one) or FLEET_SUPERVISOR))
        for time_us, one in COMMANDS
        if isinstance(one, PublicCommand)
    ]
    outside = [OutsideCommand(time_us / S, one.command, one.issued_by, one.parameters) for time_us, one in several]
    outside += [
        OutsideCommand(12.0 + 2.0 * number, name, by, msgspec.json.encode(fields).decode())
        for number, (name, by, fields) in enumerate(REPORTS)
    ]
    record = ran(scheduled(*outside))
    assert {one.command for _, one in of(record, CommandGiven)} == set(commands())
    assert len(of(record, CommandGiven)) == len(outside)
    assert of(record, RobotDeparted)
    assert {one.command for _, one in of(record, CommandRejected)} < {one.command for one in outside}
    assert replay_run(record) is None
    assert replay_run(record, is_recorded=True) is None


def test_commands_of_one_moment_come_in_the_order_of_the_file(tmp_path: Path) -> None:
    second = DENSITY.replace("review_every = 1", "review_every = 3")
    constants = written(FILE + DENSITY + second, tmp_path)
    sets = [(time_us, one.review_every) for time_us, one in of(ran(constants), SupervisionDensitySet)]
    assert [every for _, every in sets] == [1, 3]
    assert len({time_us for time_us, _ in of(ran(constants), CommandGiven)}) == 2


def test_the_file_is_in_event_0_and_a_scenario_without_commands_is_as_before(tmp_path: Path) -> None:
    constants = written(FILE + DENSITY, tmp_path)
    assert read_constants(write_constants(constants)) == constants
    assert "commands" not in write_constants(written(FILE, tmp_path))


def test_a_record_that_lacks_a_command_of_its_scenario_or_has_another_one_is_found(tmp_path: Path) -> None:
    record = ran(written(FILE + DENSITY, tmp_path))
    for text in (FILE, FILE + DENSITY.replace("review_every = 1", "review_every = 2")):
        difference = replay_run(restarted(record, parameters=write_constants(written(text, tmp_path))))
        assert difference is not None
        assert difference.handler == "world.schedule.schedule"


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_every_architecture_takes_work_from_outside(architecture: str, tmp_path: Path) -> None:
    work = """
    [[commands]]
    at_s = 90
    command = "SubmitTask"
    by = "service/desk"
    robot = "robot/C1"
    task_id = "round"
    steps = ["C navigate.indoor", "C inspect.visual"]
    budget_us = 60_000_000
    """
    record = ran(written(FILE + work, tmp_path), architecture)
    assert "round" in [one.task_id for _, one in of(record, TaskCompleted)]
    assert replay_run(record) is None


def test_an_architecture_that_does_not_decide_a_command_is_named_before_the_run(tmp_path: Path) -> None:
    constants = written(FILE + OTHERS, tmp_path)
    with pytest.raises(InvalidExperiment) as refused:
        Experiment(("fsar", "cfc"), ("visit",), 1, constants=constants)
    assert str(refused.value) == (
        "scenario visit: commands[0].command: found UpgradeCapability, which architecture cfc does not decide, "
        "expected one of RespondToCall, SetSupervisionDensity, SubmitTask, or --architecture fsar, which decides every "
        "command"
    )
    assert Experiment(("fsar",), ("visit",), 1, constants=constants).size == 1


@pytest.mark.parametrize(
    ("now", "then", "found"),
    [
        (
            "review_every",
            "review_evry",
            "13: commands[0].review_evry: found an unknown field, expected one of issued_by,",
        ),
        ("review_every = 1", 'review_every = "1"', '13: commands[0].review_every: found "1", expected a whole number'),
        ('reason = "a visitor"', "", "8: commands[0].reason: found nothing, expected a value"),
        (
            "SetSupervisionDensity",
            "SetSupervisonDensity",
            "10: commands[0].command: found SetSupervisonDensity, expected a command that exists; did you mean SetSup",
        ),
        ('command = "SetSupervisionDensity"\n', "", "8: commands[0].command: found nothing, expected a value"),
        ("at_s = 1\n", "", "8: commands[0].at_s: found nothing, expected a value"),
        ("at_s = 1\n", 'at_s = "1"\n', '9: commands[0].at_s: found "1", expected a number'),
        ("at_s = 1\n", "at_s = -1\n", "9: commands[0].at_s: found -1, expected seconds from 0 to 1800"),
        ("at_s = 1\n", "at_s = nan\n", "9: commands[0].at_s: found nan, expected seconds from 0 to 1800"),
        (
            'by = "supervisor/fleet"',
            'by = "maria"',
            "11: commands[0].by: found maria, expected who gives it, as robot/",
        ),
        ("review_every = 1", "review_every = 0x" + "f" * 5_000, "8: commands[0]: found a whole number of thousands"),
        (
            '"a visitor"',
            '"a\\u0007visitor"',
            r"14: commands[0].reason: found a\x07visitor, expected characters that can be printed",
        ),
        ("review_every = 1", "review_every = 1e999", "commands[0].parameters: found {"),
    ],
)
def test_a_command_that_is_none_is_refused_with_its_line(now: str, then: str, found: str, tmp_path: Path) -> None:
    text = FILE + DENSITY
    assert text.count(now) == 1 or now.startswith("by")
    with pytest.raises(UsageError) as refused:
        written(text.replace(now, then, 1), tmp_path)
    said = str(refused.value)
    assert found in said, said
    assert said.startswith(f"{tmp_path}/visit.toml:")


def test_what_a_robot_would_do_for_a_time_that_nobody_knows_is_refused(tmp_path: Path) -> None:
    install = """
    [[commands]]
    at_s = 1
    command = "InstallCapability"
    by = "robot/C1"
    robot = "robot/C1"
    capability = "sing.aloud"
    version = "1.0.0"
    """
    with pytest.raises(UsageError, match=r"commands\[0\]\.capability: found sing\.aloud, expected one whose length"):
        written(FILE + install, tmp_path)
    assert of(ran(written(FILE + install.replace("sing.aloud", "carry.heavy"), tmp_path)), CommandRejected) == []


def test_commands_that_an_adversary_records_are_a_doubt_and_say_why() -> None:
    constants = scheduled()
    assert constants.scenario is not None
    record = ran(constants)
    for parameters in ("", "[]", "{", '{"robot": 1}', '{"review_every": null}'):
        bad = OutsideCommand(1.0, "SetSupervisionDensity", "supervisor/fleet", parameters)
        scenario = replace(constants.scenario, commands=(bad,))
        assert list(problems_of_commands(scenario, registered.fleet()))
        difference = replay_run(restarted(record, parameters=write_constants(Constants(scenario=scenario))))
        assert difference is not None
        assert "commands[0]" in str(difference)


@pytest.mark.parametrize(
    "change", ["drop command:SetSupervisionDensity/0", "answer command:SetSupervisionDensity/0 review_every=0"]
)
def test_a_run_without_the_command_or_with_another_one_is_made_again(change: str, tmp_path: Path) -> None:
    record = ran(written(FILE + DENSITY, tmp_path))
    started = record.events[0]
    assert isinstance(started, RunStarted)
    other = fork(recorded_recipe(started, len(record.events)), record, "0" * 64, parsed([change]))
    assert of(record, SupervisorCalled)
    assert of(other.record, SupervisorCalled) == []
    assert replay_run(other.record) is None
    assert msgspec.json.encode(other.record.events[0]) != msgspec.json.encode(started)


def test_a_command_that_is_named_says_what_its_name_is_given_and_not_what_a_pattern_is(tmp_path: Path) -> None:
    record = ran(written(FILE + DENSITY, tmp_path))
    started = record.events[0]
    assert isinstance(started, RunStarted)
    base = recorded_recipe(started, len(record.events))
    named, every = (f"answer command:SetSupervisionDensity/{which} review_every={n}" for which, n in ((0, 3), ("*", 0)))
    either = [fork(base, record, "0" * 64, parsed(texts)).record for texts in ([named, every], [every, named])]
    for found in either:
        assert [event.review_every for _, event in of(found, SupervisionDensitySet)] == [3]
        assert replay_run(found) is None
