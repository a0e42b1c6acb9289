"""The fit reads the tables that it names, and the package's constants are those that it accepted."""

import json
import sys
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy.optimize import minimize

from fsar_ledger.base.errors import WriteFailed
from fsar_ledger.designs.constants import Constants, Structure, WorldConstants
from fsar_ledger.metrics.registration import registration
from fsar_ledger.metrics.verdicts import MARGINS, published
from fsar_ledger.runtime.simulation import MODEL_VERSION
from fsar_ledger.studies import calibration
from fsar_ledger.studies.calibration import (
    PLAN,
    calibrate,
    distances,
    losses,
    objective,
    screened,
    search,
    slopes,
    weighted_slopes,
)
from fsar_ledger.studies.evaluations import CELLS, Answer, Question, evaluate, question_at
from fsar_ledger.studies.factor_effects import Vector
from fsar_ledger.studies.factors import FREE, constants_at, point_of, rounded, value_of, with_values
from fsar_ledger.studies.predictions import SEEDS
from tests.running import ran

RECORD = json.loads(files("fsar_ledger.reports").joinpath("calibration.json").read_text())


def test_the_constants_are_those_that_the_recorded_fit_accepted() -> None:
    accepted = {parameter["name"]: parameter["accepted"] for parameter in RECORD["parameters"]}
    assert list(accepted) == [free.name for free in FREE]
    assert with_values(list(accepted.values())) == Constants()


def test_the_calibration_seed_is_the_registered_one_and_none_that_is_published_or_predicted() -> None:
    assert RECORD["seeds"] == [PLAN.seed]
    assert PLAN.seed not in (42, *registration().verdicts.seeds, *SEEDS)


def test_the_fit_is_to_the_model_of_this_release() -> None:
    assert RECORD["model_version"] == registration().model_version == MODEL_VERSION


def test_the_free_constants_are_those_that_say_that_they_are_fitted() -> None:
    said = {
        f"{part}.{field.name}"
        for part, group in (("world", WorldConstants), ("structure", Structure))
        for field in msgspec.inspect.type_info(group).fields  # type: ignore[attr-defined]
        if getattr(field.type, "extra", None) == {"from": "fitted"}
    }
    assert {free.name for free in FREE} == said


def test_every_accepted_constant_lies_in_its_registered_range() -> None:
    for parameter, free in zip(RECORD["parameters"], FREE, strict=True):
        assert free.range.low <= parameter["accepted"] <= free.range.high


OPENED = """
import sys
opened = set()
sys.addaudithook(lambda name, arguments: opened.add(str(arguments[0])) if name == "open" else None)
import numpy
from fsar_ledger.studies import calibration, evaluations
middle = numpy.zeros(len(calibration.FREE))
assert len(calibration.distances(evaluations.evaluate(evaluations.question_at(middle, 1, 1)))) == 24
print(*sorted(name.rpartition("/")[2].removesuffix(".csv") for name in opened if name.endswith(".csv")))
"""


@pytest.mark.slow
def test_the_fit_reads_the_table_that_it_aims_at_and_no_other() -> None:
    done = ran([sys.executable, "-c", OPENED], check=True)
    assert done.stdout.split() == [PLAN.aims_at]


def test_values_have_three_digits() -> None:
    assert [rounded(value) for value in (0.022749, 11.4999, 6_512_345.0)] == [0.0227, 11.5, 6_510_000.0]


def test_a_point_is_the_middle_of_each_range_or_one_of_its_ends() -> None:
    count = len(FREE)
    for place, end in ((-1.0, "low"), (0.0, "middle"), (1.0, "high")):
        assert constants_at(np.full(count, place)) == with_values([getattr(free.range, end) for free in FREE])


def test_values_are_found_again_at_their_point() -> None:
    point = np.linspace(-1.0, 1.0, len(FREE))
    assert point_of([value_of(constants_at(point), free) for free in FREE]) == pytest.approx(point, abs=0.01)


def test_the_objective_adds_a_robust_loss_of_margins_and_squared_half_ranges() -> None:
    found, point = np.zeros(24), np.array([0.5])
    found[:2] = 3.0, -0.01
    assert objective(found, point) == pytest.approx(2 * (10**0.5 - 1) + 0.01**2 + 0.25, abs=1e-6)


def test_a_cell_far_away_counts_in_proportion_to_its_distance() -> None:
    far, further = (objective(np.eye(24)[0] * one, np.zeros(1)) for one in (100.0, 200.0))
    assert further / far == pytest.approx(2, rel=0.02)


def test_the_derivatives_of_the_losses_are_those_of_the_losses_and_ranges_stay_squared() -> None:
    squares, step = np.linspace(0.1, 9.0, 24 + 3), 1e-5
    values, first, second = losses(squares)
    for derivative, of in ((first, 0), (second, 1)):
        assert derivative == pytest.approx(
            (losses(squares + step)[of] - losses(squares - step)[of]) / (2 * step), abs=1e-8
        )
    assert values[24:] == pytest.approx(squares[24:])
    assert values[:24] == pytest.approx(2 * (np.sqrt(1 + squares[:24]) - 1))


STEEPNESS = np.random.default_rng(5).normal(size=(24, len(FREE)))


class Linear:
    """Judges points in a linear world whose cells all can be met but one, which lies `miss` margins away."""

    def __init__(self, truth: Vector, miss: float = 0.0) -> None:
        self._truth, self._miss = truth, miss * np.eye(24)[7]

    def each(self, points: Sequence[Vector], runs: int) -> list[Vector]:
        return [STEEPNESS @ (point - self._truth) + self._miss for point in points]

    def objective(self, point: Vector) -> float:
        return objective(self.each([point], 1)[0], point)


def test_a_cell_that_cannot_be_met_hardly_moves_the_constants() -> None:
    """Under squares it would move them by as much as it is away; a search ends at the minimum of the objective."""
    truth, start = np.random.default_rng(6).uniform(-0.5, 0.5, len(FREE)), np.zeros(len(FREE))
    ends = [search(Linear(truth, miss), start, 1, 50) for miss in (0.0, 30.0, 300.0)]  # type: ignore[arg-type]
    near, far = (float(np.abs(one.point - ends[0].point).max()) for one in ends[1:])
    squares = np.linalg.solve(STEEPNESS.T @ STEEPNESS + np.eye(len(FREE)), STEEPNESS[7] * 300.0)
    assert max(near, far) < 0.6, "however far away it is"
    assert np.abs(squares).max() > 3.0
    for one, miss in zip(ends, (0.0, 30.0, 300.0), strict=True):
        world = Linear(truth, miss)
        assert one.slopes == pytest.approx(STEEPNESS)
        assert one.reached == pytest.approx(world.objective(one.point))
        least = minimize(world.objective, one.point, bounds=[(-1, 1)] * len(FREE))
        assert one.reached == pytest.approx(least.fun, rel=0.03), "a search ends where a step gains too little"


def test_weighted_slopes_give_the_curvature_of_the_objective() -> None:
    found, step = np.random.default_rng(7).normal(size=24) * 2, 1e-4
    matrix = weighted_slopes(STEEPNESS, found)
    for along in np.eye(len(FREE)):
        low, mid, high = (objective(found + STEEPNESS @ along * one, np.zeros(1)) for one in (-step, 0.0, step))
        assert (high - 2 * mid + low) / step**2 / 2 == pytest.approx(along @ matrix.T @ matrix @ along, rel=1e-3)


def test_a_distance_is_a_difference_in_margins_and_an_undefined_cell_is_one_margin_away() -> None:
    means: list[float | None] = [published()[cell].value + 2 * MARGINS[cell[0]] for cell in CELLS]
    means[3] = None
    assert distances(tuple(means)) == pytest.approx([2.0] * 3 + [1.0] + [2.0] * 20)


def test_slopes_are_those_of_a_linear_world_and_keep_within_the_ranges() -> None:
    matrix = np.arange(6.0).reshape(3, 2)
    asked: list[np.ndarray[tuple[int], np.dtype[np.float64]]] = []

    def each(
        points: list[np.ndarray[tuple[int], np.dtype[np.float64]]],
    ) -> list[np.ndarray[tuple[int], np.dtype[np.float64]]]:
        asked.extend(points)
        return [matrix @ point for point in points]

    assert slopes(each, np.array([1.0, -0.97])) == pytest.approx(matrix)
    assert np.abs(asked).max() <= 1.0


def test_the_screening_begins_in_the_middle_and_covers_every_range() -> None:
    points = np.array(screened())
    assert points.shape == (PLAN.screened + 1, len(FREE))
    assert not points[0].any()
    assert (points.min(axis=0) < -0.98).all()
    assert (points.max(axis=0) > 0.98).all()


def test_a_path_that_cannot_be_written_is_refused_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for out in (tmp_path / "file" / "record.json", tmp_path):
        with pytest.raises(WriteFailed, match="cannot be written"):
            calibrate(out)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def small(question: Question) -> Answer:
    """The middle of the ranges is as the paper says, and every constant moves every cell."""
    point = point_of([value_of(question.setting.constants, free) for free in FREE])
    return tuple(published()[cell].value + MARGINS[cell[0]] * float(point.sum()) for cell in CELLS)


@pytest.mark.slow
def test_the_record_of_a_small_fit_is_complete_and_an_interruption_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = msgspec.structs.replace(
        PLAN, screened=4, screened_runs=1, starts=2, rough_runs=1, rough_steps=2, runs=1, judged_runs=1, most_steps=1
    )
    monkeypatch.setattr(calibration, "PLAN", plan)
    asked: list[str] = []

    def breaks(question: Question) -> Answer:
        if len(asked) == 20:
            raise KeyboardInterrupt
        asked.append(question.key)
        return small(question)

    calibrate(tmp_path / "one.json", workers=1, ask=small)
    with pytest.raises(KeyboardInterrupt):
        calibrate(tmp_path / "two.json", workers=1, ask=breaks)
    asked.append("goes on")
    calibrate(tmp_path / "two.json", workers=1, ask=breaks)
    assert (tmp_path / "one.json").read_bytes() == (tmp_path / "two.json").read_bytes()
    assert len(asked) == len(set(asked))
    record = json.loads((tmp_path / "one.json").read_text())
    assert record["evaluations"] == len(asked) - 1
    assert len(record["searches"]) == 3
    assert record["searches"][-1]["start"] == min(search["reached"] for search in record["searches"][:-1])
    assert [len(residual["slopes"]) for residual in record["residuals"]] == [len(FREE)] * 24
    assert [parameter["name"] for parameter in record["parameters"]] == [free.name for free in FREE]


@pytest.mark.slow
def test_an_evaluation_is_of_the_constants_at_its_point() -> None:
    point = np.zeros(len(FREE))
    assert evaluate(question_at(point, 3, 1)) == evaluate(question_at(point, 3, 1))
    other = point.copy()
    other[0] = 0.5
    assert evaluate(question_at(other, 3, 1)) != evaluate(question_at(point, 3, 1))
