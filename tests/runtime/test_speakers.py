"""Who speaks in a command of a live run: nobody speaks for another, but for who brings work."""

from typing import Any

import msgspec
import pytest

from fsar_ledger.events.command import CommandGiven, CommandRejected
from fsar_ledger.events.envelope import FLEET_SUPERVISOR
from fsar_ledger.runtime.handlers.public import PublicCommand, commands, speaker
from fsar_ledger.runtime.live import command_given
from fsar_ledger.runtime.run_replay import replay_run
from tests.runtime.test_live import A, B, Play, S, at_the_door

OWN = {"robot": A, "executor": A, "requester": A, "claimant": A, "holder": A}
SUPERVISORS = ("supervisor", "issued_by")
WORK = {"robot": A, "task_id": "w", "steps": ["A navigate.indoor"], "budget_us": 60 * S}
JOIN: dict[str, Any] = {"robot": "robot/E1", "role": "A", "team": 1, "domain": ""}


def said(play: Play, command: str, by: str, **fields: Any) -> str | None:
    play.now_s += 1
    return play.run.give(play.now_s * S, command_given(command, by, fields)).rejected


def given_none(kind: type[PublicCommand]) -> Any:
    nothing: dict[str, Any] = dict.fromkeys(field.name for field in msgspec.structs.fields(kind))
    return kind(**nothing)


def test_in_every_command_it_is_told_who_speaks() -> None:
    for name, kind in commands().items():
        fields = set(kind.__struct_fields__)
        values = {field: "supervisor/A1" if field in SUPERVISORS else OWN.get(field) for field in fields}
        command = msgspec.structs.replace(given_none(kind), **values)
        expected = A if name == "JoinFleet" or not fields & set(SUPERVISORS) else "supervisor/A1"
        if name == "JoinFleet":
            command.issued_by = None
        assert speaker(command) == (None if name == "ConsultRegistry" else expected), name


@pytest.mark.parametrize("by", [B, "supervisor/B1", "service/hub", "auditor/anna", "anna", ""])
def test_the_word_of_another_is_rejected_on_record_and_replays(by: str) -> None:
    play = at_the_door()
    refused = said(play, "ReportContext", by, robot=A)
    assert refused == f"{by} speaks for {A}, expected its own word"
    given, rejected = play.run.kernel.events[-2:]
    assert isinstance(given, CommandGiven)
    assert isinstance(rejected, CommandRejected)
    assert rejected.issued_by == given.issued_by == by
    assert (rejected.command, rejected.subject) == ("ReportContext", by)
    assert replay_run(play.record) is None


@pytest.mark.parametrize(
    ("by", "is_taken"),
    [
        (A, True),
        ("supervisor/A1", True),
        (FLEET_SUPERVISOR, True),
        ("service/hub", True),
        (B, False),
        ("supervisor/B1", False),
        ("auditor/anna", False),
    ],
)
def test_work_comes_from_the_robot_itself_its_supervisors_and_services(by: str, is_taken: bool) -> None:
    assert (said(Play(), "SubmitTask", by, **WORK) is None) is is_taken


def test_a_robot_joins_by_its_own_word_and_nobody_joins_another_but_a_supervisor() -> None:
    play = Play()
    assert said(play, "JoinFleet", A, **JOIN) is not None
    assert said(play, "JoinFleet", "robot/E1", **JOIN, supervisor="supervisor/maria") is not None
    assert said(play, "JoinFleet", "supervisor/fleet", **JOIN, supervisor="supervisor/", issued_by="supervisor/fleet")
    assert said(play, "JoinFleet", "robot/E1", **JOIN) is None
    assert said(play, "JoinFleet", FLEET_SUPERVISOR, **JOIN | {"robot": "robot/F1"}, issued_by=FLEET_SUPERVISOR) is None
    assert said(play, "ReportContext", "robot/E1", robot="robot/E1") is None


def test_a_person_takes_several_robots_by_their_own_word() -> None:
    play, maria = Play(), "supervisor/maria"
    for robot in ("robot/E1", "robot/F1"):
        assert said(play, "JoinFleet", maria, **JOIN | {"robot": robot}, supervisor=maria, issued_by=maria) is None
        assert said(play, "SubmitTask", maria, **WORK | {"robot": robot, "task_id": robot[6:]}) is None
    assert said(play, "SubmitTask", maria, **WORK) is not None
    assert replay_run(play.record) is None


def test_anybody_may_look_into_the_registry() -> None:
    for by in (A, "supervisor/A1", "service/hub"):
        assert said(Play(), "ConsultRegistry", by, query={"requester": A, "capability": "door.open.secure"}) is None


def test_a_robot_looks_into_the_registry_as_nobody_else() -> None:
    of_a = {"requester": A, "capability": "door.open.secure"}
    for copy in ({}, {"cache_holder": B}):
        assert said(Play(), "ConsultRegistry", B, query=of_a, **copy) == f"{B} speaks for {A}, expected its own word"
    assert (
        said(Play(), "ConsultRegistry", A, query=of_a, cache_holder=B) == f"{A} speaks for {B}, expected its own word"
    )


REGISTRY: dict[str, dict[str, Any]] = {
    "AdvertiseCapability": {"version": "1.0.0"},
    "WithdrawCapability": {"reason": "x"},
    "ReportAvailability": {"availability": "offline", "reason": "x"},
    "DeprecateCapability": {"version": "1.0.0"},
    "UpgradeCapability": {"version": "2.0.0"},
    "InstallCapability": {"version": "1.0.0"},
    "RemoveCapability": {},
}
"""The commands about what a robot possesses and advertises, each with its other fields."""


@pytest.mark.parametrize("command", REGISTRY)
def test_nobody_changes_what_a_robot_possesses_or_shows_but_itself_and_who_is_in_charge_of_it(command: str) -> None:
    capability = "weld" if command == "InstallCapability" else "door.open.secure"
    about = {"robot": B, "capability": capability, **REGISTRY[command]}
    for other in (A, "supervisor/A1", "service/hub", "supervisor/stranger"):
        play = Play()
        refused = said(play, command, other, **about, issued_by=other)
        assert refused is not None
        assert isinstance(play.run.kernel.events[-1], CommandRejected)
    for own in (B, "supervisor/B1", FLEET_SUPERVISOR):
        assert said(Play(), command, own, **about, issued_by=own) is None
    assert said(Play(), command, B, **about) is None


def test_a_stranger_joins_nobody() -> None:
    play, stranger = Play(), "supervisor/Z9"
    refused = said(play, "JoinFleet", stranger, **JOIN, issued_by=stranger)
    assert refused is not None
    assert refused.startswith("unknown supervisor supervisor/Z9")
