"""The fit reads the tables that it names, and the package's constants are those that it accepted."""

import json
import sys
from concurrent.futures import ThreadPoolExecutor
from importlib.resources import files
from pathlib import Path

import msgspec
import numpy as np
import pytest

from fsar_ledger.base.errors import WriteFailed
from fsar_ledger.designs.constants import Constants, Structure, WorldConstants
from fsar_ledger.metrics.registration import registration
from fsar_ledger.runtime.simulation import MODEL_VERSION
from fsar_ledger.studies import calibration
from fsar_ledger.studies.calibration import (
    FREE,
    PLAN,
    at,
    calibrate,
    distances,
    objective,
    rounded,
    screened,
    slopes,
    with_values,
)
from fsar_ledger.studies.evaluations import measured
from tests.running import ran

RECORD = json.loads(files("fsar_ledger.reports").joinpath("calibration.json").read_text())


def test_the_constants_are_those_that_the_recorded_fit_accepted() -> None:
    accepted = {parameter["name"]: parameter["accepted"] for parameter in RECORD["parameters"]}
    assert list(accepted) == [free.name for free in FREE]
    assert with_values(list(accepted.values())) == Constants()


def test_the_calibration_seed_is_the_registered_one_and_none_that_is_published_or_predicted() -> None:
    assert RECORD["seeds"] == [PLAN.seed]
    assert PLAN.seed not in (42, 57721, 61803)


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
from fsar_ledger.studies import calibration, evaluations
from fsar_ledger.designs.constants import Constants
assert len(calibration.distances(evaluations.measured(Constants(), 1, 1))) == 24
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
        assert at(np.full(count, place)) == with_values([getattr(free.range, end) for free in FREE])


def test_the_objective_adds_squared_margins_and_squared_half_ranges() -> None:
    assert objective(np.array([3.0, 4.0]), np.array([0.5])) == pytest.approx(25.25)


def test_a_distance_is_a_difference_in_margins() -> None:
    rows = measured(Constants(), PLAN.seed, 1)
    success = next(row for row in rows if (row.metric, row.architecture) == ("coordination_success", "dhma"))
    found = dict(zip(((row.metric, row.architecture) for row in rows), distances(rows), strict=True))
    assert len(found) == 24
    assert success.mean is not None
    assert found["coordination_success", "dhma"] == pytest.approx((success.mean - 0.84) / 0.05)


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


@pytest.mark.slow
def test_the_record_of_a_small_fit_is_complete_and_the_same_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = msgspec.structs.replace(
        PLAN, screened=2, screened_runs=1, starts=2, rough_runs=1, rough_steps=1, runs=1, judged_runs=1, most_steps=1
    )
    for name, value in {"PLAN": plan, "FREE": FREE[:2], "WorkerPool": ThreadPoolExecutor}.items():
        monkeypatch.setattr(calibration, name, value)
    told: list[tuple[int, int]] = []
    for name in ("one.json", "two.json"):
        calibrate(tmp_path / name, workers=1, progress=lambda *done: told.append(done))
    assert (tmp_path / "one.json").read_bytes() == (tmp_path / "two.json").read_bytes()
    assert told[-1] == (18, 18)
    record = json.loads((tmp_path / "one.json").read_text())
    assert record["objective"]["accepted"] <= record["objective"]["start"]
    assert len(record["searches"]) == 3
    assert record["searches"][-1]["start"] == min(search["reached"] for search in record["searches"][:-1])
    assert len(record["residuals"]) == 24
    assert [parameter["name"] for parameter in record["parameters"]] == [free.name for free in FREE[:2]]
