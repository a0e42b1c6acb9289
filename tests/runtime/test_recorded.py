"""The recorded environment: a run is made again from its events alone, whatever world it was in."""

from functools import partial
from pathlib import Path

import pytest

from fsar_ledger.designs.constants import Constants, Outages
from fsar_ledger.events.configuration import CONFIGURATIONS, PAPER_ARCHITECTURES
from fsar_ledger.events.envelope import with_columns
from fsar_ledger.events.execution import ExecutionStarted
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.events.knowledge import FleetRuleLearned
from fsar_ledger.events.request import RequestDenied
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.rows.runs import parts_at
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.projections.fold import fold
from fsar_ledger.runtime.change_texts import parsed
from fsar_ledger.runtime.experiment import ORIGIN, Experiment, workflow_experiment
from fsar_ledger.runtime.forks import fork, record_of
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.recipes import Recipe
from fsar_ledger.runtime.recorded import RecordedKernel, recorded_environment
from fsar_ledger.runtime.run_replay import replay_run
from fsar_ledger.runtime.simulation import (
    SCENARIOS,
    RunSpec,
    environment_of,
    founding_of,
    handler_table_of,
    run_id,
    simulate_run,
)
from fsar_ledger.runtime.world import Draws
from tests.cli.conftest import Call, call, one_message  # noqa: F401
from tests.quick import few
from tests.runtime.forgeries import FORGERIES, HONEST, changed, dropped, seq_of
from tests.runtime.physics import MIXED
from tests.runtime.pinned import PINNED
from tests.runtime.test_replay import DECIDED

CONSTANTS = Constants()
EXPERIMENTS = {
    "every architecture": Experiment(PAPER_ARCHITECTURES, SCENARIOS, runs=2, seed=11),
    "every ablation": Experiment(("fsar",), SCENARIOS, runs=1, seed=12, configurations=CONFIGURATIONS),
    "the workflows": workflow_experiment(seed=13, runs=2),
    "larger fleets": Experiment(PAPER_ARCHITECTURES, SCENARIOS, runs=1, seed=14, fleet_size=16),
    "robots and links that fail": Experiment(
        PAPER_ARCHITECTURES, SCENARIOS, runs=3, seed=15, constants=Constants(outages=MIXED)
    ),
    "robots off all the time": Experiment(
        PAPER_ARCHITECTURES, SCENARIOS, runs=2, seed=16, constants=Constants(outages=Outages(0.1, 5.0, 0.1, 5.0, 0.05))
    ),
}


def made_from_record(record: LedgerRun) -> LedgerRun:
    """The run that the handlers make in the world on record: no seed, draw or constant of the world is read."""
    started = record.events[0]
    assert isinstance(started, RunStarted)
    assert started.architecture is not None
    table = handler_table_of(started.architecture, started.configuration or "full")
    founding = [event for event, time_us in zip(record.events, record.times_us, strict=True) if time_us == 0]
    environment = recorded_environment(record, table)
    kernel = RecordedKernel(table, environment, founding)
    kernel.later_us = environment.later_us
    kernel.run()
    return record_of(kernel)


@pytest.mark.parametrize("name", few(EXPERIMENTS, ["every architecture", "robots and links that fail"]))
def test_a_run_is_made_again_from_its_events_alone(name: str) -> None:
    experiment = EXPERIMENTS[name]
    for spec in experiment.specs():
        record = simulate_run(spec, experiment.constants)
        assert parts_at(record, made_from_record(record)) is None, record.run_id
        assert replay_run(record, is_recorded=True) is None


@pytest.mark.parametrize("fleet_size", [4, 8, 24])
def test_a_run_begins_in_the_state_that_its_founding_makes(fleet_size: int) -> None:
    """The founding of a fleet is folded once for all its runs."""
    spec = RunSpec(1, "fsar", "full", "door-relay", fleet_size, 0)
    founding, founded = founding_of(spec, CONSTANTS)
    kernel = Kernel(handler_table_of("fsar", "full"), environment_of(spec, CONSTANTS), founding, founded)
    assert kernel.state == fold(founding)


def test_no_draw_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    def drawn(*_: object) -> int:
        raise AssertionError("a draw")

    monkeypatch.setattr(Draws, "answer", drawn)
    with pytest.raises(AssertionError, match="a draw"):
        simulate_run(RunSpec(987_654, "fsar", "full", "door-relay", 4, 0), CONSTANTS)
    assert parts_at(HONEST, made_from_record(HONEST)) is None


def _feigned(change: str, run: int) -> LedgerRun | None:
    """The run in a world with this change, under the head of the run in its own; None if the change reaches nothing."""
    spec = RunSpec(42, "fsar", "full", "door-relay", 4, run)
    base = simulate_run(spec, PINNED)
    found = fork(Recipe(spec, PINNED), base, "0a" * 32, parsed([change])).record
    feigned = LedgerRun(base.run_id, found.times_us, found.caused_by, [base.events[0], *found.events[1:]])
    return None if parts_at(base, feigned) is None else feigned


@pytest.mark.parametrize(
    "change",
    [
        "drop window:fleet/B1/1",
        "answer call:1 deny",
        "answer execution:A1-1/1.1 9s",
        "answer approach:A1-2/2.1 never",
        "set world.obstruction_rate_per_s=0.05 from 20s",
    ],
)
def test_a_run_in_another_world_passes_in_its_own_and_not_in_that_of_its_seed(change: str) -> None:
    feigned = next(one for one in map(partial(_feigned, change), range(12)) if one is not None)
    assert replay_run(feigned, is_recorded=True) is None
    assert replay_run(feigned) is not None


def test_a_fork_with_a_command_of_a_supervisor_passes() -> None:
    spec = RunSpec(42, "fsar", "full", "door-relay", 4, 0)
    base = simulate_run(spec, CONSTANTS)
    changes = parsed(["rule fleet review robot=B1 capability=door.open.basic from 10s", "answer call:1 deny"])
    assert replay_run(fork(Recipe(spec, CONSTANTS), base, "0a" * 32, changes).record, is_recorded=True) is None


OPEN = {
    "an execution starts early": "how long an approach takes is an answer",
    "a refusal is left out": "found, where the fact after it is missed",
    "an execution takes longer": "found, where it ends",
    "a fact of the world is added, without its consequence": "found, where the consequence is missed",
    "a fact of the world is said to have a cause": "found as a fact that does not happen by itself",
}
"""Forgeries that are not found at their place in the world on record, and why."""


@pytest.mark.parametrize("name", FORGERIES)
def test_a_forged_decision_is_found_in_the_world_on_record(name: str) -> None:
    forgery = FORGERIES[name]
    difference = replay_run(forgery.run, is_recorded=True)
    if name == "an execution starts early":
        assert difference is None
        return
    assert difference is not None
    assert name in OPEN or (difference.seq, difference.field) == (forgery.seq, forgery.field)


@pytest.mark.slow
def test_what_is_left_out_or_late_is_missed_unless_the_world_may_have_made_it_so() -> None:
    left_out, late = set(), set()
    for seq in DECIDED[:: 1 if len(DECIDED) < 300 else 2]:
        kind = type(HONEST.events[seq])
        if replay_run(dropped(HONEST, seq), is_recorded=True) is None:
            left_out.add(kind)
        if replay_run(changed(HONEST, seq, time_us=HONEST.times_us[seq] + 1), is_recorded=True) is None:
            late.add(kind)
    assert left_out == {FleetRuleLearned}, "that a robot is told of a rule is a message, which may never arrive"
    assert {FleetRuleLearned, ExecutionStarted} <= late
    assert RequestDenied not in late, "who denies does so when the request arrives"


def test_every_length_counts() -> None:
    seq = seq_of(ExecutionStarted)
    started = HONEST.events[seq]
    assert isinstance(started, ExecutionStarted)
    longer = changed(HONEST, seq, with_columns(started, ends_us=(started.ends_us or 0) + 1))
    assert replay_run(longer, is_recorded=True) is not None


def test_verify_takes_the_world_from_the_ledger_or_from_the_seed(call: Call, tmp_path: Path) -> None:  # noqa: F811
    spec = RunSpec(42, "fsar", "full", "door-relay", 4, 4)  # in which a supervisor is called
    base = simulate_run(spec, PINNED)
    found = fork(Recipe(spec, PINNED), base, "0a" * 32, parsed(["drop window:fleet/B1/1"])).record
    started = base.events[0]
    assert isinstance(started, RunStarted)
    feigned = LedgerRun(run_id(started), found.times_us, found.caused_by, [started, *found.events[1:]])
    ledger = tmp_path / "ledger"
    with Writer(ledger, ORIGIN) as writer:
        writer.append(stage(ledger, [feigned]))
    answer = call("verify", str(ledger), "--replay", "--recorded")
    assert answer.code == 0, answer.err
    assert "as the handlers make them in the recorded world" in answer.out
    assert "this does not show whether that was the world of the seed" in answer.out
    assert call("verify", str(ledger), "--replay").code == 3
    one_message(call("verify", str(ledger), "--recorded"), 2, "--recorded: expected it with --replay")
