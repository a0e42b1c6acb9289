"""Each constant says in one word where its value is from, and what it says holds."""

import json
from importlib.resources import files
from typing import Any

import msgspec
import pytest

from fsar_ledger.designs import constants
from fsar_ledger.designs.constants import (
    DESIGNS,
    WORDS,
    Chosen,
    Constants,
    Structure,
    WorldConstants,
    origins,
    write_constants,
)
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.events.envelope import Architecture
from fsar_ledger.metrics.results import MetricRow
from fsar_ledger.report.build import Document
from fsar_ledger.report.printing import flat
from fsar_ledger.report.records import own_constants
from fsar_ledger.studies.calibration import PLAN
from fsar_ledger.studies.evaluations import measured
from tests.quick import few
from tests.report.made import made, said

RECORD = json.loads(files("fsar_ledger.reports").joinpath("calibration.json").read_text())
INFORMED = {  # chosen after the held-out tables had been seen, or part of the study that came before the first fit
    *(
        *("world.response", "world.encounter_mean_s", "world.routine_until_s"),
        *("world.approach", "world.budget_delegated_s", "world.budget_own_s"),
    ),
    *(
        "structure.expiry_budgets",
        "structure.candidate_cost_ppm",
        "structure.back_off_us",
        "structure.encounter_memory_us",
        "structure.replan_us",
    ),
    *(
        "world.absence_from_s",
        "world.absence_to_s",
        "world.durations.navigate.indoor",
        "structure.assistance_us",
        "structure.ordering_response_ppm",
    ),
}
CHANGES: dict[str, dict[str, Any]] = {
    "structure": {
        "negotiation_rounds": 2,
        "peer_budget_us": 20_000_000,
        "fleet_budget_us": 20_000_000,
        "human_budget_us": 180_000_000,
        "human_calls": 3,
    },
    "world": {"floor_teams": 8, "crowding_rate_per_s": 0.01},
}
"""Another value for each constant that no cell hangs on."""


def of(word: str) -> set[str]:
    return {name for name, said in origins().items() if said == word}


def test_every_constant_says_one_of_the_four_words() -> None:
    assert {name: word for name, word in origins().items() if word not in WORDS} == {}


def test_every_constant_that_a_run_records_has_a_word() -> None:
    recorded = dict(flat("", msgspec.json.decode(write_constants(Constants()))))
    assert recorded.keys() <= origins().keys()
    groups = {name.partition(".")[0] for name in origins()}
    assert groups == set(Constants.__struct_fields__) - set(DESIGNS), "also a group that is absent by default"


class Unsaid(msgspec.Struct):
    """A group whose constants say nothing, one word, and two."""

    nothing: float = 1.0
    one: Chosen[float] = 1.0
    two: Chosen[Chosen[float]] = 1.0


def test_a_constant_without_a_word_or_with_two_is_found() -> None:
    hints = constants._hints(Unsaid)
    assert {name: constants._word(hint) for name, hint in hints.items()} == {"nothing": "", "one": "chosen", "two": ""}


def test_what_is_fitted_is_what_the_record_of_the_fit_holds() -> None:
    assert of("fitted") == {parameter["name"] for parameter in RECORD["parameters"]}


def test_what_was_chosen_after_tables_had_been_seen_does_not_pass_for_anything_else() -> None:
    assert of("chosen after fits") >= INFORMED


def test_what_the_paper_prints_is_what_the_paper_prints() -> None:
    printed = {
        name: value
        for name, value in flat("", msgspec.json.decode(write_constants(Constants())))
        if name in of("paper")
    }
    assert printed == {
        "world.degradation_probability": "0.3",
        "world.degraded_reliability": "0.6",
        "world.durations.carry.package": "1 to 5 s",
        "world.durations.door.open.basic": "0.5 to 2 s",
        "world.durations.door.open.secure": "0.5 to 2 s",
        "world.message": "0.05 to 0.5 s",
        "structure.local_attempts": "2",
        "structure.local_budget_us": "30,000,000",
    }


def cells(constants: Constants, architecture: Architecture) -> list[MetricRow]:
    return measured(constants, PLAN.seed, 1, architectures=(architecture,))


@pytest.mark.parametrize("architecture", few(PAPER_ARCHITECTURES, ["fsar"]))
def test_no_cell_hangs_on_what_was_chosen(architecture: Architecture) -> None:
    changed = {f"{group}.{name}" for group, values in CHANGES.items() for name in values}
    assert of("chosen") | of("dial") == changed | {
        name for name in origins() if name.partition(".")[0] not in CHANGES
    }, "the other groups are absent"
    replace = msgspec.structs.replace
    other = Constants(replace(WorldConstants(), **CHANGES["world"]), replace(Structure(), **CHANGES["structure"]))
    assert cells(other, architecture) == cells(Constants(), architecture)


def test_the_report_names_the_constants_that_are_not_this_versions() -> None:
    given = {
        "structure.poll_us": "2,000,000",
        "world.motion_share": str(Constants().world.motion_share),
        "of.another.model": "1",
    }
    rows = {row["name"]: (row["value"], row["ours"]) for row in own_constants(given).to_pylist()}
    assert rows.keys() == {"structure.poll_us", "of.another.model"}
    assert rows["of.another.model"] == ("1", None)
    assert "of.another.model = 1 and structure.poll_us = 2" in said(
        Document(msgspec.structs.replace(made(), parameters=given))
    )
