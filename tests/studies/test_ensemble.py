"""Points around the fit are drawn as its slopes leave them open, and a point is plausible if every cell is."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from fsar_ledger.base.errors import UsageError
from fsar_ledger.designs.constants import write_constants
from fsar_ledger.metrics.registration import Registration, Sample, SampleAround, registration
from fsar_ledger.metrics.robustness import CellSpread, Ensemble
from fsar_ledger.metrics.study_results import Calibration, Parameter, Residual, encoded, read
from fsar_ledger.metrics.verdicts import MARGINS, published
from fsar_ledger.runtime.simulation import MODEL_VERSION
from fsar_ledger.studies import robustness as study
from fsar_ledger.studies.evaluations import CELLS, Answer, Question
from fsar_ledger.studies.factors import FREE, constants_at, point_of, value_of
from fsar_ledger.studies.robustness import ensemble, normal_sample, points_around

SAMPLE = SampleAround(seed=5, size=256, runs=1, spread=1.0)


def fit(steepness: float, distance: float = 0.0) -> Calibration:
    """A fit in the middle of all ranges, whose first cells have a slope along one constant each."""
    slopes = steepness * np.eye(len(CELLS), len(FREE))
    return Calibration(
        model_version=MODEL_VERSION,
        parameters=[
            Parameter(name=free.name, unit="", start=0.0, accepted=free.range.middle, identified=True) for free in FREE
        ],
        residuals=[
            Residual(metric, architecture, 0.0, 0.0, distance, tuple(row))
            for (metric, architecture), row in zip(CELLS, slopes.tolist(), strict=True)
        ],
    )


def test_a_sample_of_the_normal_distribution_has_its_precision() -> None:
    precision = np.array([[4.0, 1.0], [1.0, 2.0]])
    whole = np.eye(len(FREE))
    whole[:2, :2] = precision
    points = normal_sample(whole, Sample(seed=5, size=4096, runs=1))
    assert np.cov(points.T)[:2, :2] == pytest.approx(np.linalg.inv(precision), abs=0.01)
    assert points.mean(axis=0) == pytest.approx(0, abs=0.01)


def test_points_spread_as_the_slopes_leave_them_open_and_stay_within_the_ranges() -> None:
    (narrow, clipped), (wide, clipped_wide) = points_around(fit(10.0), SAMPLE), points_around(fit(0.0), SAMPLE)
    assert np.array(narrow).std(axis=0) == pytest.approx((1 + 100.0) ** -0.5, rel=0.05)
    assert (clipped, round(clipped_wide, 1)) == (0.0, 0.3), "the prior reaches beyond the ranges as a normal law does"
    assert np.abs(wide).max() == 1.0
    half, _ = points_around(fit(10.0), msgspec.structs.replace(SAMPLE, spread=0.5))
    assert np.array(half) == pytest.approx(np.array(narrow) / 2)


def test_a_cell_that_the_fit_misses_says_less_about_the_constants() -> None:
    at, off = (np.array(points_around(fit(40.0, distance), SAMPLE)[0]).std() for distance in (0.0, 5.0))
    assert off == pytest.approx((1 + 1600.0 * 26**-1.5) ** -0.5, rel=0.1)
    assert off > 3 * at


def moved(question: Question) -> Answer:
    """The first constant moves the first cell by a margin for each tenth of its half range, the others are met."""
    point = point_of([value_of(question.setting.constants, free) for free in FREE])
    return tuple(
        published()[cell].value + (MARGINS[cell[0]] * 10 * float(point[0]) if at == 0 else 0.0)
        for at, cell in enumerate(CELLS)
    )


def never(question: Question) -> Answer:
    """As `moved`, with a cell that is never met, and one that is undefined."""
    return (*moved(question)[:-2], published()[CELLS[-2]].value + 1.0, None)


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> Registration:
    metric, architecture = CELLS[0]
    other = msgspec.structs.replace(
        registration(), ensemble=SAMPLE, discrepancy={metric: {architecture: MARGINS[metric]}}
    )
    monkeypatch.setattr(study, "registration", lambda: other)
    return other


def made(folder: Path, ask: object = moved) -> Ensemble:
    (folder / "fit.json").write_bytes(encoded(fit(10.0)))
    return ensemble(folder / "ensemble.json", folder / "fit.json", workers=1, ask=ask)  # type: ignore[arg-type]


def cell(found: Ensemble, at: int) -> CellSpread:
    return found.cells[at]


@pytest.mark.usefixtures("registered")
def test_a_point_is_plausible_if_every_cell_is_within_margin_and_discrepancy(tmp_path: Path) -> None:
    found = made(tmp_path)
    first = cell(found, 0)
    assert first.discrepancy == first.margin
    assert found.plausible == first.within_tolerance
    assert found.plausible / SAMPLE.size == pytest.approx(0.95, abs=0.03), "two standard deviations of the constant"
    assert first.within_margin / SAMPLE.size == pytest.approx(0.68, abs=0.05), "one"
    assert first.plausible_within_margin == first.within_margin
    assert first.only_miss == SAMPLE.size - found.plausible
    assert all(one.within_margin == SAMPLE.size for one in found.cells[1:])
    assert {one.neither for one in found.signs} == {0}
    assert {one.same + one.other for one in found.signs} == {found.plausible}
    assert f"{found.plausible} of {SAMPLE.size} points are plausible" in found.summary()
    assert read(tmp_path / "ensemble.json", Ensemble) == found
    assert found.parameters == write_constants(constants_at(np.zeros(len(FREE)))), "around the fit that was given"


@pytest.mark.usefixtures("registered")
def test_where_no_point_is_plausible_it_is_said_and_all_points_count(tmp_path: Path) -> None:
    found = made(tmp_path, never)
    assert found.plausible == 0
    assert found.summary().startswith(f"no point of {SAMPLE.size} is plausible: signs and ranks are of all points")
    assert cell(found, -1).undefined == SAMPLE.size
    assert (cell(found, -1).median, cell(found, -1).within_margin) == (None, 0)
    assert {one.same + one.other + one.neither for one in found.signs} == {SAMPLE.size}


def test_a_fit_without_slopes_or_of_another_model_is_refused(tmp_path: Path) -> None:
    whole = fit(1.0)
    for other in (
        msgspec.structs.replace(whole, model_version="0"),
        msgspec.structs.replace(whole, parameters=whole.parameters[1:]),
        msgspec.structs.replace(whole, residuals=whole.residuals[1:]),
        msgspec.structs.replace(whole, residuals=[msgspec.structs.replace(one, slopes=()) for one in whole.residuals]),
    ):
        (tmp_path / "fit.json").write_bytes(encoded(other))
        with pytest.raises(UsageError, match=r"fit\.json: found no fit of model .* study run calibration"):
            ensemble(tmp_path / "ensemble.json", tmp_path / "fit.json", workers=1, ask=moved)


def test_discrepancies_are_of_cells_that_there_are_and_none_is_negative() -> None:
    for metric, of_metric in registration().discrepancy.items():
        assert {(metric, architecture) for architecture in of_metric} <= set(CELLS)
        assert min(of_metric.values()) >= 0
    assert all(registration().tolerance(*one) >= MARGINS[one[0]] for one in CELLS)
