"""FSAR under another name differs from FSAR in nothing, and tests between unlike worlds keep their level."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from fsar_ledger.designs.constants import Constants
from fsar_ledger.events.configuration import ARCHITECTURES
from fsar_ledger.metrics.definitions import metrics
from fsar_ledger.metrics.registration import Sample, registration
from fsar_ledger.metrics.results import statistic_rows
from fsar_ledger.metrics.robustness import Placebo
from fsar_ledger.metrics.study_results import read, rules
from fsar_ledger.studies import placebo as study
from fsar_ledger.studies.evaluations import Answer, Question
from fsar_ledger.studies.factors import Setting
from fsar_ledger.studies.placebo import ANY, METRICS, TESTS, committed, on_same_seeds, p_values, placebo, rejections
from tests.quick import few

QUESTION = Question(Setting(Constants(), 4), 9, 3)


@pytest.mark.slow
def test_on_the_same_seeds_nothing_differs() -> None:
    assert on_same_seeds(QUESTION) == (15, 0.0)


@pytest.mark.parametrize("name", few(ARCHITECTURES[1:], ["jade"], ["dhma", "roboos"]))
def test_no_name_makes_a_difference_to_any_metric(name: str) -> None:
    with committed(QUESTION, QUESTION.seed, name) as database:
        rows = statistic_rows(database)
    assert {row.comparison for row in rows} == {f"fsar-{name}"}
    assert {row.metric for row in rows} == {metric.name for metric in metrics()}
    assert {row.mean_difference for row in rows if row.mean_difference is not None} == {0.0}


@pytest.mark.slow
def test_runs_that_did_not_meet_the_same_world_are_paired_by_no_rule_and_compared_here_alone() -> None:
    with committed(QUESTION, QUESTION.seed + 1) as database:
        assert database.rows("SELECT count(*) AS pairs FROM run_pairs") == [{"pairs": 0}]
        architectures = database.rows("SELECT architecture, seed, count(*) AS runs FROM runs GROUP BY ALL ORDER BY ALL")
    assert architectures == [
        {"architecture": "cfc", "seed": 10, "runs": 15},
        {"architecture": "fsar", "seed": 9, "runs": 15},
    ]
    found = p_values(QUESTION)
    of_t = found[:: len(TESTS)]
    assert sum(p is not None and 0 < p < 1 for p in of_t) >= 6


def test_rejections_are_counted_by_metric_and_test_and_holm_s_once_for_all() -> None:
    rng = np.random.default_rng(1)
    answers: list[Answer] = []
    for _ in range(2000):
        t = rng.uniform(size=len(METRICS))
        answers.append(tuple(value for p in t for value in (p, min(1.0, 8 * p), None, None)))
    answers.append((None,) * len(METRICS) * len(TESTS))
    found = {(one.metric, one.test): one for one in rejections(answers)}
    assert {test for _, test in found} == {"p", "p_holm"}
    for metric in METRICS:
        one = found[metric, "p"]
        assert (one.rejected + one.kept, one.undefined) == (2000, 1)
        assert one.share == pytest.approx(0.05, abs=0.02)
        assert (one.low or 0) < (one.share or 0) < (one.high or 1)
    assert found[ANY, "p_holm"].share == pytest.approx(0.05, abs=0.02)


@pytest.mark.slow
def test_the_result_is_of_the_registered_sample(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sample = Sample(seed=7, size=5, runs=1)
    other = msgspec.structs.replace(registration(), placebo=sample)
    monkeypatch.setattr(study, "registration", lambda: other)
    seeds: list[int] = []

    def ask(question: Question) -> Answer:
        seeds.append(question.seed)
        return (0.5,) * len(METRICS) * len(TESTS)

    found = placebo(tmp_path / "placebo.json", workers=1, ask=ask)
    assert seeds == [7, 9, 11, 13, 15], "each repetition has two seeds of its own"
    assert (found.pairs, found.largest_difference) == (5, 0.0)
    assert found.rules == rules("pairwise_tests")
    assert read(tmp_path / "placebo.json", Placebo) == found


@pytest.mark.soak
def test_the_tests_keep_their_level_on_seeds_of_their_own() -> None:
    answers = [p_values(Question(Setting(Constants(), 4), 10_000 + 2 * number, 20)) for number in range(100)]
    for one in rejections(answers):
        assert one.rejected <= 15, one
