"""Runs that are simulated in slices, and stored in as many commits as they need."""

from pathlib import Path

import pytest

from fsar_ledger.base.errors import InvalidExperiment
from fsar_ledger.designs.constants import Constants
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.rows.runs import joined
from fsar_ledger.ledger.verify import verify
from fsar_ledger.runtime import experiment, simulation
from fsar_ledger.runtime.experiment import Experiment, run_experiment
from fsar_ledger.runtime.replay import replay
from fsar_ledger.runtime.simulation import SCENARIOS, RunSpec, simulate_run, simulate_slices
from tests.ledger.samples import contents
from tests.quick import few

WHOLE = Experiment(PAPER_ARCHITECTURES, SCENARIOS[:2], 2)
SMALL = 300  # events of a commit; a run has some 500


@pytest.mark.parametrize("architecture", PAPER_ARCHITECTURES)
@pytest.mark.parametrize("scenario", few(SCENARIOS, SCENARIOS[2:3]))
def test_slices_are_the_run(architecture: str, scenario: str) -> None:
    for fleet_size in (4, 16):
        spec = RunSpec(7, architecture, "full", scenario, fleet_size, 1)
        whole = simulate_run(spec, Constants())
        for most in (37, 10**6) if fleet_size > 4 else (1, 37, 1_000):
            parts = list(simulate_slices(spec, Constants(), most))
            assert joined(parts) == whole
            assert [part.goes_on for part in parts] == [*[True] * (len(parts) - 1), False]
            assert max(len(part.events) for part in parts[1:] or parts) < most + 200


@pytest.fixture
def small_commits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulation, "COMMIT_EVENTS", SMALL)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The experiment in small commits, never interrupted."""
    path = tmp_path_factory.mktemp("made") / "ledger"
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(simulation, "COMMIT_EVENTS", SMALL)
        run_experiment(path, WHOLE, 1)
    return path


@pytest.mark.slow
def test_in_commits_of_any_size_the_same_experiment_has_the_same_root(tmp_path: Path, made: Path) -> None:
    first, second = run_experiment(tmp_path / "1", WHOLE, 1).head, open_for_answers(made).head
    assert (first.size, first.root) == (second.size, second.root)
    assert second.commits > 12
    assert list(open_for_answers(tmp_path / "1").runs()) == list(open_for_answers(made).runs())
    assert verify(made).ok
    assert replay(made).ok


@pytest.mark.parametrize("stop", few((1, 7, 19), [], [7]))
def test_a_simulation_that_is_interrupted_within_a_run_goes_on_with_that_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, small_commits: None, made: Path, stop: int
) -> None:
    from fsar_ledger.ledger.store.append import Writer

    append = Writer.append
    commits = 0

    def interrupted(self: Writer, *given: object) -> object:
        nonlocal commits
        commits += 1
        if commits > stop:
            raise KeyboardInterrupt
        return append(self, *given)  # type: ignore[arg-type]

    monkeypatch.setattr(Writer, "append", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run_experiment(tmp_path / "stopped", WHOLE, 1)
    monkeypatch.setattr(Writer, "append", append)
    again = run_experiment(tmp_path / "stopped", WHOLE, 1)
    whole, found = open_for_answers(made), open_for_answers(tmp_path / "stopped")
    assert (found.head.size, found.head.root) == (whole.head.size, whole.head.root)
    assert again.runs_held == WHOLE.size
    assert list(found.runs()) == list(whole.runs())
    assert verify(tmp_path / "stopped").ok


def test_any_number_of_workers_gives_the_same_bytes(tmp_path: Path) -> None:
    for workers in (1, 2):
        run_experiment(tmp_path / str(workers), WHOLE, workers)
    assert contents(tmp_path / "1") == contents(tmp_path / "2")


def test_a_fleet_that_no_memory_holds_is_refused_before_anything_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert experiment.MOST_ROBOTS == 1 << 16
    monkeypatch.setattr(experiment, "MOST_ROBOTS", 8)  # more would take all memory if they were not refused
    with pytest.raises(InvalidExperiment, match="fleet size: found 12, expected at most 8"):
        run_experiment(tmp_path / "ledger", Experiment(("fsar",), SCENARIOS[:1], 1, fleet_size=12), 1)
    assert not (tmp_path / "ledger").exists()
