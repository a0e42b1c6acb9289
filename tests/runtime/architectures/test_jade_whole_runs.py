"""JADE in every scenario: tasks end, runs replay, and every command about a run answers."""

from pathlib import Path
from typing import Any

import pytest

from fsar_ledger.designs.constants import Constants, Outages
from fsar_ledger.designs.dials import Jade
from fsar_ledger.events.envelope import flat
from fsar_ledger.events.task import StepBegan, TaskAbandoned, TaskCompleted
from fsar_ledger.events.world import ContextChanged, OutsiderRequestInjected, TaskArrived
from fsar_ledger.projections.fold import fold
from fsar_ledger.runtime.run_replay import replay_run
from fsar_ledger.runtime.simulation import SCENARIOS, RunSpec, simulate_run
from tests.foreign.verbs import ask
from tests.runtime.architectures.jade_runs import TASK, A, S, ran, scenario
from tests.runtime.live import of
from tests.runtime.physics import MIXED


@pytest.mark.parametrize("outages", [None, MIXED])
@pytest.mark.parametrize("size", [4, 16])
@pytest.mark.parametrize("name", SCENARIOS)
def test_every_task_of_every_scenario_ends(name: str, size: int, outages: Outages | None) -> None:
    found = scenario(name, size, outages)
    arrived = {event.task_id for event in found if isinstance(event, TaskArrived)}
    ended = [event.task_id for event in found if isinstance(event, TaskCompleted | TaskAbandoned)]
    assert sorted(ended) == sorted(arrived)
    assert outages is not None or any(isinstance(event, TaskCompleted) for event in found)


@pytest.mark.parametrize("dials", [{}, {"reply_by_us": 0}, {"subscribes": 1, "lease_us": 3 * S, "permissions": 1}])
def test_runs_replay_under_every_kind_of_dial(dials: dict[str, int]) -> None:
    constants = Constants(outages=MIXED, jade=Jade(**dials))
    for name in SCENARIOS:
        assert replay_run(simulate_run(RunSpec(42, "jade", "full", name, 8, 0), constants)) is None


def test_no_claim_is_left_when_a_run_is_over() -> None:
    for name in SCENARIOS:
        for outages in (None, MIXED):
            assert not any(fold(scenario(name, 4, outages)).authority.claims.values())


def test_the_world_is_that_of_every_architecture() -> None:
    def steps(architecture: str) -> set[Any]:
        found = simulate_run(RunSpec(42, architecture, "full", "door-relay", 4, 0), Constants()).events
        return {event for event in found if isinstance(event, TaskArrived | ContextChanged | OutsiderRequestInjected)}

    assert steps("jade") == steps("fsar")


def test_dials_that_nobody_set_are_not_recorded() -> None:
    begun = scenario("door-relay", 4)[0]
    assert "jade" not in flat(begun)["parameters"]


def test_a_step_is_begun_by_its_robot_alone() -> None:
    run = ran([(S, TASK)])
    assert {event.robot for _, event in of(run, StepBegan)} == {A}


@pytest.fixture(scope="module")
def ledger(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ledger of JADE's runs, in which robots fail and go off."""
    path = tmp_path_factory.mktemp("jade") / "ledger"
    named = ("--architecture", "jade", "--scenario", "failure-recovery-chain", "--runs", "2", "--workers", "1")
    ask("simulate", path, *named, "--seed", "42", "--set", "outages.off_rate_per_s=0.02").good()
    return path


@pytest.mark.slow
def test_a_run_is_told_by_every_command(ledger: Path) -> None:
    assert "replayed: all" in ask("verify", ledger, "--replay").good().out
    log = ask("log", ledger, "--run", "r0001").good().out
    award = next(line for line in log.splitlines() if line.endswith("robot/A1 -> robot/D1          award"))
    assert "robot/D1" in ask("state", ledger, "--run", "r0001", "--at", "30").good().out
    assert "carry.heavy" in ask("explain", ledger, "--run", "r0001").good().out
    explained = ask("explain", ledger, "--run", "r0001", "--request", "A1-1/1.1").good().out
    assert "contract void" in explained
    decided_by = ask("why", ledger, f"r0001:{award.split()[0]}").good().out
    assert "evaluate_proposals on EvaluateProposals" in decided_by
    page = ledger.parent / "page.html"
    ask("view", ledger, "--run", "r0001", "--out", page).good()
    assert page.stat().st_size > 10_000
