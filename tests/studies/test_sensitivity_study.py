"""A study finds known effects, continues after an interruption, and never calls unknown zero."""

import json
import math
from pathlib import Path

import msgspec
import pytest

import fsar_ledger
from fsar_ledger.base.errors import UsageError, WriteFailed
from fsar_ledger.metrics.effects import Sensitivity, that_matter
from fsar_ledger.runtime.simulation import MODEL_VERSION
from fsar_ledger.studies.evaluations import CELLS, Answer, Question, evaluate
from fsar_ledger.studies.factor_effects import DELTA
from fsar_ledger.studies.factors import factors, setting
from fsar_ledger.studies.sensitivity import BASE_SEED, EMULATOR_SEED, REPEATS, Size
from tests.studies.conftest import NAMES, linear, study


def test_known_effects_are_found_again(found: Sensitivity) -> None:
    of = {effect.factor: effect for effect in found.effects if (effect.metric, effect.architecture) == CELLS[1]}
    two_doublings_of_3 = pytest.approx((6, 6), rel=1e-5)
    assert (of["world.message"].mu, of["world.message"].mu_star) == two_doublings_of_3
    assert (of["world.window_mean_s"].mu, of["world.window_mean_s"].mu_star) == pytest.approx((-2, 2), rel=1e-5)
    per_set = pytest.approx((0.25, 0), abs=1e-5)  # not per whole range
    assert (of["load.task_sets"].mu, of["load.task_sets"].sigma) == per_set
    assert (of["structure.sync_period_us"].mu_star, of["structure.sync_period_us"].sigma) == (0, 0)
    seeds = of["world.context_rate_per_s"]  # differs between trajectories, so it has a spread
    assert seeds.sigma is not None
    assert seeds.sigma > 0.1
    assert of["world.message"].mu_margins == pytest.approx(6 / 0.05, rel=1e-5)


def test_the_parts_of_the_variance_are_those_of_the_law(found: Sensitivity) -> None:
    of = {effect.factor: effect for effect in found.effects if (effect.metric, effect.architecture) == CELLS[5]}
    assert of["world.message"].emulator_r2 == pytest.approx(1, abs=1e-6)
    # Uniform over two doublings, and a switch.
    whole = 9 / 3 + 1 / 3 + 0.25**2 / 4 + (0.125 * (EMULATOR_SEED % 3)) ** 2 / 3
    assert of["world.message"].sobol_first == pytest.approx(3 / whole, abs=1e-3)
    assert of["world.window_mean_s"].sobol_total == pytest.approx(1 / 3 / whole, abs=1e-3)
    assert of["structure.sync_period_us"].sobol_first is None  # it moves nothing, so it is none of the dozen
    assert found.about.dozen[0] == "world.message"
    assert "structure.sync_period_us" not in found.about.dozen


def test_no_metric_fills_the_list_of_those_that_matter(found: Sensitivity) -> None:
    def margins(metric: str, factor: str) -> float:
        if metric == "recovery_containment":
            return 1.0 if factor == "load.task_sets" else 0.5
        return float(10 + NAMES.index(factor))

    effects = [msgspec.structs.replace(one, mu_star_margins=margins(one.metric, one.factor)) for one in found.effects]
    effects = [
        msgspec.structs.replace(one, mu_star_margins=0.0) if one.factor == "world.message" else one for one in effects
    ]
    changed = [
        msgspec.structs.replace(one, mu_star_margins=9.0)
        if one.factor == "load.task_sets" and one.mu_star_margins != 1
        else one
        for one in effects
    ]
    about = Sensitivity(found.about, tuple(changed))
    # The second moves containment furthest, and any cell least.
    assert that_matter(about, 2) == ("structure.sync_period_us", "load.task_sets")
    assert that_matter(about, 3) == ("structure.sync_period_us", "world.context_rate_per_s", "load.task_sets")
    assert that_matter(about, 12) == (
        "structure.sync_period_us",
        "world.context_rate_per_s",
        "world.window_mean_s",
        "load.task_sets",
    )


def test_a_cell_that_is_never_defined_has_no_effects(found: Sensitivity) -> None:
    undefined = [effect for effect in found.effects if (effect.metric, effect.architecture) == CELLS[0]]
    assert {
        (effect.effects, effect.mu, effect.mu_star, effect.by_chance, effect.emulator_r2, effect.base_mean)
        for effect in undefined
    } == {(0, None, None, None, None, None)}


def test_what_chance_does_comes_from_the_base_in_other_worlds(tmp_path: Path) -> None:
    def by_seed(question: Question) -> Answer:
        return (float(question.seed % 2),) * len(CELLS) if question.seed >= BASE_SEED else (0.0,) * len(CELLS)

    effects = study(tmp_path / "chance.parquet", Size(2, 1, 0), ask=by_seed).effects
    deviation = math.sqrt(REPEATS / 4 / (REPEATS - 1))
    assert effects[0].by_chance == pytest.approx(2 * deviation / math.sqrt(math.pi) / DELTA, rel=1e-5)
    assert effects[len(NAMES) - 1].by_chance == pytest.approx(2 * deviation / math.sqrt(math.pi), rel=1e-5)
    assert {effect.mu_star for effect in effects} == {0}


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

    out = tmp_path / "effects.parquet"
    with pytest.raises(KeyboardInterrupt):
        study(out, ask=breaks)
    partial = tmp_path / "effects.parquet.partial"
    # As a process that is killed while it writes leaves it.
    partial.write_bytes(partial.read_bytes() + b'{"key":"cut of')
    told: list[tuple[int, int]] = []
    study(out, ask=goes_on, progress=lambda done, total: told.append((done, total)))
    assert out.read_bytes() == file.read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == ["effects.parquet"]
    assert len(asked) == len(set(asked))
    assert told[-1] == (len(asked) - finished, len(asked) - finished)


def test_more_trajectories_begin_with_the_same_ones(tmp_path: Path) -> None:
    asked: dict[int, set[str]] = {4: set(), 5: set()}
    for number, keys in asked.items():
        study(
            tmp_path / "effects.parquet",
            Size(number, 1, 0),
            ask=lambda question, keys=keys: keys.add(question.key) or linear(question),
        )
    assert asked[4] < asked[5]


def test_a_file_that_another_program_left_is_not_continued(tmp_path: Path) -> None:
    partial = tmp_path / "effects.parquet.partial"
    other = json.dumps({"package": fsar_ledger.__version__, "model_version": MODEL_VERSION, "program": "0" * 32}) + "\n"
    for text in (other, "something else\n", '{"package"'):
        partial.write_text(text)
        if text.endswith("\n"):
            with pytest.raises(UsageError, match="remove the file"):
                study(tmp_path / "effects.parquet")
            assert partial.read_text() == text
        else:
            study(tmp_path / "effects.parquet", Size(2, 1, 0))  # cut while its first line was written: nothing is lost


def test_a_place_that_cannot_be_written_is_refused_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.parquet").mkdir()
    for out, error in (
        ("effects.csv", UsageError),
        ("file/effects.parquet", WriteFailed),
        ("folder.parquet", WriteFailed),
    ):
        with pytest.raises(error, match=r"found a file name|cannot be written"):
            study(tmp_path / out)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder.parquet"]


def test_the_simulator_answers_every_cell_and_a_constant_of_one_architecture_moves_no_other() -> None:
    base = evaluate(Question(setting(factors(), {}), 1, 1))
    moved = evaluate(
        Question(setting(factors(), {"structure.snapshot_period_us": 1.0, "structure.engagement_us": 1.0}), 1, 1)
    )
    assert len(base) == len(CELLS)
    changed = {architecture for (_, architecture), one, other in zip(CELLS, base, moved, strict=True) if one != other}
    assert changed == {"dhma"}
