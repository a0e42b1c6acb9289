"""A plan is on record before its runs; a larger one enlarges the ledger, whatever was interrupted, to the runs that a
fresh one has."""

import shutil
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest

import fsar_ledger
from fsar_ledger.designs.constants import Constants, WorldConstants
from fsar_ledger.events.envelope import Architecture
from fsar_ledger.events.fleet import ExperimentPlanned
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.record import Head
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.verify import verify
from fsar_ledger.metrics.database import connect
from fsar_ledger.metrics.provenance import completeness
from fsar_ledger.metrics.results import metric_rows, statistic_rows
from fsar_ledger.runtime import experiment as module
from fsar_ledger.runtime.experiment import ORIGIN, Experiment, run_experiment
from fsar_ledger.runtime.replay import replay
from fsar_ledger.runtime.run_replay import replay_run
from fsar_ledger.runtime.simulation import plan_record
from tests.sure import known

BOTH: tuple[Architecture, ...] = ("fsar", "cfc")
SMALL = Experiment(BOTH, ("door-relay",), 2, 3)
LARGE = Experiment(BOTH, ("door-relay",), 5, 3)
PAIR, ONE, MORE = (Experiment(("fsar",), ("door-relay",), count, 3) for count in (2, 4, 7))


class Stopped(Exception):
    """What was done so far was enough."""


@pytest.fixture(autouse=True)
def _small_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    """A commit has few runs, so that few runs make several commits."""
    small_batches(monkeypatch)


def small_batches(patch: pytest.MonkeyPatch) -> None:
    """Let a batch have three runs of the paper's fleet."""
    patch.setattr(module, "COMMIT_EVENTS", 4 * 3 * module.EVENTS_PER_ROBOT)


def stop_after(batches: int) -> Callable[[int, int], None]:
    def progress(done: int, _total: int) -> None:
        if done >= batches:
            raise Stopped

    return progress


def interrupted(path: Path, experiment: Experiment, batches: int) -> None:
    """Stop the experiment when so many batches are there."""
    with pytest.raises(Stopped):
        run_experiment(path, experiment, 1, stop_after(batches))


def runs(path: Path) -> dict[str, LedgerRun]:
    return {run.run_id: run for run in open_ledger(path).runs() if not isinstance(run.events[0], ExperimentPlanned)}


def plans(path: Path) -> list[int]:
    """How many runs each plan names, in the order of commits."""
    return [run.events[0].run_count for run in open_ledger(path).runs() if isinstance(run.events[0], ExperimentPlanned)]


def judged(path: Path) -> tuple[object, ...]:
    with connect(path, 1) as database:
        return metric_rows(database), statistic_rows(database)


@pytest.fixture(scope="module")
def fresh(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("fresh") / "ledger"
    run_experiment(path, LARGE, 1)
    return path


@pytest.fixture(scope="module")
def enlarged(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Head]:
    """A ledger of two runs a cell that became one of five, in commits of three runs."""
    path = tmp_path_factory.mktemp("enlarged") / "ledger"
    with pytest.MonkeyPatch.context() as patch:
        small_batches(patch)
        run_experiment(path, SMALL, 1)
        return path, run_experiment(path, LARGE, 1).head


def test_the_plan_is_on_record_before_the_first_run(tmp_path: Path) -> None:
    interrupted(tmp_path / "ledger", SMALL, 0)
    view = open_ledger(tmp_path / "ledger")
    assert [(run.run_id, *run.events) for run in view.runs()] == [(plan_record(SMALL.plan()).run_id, SMALL.plan())]
    assert (view.head.commits, view.head.size) == (1, 1)
    assert verify(tmp_path / "ledger").ok


def test_who_goes_on_adds_no_second_plan(tmp_path: Path) -> None:
    interrupted(tmp_path / "ledger", SMALL, 1)
    run_experiment(tmp_path / "ledger", SMALL, 1)
    assert plans(tmp_path / "ledger") == [2]
    made = run_experiment(tmp_path / "ledger", SMALL, 1)
    assert (made.runs_asked, made.runs_made, made.runs_held, plans(tmp_path / "ledger")) == (4, 0, 4, [2])


@pytest.mark.slow
def test_an_enlarged_ledger_has_the_runs_and_metrics_of_a_fresh_one_and_another_root(
    fresh: Path, enlarged: tuple[Path, Head]
) -> None:
    path, head = enlarged
    assert runs(path) == runs(fresh)
    assert len(runs(path)) == 10
    assert judged(path) == judged(fresh)
    assert head.root != open_ledger(fresh).head.root
    assert (plans(path), plans(fresh)) == ([2, 5], [5])
    assert verify(path).runs == replay(path).runs == 10
    assert replay(path).ok


@pytest.mark.parametrize(
    ("of_small", "of_large"),
    [(1, 1), *(pytest.param(*at, marks=pytest.mark.slow) for at in ((0, 0), (0, 2), (2, 0), (2, 1)))],
)
def test_wherever_an_enlargement_is_interrupted_its_plans_decide_the_bytes(
    tmp_path: Path, of_small: int, of_large: int
) -> None:
    """The small experiment has two batches; the batches of the large one follow from what was there when it was
    planned."""
    if of_small < 2:
        interrupted(tmp_path / "stopped", ONE, of_small)
    else:
        run_experiment(tmp_path / "stopped", ONE, 1)
    shutil.copytree(tmp_path / "stopped", tmp_path / "straight")
    interrupted(tmp_path / "stopped", MORE, of_large)
    head = run_experiment(tmp_path / "straight", MORE, 1).head
    assert run_experiment(tmp_path / "stopped", MORE, 1).head == head
    assert (tmp_path / "stopped" / "checkpoint").read_bytes() == (tmp_path / "straight" / "checkpoint").read_bytes()
    assert plans(tmp_path / "stopped") == [4, 7]


@pytest.mark.parametrize(
    ("first", "then", "made"),
    [
        (SMALL, Experiment(BOTH, ("door-relay", "fleet-contention"), 2, 3), 4),
        pytest.param(SMALL, Experiment(("fsar", "cfc", "dhma"), ("door-relay",), 2, 3), 2, marks=pytest.mark.slow),
        (PAIR, Experiment(("fsar",), ("door-relay",), 2, 3, 4, ("full", "without-layered-recovery")), 2),
        pytest.param(SMALL, Experiment(("fsar",), ("door-relay", "fleet-contention"), 3, 3), 4, marks=pytest.mark.slow),
        pytest.param(PAIR, msgspec.structs.replace(PAIR, seed=4), 2, marks=pytest.mark.slow),
        pytest.param(PAIR, msgspec.structs.replace(PAIR, fleet_size=8), 2, marks=pytest.mark.slow),
        (PAIR, msgspec.structs.replace(PAIR, constants=Constants(world=WorldConstants(window_mean_s=12.0))), 2),
    ],
)
def test_what_is_there_is_not_made_again_whatever_else_is_asked_for(
    tmp_path: Path, first: Experiment, then: Experiment, made: int
) -> None:
    before = run_experiment(tmp_path / "ledger", first, 1).head
    after = run_experiment(tmp_path / "ledger", then, 1)
    assert (after.runs_asked, after.runs_made) == (then.size, made)
    assert len(plans(tmp_path / "ledger")) == 2
    assert len(runs(tmp_path / "ledger")) == after.runs_held == first.size + made
    assert after.head.commits > before.commits
    assert verify(tmp_path / "ledger").ok


@pytest.mark.slow
def test_a_small_plan_that_a_larger_one_overtook_is_not_made_again(tmp_path: Path) -> None:
    interrupted(tmp_path / "ledger", SMALL, 1)
    interrupted(tmp_path / "ledger", LARGE, 1)
    run_experiment(tmp_path / "ledger", SMALL, 1)
    assert plans(tmp_path / "ledger") == [2, 5]
    run_experiment(tmp_path / "ledger", LARGE, 1)
    assert len(runs(tmp_path / "ledger")) == 10
    assert verify(tmp_path / "ledger").ok


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"run_id": "plan.n4.s3.x0002-000000000000"}, "run_id"),
        ({"times_us": (5,)}, "time_us"),
        ({"events": (LARGE.plan(),)}, "run_id"),
    ],
)
def test_replay_finds_a_plan_that_is_not_what_its_name_says(changes: dict[str, object], field: str) -> None:
    plan = plan_record(SMALL.plan())
    assert replay_run(plan) is None
    difference = known(replay_run(msgspec.structs.replace(plan, **changes)))
    assert (difference.seq, difference.field) == (0, field)


def test_a_forged_plan_is_a_doubt_of_a_replayed_ledger(tmp_path: Path) -> None:
    with Writer(tmp_path / "ledger", ORIGIN) as writer:
        writer.append(
            stage(
                tmp_path / "ledger",
                [msgspec.structs.replace(plan_record(LARGE.plan()), run_id=plan_record(SMALL.plan()).run_id)],
            )
        )
    report = replay(tmp_path / "ledger")
    assert (report.ok, report.runs, [one.field for one in report.differences]) == (False, 0, ["run_id"])


@pytest.mark.slow
def test_shards_of_an_experiment_have_the_runs_of_the_whole_one(tmp_path: Path) -> None:
    def runs(name: str, count: int, first: int = 0) -> list[LedgerRun]:
        ledger = fsar_ledger.simulate(
            tmp_path / name, scenario="door-relay", seed=5, runs=count, first_run=first
        ).ledger
        with connect(ledger.path) as database:
            assert completeness(database).answer()["complete"] is True
        return [run for run in open_ledger(ledger.path).runs() if run.run_id.startswith("fsar")]

    whole = runs("whole", 5)
    assert len(whole) == 5
    assert runs("first", 2) + runs("second", 3, 2) == whole
