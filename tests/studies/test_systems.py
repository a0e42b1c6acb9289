"""Every architecture is run at every size and over every dial, and what cannot be otherwise is explained."""

from pathlib import Path

import msgspec
import pytest

from fsar_ledger.designs.constants import Constants, with_all_groups
from fsar_ledger.designs.dials import TRIED
from fsar_ledger.events.configuration import ARCHITECTURES, PAPER_ARCHITECTURES
from fsar_ledger.metrics.definitions import metrics
from fsar_ledger.metrics.robustness import Systems
from fsar_ledger.metrics.study_results import packaged, read
from fsar_ledger.report import specs
from fsar_ledger.runtime.own import with_values
from fsar_ledger.studies import systems as study
from fsar_ledger.studies.evaluations import Answer, Question
from fsar_ledger.studies.factors import Setting
from fsar_ledger.studies.systems import WIDTH, SystemQuestion, answer, held_ranks, moved_constants, systems, trials
from tests.quick import few


def test_a_dial_is_tried_at_its_declared_value_and_at_others() -> None:
    declared = with_all_groups(Constants())
    for name, values in TRIED.items():
        group, _, dial = name.partition(".")
        assert group in set(ARCHITECTURES) - set(PAPER_ARCHITECTURES)
        assert getattr(getattr(declared, group), dial) in values
        assert len(set(values)) == len(values) > 1


def test_trials_ask_the_same_only_where_every_dial_of_a_system_has_its_declared_value() -> None:
    keys = [one.question.key for one in trials()]
    systems_with_dials = {name.partition(".")[0] for name in TRIED}
    assert len(keys) - len(set(keys)) == len(TRIED) - len(systems_with_dials)
    assert {one.architecture for one in trials() if one.dial is None} == set(ARCHITECTURES)
    assert {one.dial for one in trials() if one.dial is not None} == set(TRIED)


def test_the_result_keeps_what_each_trial_answered(tmp_path: Path) -> None:
    asked: list[Question] = []

    def ask(question: Question) -> Answer:
        asked.append(question)
        return tuple(float(len(asked)) if at % 5 == 1 else None for at in range(WIDTH - 11)) + (2.0, None) * 5 + (0.5,)

    made = systems(tmp_path / "systems.json", workers=1, ask=ask)
    keys = [one.question.key for one in trials()]
    elsewhere = [moved.question(name).key for name in ARCHITECTURES for moved in moved_constants()]
    assert [one.key for one in asked] == list(dict.fromkeys(keys + elsewhere))
    assert len(made.numbers) == len(trials()) * len(metrics())
    place = {key: float(at + 1) for at, key in enumerate(dict.fromkeys(keys))}
    assert [one.mean for one in made.numbers[:: len(metrics())]] == [place[key] for key in keys]
    assert {one.grade for one in made.grades} == {"full", None}
    assert read(tmp_path / "systems.json", Systems) == made


def test_every_constant_is_moved_to_both_ends_and_none_of_the_worlds_is_the_base() -> None:
    moved = moved_constants()
    assert len({one.question("fsar").key for one in moved}) == len(moved)
    assert SystemQuestion(Setting(Constants(), 4), moved[0].question("fsar").seed, 20, "fsar", (1,)).setting not in [
        one.setting for one in moved
    ]
    names = [one.name.partition("=")[0] for one in moved]
    assert {name for name in names if names.count(name) == 1} >= {"load.task_sets", "fleet.size"}
    assert "world.review_share" in names


def test_a_rank_counts_the_worlds_in_which_the_intervals_do_not_meet() -> None:
    def answers(*intervals: tuple[float | None, float | None]) -> list[Answer]:
        return [(None, 0.5, low, high, None) + (None,) * (WIDTH - 5) for low, high in intervals]

    ours = answers((0.5, 0.6), (0.5, 0.6), (0.5, 0.6), (0.5, 0.6), (None, None))
    theirs = answers((0.1, 0.2), (0.1, 0.2), (0.7, 0.8), (0.6, 0.8), (0.1, 0.2))
    first, second, *_ = held_ranks(["a", "b", "c", "d", "e"], {"fsar": ours, "jade": theirs})
    assert (first.architecture, first.metric) == ("jade", "coordination_success")
    assert (first.settings, first.higher, first.lower, first.against) == (4, 2, 1, ("c",))
    assert (second.settings, second.higher, second.lower, second.against) == (0, 0, 0, ())


@pytest.mark.slow
@pytest.mark.parametrize("architecture", few(ARCHITECTURES, [], ["fsar", "dhma", "roboos"]))
def test_an_answer_has_every_metric_grade_and_share(architecture: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study, "RUNS", {4: 2})
    monkeypatch.setattr(study, "SEEDS", (1, 2))
    [question] = [one.question for one in trials() if (one.architecture, one.dial) == (architecture, None)]
    found = answer(question)
    assert len(found) == WIDTH
    assert found[0] == 2 * 2 * 5  # runs in which success is defined


@pytest.mark.slow
def test_a_dial_reaches_its_architecture() -> None:
    slow = with_values(Constants(), {"alliance.impatience_us": 15_000_000})
    impatient, patient = (
        answer(SystemQuestion(Setting(one, 4), 1, 1, "alliance", (1,)))[1] for one in (Constants(), slow)
    )
    assert impatient is not None
    assert patient is not None
    assert impatient > patient


def test_whatever_is_the_same_in_every_run_has_a_reason() -> None:
    found = packaged(Systems)
    if found is None:
        return
    cells: dict[tuple[str, str], list[tuple[float, float | None]]] = {}
    for one in found.numbers:
        if one.mean is not None:
            cells.setdefault((one.metric, one.architecture), []).append((one.mean, one.sd))
    structural = {cell for cell, same in cells.items() if len(set(same)) == 1 and same[0][1] == 0}
    explained = [(row["metric"], name) for row in specs.rows("structural") for name in row["architectures"]]
    assert sorted(explained) == sorted(structural)


def test_the_result_is_of_the_declared_seeds_and_runs() -> None:
    found = packaged(Systems)
    if found is not None:
        assert (found.seeds, found.runs) == (study.SEEDS, {str(size): runs for size, runs in study.RUNS.items()})
        assert msgspec.json.decode(msgspec.json.encode(found), type=Systems) == found
