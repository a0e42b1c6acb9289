"""Fits world laws and structural durations to the paper's results table, as registered in `reports/registration.toml`.

The fit is by nonlinear least squares on the 24 cells of `results.csv`, each difference in margins of its metric, with
common random numbers: every trial meets the same worlds. Points of a Sobol sequence over the ranges are screened first.
From each of the best of them a bounded trust region search (`scipy.optimize.least_squares`) takes some steps on few
runs, and from the end of the best search another continues with more runs. A weak pull to the middle of each range
settles what the cells leave open.

No other table of the paper is read. A fit is not evidence: the record says how many directions of the constants the 24
cells identify at all. The constants that it does not touch are not independent of the cells either: `constants.py` says
of each whether it was chosen after fits.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from fsar_ledger.api.names import Place
from fsar_ledger.api.workload import workers_of
from fsar_ledger.base.progress import Progress
from fsar_ledger.base.workers import WorkerPool
from fsar_ledger.designs.constants import Constants
from fsar_ledger.metrics import study_results
from fsar_ledger.metrics.registration import Free, registration
from fsar_ledger.metrics.results import MetricRow, metric_rows
from fsar_ledger.metrics.study_results import METRICS, Calibration, Direction, Objective, Parameter, Residual, rules
from fsar_ledger.metrics.verdicts import published
from fsar_ledger.runtime.experiment import Experiment
from fsar_ledger.runtime.simulation import ARCHITECTURES, MODEL_VERSION, SCENARIOS

from .evaluations import measured, simulated
from .factor_effects import Matrix, Vector
from .result import require_out, write

REGISTERED = registration()
FREE, PLAN = REGISTERED.free, REGISTERED.fit
STEP = 0.1  # the step of the central differences of the Jacobian, in half ranges


def with_values(values: Sequence[float]) -> Constants:
    """Return the constants with these values for the free ones, in the order of the registration."""
    changes: dict[str, dict[str, Any]] = {"world": {}, "structure": {}}
    for one, value in zip(FREE, values, strict=True):
        part, _, name = one.name.partition(".")
        changes[part][name] = rounded(value) if part == "world" else int(rounded(value))
    base = Constants()
    replace = msgspec.structs.replace
    return Constants(replace(base.world, **changes["world"]), replace(base.structure, **changes["structure"]))


def at(point: Vector) -> Constants:
    """Return the constants at a point: 0 is the middle of each range, -1 and 1 are its ends, on a logarithmic scale."""
    return with_values(
        [
            one.range.middle * (one.range.high / one.range.middle) ** float(place)
            for one, place in zip(FREE, point, strict=True)
        ]
    )


def rounded(value: float) -> float:
    """Return the value with three significant digits; the data do not determine more."""
    return float(f"{value:.3g}")


def distances(rows: list[MetricRow]) -> Vector:
    """Return (ours - paper) of the 24 cells in margins, row by row; an undefined cell is one margin away."""
    printed, margins = published(), REGISTERED.margins
    cells = [
        (row.mean, printed[row.metric, row.architecture].value, margins[row.metric])
        for row in rows
        if row.architecture is not None
    ]
    return np.array([1.0 if mean is None else (mean - paper) / margin for mean, paper, margin in cells])


def distances_at(task: tuple[Vector, int]) -> Vector:
    """Return the distances at a point on this many runs; called in a worker."""
    point, runs = task
    return distances(measured(at(point), PLAN.seed, runs))


class Judge:
    """Judges points on several processes and counts them; `most` is the most that the registered plan asks for."""

    def __init__(self, pool: Executor, progress: Progress | None) -> None:
        self.most = 1 + PLAN.screened + (PLAN.starts * PLAN.rough_steps + PLAN.most_steps) * (2 * len(FREE) + 1)
        self.evaluations = 0
        self._pool = pool
        self._progress = progress

    def each(self, points: list[Vector], runs: int) -> list[Vector]:
        """Return the distances at each point, on this many runs a scenario and architecture."""
        found = []
        for distance in self._pool.map(distances_at, [(point, runs) for point in points]):
            found.append(distance)
            self.evaluations += 1
            if self._progress is not None:
                self._progress(self.evaluations, self.most)
        return found


class Search(msgspec.Struct, frozen=True):
    """Where a search began and ended, on how many runs, the objective at both points, and the slopes at its end."""

    start: Vector
    point: Vector
    runs: int
    begun: float
    reached: float
    slopes: Matrix


def calibrate(out: Place, *, workers: int | None = None, progress: Progress | None = None) -> None:
    """Fit the constants again as registered, and write the record; takes the better part of an hour.

    Raises:
        UsageError: the file lies inside a ledger.
        WriteFailed: the file cannot be written.
    """
    out, workers = Path(out), workers_of(workers)
    require_out(out)
    with WorkerPool(workers) as pool:
        judge = Judge(pool, progress)
        points = screened()
        scores = [
            objective(found, point) for found, point in zip(judge.each(points, PLAN.screened_runs), points, strict=True)
        ]
        rough = [
            search(judge, points[index], PLAN.rough_runs, PLAN.rough_steps)
            for index in np.argsort(scores, kind="stable")[: PLAN.starts]
        ]
        best = min(rough, key=lambda one: one.reached)
        last = search(judge, best.point, PLAN.runs, PLAN.most_steps)
    accepted = Experiment(ARCHITECTURES, SCENARIOS, PLAN.judged_runs, PLAN.seed, constants=at(last.point))
    with simulated(accepted, workers) as database:
        rows = metric_rows(database)
    write(out, _result(best.start, (*rough, last), rows, judge.evaluations))


def search(judge: Judge, start: Vector, runs: int, most_steps: int) -> Search:
    """Go downhill from a point, within the ranges, until a step gains too little or all steps are used."""
    from scipy.optimize import least_squares

    tried: list[float] = []

    def residuals(point: Vector) -> Vector:
        """Return what the search squares and sums: distances in margins, and the point in half ranges."""
        (found,) = judge.each([point], runs)
        tried.append(objective(found, point))
        return np.concatenate([found, point])

    def jacobian(point: Vector) -> Matrix:
        return np.vstack([slopes(lambda points: judge.each(points, runs), point), np.eye(len(point))])

    found = least_squares(
        residuals, start, jac=jacobian, bounds=(-1.0, 1.0), ftol=PLAN.enough, xtol=None, gtol=None, max_nfev=most_steps
    )
    return Search(
        start, np.asarray(found.x), runs, tried[0], 2.0 * float(found.cost), np.asarray(found.jac)[: -len(FREE)]
    )


# See docs/decisions/fit-is-registered-first.md.
def screened() -> list[Vector]:
    """Return the points that are judged first: the middle of all ranges, and a Sobol sequence over them."""
    from scipy.stats.qmc import Sobol

    unit = Sobol(len(FREE), rng=PLAN.seed).random(PLAN.screened)
    return [np.zeros(len(FREE)), *(np.asarray(2.0 * one - 1.0) for one in unit)]


def objective(found: Vector, point: Vector) -> float:
    """Return what the fit minimises. Registered in `[fit]`."""
    return float(found @ found + point @ point)


def slopes(each: Callable[[list[Vector]], list[Vector]], point: Vector) -> Matrix:
    """Return the derivative of each distance by each coordinate of the point.

    They are central differences within the ranges, on the same worlds.
    """
    ups = [np.clip(point + shift, -1.0, 1.0) for shift in np.eye(len(point)) * STEP]
    downs = [np.clip(point - shift, -1.0, 1.0) for shift in np.eye(len(point)) * STEP]
    found = each(ups + downs)
    columns = [
        (high - low) / float((up - down).sum())
        for high, low, up, down in zip(found[: len(point)], found[len(point) :], ups, downs, strict=True)
    ]
    return np.asarray(np.array(columns).T)


def _result(start: Vector, searches: Sequence[Search], rows: list[MetricRow], evaluations: int) -> Calibration:
    last = searches[-1]
    constants, begun = at(last.point), at(start)
    _, singular, directions = np.linalg.svd(last.slopes, full_matrices=False)
    printed = published()
    return Calibration(
        objective=Objective(
            PLAN.rule,
            start=round(objective(distances(measured(begun, PLAN.seed, PLAN.runs)), start), 3),
            accepted=round(objective(distances(rows), last.point), 3),
        ),
        seeds=[PLAN.seed],
        runs_per_scenario=PLAN.judged_runs,
        evaluations=evaluations,
        model_version=MODEL_VERSION,
        rules=rules(METRICS),
        command=Calibration.MADE_BY,
        parameters=[_parameter(one, begun, constants, directions, singular, index) for index, one in enumerate(FREE)],
        residuals=[
            Residual(
                metric=row.metric,
                architecture=row.architecture or "",
                paper=printed[row.metric, row.architecture or ""].value,
                ours=row.mean,
                distance_margins=round(float(distance), 3),
            )
            for row, distance in zip(rows, distances(rows), strict=True)
        ],
        directions=[
            Direction(
                singular_value=round(float(value), 3),
                identified=bool(value > 1),
                weights={FREE[index].name: round(float(row[index]), 2) for index in np.argsort(-np.abs(row))[:4]},
            )
            for value, row in zip(singular, directions, strict=True)
        ],
        searches=[
            study_results.Search(
                runs_per_scenario=one.runs,
                start=round(one.begun, 3),
                reached=round(one.reached, 3),
                ended_at={free.name: _value(at(one.point), free) for free in FREE},
            )
            for one in searches
        ],
    )


def _parameter(
    free: Free, begun: Constants, constants: Constants, directions: Matrix, singular: Vector, index: int
) -> Parameter:
    """Return the result for a constant, which is identified when the data determine it better than its range does."""
    information = float(((singular * directions[:, index]) ** 2).sum())
    return Parameter(
        name=free.name,
        unit=free.range.unit,
        low=free.range.low,
        high=free.range.high,
        start=_value(begun, free),
        accepted=_value(constants, free),
        meaning=free.meaning,
        identified=information > 1,
    )


def _value(constants: Constants, free: Free) -> float:
    part, _, name = free.name.partition(".")
    return getattr(getattr(constants, part), name)  # type: ignore[no-any-return]
