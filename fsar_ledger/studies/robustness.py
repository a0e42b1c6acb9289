"""Tests whether the result depends on the fit: at points over the registered ranges, and at points around the fit.

`ranking` ranks the architectures at points over the whole ranges, without any fit. If FSAR were best only near the
fitted constants, the ranking would be a result of the fit. Every free constant may be anywhere in its range, and every
point has worlds of its own.

`ensemble` measures the influence of the constants that the fit leaves undetermined. The fit accepts one point, and many
others explain the 24 cells nearly as well. They are drawn from the normal distribution around it whose precision is the
Gauss-Newton matrix of the fit's objective (the Laplace approximation), with the registered spread, and clipped to the
ranges. A point is plausible if each cell is within margin plus discrepancy of the printed number.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fsar_ledger.api.names import Place
from fsar_ledger.api.verbs import workers_of
from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.progress import Progress
from fsar_ledger.designs.constants import write_constants
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.metrics.definitions import Metric, printed_tests, published_metrics
from fsar_ledger.metrics.registration import Sample, SampleAround, registration
from fsar_ledger.metrics.robustness import CellSpread, Ensemble, RankCounts, Ranking, SignCount, wilson
from fsar_ledger.metrics.study_results import Calibration, packaged, read
from fsar_ledger.metrics.verdicts import MARGINS, published
from fsar_ledger.runtime.simulation import MODEL_VERSION

from .calibration import weighted_slopes
from .evaluations import CELLS, Answer, Evaluate, evaluate, evaluating, question_at
from .factor_effects import Matrix, Vector
from .factors import FREE, point_of, points_over_ranges, sobol, with_values
from .result import RESUME_ADVICE, grounds, ranges, write

ALL = "all eight"
IN_PAPER = "those in which the paper prints it best"
FSAR, OTHERS = PAPER_ARCHITECTURES[0], PAPER_ARCHITECTURES[1:]


def ranking(
    out: Place, *, workers: int | None = None, progress: Progress | None = None, ask: Evaluate = evaluate
) -> Ranking:
    """Rank the architectures at the registered points, write the result and return it.

    An interrupted study continues from the answers kept beside it.

    Raises: As `evaluating`; WriteFailed, WorkerDied.
    """
    out, sample = Path(out), registration().ranking
    points = points_over_ranges(sample.size, sample.seed)
    with evaluating(out, workers_of(workers), progress, ask) as evaluations:
        evaluations.expected = sample.size
        answers = evaluations.answers(
            [question_at(point, sample.seed + number, sample.runs) for number, point in enumerate(points)]
        )
        result = Ranking(
            **grounds(Ranking),
            sample=sample,
            ranges=ranges(),
            cpu_minutes=evaluations.cpu_minutes,
            ranks=list(ranks(answers)),
        )
        write(out, result, RESUME_ADVICE)
    return result


class _Standing(NamedTuple):
    """FSAR in a metric at a point: its lead over the better of the others, in margins, and the order.

    The lead is None if one of the three means is undefined, `is_ordered` also if two are equal.
    """

    lead: float | None
    is_ordered: bool | None


def _standing(metric: Metric, means: Mapping[str, float | None]) -> _Standing:
    sign = 1 if metric.better == "higher" else -1
    known = {architecture: sign * mean for architecture, mean in means.items() if mean is not None}
    if len(known) < len(PAPER_ARCHITECTURES):
        return _Standing(None, None)
    lead = (known[FSAR] - max(known[other] for other in OTHERS)) / MARGINS[metric.name]
    ours = [
        known[architecture]
        for architecture in sorted(
            PAPER_ARCHITECTURES, key=lambda architecture: -sign * published()[metric.name, architecture].value
        )
    ]
    return _Standing(lead, None if len(set(ours)) < len(ours) else ours == sorted(ours, reverse=True))


def ranks(answers: Sequence[Answer]) -> Iterator[RankCounts]:
    """Yield the ranks in each metric over these points, in all, and in those in which the paper prints FSAR best."""
    all_metrics = published_metrics()
    for metric in all_metrics:
        yield _rank(metric.name, [metric], answers)
    yield _rank(ALL, all_metrics, answers)
    yield _rank(IN_PAPER, [metric for metric in all_metrics if is_best_in_paper(metric)], answers)


def is_best_in_paper(metric: Metric) -> bool:
    """Return whether the paper prints FSAR as better than both others."""
    return (
        _standing(
            metric, {architecture: published()[metric.name, architecture].value for architecture in PAPER_ARCHITECTURES}
        ).lead
        or 0.0
    ) > 0


def _rank(name: str, metrics: Sequence[Metric], answers: Sequence[Answer]) -> RankCounts:
    points = [_standings(metrics, answer) for answer in answers]
    leads = [[standing.lead for standing in point] for point in points]
    known = [[lead for lead in point if lead is not None] for point in leads]
    beaten = sum(any(lead < 0 for lead in point) for point in known)
    undefined = sum(
        None in point and not any(lead < 0 for lead in known_leads)
        for point, known_leads in zip(leads, known, strict=True)
    )
    best = sum(len(point) == len(metrics) and all(lead > 0 for lead in point) for point in known)
    orders = [[standing.is_ordered for standing in point] for point in points]
    ordered = sum(all(point) for point in orders)
    disordered = sum(False in point for point in orders)
    of_best, of_ordered = wilson(best, best + beaten).rounded(), wilson(ordered, ordered + disordered).rounded()
    return RankCounts(
        metric=name,
        is_best_in_paper=all(map(is_best_in_paper, metrics)),
        best=best,
        clearly_best=sum(len(point) == len(metrics) and all(lead >= 1 for lead in point) for point in known),
        beaten=beaten,
        tied=len(points) - best - beaten - undefined,
        undefined=undefined,
        close=sum(any(abs(lead) < 1 for lead in point) for point in known),
        best_share=of_best.share,
        best_low=of_best.low,
        best_high=of_best.high,
        ordered=ordered,
        disordered=disordered,
        ordered_share=of_ordered.share,
        ordered_low=of_ordered.low,
        ordered_high=of_ordered.high,
    )


def _standings(metrics: Sequence[Metric], answer: Answer) -> list[_Standing]:
    by_cell = dict(zip(CELLS, answer, strict=True))
    return [
        _standing(metric, {architecture: by_cell[metric.name, architecture] for architecture in PAPER_ARCHITECTURES})
        for metric in metrics
    ]


def ensemble(
    out: Place,
    calibration: Place | None = None,
    *,
    workers: int | None = None,
    progress: Progress | None = None,
    ask: Evaluate = evaluate,
) -> Ensemble:
    """Evaluate the registered number of points around the accepted one, write the result and return it.

    An interrupted study continues from the answers kept beside it.

    Args:
        out: The result.
        calibration: A record of the fit; None: the one in this package.
        workers: Processes at once.
        progress: Called with the evaluations done and their total.
        ask: Answers a question, in another process unless `workers` is 1.

    Raises:
        UsageError: There is no fit of this model that keeps its slopes; or as `evaluating`.
        FsarLedgerError: The record is something else.
        WriteFailed, WorkerDied: As `evaluating`.
    """
    out, sample = Path(out), registration().ensemble
    fitted_record = packaged(Calibration) if calibration is None else read(Path(calibration), Calibration)
    fit = _require_slopes(fitted_record, str(calibration or f"reports/{Calibration.FILE}"))
    points, clipped = points_around(fit, sample)
    with evaluating(out, workers_of(workers), progress, ask) as evaluations:
        evaluations.expected = sample.size
        answers = evaluations.answers(
            [question_at(point, sample.seed + number, sample.runs) for number, point in enumerate(points)]
        )
        result = _result(fit, sample, answers, clipped, evaluations.cpu_minutes)
        write(out, result, RESUME_ADVICE)
    return result


def _require_slopes(fit: Calibration | None, name: str) -> Calibration:
    """Return the fit if points can be drawn from it. Raises: UsageError."""
    if (
        fit is None
        or fit.model_version != MODEL_VERSION
        or [parameter.name for parameter in fit.parameters] != [free.name for free in FREE]
        or [(residual.metric, residual.architecture) for residual in fit.residuals] != list(CELLS)
        or any(len(residual.slopes) != len(FREE) for residual in fit.residuals)
    ):
        raise UsageError(
            f"{name}: found no fit of model {MODEL_VERSION} that keeps the slopes of the {len(CELLS)} cells, expected "
            f"what `{Calibration.MADE_BY}` writes"
        )
    return fit


def points_around(fit: Calibration, sample: SampleAround) -> tuple[list[Vector], float]:
    """Return points around the accepted one, and the share of coordinates that were clipped."""
    centre = point_of([parameter.accepted for parameter in fit.parameters])
    distances = np.array(
        [1.0 if residual.distance_margins is None else residual.distance_margins for residual in fit.residuals]
    )
    steepness = weighted_slopes(np.array([residual.slopes for residual in fit.residuals]), distances)
    free = centre + sample.spread * normal_sample(steepness.T @ steepness + np.eye(len(FREE)), sample)
    points = np.clip(free, -1.0, 1.0)
    return list(points), round(float(np.mean(points != free)), 4)


def normal_sample(precision: Matrix, sample: Sample) -> Matrix:
    """Return a sample of the normal distribution with this precision and mean 0."""
    from scipy.special import ndtri

    tiny = 2.0**-32
    standard = ndtri(np.clip(sobol(sample.size, sample.seed), tiny, 1.0 - tiny))
    return np.asarray(np.linalg.solve(np.linalg.cholesky(precision).T, standard.T).T)


def _result(
    fit: Calibration, sample: SampleAround, answers: Sequence[Answer], clipped: float, cpu_minutes: float
) -> Ensemble:
    plausible = [answer for answer in answers if not _missed_cells(answer)]
    basis = plausible or answers
    accepted = write_constants(with_values([parameter.accepted for parameter in fit.parameters]))
    return Ensemble(
        **grounds(Ensemble) | {"parameters": accepted},
        sample=sample,
        cpu_minutes=cpu_minutes,
        clipped=clipped,
        plausible=len(plausible),
        cells=[_spread(cell, answers, plausible) for cell in range(len(CELLS))],
        signs=list(_signs(basis)),
        ranks=list(ranks(basis)),
    )


def _missed_cells(answer: Answer) -> list[int]:
    """Return the indexes of cells that are undefined, or beyond their tolerance."""
    return [
        cell
        for cell, mean in enumerate(answer)
        if mean is None or abs(mean - published()[CELLS[cell]].value) > registration().tolerance(*CELLS[cell])
    ]


def _spread(cell: int, answers: Sequence[Answer], plausible: Sequence[Answer]) -> CellSpread:
    metric, architecture = CELLS[cell]
    paper, margin = published()[metric, architecture].value, MARGINS[metric]
    known = [mean for answer in answers if (mean := answer[cell]) is not None]
    lower, median, upper = np.quantile(known, [0.25, 0.5, 0.75]).round(4).tolist() if known else [None] * 3

    def within(part: Sequence[Answer]) -> int:
        return sum(mean is not None and abs(mean - paper) <= margin for answer in part for mean in [answer[cell]])

    return CellSpread(
        metric=metric,
        architecture=architecture,
        paper=paper,
        margin=margin,
        discrepancy=round(registration().tolerance(metric, architecture) - margin, 9),
        undefined=len(answers) - len(known),
        within_margin=within(answers),
        within_tolerance=sum(cell not in _missed_cells(answer) for answer in answers),
        only_miss=sum(_missed_cells(answer) == [cell] for answer in answers),
        plausible_within_margin=within(plausible),
        lower_quartile=lower,
        median=median,
        upper_quartile=upper,
    )


def _signs(answers: Sequence[Answer]) -> Iterator[SignCount]:
    for (metric, comparison), test in printed_tests().items():
        first, second = (CELLS.index((metric, architecture)) for architecture in comparison.split("-"))
        differences = [
            one - other
            for answer in answers
            if (one := answer[first]) is not None and (other := answer[second]) is not None and one != other
        ]
        same = sum((difference > 0) == (test.t > 0) for difference in differences)
        yield SignCount(
            metric=metric,
            comparison=comparison,
            paper_t=test.t,
            same=same,
            other=len(differences) - same,
            neither=len(answers) - len(differences),
        )
