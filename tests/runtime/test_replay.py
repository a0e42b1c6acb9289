"""Replay finds what no hash can: a decision that was forged before it was committed.

Every forged run here is appended by the real writer, so that `verify` finds nothing wrong with it.
"""

from collections.abc import Iterator
from functools import wraps
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fsar_ledger.designs.constants import Constants, Range, Structure, WorldConstants
from fsar_ledger.events import Event
from fsar_ledger.events.configuration import CONFIGURATIONS, PAPER_ARCHITECTURES, Configuration
from fsar_ledger.events.envelope import Architecture, Robot, flat, with_columns
from fsar_ledger.events.trust import TrustSet
from fsar_ledger.events.world import ContextChanged, WorldEvent
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.verify import verify
from fsar_ledger.projections.fold import State
from fsar_ledger.runtime.architectures import HandlerTable
from fsar_ledger.runtime.architectures.fsar import FSAR
from fsar_ledger.runtime.architectures.fsar.request import EvaluateRequest
from fsar_ledger.runtime.experiment import ORIGIN, Experiment, run_experiment, workflow_experiment
from fsar_ledger.runtime.handlers.commands import Command, Decide
from fsar_ledger.runtime.knockouts import KNOCKOUTS, Knockout
from fsar_ledger.runtime.replay import ReplayReport, replay
from fsar_ledger.runtime.run_replay import replay_run
from fsar_ledger.runtime.simulation import SCENARIOS, RunSpec, handler_table_of, simulate_run
from tests import past
from tests.cli.conftest import Call, call, one_message  # noqa: F401
from tests.ledger.forgery import segment_at
from tests.ledger.hostile import stage_anything
from tests.quick import few
from tests.runtime import governed
from tests.runtime.forgeries import FORGERIES, HONEST, added, changed, dropped, renamed, seq_of
from tests.sure import known

CONSTANTS = Constants()
ABLATIONS: tuple[Configuration, ...] = CONFIGURATIONS[1:]
DECIDED = [seq for seq, event in enumerate(HONEST.events) if HONEST.times_us[seq] and not isinstance(event, WorldEvent)]


def committed(path: Path, *runs: LedgerRun) -> Path:
    """A ledger of one commit with these runs, which verifies."""
    with Writer(path, ORIGIN) as writer:
        writer.append(stage_anything(path, runs))
    assert verify(path).ok
    return path


# --- honest ledgers ---

EXPERIMENTS = {
    "every architecture": Experiment(PAPER_ARCHITECTURES, SCENARIOS, runs=3, seed=11),
    "every ablation": Experiment(("fsar",), SCENARIOS, runs=2, seed=12, configurations=ABLATIONS),
    "the workflows": workflow_experiment(seed=13, runs=2),
    "a larger fleet": Experiment(PAPER_ARCHITECTURES, ("fleet-contention",), runs=1, seed=14, fleet_size=8),
    "another world": Experiment(
        PAPER_ARCHITECTURES,
        ("door-relay",),
        1,
        15,
        constants=Constants(WorldConstants(message=Range(0.1, 0.2)), Structure(local_attempts=3)),
    ),
}


@pytest.mark.parametrize("name", few(EXPERIMENTS, ["every architecture", "another world"]))
def test_an_honest_ledger_is_as_the_handlers_decide(tmp_path: Path, name: str) -> None:
    experiment = EXPERIMENTS[name]
    head = run_experiment(tmp_path / "ledger", experiment, workers=1).head
    expected = ReplayReport(True, (), head.commits, len(list(experiment.specs())), head.size - 1)
    report = replay(tmp_path / "ledger")
    assert msgspec.structs.replace(report, remarks=()) == expected
    assert bool(report.remarks) == (experiment.constants != CONSTANTS)


@pytest.mark.slow
def test_workers_find_the_same_in_the_same_order_and_progress_is_told(tmp_path: Path) -> None:
    forged = [
        renamed(dropped(simulate_run(RunSpec(5, "cfc", "full", "door-relay", 4, run), CONSTANTS), 100 + run))
        for run in range(3)
    ]
    with Writer(tmp_path / "ledger", ORIGIN) as writer:
        for run in (HONEST, *forged):
            writer.append(stage(tmp_path / "ledger", [run]))
    told: list[tuple[int, int]] = []
    report = replay(tmp_path / "ledger", workers=2, progress=lambda done, total: told.append((done, total)))
    assert told == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert report == replay(tmp_path / "ledger")
    assert [(one.commit, one.segment, one.run) for one in report.differences] == [
        (at, f"segments/{segment_at(tmp_path / 'ledger', at).name}", run.run_id)
        for at, run in enumerate(forged, start=1)
    ]
    assert (report.commits, report.runs, report.events) == (1, 1, len(HONEST.events))
    assert replay(tmp_path / "ledger", commits=1).ok


# --- forged decisions ---


@pytest.mark.parametrize("name", few(FORGERIES, [*FORGERIES][::4]))
def test_a_forged_run_that_verifies_is_found_by_replay(tmp_path: Path, name: str) -> None:
    forgery = FORGERIES[name]
    [difference] = replay(committed(tmp_path / "ledger", forgery.run)).differences
    found = (difference.commit, difference.segment, difference.run, difference.seq, difference.field)
    assert found == (
        0,
        f"segments/{segment_at(tmp_path / 'ledger', 0).name}",
        HONEST.run_id,
        forgery.seq,
        forgery.field,
    ), difference
    assert (difference.handler or "none").endswith(forgery.handler or "none"), difference


def test_every_decision_that_is_left_out_is_missed_at_its_place() -> None:
    for seq in DECIDED[::5]:
        difference = known(replay_run(dropped(HONEST, seq)))
        assert difference.seq == seq
        assert difference.handler


def test_every_decision_that_comes_a_microsecond_later_is_named() -> None:
    for seq in DECIDED[::5]:
        difference = known(replay_run(changed(HONEST, seq, time_us=HONEST.times_us[seq] + 1)))
        assert (difference.seq, difference.field, difference.expected) == (seq, "time_us", str(HONEST.times_us[seq]))


def test_every_field_of_every_decision_counts() -> None:
    others: dict[type, Any] = {str: "another", int: 7_777_777, bool: None, tuple: ("another",), type(None): "another"}
    tried = set()
    for seq in DECIDED:
        event = HONEST.events[seq]
        for name, value in flat(event).items():
            if (type(event), name) not in tried:
                tried.add((type(event), name))
                other = with_columns(event, **{name: others[type(value)]})
                difference = known(replay_run(changed(HONEST, seq, other)))
                assert (difference.seq, difference.field) == (seq, name)
    assert len(tried) > 150


# --- facts of the world: more in test_invented_world.py ---


def test_a_fact_of_the_world_that_is_left_out_with_all_that_follows_from_it_is_missed() -> None:
    assert isinstance(HONEST.events[-1], ContextChanged)
    difference = known(replay_run(dropped(HONEST, len(HONEST.events) - 1)))
    assert (difference.seq, difference.field) == (len(HONEST.events) - 1, "type")
    assert difference.actual == "the end of the run"
    assert difference.expected.startswith(f"ContextChanged.v1 at {HONEST.times_us[-1]} microseconds")


def test_facts_of_the_world_out_of_their_order_in_time_are_found() -> None:
    forged = added(HONEST, len(HONEST.events), ContextChanged(Robot("robot/A1")), 5, 0)
    difference = known(replay_run(forged))
    assert (difference.seq, difference.field, difference.expected) == (len(HONEST.events), "type", "the end of the run")
    assert difference.actual.startswith("ContextChanged.v1 at 5 microseconds")


# --- other handlers ---


def nothing(_state: State, _command: Command) -> tuple[Event, ...]:
    return ()


def nothing_of(kind: type[Command]) -> Decide:
    """A handler of such commands that never makes anything."""

    def decide(_state: State, command: Command) -> tuple[Event, ...]:
        assert isinstance(command, kind)
        return ()

    return decide


def name_of(structure: HandlerTable, command: type[Command]) -> str:
    decide = structure.decides[command]
    return f"{decide.__module__}.{decide.__qualname__}".removeprefix("fsar_ledger.runtime.")


@pytest.mark.parametrize("architecture", PAPER_ARCHITECTURES)
def test_whichever_handler_is_silenced_replay_names_that_handler(
    monkeypatch: pytest.MonkeyPatch, architecture: Architecture
) -> None:
    decides: dict[Any, Any] = handler_table_of(architecture).decides
    silenced = set()
    for scenario in ("failure-recovery-chain", "mixed-trust-inspection"):
        honest = simulate_run(RunSpec(5, architecture, "full", scenario, 4, 0), CONSTANTS)
        for command, decide in list(decides.items()):
            with monkeypatch.context() as patch:
                patch.setitem(decides, command, wraps(decide)(nothing_of(command)))
                difference = replay_run(honest)
            if difference is not None:
                assert difference.expected == "nothing"
                assert difference.handler == name_of(handler_table_of(architecture), command)
                silenced.add(command)
    assert len(silenced) >= 18


def without_saying_so(switch: Knockout) -> Iterator[str | None]:
    """The handler of the first difference of each run that lacks the mechanism and claims to be in full."""
    for spec in (
        RunSpec(5, switch.architecture, "full", scenario, 4, run) for scenario in SCENARIOS for run in range(3)
    ):
        difference = replay_run(
            simulate_run(spec, CONSTANTS, handler_table_of(switch.architecture, switch.configuration))
        )
        if difference is not None:
            yield difference.handler


@pytest.mark.parametrize(
    "switch", [switch for switch in KNOCKOUTS if switch.decides and not switch.change], ids=lambda switch: switch.name
)
def test_a_fleet_without_one_mechanism_is_not_taken_for_a_whole_one(switch: Knockout) -> None:
    handlers = set(without_saying_so(switch))
    assert handlers
    assert handlers <= {name_of(handler_table_of(switch.architecture), command) for command in switch.decides}


@pytest.mark.parametrize("switch", [switch for switch in KNOCKOUTS if switch.change], ids=lambda switch: switch.name)
def test_a_fleet_with_another_handler_table_is_not_taken_for_a_whole_one(switch: Knockout) -> None:
    assert any(True for _ in without_saying_so(switch))


@pytest.mark.parametrize("switch", KNOCKOUTS, ids=lambda switch: switch.name)
def test_a_fleet_that_names_the_mechanism_it_is_without_is_played_again_without_it(switch: Knockout) -> None:
    spec = RunSpec(5, switch.architecture, switch.configuration, "mixed-trust-inspection", 4, 0)
    assert replay_run(simulate_run(spec, CONSTANTS)) is None


def test_a_handler_that_was_changed_since_decides_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    assert replay_run(HONEST) is None
    decides: dict[Any, Any] = FSAR.decides
    monkeypatch.setitem(decides, EvaluateRequest, nothing)
    difference = known(replay_run(HONEST))
    assert difference.seq == FORGERIES["an execution without admission"].seq
    assert difference.handler == "tests.runtime.test_replay.nothing"


def test_a_decision_from_outside_is_not_a_fact_of_the_world() -> None:
    one = governed.governed("door-relay", (30_000_000, past.trusted(Robot("robot/A1"), Robot("robot/C1"), "task")))
    difference = known(replay_run(governed.record(one)))
    assert (difference.seq, difference.field) == (seq_of(TrustSet, 50, governed.record(one)), "type")
    assert difference.actual == "TrustSet.v1 at 30000000 microseconds"
