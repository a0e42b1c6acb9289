"""Ranks the architectures all over the registered ranges, without any fit.

If FSAR were best only near the fitted constants, the ranking would be a result of the fit. Here every free constant is
anywhere in its range, and every point meets worlds of its own.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from fsar_ledger.api.names import Place
from fsar_ledger.api.verbs import workers_of
from fsar_ledger.base.progress import Progress
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.metrics.definitions import Metric, published_metrics
from fsar_ledger.metrics.registration import registration
from fsar_ledger.metrics.robustness import RankCounts, Ranking, wilson
from fsar_ledger.metrics.verdicts import MARGINS, published

from .evaluations import CELLS, Answer, Evaluate, evaluate, evaluating, question_at
from .factors import points_over_ranges
from .result import RESUME_ADVICE, grounds, ranges, write

ALL = "all eight"
IN_PAPER = "those in which the paper prints it best"
FSAR, OTHERS = PAPER_ARCHITECTURES[0], PAPER_ARCHITECTURES[1:]


def ranking(
    out: Place, *, workers: int | None = None, progress: Progress | None = None, ask: Evaluate = evaluate
) -> Ranking:
    """Rank the architectures at the registered points, write the result and return it.

    An interrupted study continues from what is kept beside it.

    Raises: As `evaluating`; WriteFailed, WorkerDied.
    """
    out, sample = Path(out), registration().ranking
    points = points_over_ranges(sample.size, sample.seed)
    with evaluating(out, workers_of(workers), progress, ask) as evaluations:
        evaluations.expected = sample.size
        found = evaluations.answers(
            [question_at(point, sample.seed + number, sample.runs) for number, point in enumerate(points)]
        )
        result = Ranking(
            **grounds(Ranking),
            sample=sample,
            ranges=ranges(),
            cpu_minutes=evaluations.cpu_minutes,
            ranks=list(ranks(found)),
        )
        write(out, result, RESUME_ADVICE)
    return result


class _Standing(NamedTuple):
    """How FSAR stands in a metric at a point: its lead over the better of the others, in margins, and the order.

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
        known[one] for one in sorted(PAPER_ARCHITECTURES, key=lambda one: -sign * published()[metric.name, one].value)
    ]
    return _Standing(lead, None if len(set(ours)) < len(ours) else ours == sorted(ours, reverse=True))


def ranks(answers: Sequence[Answer]) -> Iterator[RankCounts]:
    """Yield the ranks in each metric over these points, in all, and in those in which the paper prints FSAR best."""
    every = published_metrics()
    for metric in every:
        yield _rank(metric.name, [metric], answers)
    yield _rank(ALL, every, answers)
    yield _rank(IN_PAPER, [metric for metric in every if is_best_in_paper(metric)], answers)


def is_best_in_paper(metric: Metric) -> bool:
    """Return whether the paper prints FSAR as better than both others."""
    return (
        _standing(metric, {one: published()[metric.name, one].value for one in PAPER_ARCHITECTURES}).lead or 0.0
    ) > 0


def _rank(name: str, of: Sequence[Metric], answers: Sequence[Answer]) -> RankCounts:
    points = [_standings(of, answer) for answer in answers]
    leads = [[one.lead for one in point] for point in points]
    known = [[lead for lead in point if lead is not None] for point in leads]
    beaten = sum(any(lead < 0 for lead in point) for point in known)
    undefined = sum(
        None in point and not any(lead < 0 for lead in also) for point, also in zip(leads, known, strict=True)
    )
    best = sum(len(point) == len(of) and all(lead > 0 for lead in point) for point in known)
    orders = [[one.is_ordered for one in point] for point in points]
    ordered = sum(all(point) for point in orders)
    disordered = sum(False in point for point in orders)
    of_best, of_ordered = wilson(best, best + beaten).rounded(), wilson(ordered, ordered + disordered).rounded()
    return RankCounts(
        metric=name,
        is_best_in_paper=all(map(is_best_in_paper, of)),
        best=best,
        clearly_best=sum(len(point) == len(of) and all(lead >= 1 for lead in point) for point in known),
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


def _standings(of: Sequence[Metric], answer: Answer) -> list[_Standing]:
    by_cell = dict(zip(CELLS, answer, strict=True))
    return [_standing(metric, {one: by_cell[metric.name, one] for one in PAPER_ARCHITECTURES}) for metric in of]
