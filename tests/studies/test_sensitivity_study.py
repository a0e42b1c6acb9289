"""A study finds known effects, continues after an interruption, and never calls unknown zero."""

import json
import math
from pathlib import Path

import msgspec
import pytest

import fsar_ledger
from fsar_ledger.base.errors import UsageError, WriteFailed
from fsar_ledger.metrics.effects import Sensitivity, VariedFactor, that_matter
from fsar_ledger.metrics.verdicts import MARGINS
from fsar_ledger.runtime.simulation import MODEL_VERSION
from fsar_ledger.studies.evaluations import CELLS, Answer, Question, evaluate
from fsar_ledger.studies.factor_effects import DELTA
from fsar_ledger.studies.factors import factors, setting
from fsar_ledger.studies.sensitivity import BASE_SEED, EMULATOR_SEED, REPEATS
from tests.studies.conftest import NAMES, linear, study
from tests.sure import known


def varied(found: Sensitivity, name: str) -> VariedFactor:
    (factor,) = (one for one in found.factors if one.name == name)
    return factor


def test_known_effects_are_found_again(found: Sensitivity) -> None:
    cell = 1
    of = {one.name: (one.mu[cell], one.mu_star[cell], one.sigma[cell]) for one in found.factors}
    assert of["world.message"][:2] == pytest.approx((6, 6), rel=1e-3), "two doublings of 3"
    assert of["world.window_mean_s"][:2] == pytest.approx((-2, 2), rel=1e-3)
    assert of["load.task_sets"] == pytest.approx((0.25, 0.25, 0), abs=1e-3), "not per whole range"
    assert of["structure.sync_period_us"] == (0, 0, 0)
    assert (of["world.context_rate_per_s"][2] or 0) > 0.1, "differs between trajectories, so it has a spread"
    in_margins = {(one.factor, one.metric, one.architecture): one.mu_margins for one in found.effects}
    assert in_margins["world.message", *CELLS[cell]] == pytest.approx(6 / 0.05, rel=1e-3)


def test_the_parts_of_the_variance_are_those_of_the_law(found: Sensitivity) -> None:
    cell = 5
    assert found.cells[cell].emulator_r2 == pytest.approx(1, abs=1e-6)
    # Uniform over two doublings, and a switch.
    whole = 9 / 3 + 1 / 3 + 0.25**2 / 4 + (0.125 * (EMULATOR_SEED % 3)) ** 2 / 3
    assert known(varied(found, "world.message").sobol_first)[cell] == pytest.approx(3 / whole, abs=1e-3)
    assert known(varied(found, "world.window_mean_s").sobol_total)[cell] == pytest.approx(1 / 3 / whole, abs=1e-3)
    assert varied(found, "structure.sync_period_us").sobol_first is None  # it moves nothing: it is none of the dozen
    assert found.dozen[0] == "world.message"
    assert "structure.sync_period_us" not in found.dozen


def test_no_metric_fills_the_list_of_those_that_matter(found: Sensitivity) -> None:
    def moves(factor: str) -> tuple[float, ...]:
        """Return the reach in margins, times the margins: the second moves containment furthest, any cell least."""
        if factor == "world.message":
            return (0.0,) * len(CELLS)
        beyond = 9.0 if factor == "load.task_sets" else 10.0 + NAMES.index(factor)
        within = 1.0 if factor == "load.task_sets" else 0.5
        return tuple(MARGINS[metric] * (within if metric == "recovery_containment" else beyond) for metric, _ in CELLS)

    changed = [msgspec.structs.replace(one, mu_star=moves(one.name)) for one in found.factors]
    about = msgspec.structs.replace(found, factors=tuple(changed))
    assert that_matter(about, 2) == ("structure.sync_period_us", "load.task_sets")
    assert that_matter(about, 3) == ("structure.sync_period_us", "world.context_rate_per_s", "load.task_sets")
    assert that_matter(about, 12) == (
        "structure.sync_period_us",
        "world.context_rate_per_s",
        "world.window_mean_s",
        "load.task_sets",
    )


def test_a_cell_that_is_never_defined_has_no_effects(found: Sensitivity) -> None:
    assert {(one.effects[0], one.mu[0], one.mu_star[0]) for one in found.factors} == {(0, None, None)}
    cell = found.cells[0]
    assert (cell.base_mean, cell.by_chance, cell.by_chance_of_switch, cell.emulator_r2) == (None,) * 4


def test_what_chance_does_comes_from_the_base_in_other_worlds(tmp_path: Path) -> None:
    def by_seed(question: Question) -> Answer:
        return (float(question.seed % 2),) * len(CELLS) if question.seed >= BASE_SEED else (0.0,) * len(CELLS)

    result = study(tmp_path / "chance.json", trajectories=2, points=0, ask=by_seed)
    expected = 2 * math.sqrt(REPEATS / 4 / (REPEATS - 1)) / math.sqrt(math.pi)
    assert result.cells[0].by_chance == pytest.approx(expected / DELTA, rel=1e-3)
    assert result.cells[0].by_chance_of_switch == pytest.approx(expected, rel=1e-3)
    chances = {(one.factor == NAMES[-1], one.by_chance_margins) for one in result.effects if one.metric == CELLS[0][0]}
    assert len(chances) == 2, "the last is a switch"
    assert {effect.mu_star_margins for effect in result.effects} == {0}


@pytest.mark.parametrize("finished", [0, 1, 20, 60])
def test_an_interrupted_study_goes_on_where_it_stopped_and_ends_in_the_same_bytes(
    tmp_path: Path, file: Path, finished: int
) -> None:
    asked: list[str] = []

    def breaks(question: Question) -> Answer:
        if len(asked) == finished:
            raise KeyboardInterrupt
        asked.append(question.key)
        return linear(question)

    def goes_on(question: Question) -> Answer:
        asked.append(question.key)
        return linear(question)

    out = tmp_path / "effects.json"
    with pytest.raises(KeyboardInterrupt):
        study(out, ask=breaks)
    partial = tmp_path / "effects.json.partial"
    # As a process that is killed while it writes leaves it.
    partial.write_bytes(partial.read_bytes() + b'{"key":"cut of')
    told: list[tuple[int, int]] = []
    study(out, ask=goes_on, progress=lambda done, total: told.append((done, total)))
    assert out.read_bytes() == file.read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == ["effects.json"]
    assert len(asked) == len(set(asked))
    assert told[-1] == (len(asked) - finished, len(asked) - finished)


def test_more_trajectories_begin_with_the_same_ones(tmp_path: Path) -> None:
    asked: dict[int, set[str]] = {4: set(), 5: set()}
    for number, keys in asked.items():
        study(
            tmp_path / "effects.json",
            trajectories=number,
            runs=1,
            points=0,
            ask=lambda question, keys=keys: keys.add(question.key) or linear(question),
        )
    assert asked[4] < asked[5]


def test_a_file_that_another_program_left_is_not_continued(tmp_path: Path) -> None:
    partial = tmp_path / "effects.json.partial"
    other = json.dumps({"package": fsar_ledger.__version__, "model_version": MODEL_VERSION, "program": "0" * 32}) + "\n"
    for text in (other, "something else\n", '{"package"'):
        partial.write_text(text)
        if text.endswith("\n"):
            with pytest.raises(UsageError, match="remove the file"):
                study(tmp_path / "effects.json")
            assert partial.read_text() == text
        else:
            study(tmp_path / "effects.json", points=0)  # its first line was cut: nothing is lost


def test_a_place_that_cannot_be_written_is_refused_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.json").mkdir()
    for out in ("file/effects.json", "folder.json"):
        with pytest.raises(WriteFailed, match="cannot be written"):
            study(tmp_path / out)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder.json"]


@pytest.mark.slow
def test_the_simulator_answers_every_cell_and_a_constant_of_one_architecture_moves_no_other() -> None:
    base = evaluate(Question(setting(factors(), {}), 1, 1))
    moved = evaluate(
        Question(setting(factors(), {"structure.snapshot_period_us": 1.0, "structure.engagement_us": 1.0}), 1, 1)
    )
    assert len(base) == len(CELLS)
    changed = {architecture for (_, architecture), one, other in zip(CELLS, base, moved, strict=True) if one != other}
    assert changed == {"dhma"}
