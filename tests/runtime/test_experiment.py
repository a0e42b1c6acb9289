"""An experiment is a row of runs in canonical order, committed in batches."""

from math import nan
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fsar_ledger.base.errors import InvalidExperiment, NotALedger
from fsar_ledger.designs.constants import Constants, Outages, Range, Structure, WorldConstants
from fsar_ledger.events import Event
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.events.knowledge import CopySynced, SnapshotTaken
from fsar_ledger.events.task import TaskCompleted
from fsar_ledger.events.world import TaskArrived
from fsar_ledger.ledger.opening import open_for_answers, open_ledger
from fsar_ledger.ledger.verify import verify
from fsar_ledger.runtime.experiment import Experiment, missing_runs, run_experiment
from fsar_ledger.runtime.experiment_arguments import experiment_of
from fsar_ledger.runtime.simulation import SCENARIOS, RunSpec, run_id, run_started, simulate_run

SMALL = Experiment(PAPER_ARCHITECTURES, SCENARIOS[:2], runs=5, seed=3)


def test_runs_come_in_canonical_order() -> None:
    specs = [(spec.scenario, spec.run, spec.architecture) for spec in SMALL.specs()]
    assert specs[:4] == [
        ("door-relay", 0, "fsar"),
        ("door-relay", 0, "cfc"),
        ("door-relay", 0, "dhma"),
        ("door-relay", 1, "fsar"),
    ]
    assert len(specs) == len(set(specs)) == 30


def test_batches_have_as_many_runs_as_a_commit_holds_of_such_a_fleet_and_the_last_one_the_rest() -> None:
    many = msgspec.structs.replace(SMALL, runs=20)
    assert [len(batch) for batch in many.batches()] == [88, 32]
    default = Experiment(PAPER_ARCHITECTURES, SCENARIOS, runs=20)
    assert [len(batch) for batch in default.batches()] == [88, 88, 87, 37]
    larger = msgspec.structs.replace(SMALL, fleet_size=16)
    assert [len(batch) for batch in larger.batches()] == [22, 8]
    assert {len(batch) for batch in msgspec.structs.replace(SMALL, fleet_size=1024).batches()} == {1}


def late(folder: Path, offset_s: float, *more: str) -> str:
    """A scenario of a user with a task so late, and what else its file says."""
    path = folder / "late.toml"
    steps = 'owner = "A"\nsteps = ["A navigate.indoor", "A door.open.secure B"]\n'
    path.write_text("\n".join(('name = "late"', *more, f"[[tasks]]\n{steps}[[tasks]]\noffset_s = {offset_s}\n{steps}")))
    return str(path)


def watch_s(path: str, load: tuple[int | None, int] = (None, 1), settings: list[str] | None = None) -> float:
    experiment = experiment_of(None, [path], 1, 3, None, None, load=load, settings=settings)
    return experiment.constants.structure.watch_us / 1e6


def test_periodic_exchanges_go_on_until_every_task_of_an_own_scenario_can_have_arrived(tmp_path: Path) -> None:
    assert watch_s(late(tmp_path, 77)) == 100, "the default"
    assert watch_s(late(tmp_path, 200)) == 223, "a start within 20 s, and 3 s of jitter"
    assert watch_s(late(tmp_path, 200), (None, 3)) == 283, "two more sets, one each 30 s"
    assert watch_s(late(tmp_path, 200), settings=["structure.watch_us=5"]) == 5e-6
    assert watch_s(late(tmp_path, 200, 'settings = ["structure.watch_us=7"]')) == 7e-6
    with pytest.raises(InvalidExperiment, match="late: found a task that can arrive 1801 s after the beginning"):
        watch_s(late(tmp_path, 1778))


@pytest.mark.parametrize(("architecture", "kind"), [("cfc", CopySynced), ("dhma", SnapshotTaken)])
def test_a_late_task_is_decided_on_copies_that_are_still_refreshed(
    architecture: str, kind: type[Event], tmp_path: Path
) -> None:
    experiment = experiment_of([architecture], [late(tmp_path, 200)], 1, 3, None, None)
    [spec] = experiment.specs()
    record = simulate_run(spec, experiment.constants)
    times = {
        which: [time_us for time_us, event in zip(record.times_us, record.events, strict=True) if type(event) is which]
        for which in (kind, TaskArrived, TaskCompleted)
    }
    assert any(times[TaskArrived][-1] < time_us < times[TaskCompleted][-1] for time_us in times[kind])


def test_what_is_missing_of_a_batch_is_committed_with_the_rest_of_that_batch() -> None:
    whole = msgspec.structs.replace(SMALL, fleet_size=16).batches()
    assert missing_runs(whole, lambda spec: spec in whole[0]) == whole[1:]
    assert missing_runs(whole, lambda spec: spec.architecture != "dhma") == [
        tuple(spec for spec in batch if spec.architecture == "dhma") for batch in whole
    ]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"architectures": ("fsra",)}, "architecture: found fsra"),
        ({"architectures": ()}, "architecture: found none"),
        ({"architectures": ("cfc", "cfc")}, "each once"),
        ({"scenarios": ("moon",)}, "scenario: found moon"),
        ({"configurations": ("without-luck",)}, "configuration: found without-luck"),
        (
            {"configurations": ("without-trust-evaluation",)},
            r"without trust-evaluation: found architecture cfc, expected fsar alone",
        ),
        ({"runs": 0}, "runs: found 0"),
        ({"runs": 10_000}, "runs: found 10000"),
        ({"seed": -1}, "seed: found -1"),
        ({"seed": 2**53}, "seed: found"),
        ({"fleet_size": 6}, "fleet size: found 6"),
        ({"fleet_size": 0}, "fleet size: found 0"),
        (
            {"constants": Constants(WorldConstants(window_mean_s=-1.0))},
            "constants: found world.window_mean_s -1.0, expected 0 or more",
        ),
        (
            {"constants": Constants(WorldConstants(message=Range(-0.5, 0.5)))},
            "constants: found world.message.low_s -0.5",
        ),
        (
            {"constants": Constants(outages=Outages(loss_rate_per_s=nan))},
            "constants: found outages.loss_rate_per_s nan",
        ),
        (
            {"constants": Constants(structure=Structure(sync_period_us=-1))},
            "constants: found structure.sync_period_us -1",
        ),
    ],
)
def test_an_impossible_experiment_is_refused_with_what_was_found(changes: dict[str, Any], message: str) -> None:
    given: dict[str, Any] = {"architectures": PAPER_ARCHITECTURES, "scenarios": SCENARIOS, "runs": 1, **changes}
    with pytest.raises(InvalidExperiment, match=message):
        Experiment(**given)


def test_other_parameters_are_other_runs() -> None:
    spec = RunSpec(1, "fsar", "full", "door-relay", 4, 0)
    other = Constants(world=WorldConstants(window_mean_s=12.0))
    names = {run_id(run_started(spec, constants)) for constants in (Constants(), other)}
    assert len(names) == 2
    assert all(name.startswith("fsar.full.door-relay.n4.s1.r0000-") for name in names)


@pytest.mark.slow
def test_an_interrupted_experiment_goes_on_at_the_first_missing_batch(tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []

    class Stop(Exception):
        pass

    def stop_after_one(done: int, total: int) -> None:
        told.append((done, total))
        if done == 1:
            raise Stop

    larger = msgspec.structs.replace(SMALL, runs=20)
    with pytest.raises(Stop):
        run_experiment(tmp_path / "ledger", larger, 1, stop_after_one)
    assert open_ledger(tmp_path / "ledger").head.commits == 2
    told.clear()
    head = run_experiment(tmp_path / "ledger", larger, 1, lambda done, total: told.append((done, total))).head
    assert told == [(1, 2), (2, 2)]
    assert run_experiment(tmp_path / "whole", larger, 1).head == head
    assert verify(tmp_path / "ledger").ok


@pytest.mark.slow
def test_an_experiment_that_another_process_finishes_meanwhile_finishes_too_and_nothing_is_there_twice(
    tmp_path: Path,
) -> None:
    path = tmp_path / "ledger"

    def finish_elsewhere(done: int, _total: int) -> None:
        if done == 0:
            run_experiment(path, SMALL, 1)

    head = run_experiment(path, SMALL, 1, finish_elsewhere).head
    assert head == run_experiment(tmp_path / "alone", SMALL, 1).head
    assert verify(path).ok


@pytest.mark.slow
def test_two_experiments_at_once_in_one_ledger_both_finish(tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    other = msgspec.structs.replace(SMALL, seed=SMALL.seed + 1)

    def begin_elsewhere(done: int, _total: int) -> None:
        if done == 1:
            run_experiment(path, other, 1)

    run_experiment(path, SMALL, 1, begin_elsewhere)
    held = {run.run_id for run in open_for_answers(path).runs()}
    alone = [run_experiment(tmp_path / name, one, 1).head for name, one in (("one", SMALL), ("two", other))]
    assert open_for_answers(path).head.size == sum(head.size for head in alone)
    assert len(held) == SMALL.size + other.size + 2
    assert verify(path).ok


def test_another_experiment_can_join_a_ledger_if_it_shares_no_run(tmp_path: Path) -> None:
    run_experiment(tmp_path / "ledger", SMALL, 1)
    joined = run_experiment(tmp_path / "ledger", Experiment(("fsar",), SCENARIOS[:1], runs=2, seed=4), 1).head
    assert joined.commits == 4
    assert verify(tmp_path / "ledger").ok


def test_runs_that_are_there_in_other_batches_are_not_made_again_and_nothing_changes(tmp_path: Path) -> None:
    head = run_experiment(tmp_path / "ledger", SMALL, 1).head
    made = run_experiment(tmp_path / "ledger", Experiment(("fsar",), SCENARIOS[:1], runs=2, seed=3), 1)
    assert (made.runs_asked, made.runs_made, made.runs_held, made.head) == (2, 0, 30, head)
    assert open_ledger(tmp_path / "ledger").head == head


def test_a_folder_that_is_no_ledger_is_left_as_it_was(tmp_path: Path) -> None:
    (tmp_path / "precious.txt").write_text("mine")
    with pytest.raises(NotALedger):
        run_experiment(tmp_path, SMALL, 1)
    assert [path.name for path in tmp_path.iterdir()] == ["precious.txt"]
