"""The ranking counts what is best, beaten, tied and undefined apart, and is of the registered ranges alone."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from fsar_ledger.metrics.definitions import published_metrics
from fsar_ledger.metrics.registration import Sample, registration
from fsar_ledger.metrics.robustness import RankCounts, Ranking
from fsar_ledger.metrics.study_results import read
from fsar_ledger.metrics.verdicts import MARGINS, published
from fsar_ledger.studies import robustness as study
from fsar_ledger.studies.evaluations import CELLS, Answer, Question
from fsar_ledger.studies.factors import FREE, point_of, points_over_ranges, value_of
from fsar_ledger.studies.result import grounds, stale
from fsar_ledger.studies.robustness import ALL, IN_PAPER, ranking, ranks

PAPER: Answer = tuple(published()[cell].value for cell in CELLS)


def answer(**fsar: float | None) -> Answer:
    """The paper's numbers, with other ones of FSAR."""
    return tuple(
        fsar[metric] if architecture == "fsar" and metric in fsar else number
        for (metric, architecture), number in zip(CELLS, PAPER, strict=True)
    )


def of(metric: str, *answers: Answer) -> RankCounts:
    (found,) = (one for one in ranks(answers) if one.metric == metric)
    return found


def counts(found: RankCounts) -> tuple[int, int, int, int]:
    return found.best, found.beaten, found.tied, found.undefined


def test_the_paper_s_own_numbers_are_in_its_order_and_best_where_it_says_so() -> None:
    found = {one.metric: one for one in ranks([PAPER])}
    assert list(found) == [*(metric.name for metric in published_metrics()), ALL, IN_PAPER]
    for name, one in found.items():
        assert (one.ordered, one.disordered) == (1, 0)
        assert one.is_best_in_paper == (one.best == 1), name
    assert [one.metric for one in found.values() if one.beaten] == [
        "coordination_success",
        "reassignment_latency_s",
        ALL,
    ]


def test_best_is_by_the_direction_of_the_metric_and_a_tie_or_an_undefined_cell_is_neither() -> None:
    cfc = published()["authority_conflicts", "cfc"].value
    found = of(
        "authority_conflicts",
        *(answer(authority_conflicts=number) for number in (cfc - 3, cfc - 0.1, cfc + 0.1, cfc + 9, cfc, None)),
    )
    assert counts(found) == (2, 2, 1, 1)
    assert (found.clearly_best, found.close) == (1, 3)
    assert (found.ordered, found.disordered) == (2, 2)
    assert (found.best_share, found.best_low, found.best_high) == pytest.approx((0.5, 0.15, 0.85), abs=0.01)
    higher = of("governance_locality", answer(governance_locality=0.99), answer(governance_locality=0.01))
    assert counts(higher) == (1, 1, 0, 0)


def test_several_metrics_are_beaten_by_one_and_open_where_one_is() -> None:
    assert counts(of(IN_PAPER, PAPER)) == (1, 0, 0, 0)
    open_one = answer(authority_conflicts=None)
    assert counts(of(IN_PAPER, open_one)) == (0, 0, 0, 1)
    assert counts(of(IN_PAPER, answer(authority_conflicts=None, policy_violations=9.0))) == (0, 1, 0, 0)
    tied = answer(authority_conflicts=published()["authority_conflicts", "cfc"].value)
    assert counts(of(IN_PAPER, tied)) == (0, 0, 1, 0)
    assert (of(ALL, tied).ordered, of(ALL, tied).disordered) == (0, 0)
    assert of(IN_PAPER, tied).best_share is None


def test_points_cover_every_range_and_are_the_same_again() -> None:
    points = np.array(points_over_ranges(64, 3))
    assert (points == np.array(points_over_ranges(64, 3))).all()
    assert (points[:40] == np.array(points_over_ranges(40, 3))).all()
    assert (points.min(axis=0) < -0.9).all()
    assert (points.max(axis=0) > 0.9).all()


def by_sum(question: Question) -> Answer:
    """FSAR has the fewest conflicts in half of the ranges; the seed counts, as other worlds do."""
    point = point_of([value_of(question.setting.constants, free) for free in FREE])
    sign = 1.0 if point.sum() > 0 else -1.0
    conflicts = published()["authority_conflicts", "cfc"].value + sign * MARGINS["authority_conflicts"]
    return answer(authority_conflicts=conflicts + 1e-6 * (question.seed % 7))


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> Sample:
    sample = Sample(seed=registration().ranking.seed, size=40, runs=1)
    other = msgspec.structs.replace(registration(), ranking=sample)
    monkeypatch.setattr(study, "registration", lambda: other)
    return sample


def test_a_ranking_is_of_the_registered_sample_and_goes_on_where_it_stopped(tmp_path: Path, small: Sample) -> None:
    asked: list[Question] = []

    def breaks(question: Question) -> Answer:
        if len(asked) == 17:
            raise KeyboardInterrupt
        asked.append(question)
        return by_sum(question)

    whole = ranking(tmp_path / "one.json", workers=1, ask=by_sum)
    with pytest.raises(KeyboardInterrupt):
        ranking(tmp_path / "two.json", workers=1, ask=breaks)
    asked.append(asked[0])
    told: list[tuple[int, int]] = []
    ranking(tmp_path / "two.json", workers=1, ask=breaks, progress=lambda *done: told.append(done))
    assert (tmp_path / "one.json").read_bytes() == (tmp_path / "two.json").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.json", "two.json"]
    assert told[-1] == (small.size - 17, small.size - 17)
    assert {one.seed - small.seed for one in asked} == set(range(small.size)), "each point meets worlds of its own"
    assert read(tmp_path / "one.json", Ranking) == whole
    (conflicts,) = (one for one in whole.ranks if one.metric == "authority_conflicts")
    assert conflicts.best + conflicts.beaten == small.size
    assert 10 <= conflicts.best <= 30


def test_a_ranking_does_not_rest_on_the_fit_and_does_on_ranges_and_sample(tmp_path: Path, small: Sample) -> None:
    found = ranking(tmp_path / "ranking.json", workers=1, ask=by_sum)
    assert "expected the registered" in (stale(found) or "")
    found = msgspec.structs.replace(found, sample=registration().ranking)
    assert stale(found) is None
    assert found.parameters == grounds(Ranking)["parameters"]
    other = found.ranges | {FREE[0].name: (0.1, 0.2)}
    assert "other ranges" in (stale(msgspec.structs.replace(found, ranges=other)) or "")
    assert "of model '1'" in (stale(msgspec.structs.replace(found, model_version="1")) or "")
