"""Replay of runs that cannot be checked, of content that nobody thought of, and by the command."""

import json
import shutil
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fsar_ledger import federate, record
from fsar_ledger.designs.constants import Constants, Range, Structure, WorldConstants
from fsar_ledger.events import CONCERNS, Event
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.events.envelope import Architecture, Robot
from fsar_ledger.events.world import RoutineDue
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.runtime.replay import NOT_REPLAYED, ReplayReport, replay, replay_commit
from fsar_ledger.runtime.run_replay import replay_run
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from tests import past
from tests.cli.conftest import Call, call, one_message  # noqa: F401
from tests.quick import few
from tests.runtime.commanded import commanded
from tests.runtime.forgeries import FORGERIES, HONEST, LATE, added, changed, renamed
from tests.runtime.test_replay import CONSTANTS, committed
from tests.sure import known

# --- runs that cannot be checked, and content that nobody thought of ---


def restarted(record: LedgerRun = HONEST, /, **fields: Any) -> LedgerRun:
    """The run, with other parameters in its first event and the name that they give it."""
    return renamed(changed(record, 0, msgspec.structs.replace(record.events[0], **fields)))


def parameters(constants: Constants) -> str:
    return msgspec.json.encode(constants, order="deterministic").decode()


UNCHECKED = {
    "a live run": (restarted(kind="live", scenario=None), "kind", "commands are not stored"),
    "a simulated run of no scenario": (restarted(scenario=None), None, "Expected `str`, got `null` - at `$.scenario`"),
    "a scenario of somebody else's": (
        restarted(scenario="my-hall"),
        None,
        "scenario: found my-hall, expected some of door-relay",
    ),
    "a run without a seed": (restarted(seed=None), None, "got `null` - at `$.seed`"),
    "another observation": (
        restarted(observes=tuple(one for one in CONCERNS if one != "command")),
        "observes",
        "'world'), so the run cannot be replayed",
    ),
    "another model": (restarted(model_version="0"), "model_version", "'0', so the run cannot be replayed"),
    "an impossible fleet": (restarted(fleet_size=10**12), None, "fleet size: found 1000000000000"),
    "a baseline without a mechanism": (
        restarted(architecture="cfc", configuration="without-trust-evaluation"),
        None,
        "cfc",
    ),
    "no constants": (restarted(parameters="no JSON"), "parameters", "malformed"),
    "not all constants": (restarted(parameters="{}"), "parameters", "'{}' without structure.assistance_us, "),
    "all constants but one": (
        restarted(parameters=parameters(CONSTANTS).replace('"back_off_us":7000000,', "")),
        "parameters",
        " without structure.back_off_us, so the run cannot be replayed",
    ),
    "constants in nests": (restarted(parameters="[" * 100_000), "parameters", "Expected `object`"),
    "another name": (LedgerRun("run", HONEST.times_us, HONEST.caused_by, HONEST.events), "run_id", "'run'"),
    "no beginning": (LedgerRun("run", HONEST.times_us[:1], [None], HONEST.events[1:2]), "type", "RobotJoined.v1"),
}


@pytest.mark.parametrize("name", few(UNCHECKED, ["another model", "not all constants", "another name", "no beginning"]))
def test_a_run_that_cannot_be_replayed_is_a_doubt_and_says_why(tmp_path: Path, name: str) -> None:
    record, field, found = UNCHECKED[name]
    report = replay(committed(tmp_path / "ledger", record))
    assert not report.ok
    [difference] = report.differences
    assert (difference.commit, difference.run, difference.seq, difference.field) == (0, record.run_id, 0, field)
    assert found in difference.actual


ODD_FACTS: dict[str, Event] = {
    "an unknown robot": RoutineDue(Robot("robot/Z9"), "sensing"),
    "a step that is none": past.arrived("odd", Robot("robot/A1"), ("nonsense",), budget_us=10, due_us=10),
    "a step of an unknown robot": past.arrived(
        "odd", Robot("robot/A1"), ("Z navigate.indoor",), budget_us=10, due_us=10
    ),
    "a capability without a duration": past.arrived(
        "odd", Robot("robot/A1"), ("A fly",), budget_us=10**9, due_us=LATE + 10**9
    ),
}


@pytest.mark.parametrize("name", list(ODD_FACTS))
def test_facts_that_no_handler_can_decide_on_are_a_finding_with_its_place(tmp_path: Path, name: str) -> None:
    forged = added(HONEST, len(HONEST.events), ODD_FACTS[name], LATE, 0)
    [difference] = replay(committed(tmp_path / "ledger", forged)).differences
    assert (difference.commit, difference.run) == (0, HONEST.run_id)
    assert difference.seq is not None
    assert difference.seq >= len(HONEST.events)


@pytest.mark.parametrize(
    ("architecture", "constants"),
    [
        *(
            (architecture, Constants(WorldConstants(message=Range(-1e12, -1e11))))
            for architecture in PAPER_ARCHITECTURES
        ),
        *(
            (architecture, Constants(WorldConstants(message=Range(1e300, 1e308))))
            for architecture in PAPER_ARCHITECTURES
        ),
        ("fsar", Constants(WorldConstants(durations=()))),
        ("cfc", Constants(structure=Structure(sync_period_us=0))),
        ("cfc", Constants(structure=Structure(sync_period_us=1))),
        ("dhma", Constants(structure=Structure(snapshot_period_us=1, back_off_us=-5))),
    ],
)
def test_odd_constants_end_in_a_finding_and_not_in_a_hang(architecture: Architecture, constants: Constants) -> None:
    record = simulate_run(RunSpec(5, architecture, "full", "failure-recovery-chain", 4, 0), CONSTANTS)
    difference = known(replay_run(restarted(record, parameters=parameters(constants))))
    assert difference.seq is not None
    assert 0 <= difference.seq < len(record.events)


def test_a_segment_that_cannot_be_read_is_a_finding(tmp_path: Path) -> None:
    report = replay_commit(str(committed(tmp_path / "ledger", HONEST)), 0, ("segments/000000000001.parquet",))
    assert [(one.commit, one.segment, one.run) for one in report.differences] == [
        (0, "segments/000000000001.parquet", None)
    ]
    assert not report.ok


def test_a_run_in_the_journal_is_said_to_be_there(tmp_path: Path) -> None:
    forged = FORGERIES["no supervisor is named"].run
    with Writer(tmp_path / "ledger", "test") as writer:
        writer.add([forged])
    [difference] = replay(tmp_path / "ledger").differences
    assert (difference.segment, difference.run) == ("journal.jsonl", forged.run_id)


def test_a_run_between_whose_commits_another_was_recorded_replays(tmp_path: Path) -> None:
    task: dict[str, Any] = {"robot": "robot/A1", "task_id": "t", "steps": ("A navigate.indoor",), "budget_us": 1 << 30}
    with federate(tmp_path / "ledger", run="day", clock=lambda: 1_772_359_200 * 10**9) as one:
        one.give("SubmitTask", "robot/A1", **task)
        with record(tmp_path / "ledger", run="beside", observes=["ExecutionStarted"]):
            one.give("ReportStart", "robot/A1", robot="robot/A1", action_id="t/1.1")
    report = replay(tmp_path / "ledger")
    assert (report.differences, report.runs, report.recordings) == ((), 1, 1)


# --- the command ---


def test_verify_with_replay_says_what_was_replayed(call: Call, tmp_path: Path) -> None:  # noqa: F811
    path = committed(tmp_path / "ledger", HONEST)
    called = call("verify", path, "--replay").good()
    assert called.out.endswith(
        f"replayed: all {len(HONEST.events)} events of 1 run are as the world and the handlers make them\n"
    )
    answer = json.loads(call("verify", path, "--replay", "--json").out)
    assert (answer["ok"], answer["replay"]["ok"], answer["replay"]["events"]) == (True, True, len(HONEST.events))
    assert "replay" not in json.loads(call("verify", path, "--json").out)


def test_a_recording_is_counted_as_not_replayed_and_no_doubt(call: Call, tmp_path: Path) -> None:  # noqa: F811
    with record(tmp_path / "ledger", run="day", observes=["ExecutionStarted"]) as recorder:
        recorder.event("ExecutionStarted", task_id="t", action_id="t/1", robot="robot/a", capability="carry")
    called = call("verify", tmp_path / "ledger", "--replay").good()
    assert called.out.splitlines()[-2:] == [
        "not replayed: 1 recording of what other systems did and decided",
        "replayed: nothing; the ledger holds no other run",
    ]
    answer = json.loads(call("verify", tmp_path / "ledger", "--replay", "--json").out)
    assert (answer["ok"], answer["replay"]["runs"], answer["replay"]["recordings"]) == (True, 0, 1)


def test_a_forged_decision_ends_the_command_with_3(call: Call, tmp_path: Path) -> None:  # noqa: F811
    forgery = FORGERIES["no supervisor is named"]
    path = committed(tmp_path / "ledger", forgery.run)
    assert call("verify", path).code == 0
    called = call("verify", path, "--replay")
    assert (called.code, called.out) == (3, "")
    for part in (
        f"segments/{0:012}-{len(forgery.run.events):012}.parquet",
        "commit 0",
        HONEST.run_id,
        f"seq {forgery.seq}",
        "field supervised_by",
        "found None",
        "fsar.execution.start",
    ):
        assert part in called.err
    assert "Traceback" not in called.err
    called = call("verify", path, "--replay", "--json")
    answer = json.loads(called.out)
    assert (called.code, answer["ok"], answer["problems"], answer["replay"]["ok"]) == (3, False, [], False)
    assert answer["replay"]["differences"][0]["handler"] == "architectures.fsar.execution.start"


def test_commands_given_from_outside_cannot_be_replayed_and_end_with_3(call: Call, tmp_path: Path) -> None:  # noqa: F811
    live = commanded()
    started = msgspec.structs.replace(live.events[0], kind="live", scenario=None)
    record = renamed(LedgerRun("", live.times_us, live.caused_by, [started, *live.events[1:]]))
    called = call("verify", committed(tmp_path / "ledger", record), "--replay")
    assert called.code == 3
    assert "a live run, whose commands are not stored, so the run cannot be replayed" in called.err


def test_a_ledger_that_does_not_verify_is_not_replayed(call: Call, tmp_path: Path) -> None:  # noqa: F811
    path = committed(tmp_path / "ledger", HONEST)
    shutil.copy(path / "ledger.json", path / "stray.json")
    called = call("verify", path, "--replay")
    assert called.code == 3
    assert "stray.json" in called.err
    assert "not replayed" in called.err
    answer = json.loads(call("verify", path, "--replay", "--json").out)
    assert (answer["ok"], msgspec.convert(answer["replay"], ReplayReport)) == (False, NOT_REPLAYED)
