"""Every constant is varied, known effects are found again, an interrupted study loses nothing, and nothing unknown is called zero."""

import json
import math
from hashlib import sha256
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import fsar_ledger
from fsar_ledger.cli.app import run
from fsar_ledger.constants import Constants, negatives, write_constants
from fsar_ledger.errors import UsageError, WriteFailed
from fsar_ledger.report.provenance import origins
from fsar_ledger.report.sensitivity import (
    METADATA,
    Sensitivity,
    dozen,
    heat_map,
    reach,
    read_sensitivity,
    section,
    table_of,
    that_matter,
)
from fsar_ledger.runtime.experiment import Experiment
from fsar_ledger.runtime.simulation import ARCHITECTURES, MODEL_VERSION, SCENARIOS
from fsar_ledger.sensitivity.emulator import design, indices, terms
from fsar_ledger.sensitivity.evaluations import CELLS, Answer, Question, evaluate
from fsar_ledger.sensitivity.factors import Factor, Setting, factors, setting
from fsar_ledger.sensitivity.morris import DELTA, Trajectory, elementary_effects, summary, trajectory
from fsar_ledger.sensitivity.study import BASE_SEED, EMULATOR_SEED, REPEATS, Size, sensitivity

SALIB = json.loads((Path(__file__).parent / "vectors" / "salib" / "polynomial.json").read_text())
NAMES = (
    "world.message",
    "world.window_mean_s",
    "world.context_rate_per_s",
    "structure.sync_period_us",
    "load.task_sets",
)
SOME = tuple(factor for name in NAMES for factor in factors() if factor.name == name)
SMALL = Size(trajectories=4, runs=1, points=64)


def doublings(value: float, base: float) -> float:
    return math.log2(value / base)


def linear(question: Question) -> Answer:
    """A world in which two lengths move all cells, a rate adds what differs between seeds, task sets what one set more does, and the period nothing."""
    world, load = question.setting.constants.world, question.setting.constants.load
    value = 3 * doublings(world.message.high_s, 0.5) - doublings(world.window_mean_s, Constants().world.window_mean_s)
    sets = 1 if load is None else load.task_sets
    value += 0.25 * (sets - 1) + 0.125 * (question.seed % 3) * doublings(
        world.context_rate_per_s, Constants().world.context_rate_per_s
    )
    return (None, *[value] * (len(CELLS) - 1))


def study(out: Path, size: Size = SMALL, **changes: Any) -> Sensitivity:
    return sensitivity(out, size, **{"ask": linear, "subject": SOME, **changes})


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("sensitivity") / "effects.parquet"
    study(path)
    return path


@pytest.fixture(scope="module")
def found(file: Path) -> Sensitivity:
    return read_sensitivity(file, MODEL_VERSION, write_constants(Constants()))


# --- what is varied ---


def test_every_number_of_the_world_and_the_structure_is_a_factor_and_load_and_size_too() -> None:
    expected = [name for name in origins() if not name.startswith("outages.")]
    assert sorted(factor.name for factor in factors()) == sorted([*expected, "fleet.size"])
    assert {factor.origin for factor in factors()} == {"paper", "fitted", "chosen after fits", "chosen"}


def test_nothing_moved_is_the_package_s_own_world() -> None:
    assert setting(factors(), {}) == Setting(Constants(), 4)


def test_what_is_moved_changes_and_nothing_else() -> None:
    for factor in factors():
        low, high = (setting(factors(), {factor.name: position}) for position in (0.0, 1.0))
        if factor.name in ("load.teams_working", "load.interval_s"):
            assert low == high == Setting(Constants(), 4)  # one team, one set: nothing to tell apart
            continue
        changed = msgspec.to_builtins(low), msgspec.to_builtins(high)
        assert changed[0] != changed[1]
        part, _, name = factor.name.partition(".")
        if part == "fleet":
            assert (low.fleet_size, high.fleet_size) == (4, 8)
            assert low.constants == high.constants
        elif part != "load":
            for one in changed:
                one["constants"][part].pop(name.partition(".")[0])
            assert changed[0] == changed[1]


def test_lengths_are_halved_to_doubled_shares_stay_shares_and_counts_whole() -> None:
    at = {factor.name: (factor.at(0.0), factor.at(1.0)) for factor in factors()}
    assert at["world.window_mean_s"] == (Constants().world.window_mean_s / 2, Constants().world.window_mean_s * 2)
    assert at["world.degraded_reliability"] == (0.428571, 0.75)
    assert at["structure.local_attempts"] == (1, 4)
    assert at["structure.peer_helpers"] == (1, 2)
    for factor in factors():
        for position in (0.0, 1 / 3, 0.5, 2 / 3, 1.0):
            value = factor.at(position)
            if factor.kind == "share":
                assert 0 < value < (1 if isinstance(factor.value, float) else 1_000_000)
            if factor.kind == "count":
                assert isinstance(value, int)
                assert value >= 1


def test_the_name_of_a_constant_says_whether_it_is_a_share_or_a_count() -> None:
    """So that a new one is not scaled out of its range unseen."""
    for factor in factors():
        if factor.name.endswith(("_share", "_probability", "_reliability")):
            assert factor.kind == "share"
        if (
            factor.name.startswith(("world.", "structure."))
            and isinstance(factor.value, int)
            and not factor.name.endswith(("_us", "_ppm"))
        ):
            assert factor.kind == "count"


@pytest.mark.parametrize("end", [0.0, 1.0])
def test_runs_take_the_constants_at_the_ends_of_all_ranges(end: float) -> None:
    for names in ([factor.name for factor in factors()], *([factor.name] for factor in factors())):
        at = setting(factors(), dict.fromkeys(names, end))
        assert negatives(at.constants) == []
        Experiment(ARCHITECTURES, SCENARIOS, 1, 1, at.fleet_size, constants=at.constants)


# --- the definitions ---


def test_effects_and_indices_are_those_of_salib() -> None:
    """The numbers are of SALib 1.6.0; `what` in the file says how they were made."""
    points, outputs = np.array(SALIB["points"]) / 3, np.array(SALIB["outputs"])
    steps = points.shape[1] + 1
    moves = []
    for start in range(0, len(points), steps):
        path = points[start : start + steps]
        order = tuple(int(np.flatnonzero(path[step] != path[step + 1])[0]) for step in range(steps - 1))
        moves.append(elementary_effects(Trajectory(path, order), outputs[start : start + steps], [False] * 6))
    ours = [summary(np.array(moves)[:, factor]) for factor in range(6)]
    for name in ("mu", "mu_star", "sigma"):
        assert [getattr(one, name) for one in ours] == pytest.approx(SALIB[name], abs=1e-12)
    assert [one.mu_star_conf for one in ours] == pytest.approx(SALIB["mu_star_conf"], rel=0.01)  # SALib draws it

    subject = [Factor(name, "scaled", 1.0, "chosen") for name in "abcd"] + [
        SOME[-1],
        Factor("f", "scaled", 1.0, "chosen"),
    ]
    positions = design(256, [factor.name for factor in subject])
    a, b, c, d, e, _ = positions.T
    parts = indices(terms(subject, positions), 3 * a - 2 * b**2 + 4 * c * d + np.where(e >= 0.5, 1.5, 0.0) * a, 6)
    assert parts.r2 == pytest.approx(1)
    assert parts.first == pytest.approx(SALIB["first"], abs=2e-3)
    assert parts.total == pytest.approx(SALIB["total"], abs=2e-3)


def test_a_trajectory_moves_each_factor_once_by_one_step() -> None:
    path = trajectory(3, NAMES)
    assert sorted(path.moved) == [0, 1, 2, 3, 4]
    for step, factor in enumerate(path.moved):
        moved = path.points[step + 1] - path.points[step]
        assert np.abs(moved[factor]) == pytest.approx(DELTA)
        assert np.count_nonzero(moved) == 1
    assert set(np.round(path.points.ravel() * 3, 9)) <= {0, 1, 2, 3}
    assert {tuple(trajectory(number, NAMES).points[0]) for number in range(20)} != {tuple(path.points[0])}


def test_a_cell_that_is_undefined_somewhere_hides_the_effects_beside_it_and_no_other() -> None:
    path = trajectory(0, NAMES)
    outputs = path.points[:, 0].copy()
    outputs[2] = math.nan
    effects = elementary_effects(path, outputs, [False] * 5)
    assert {path.moved.index(factor) for factor in np.flatnonzero(np.isnan(effects))} == {1, 2}
    known = summary(np.array([1.0, math.nan, -3.0]))
    assert (known.count, known.mu, known.mu_star) == (2, -1.0, 2.0)
    assert summary(np.array([1.0, math.nan])).mu_star is None


def test_no_index_is_given_where_the_polynomial_says_too_little() -> None:
    positions = design(64, NAMES)
    polynomial = terms(SOME, positions)
    noise = np.array([hash((index, 7919)) % 1009 for index in range(64)], dtype=np.float64)
    poor = indices(polynomial, noise, 5)
    assert poor.r2 is not None
    assert poor.r2 < 0.8
    assert poor.first is None
    for outputs in (np.zeros(64), np.where(np.arange(64) == 5, math.nan, positions[:, 0])):
        assert indices(polynomial, outputs, 5) == indices(terms(SOME, positions[:10]), positions[:10, 0], 5)


# --- the study ---


def test_known_effects_are_found_again(found: Sensitivity) -> None:
    of = {effect.factor: effect for effect in found.effects if (effect.metric, effect.architecture) == CELLS[1]}
    assert (of["world.message"].mu, of["world.message"].mu_star) == pytest.approx(
        (6, 6), rel=1e-5
    )  # two doublings of 3
    assert (of["world.window_mean_s"].mu, of["world.window_mean_s"].mu_star) == pytest.approx((-2, 2), rel=1e-5)
    assert (of["load.task_sets"].mu, of["load.task_sets"].sigma) == pytest.approx(
        (0.25, 0), abs=1e-5
    )  # per set, not per whole range
    assert (of["structure.sync_period_us"].mu_star, of["structure.sync_period_us"].sigma) == (0, 0)
    seeds = of["world.context_rate_per_s"]  # differs between trajectories, so it has a spread
    assert seeds.sigma is not None
    assert seeds.sigma > 0.1
    assert of["world.message"].mu_margins == pytest.approx(6 / 0.05, rel=1e-5)


def test_the_parts_of_the_variance_are_those_of_the_law(found: Sensitivity) -> None:
    of = {effect.factor: effect for effect in found.effects if (effect.metric, effect.architecture) == CELLS[5]}
    assert of["world.message"].emulator_r2 == pytest.approx(1, abs=1e-6)
    whole = (
        9 / 3 + 1 / 3 + 0.25**2 / 4 + (0.125 * (EMULATOR_SEED % 3)) ** 2 / 3
    )  # uniform over two doublings, and a switch
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
    assert that_matter(about, 2) == (
        "structure.sync_period_us",
        "load.task_sets",
    )  # the second moves containment furthest, and any cell least
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
    partial.write_bytes(
        partial.read_bytes() + b'{"key":"cut of'
    )  # as a process leaves it that is killed while it writes
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


def test_what_another_program_left_is_not_gone_on_with(tmp_path: Path) -> None:
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


# --- the file and the figure ---


def test_a_file_is_read_as_it_was_written(file: Path, found: Sensitivity) -> None:
    assert table_of(found).equals(pq.read_table(file), check_metadata=True)
    assert len(found.effects) == len(CELLS) * len(NAMES)


def test_a_file_of_another_model_of_other_constants_or_of_another_kind_is_refused(file: Path, tmp_path: Path) -> None:
    own = write_constants(Constants())
    other = write_constants(setting(factors(), {"world.absence_s": 0.0}).constants)
    with pytest.raises(
        UsageError,
        match=r"found effects of model .*, expected those of model 0; make them again: fsar-ledger sensitivity",
    ):
        read_sensitivity(file, "0", own)
    with pytest.raises(UsageError, match=r"around other constants \(world.absence_s\)"):
        read_sensitivity(file, MODEL_VERSION, other)
    foreign, text = tmp_path / "foreign.parquet", tmp_path / "text.parquet"
    pq.write_table(pa.table({"a": [1]}), foreign)
    text.write_text("no parquet")
    renamed = pq.read_table(file).drop_columns(["mu"])
    pq.write_table(renamed, tmp_path / "column.parquet")
    assert METADATA in renamed.schema.metadata
    pq.write_table(pq.read_table(file).slice(1), tmp_path / "row.parquet")
    for path in (foreign, text, tmp_path / "column.parquet", tmp_path / "row.parquet"):
        with pytest.raises(UsageError, match="found no file of effects"):
            read_sensitivity(path, MODEL_VERSION, own)
    for path in (tmp_path / "nowhere.parquet", tmp_path):
        with pytest.raises(UsageError, match="found no such file, expected one of `fsar-ledger sensitivity"):
            read_sensitivity(path, MODEL_VERSION, own)


def test_a_report_has_the_effects_of_its_runs_or_says_how_to_make_them(found: Sensitivity) -> None:
    own = sha256(write_constants(Constants()).encode()).hexdigest()
    there = section(found, MODEL_VERSION, {own, "another load"})
    assert there.figure == heat_map(found)
    assert there.table is not None
    assert [row[0].printed for row in there.table.rows] == list(found.about.dozen)
    assert there.sentence.endswith("1 of them move nothing.")
    for given, model, digest, why in (
        (None, MODEL_VERSION, own, "was not looked at"),
        (found, "0", own, "expected those of model 0"),
        (found, None, own, "expected those of model unknown"),
        (found, MODEL_VERSION, "other", "around other constants"),
    ):
        missing = section(given, model, {digest})
        assert (missing.figure, missing.table) == (None, None)
        assert why in missing.sentence
        assert "fsar-ledger sensitivity --out FILE.parquet" in missing.sentence


def test_the_table_names_the_cell_that_each_of_the_dozen_moves_furthest(found: Sensitivity) -> None:
    rows = dozen(found)
    assert (
        [row["factor"] for row in rows]
        == list(found.about.dozen)
        == [name for name, furthest in reach(found).items() if furthest]
    )
    assert rows[0]["range"] == "(0.025 to 0.25) to (0.1 to 1)"
    assert rows[0]["metric"] in ("governance_locality", "audit_attributability")  # the smallest margins
    assert rows[0]["mu_star_margins"] == pytest.approx(6 / 0.02, rel=1e-5)


def test_the_heat_map_is_the_same_again_and_another_where_an_effect_is_another(found: Sensitivity) -> None:
    drawn = heat_map(found)
    assert drawn == heat_map(found)
    for other in (0.3, None):
        effects = [
            msgspec.structs.replace(one, mu_star_margins=other) if one.factor == "world.message" else one
            for one in found.effects
        ]
        assert heat_map(Sensitivity(found.about, tuple(effects))) != drawn


@pytest.mark.slow
def test_a_small_study_of_the_simulator_is_the_same_with_any_number_of_workers(tmp_path: Path) -> None:
    subject = tuple(
        factor
        for factor in factors()
        if factor.name in ("structure.sync_period_us", "world.floor_teams", "world.window_mean_s")
    )
    made = [sensitivity(tmp_path / f"{workers}.parquet", Size(2, 1, 0), workers, subject=subject) for workers in (1, 2)]
    assert made[0] == made[1]
    assert (tmp_path / "1.parquet").read_bytes() == (tmp_path / "2.parquet").read_bytes()
    moved = {(effect.factor, effect.architecture) for effect in made[0].effects if effect.mu_star}
    assert moved == {
        ("structure.sync_period_us", "cfc"),
        *(("world.window_mean_s", architecture) for architecture in ARCHITECTURES),
    }


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--out", "effects.csv"), "--out effects.csv: found a file name that ends in '.csv', expected .parquet"),
        (("--out", "effects.parquet", "--runs", "0"), "--runs 0: expected 1 to 9999"),
        (("--out", "effects.parquet", "--trajectories", "1"), "--trajectories 1: expected 2 to 9999"),
        (("--out", "effects.parquet", "--points", "-1"), "--points -1: expected 0 to 65536"),
    ],
)
def test_a_call_that_cannot_be_carried_out_is_one_message(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], said: str
) -> None:
    assert run(["sensitivity", *arguments]) == 2
    assert capsys.readouterr().err == f"fsar-ledger: {said}\n"
    assert not list(Path().glob("effects*"))
