"""Every registered prediction is played, each in its own world, and the record names what was played."""

import json
from pathlib import Path

import msgspec
import pytest

from fsar_ledger.base.errors import WriteFailed
from fsar_ledger.events.configuration import CONFIGURATIONS, removed_mechanisms
from fsar_ledger.metrics.definitions import published_metrics
from fsar_ledger.metrics.registration import registration
from fsar_ledger.runtime.simulation import MODEL_VERSION
from fsar_ledger.studies import predictions
from fsar_ledger.studies.predictions import PlannedExperiment, planned_experiments, predict


def registered(of: str) -> list[PlannedExperiment]:
    return [plan for plan in planned_experiments() if plan.of == of]


def test_all_that_is_registered_is_played_and_nothing_twice() -> None:
    every = [msgspec.json.encode(plan) for plan in planned_experiments()]
    assert len(every) == len(set(every))
    assert {plan.of for plan in planned_experiments()} == {
        "cases",
        "ablation",
        "triples",
        "encounters",
        "scaling",
        "loads",
        "seeds",
    }


def test_ablations_are_those_of_the_paper_and_triples_lack_three_mechanisms() -> None:
    assert [plan.experiment.configurations for plan in registered("ablation")] == [CONFIGURATIONS]
    (triples,) = registered("triples")
    assert [len(removed_mechanisms(one)) for one in triples.experiment.configurations] == [3] * 4


def test_fleets_are_the_papers_those_between_and_one_beyond_at_both_ends_of_the_load() -> None:
    found = {
        (plan.experiment.fleet_size, plan.experiment.constants.load and plan.experiment.constants.load.teams_working)
        for plan in registered("scaling")
    }
    assert found == {(4, None), *((size, teams) for size in (8, 12, 16, 28) for teams in (None, 1))}


def test_encounters_change_nothing_else() -> None:
    worlds = [plan.experiment.constants.world for plan in registered("encounters")]
    assert [world.encounter_mean_s for world in worlds] == [30, 50, 90, 200, 300]
    assert len({msgspec.json.encode(msgspec.structs.replace(world, encounter_mean_s=90.0)) for world in worlds}) == 1


def test_runs_are_spread_over_the_seeds_of_the_verdicts_but_where_a_seed_of_its_own_is_registered() -> None:
    seeds = registration().verdicts.seeds
    for plan in planned_experiments():
        parts = list(plan.parts())
        assert sum(part.runs for part in parts) == plan.experiment.runs
        assert [part.seed for part in parts] == ([plan.seed] if plan.of == "seeds" else list(seeds))
    assert [plan.seed for plan in registered("seeds")] == [31622776, 36055512]


@pytest.mark.slow
def test_numbers_name_what_was_played(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small = [
        msgspec.structs.replace(plan, experiment=msgspec.structs.replace(plan.experiment, runs=1))
        for plan in (registered("loads")[0], registered("cases")[0])
    ]
    monkeypatch.setattr(predictions, "planned_experiments", lambda: iter(small))
    told: list[tuple[int, int]] = []
    predict(tmp_path / "new" / "predictions.json", workers=1, progress=lambda *done: told.append(done))
    record = json.loads((tmp_path / "new" / "predictions.json").read_text())
    assert (record["model_version"], told) == (MODEL_VERSION, [(1, 2), (2, 2)])
    played = {(row["of"], row["fleet_size"], row["teams_working"], row["seed"]) for row in record["numbers"]}
    assert played == {("loads", 16, 2, None), ("cases", 4, None, None)}
    assert len(record["numbers"]) == 2 * 3 * len(published_metrics()) * 6, "over all scenarios, and of each"
    assert {claim["case_number"] for claim in record["cases"]} == {1, 2, 3, 4}


def test_a_path_that_cannot_be_written_is_refused_before_the_work(tmp_path: Path) -> None:
    with pytest.raises(WriteFailed, match="it is a folder"):
        predict(tmp_path)
