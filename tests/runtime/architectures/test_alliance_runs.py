"""ALLIANCE in whole runs of every scenario: records, levels, claims, ends, replay, and what the verbs answer."""

from pathlib import Path

import pytest

import fsar_ledger
from fsar_ledger.designs.constants import Constants, Outages
from fsar_ledger.designs.dials import Alliance
from fsar_ledger.events.authority import AuthorityClaimed, AuthorityReleased
from fsar_ledger.events.envelope import Parties, Principals
from fsar_ledger.events.execution import ExecutionFinished, ExecutionStarted
from fsar_ledger.events.recovery import FailureResolved, RecoveryEscalated
from fsar_ledger.events.supervision import SupervisorCalled
from fsar_ledger.events.task import TaskAbandoned, TaskCompleted
from fsar_ledger.events.world import TaskArrived
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.projections.fold import State, apply, fold
from fsar_ledger.projections.motivation import action_of, execution_name
from fsar_ledger.runtime.run_replay import replay_run
from fsar_ledger.runtime.simulation import SCENARIOS, RunSpec, simulate_run
from tests.quick import few

DIALS = Alliance()
MIXED = Outages(0.02, 8.0, 0.03, 6.0, 0.002)


@pytest.fixture(scope="module")
def runs() -> list[LedgerRun]:
    constants = Constants(alliance=DIALS)
    return [
        simulate_run(RunSpec(7, "alliance", "full", scenario, size, run), constants)
        for scenario in SCENARIOS
        for size in (4, 16)
        for run in range(2)
    ]


def test_records_name_the_robot_that_executes_and_neither_requester_nor_supervisor(runs: list[LedgerRun]) -> None:
    named = [one.principals for run in runs for one in run.events if hasattr(one, "principals")]
    assert {one.requested_by for one in named} == {one.supervised_by for one in named} == {None}
    started = [one for run in runs for one in run.events if isinstance(one, ExecutionStarted | ExecutionFinished)]
    assert all(one.principals.executed_by == one.robot for one in started)


def test_every_decision_is_one_robots_own(runs: list[LedgerRun]) -> None:
    made = [one.principals for run in runs for one in run.events if hasattr(one, "principals")]
    decisions = [one for one in made if isinstance(one, Principals)]
    assert {one.path for one in decisions} == {(one.decided_by,) for one in decisions}
    assert all(str(one.decided_by).startswith("robot/") for one in decisions)
    assert any(isinstance(one, Parties) for one in made)


def test_recovery_has_no_fleet_and_no_human_level(runs: list[LedgerRun]) -> None:
    events = [one for run in runs for one in run.events]
    assert {one.level for one in events if isinstance(one, FailureResolved)} == {"local", "peer"}
    assert {one.to_level for one in events if isinstance(one, RecoveryEscalated)} == {"peer"}
    assert not [one for one in events if isinstance(one, SupervisorCalled)]


def test_a_claim_lasts_as_long_as_the_activity(runs: list[LedgerRun]) -> None:
    for run in runs:
        claims = [one for one in run.events if isinstance(one, AuthorityClaimed)]
        ended = [one for one in run.events if isinstance(one, AuthorityReleased)]
        assert len(claims) == len(ended)
        state = fold(run.events)
        assert (state.authority.claims, state.motivation.active) == ({}, {})


def test_no_step_starts_against_the_robots_own_policy_where_it_is_sensed(runs: list[LedgerRun]) -> None:
    for run in runs:
        state, denied = State(), 0
        for event in run.events:
            if isinstance(event, ExecutionStarted):
                denied += bool(state.world.local.get(event.robot))
            apply(state, event)
        assert denied == 0


@pytest.mark.parametrize("outages", [None, MIXED], ids=["whole", "outages"])
@pytest.mark.parametrize("size", few([4, 16], [4]))
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_every_task_ends_and_every_run_is_replayed(scenario: str, size: int, outages: Outages | None) -> None:
    for learns in (0, 1):
        constants = Constants(outages=outages, alliance=Alliance(learns=learns))
        run = simulate_run(RunSpec(11, "alliance", "full", scenario, size, 0), constants)
        arrived = {one.task_id for one in run.events if isinstance(one, TaskArrived)}
        ended = [one.task_id for one in run.events if isinstance(one, TaskCompleted | TaskAbandoned)]
        assert sorted(ended) == sorted(arrived)
        assert replay_run(run) is None


EXTREMES = [{name: value} for name in Alliance.__struct_fields__ for value in (0, 10**12)]


@pytest.mark.parametrize("dial", EXTREMES, ids=str)
def test_runs_end_at_the_extremes_of_each_dial(dial: dict[str, int]) -> None:
    run = simulate_run(RunSpec(3, "alliance", "full", "fleet-contention", 8, 0), Constants(alliance=Alliance(**dial)))
    ended = [one for one in run.events if isinstance(one, TaskCompleted | TaskAbandoned)]
    assert len(ended) == len([one for one in run.events if isinstance(one, TaskArrived)])


@pytest.mark.slow
def test_the_verbs_answer_on_a_run(tmp_path: Path) -> None:
    ledger = fsar_ledger.simulate(
        tmp_path / "ledger", architecture="alliance", scenario="door-relay", runs=1, fleet_size=8
    ).ledger
    [run] = {row["run_id"] for row in ledger.log().rows()}
    lines = [row["message"] for row in ledger.log(run).rows()]
    assert "says that it is active" in lines
    assert ledger.state(run, at=40).standing
    accepted = next(row for row in ledger.log(run).rows() if row["message"].startswith("accept"))
    assert ledger.why(f"{run}:{accepted['seq']}")
    assert ledger.explain(run, request=accepted["action_id"])
    assert ledger.requests(run).rows()
    ledger.view(tmp_path / "run.html", run)
    assert (tmp_path / "run.html").stat().st_size > 10_000


def test_no_two_robots_execute_an_action_under_one_name(runs: list[LedgerRun]) -> None:
    shared = 0
    for run in runs:
        state = State()
        for event in run.events:
            apply(state, event)
            together: dict[str, list[str]] = {}
            for robot, active in state.motivation.active.items():
                name = execution_name(state.execution, active.action_id, robot)
                assert action_of(name) == active.action_id
                if name in state.execution.actions:
                    together.setdefault(active.action_id, []).append(name)
            assert all(len(set(names)) == len(names) for names in together.values())
            shared += any(len(names) > 1 for names in together.values())
    assert shared > 0
