"""Fits world laws and structural durations to the paper's results table, as registered in `reports/registration.toml`.

The fit is by nonlinear least squares on the 24 cells of `results.csv`, each difference in margins of its metric, with
common random numbers: every trial meets the same worlds. The loss is robust, so that a cell that the model cannot
reproduce does not move the constants on which the others depend. Points of a Sobol sequence over the ranges are
screened first. From each of the best of them a bounded trust region search (`scipy.optimize.least_squares`) takes some
steps on few runs, and from the end of the best search another continues with more runs. A weak pull to the middle of
each range settles what the cells leave undetermined.

No other table of the paper is read. A fit is not evidence: the record gives the number of directions of the constants
that the 24 cells identify at all. The constants outside the fit are not independent of the cells either:
`constants.py` notes for each whether it was chosen after fits.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec
import numpy as np

from fsar_ledger.api.names import Place
from fsar_ledger.api.verbs import workers_of
from fsar_ledger.base.progress import Progress
from fsar_ledger.designs.constants import Constants
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.metrics import study_results
from fsar_ledger.metrics.registration import Free, registration
from fsar_ledger.metrics.results import metric_rows
from fsar_ledger.metrics.study_results import METRICS, Calibration, Direction, Objective, Parameter, Residual, rules
from fsar_ledger.metrics.verdicts import MARGINS, published
from fsar_ledger.runtime.experiment import Experiment
from fsar_ledger.runtime.simulation import MODEL_VERSION, SCENARIOS

from .evaluations import CELLS, Answer, Evaluate, Evaluations, evaluate, evaluating, means_of, question_at, simulated
from .factor_effects import Matrix, Vector
from .factors import FREE, constants_at, points_over_ranges, value_of
from .result import RESUME_ADVICE, write

PLAN = registration().fit
STEP = 0.1  # the step of the central differences of the Jacobian, in half ranges


def distances(means: Answer) -> Vector:
    """Return (ours - paper) of the 24 cells in margins; an undefined cell is one margin away."""
    return np.array(
        [
            1.0 if mean is None else (mean - published()[cell].value) / MARGINS[cell[0]]
            for cell, mean in zip(CELLS, means, strict=True)
        ]
    )


class Judge:
    """Judges points, within the number of evaluations of the registered plan."""

    def __init__(self, evaluations: Evaluations) -> None:
        self._evaluations = evaluations
        most_steps = PLAN.starts * PLAN.rough_steps + PLAN.most_steps
        evaluations.expected = 1 + PLAN.screened + most_steps * (2 * len(FREE) + 1)

    def each(self, points: Sequence[Vector], runs: int) -> list[Vector]:
        """Return the distances at each point, on `runs` runs of each scenario and architecture."""
        return [*map(distances, self._evaluations.answers([question_at(point, PLAN.seed, runs) for point in points]))]


class Search(msgspec.Struct, frozen=True):
    """A search: where it began and ended, its runs, the objective at both points, and the slopes at its end."""

    start: Vector
    point: Vector
    runs: int
    begun: float
    reached: float
    slopes: Matrix


def calibrate(
    out: Place, *, workers: int | None = None, progress: Progress | None = None, ask: Evaluate = evaluate
) -> None:
    """Fit the constants again as registered, and write the record; takes the better part of an hour.

    An interrupted fit continues from the answers kept beside it.

    Raises: As `evaluating`; WriteFailed, WorkerDied.
    """
    out, workers = Path(out), workers_of(workers)
    with evaluating(out, workers, progress, ask) as evaluations:
        judge = Judge(evaluations)
        points = screened()
        scores = [
            objective(differences, point)
            for differences, point in zip(judge.each(points, PLAN.screened_runs), points, strict=True)
        ]
        rough = [
            search(judge, points[index], PLAN.rough_runs, PLAN.rough_steps)
            for index in np.argsort(scores, kind="stable")[: PLAN.starts]
        ]
        best = min(rough, key=lambda result: result.reached)
        last = search(judge, best.point, PLAN.runs, PLAN.most_steps)
        (begun,) = judge.each([best.start], PLAN.runs)
        accepted = Experiment(
            PAPER_ARCHITECTURES, SCENARIOS, PLAN.judged_runs, PLAN.seed, constants=constants_at(last.point)
        )
        with simulated([accepted], workers) as database:
            means = means_of(metric_rows(database))
        record = _result(objective(begun, best.start), best.start, (*rough, last), means)
        write(
            out,
            msgspec.structs.replace(record, evaluations=evaluations.count, cpu_minutes=evaluations.cpu_minutes),
            RESUME_ADVICE,
        )


def search(judge: Judge, start: Vector, runs: int, most_steps: int) -> Search:
    """Search downhill from a point, within the ranges, until a step gains too little or all steps are used."""
    from scipy.optimize import least_squares

    tried: list[float] = []
    steepness: list[Matrix] = []

    def residuals(point: Vector) -> Vector:
        """Return the residuals of the loss: distances in margins, and the point in half ranges."""
        (differences,) = judge.each([point], runs)
        tried.append(objective(differences, point))
        return np.concatenate([differences, point])

    def jacobian(point: Vector) -> Matrix:
        steepness.append(slopes(lambda points: judge.each(points, runs), point))
        return np.vstack([steepness[-1], np.eye(len(point))])

    fitted = least_squares(
        residuals,
        start,
        jac=jacobian,
        bounds=(-1.0, 1.0),
        loss=losses,  # type: ignore[arg-type]  # the stubs ask for more than scipy does
        ftol=PLAN.enough,
        xtol=None,
        gtol=None,
        max_nfev=most_steps,
    )
    # The last Jacobian is that of the final point; scipy weights its own copy by the loss.
    return Search(start, np.asarray(fitted.x), runs, tried[0], 2.0 * float(fitted.cost), steepness[-1])


# See docs/decisions/fit-is-registered-first.md.
def screened() -> list[Vector]:
    """Return the points judged first: the middle of all ranges, and a Sobol sequence over them."""
    return [np.zeros(len(FREE)), *points_over_ranges(PLAN.screened, PLAN.seed)]


def objective(found: Vector, point: Vector) -> float:
    """Return the objective of the fit. Registered in `[fit]`."""
    return float(losses(np.concatenate([found, point]) ** 2)[0].sum())


def losses(squares: Vector) -> Matrix:
    """Return the loss of each squared residual and its first two derivatives by the square, in scipy's form.

    The residuals are the distances of the 24 cells, whose loss is soft L1, and then the coordinates of the point, whose
    loss is the square itself.
    """
    cells = 1.0 + squares[: len(CELLS)]
    prior = squares[len(CELLS) :]
    return np.hstack(
        [
            np.array([2.0 * (np.sqrt(cells) - 1.0), cells**-0.5, -0.5 * cells**-1.5]),
            np.array([prior, np.ones_like(prior), np.zeros_like(prior)]),
        ]
    )


def weighted_slopes(steepness: Matrix, found: Vector) -> Matrix:
    """Return the slopes of the cells at these distances, each weighted as by the fit's loss.

    Their Gram matrix, plus one for each coordinate, is the Gauss-Newton matrix of half the objective.
    """
    _, first, second = losses(found**2)
    return np.asarray(np.sqrt(first + 2.0 * second * found**2)[:, None] * steepness)


def slopes(each: Callable[[list[Vector]], list[Vector]], point: Vector) -> Matrix:
    """Return the derivative of each distance by each coordinate of the point.

    They are central differences within the ranges, on the same worlds.
    """
    ups = [np.clip(point + shift, -1.0, 1.0) for shift in np.eye(len(point)) * STEP]
    downs = [np.clip(point - shift, -1.0, 1.0) for shift in np.eye(len(point)) * STEP]
    at_points = each(ups + downs)
    columns = [
        (high - low) / float((up - down).sum())
        for high, low, up, down in zip(at_points[: len(point)], at_points[len(point) :], ups, downs, strict=True)
    ]
    return np.asarray(np.array(columns).T)


def _result(begun: float, start: Vector, searches: Sequence[Search], means: Answer) -> Calibration:
    last = searches[-1]
    constants, differences = constants_at(last.point), distances(means)
    _, singular, directions = np.linalg.svd(weighted_slopes(last.slopes, differences), full_matrices=False)
    return Calibration(
        objective=Objective(PLAN.rule, start=round(begun, 3), accepted=round(objective(differences, last.point), 3)),
        seeds=[PLAN.seed],
        runs_per_scenario=PLAN.judged_runs,
        model_version=MODEL_VERSION,
        rules=rules(METRICS),
        command=Calibration.MADE_BY,
        parameters=[
            _parameter(free, constants_at(start), constants, directions, singular, index)
            for index, free in enumerate(FREE)
        ],
        residuals=[
            Residual(
                metric=metric,
                architecture=architecture,
                paper=published()[metric, architecture].value,
                ours=mean,
                distance_margins=round(float(distance), 3),
                slopes=tuple(round(float(slope), 3) for slope in row),
            )
            for (metric, architecture), mean, distance, row in zip(CELLS, means, differences, last.slopes, strict=True)
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
                runs_per_scenario=search.runs,
                start=round(search.begun, 3),
                reached=round(search.reached, 3),
                ended_at={free.name: value_of(constants_at(search.point), free) for free in FREE},
            )
            for search in searches
        ],
    )


def _parameter(
    free: Free, begun: Constants, constants: Constants, directions: Matrix, singular: Vector, index: int
) -> Parameter:
    """Return the result for a constant, which is identified if the data determine it better than its range does."""
    information = float(((singular * directions[:, index]) ** 2).sum())
    return Parameter(
        name=free.name,
        unit=free.range.unit,
        low=free.range.low,
        high=free.range.high,
        start=value_of(begun, free),
        accepted=value_of(constants, free),
        meaning=free.meaning,
        identified=information > 1,
    )
