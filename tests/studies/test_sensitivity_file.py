"""The file, the table and the figure of a study."""

import re
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fsar_ledger.base.errors import FsarLedgerError
from fsar_ledger.cli.app import run
from fsar_ledger.designs.constants import Constants, write_constants
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.metrics.effects import Sensitivity, dozen, reach
from fsar_ledger.metrics.study_results import METRICS, encoded, read, rules
from fsar_ledger.report.build import Document
from fsar_ledger.report.printing import flat
from fsar_ledger.report.study_charts import heat_map
from fsar_ledger.runtime.simulation import MODEL_VERSION
from fsar_ledger.studies.evaluations import CELLS, evaluate
from fsar_ledger.studies.factors import factors, setting
from tests.report.made import column, made, names, said
from tests.studies.conftest import NAMES, study


def test_a_file_is_read_as_it_was_written_and_stays_small(file: Path, found: Sensitivity) -> None:
    assert encoded(found) == file.read_bytes()
    assert len(found.effects) == len(CELLS) * len(NAMES)
    of_factors = file.read_text().partition('"factors"')[2]
    assert len(of_factors) / len(NAMES) * len(factors()) < 150_000, "with all factors"


def constants(given: Constants) -> dict[str, str]:
    """The constants by dotted name, as the findings of a ledger have them."""
    return dict(flat("", msgspec.json.decode(write_constants(given))))


OWN = constants(Constants())


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"cells": []}, "the cells are not those of the results table"),
        ({"dozen": ["world.message", "world.massage"]}, "is not there"),
        ({"parameters": "1"}, "expected"),
        ({"factors": [{}]}, "missing required field"),
        ({"runs": None}, "Expected `int`"),
    ],
)
def test_a_file_of_another_kind_is_refused(file: Path, tmp_path: Path, changed: dict[str, Any], said: str) -> None:
    other = tmp_path / "other.json"
    other.write_bytes(msgspec.json.encode(msgspec.json.decode(file.read_bytes()) | changed))
    with pytest.raises(FsarLedgerError, match=f"{said}.*study run sensitivity"):
        read(other, Sensitivity)


def test_a_factor_without_a_number_for_each_cell_is_refused(found: Sensitivity) -> None:
    short = msgspec.structs.replace(found.factors[0], mu=found.factors[0].mu[1:])
    with pytest.raises(ValueError, match=r"factor world\.message: not a number for each cell"):
        msgspec.structs.replace(found, factors=(short,), dozen=())


def report(model: str | None, parameters: dict[str, str], given: Sensitivity) -> Document:
    """A report of runs of this model and these constants, with these effects."""
    return Document(msgspec.structs.replace(made(), model_version=model, parameters=parameters), effects=given)


@pytest.mark.slow
def test_a_report_has_the_effects_of_its_runs_or_says_how_to_make_them(found: Sensitivity) -> None:
    there = report(MODEL_VERSION, OWN, found)
    assert column(there, "sensitivity", "factor") == list(found.dozen)
    assert "1 of them moves nothing" in said(there)
    absent = constants(setting(factors(), {"world.absence_s": 0.0}).constants)
    another_model = r"found effects of model .*, expected those of model {}; make them again"
    for model, parameters, why in (
        ("0", OWN, another_model.format(0)),
        (None, OWN, another_model.format("unknown")),
        (MODEL_VERSION, absent, r"around other constants \(world.absence_s\)"),
        (MODEL_VERSION, {}, "around other constants"),
    ):
        missing = report(model, parameters, found)
        assert "sensitivity" not in names(missing, "table")
        assert re.search(why, said(missing, "note"))
        assert "fsar-ledger study run sensitivity --out FILE" in said(missing, "note")


@pytest.mark.slow
def test_effects_name_the_queries_that_judged_them_and_the_report_those_that_changed(found: Sensitivity) -> None:
    assert found.rules == rules(METRICS)
    for given, is_said in (({"facts/conflicts": "0"}, True), (found.rules, False)):
        told = said(report(MODEL_VERSION, OWN, msgspec.structs.replace(found, rules=given)))
        assert ("They were judged before facts/conflicts changed." in told) == is_said


def test_the_table_names_the_cell_that_each_of_the_dozen_moves_furthest(found: Sensitivity) -> None:
    rows = dozen(found)
    assert (
        [row["factor"] for row in rows]
        == list(found.dozen)
        == [name for name, furthest in reach(found).items() if furthest]
    )
    assert rows[0]["range"] == "(0.025 to 0.25) to (0.1 to 1)"
    assert rows[0]["metric"] in ("governance_locality", "audit_attributability")  # the smallest margins
    assert rows[0]["mu_star_margins"] == pytest.approx(6 / 0.02, rel=1e-3)


@pytest.mark.slow
def test_the_heat_map_is_the_same_again_and_another_where_an_effect_is_another(found: Sensitivity) -> None:
    drawn = heat_map(found)
    assert drawn == heat_map(found)
    for other in (0.3, None):
        first = msgspec.structs.replace(found.factors[0], mu_star=(other,) * len(CELLS))
        assert heat_map(msgspec.structs.replace(found, factors=(first, *found.factors[1:]))) != drawn


@pytest.mark.slow
def test_a_small_study_of_the_simulator_is_the_same_with_any_number_of_workers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fsar_ledger.studies.sensitivity.REPEATS", 2)  # what chance does is not asked here
    subject = tuple(
        factor
        for factor in factors()
        if factor.name in ("structure.sync_period_us", "world.floor_teams", "world.window_mean_s")
    )
    few: dict[str, Any] = {"trajectories": 2, "points": 0, "subject": subject, "ask": evaluate}
    made = [study(tmp_path / f"{workers}.json", workers=workers, **few) for workers in (1, 2)]
    one, two = (msgspec.structs.replace(result, cpu_minutes=0.0) for result in made)
    assert one == two
    moved = {(effect.factor, effect.architecture) for effect in one.effects if effect.mu_star_margins}
    assert moved == {
        ("structure.sync_period_us", "cfc"),
        *(("world.window_mean_s", architecture) for architecture in PAPER_ARCHITECTURES),
    }


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--out", "effects.json", "--runs", "0"), "--runs 0: expected 1 to 9999"),
        (("--out", "effects.json", "--trajectories", "1"), "--trajectories 1: expected 2 to 9999"),
        (("--out", "effects.json", "--points", "-1"), "--points -1: expected 0 to 65536"),
    ],
)
def test_a_call_that_cannot_be_carried_out_is_one_message(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], said: str
) -> None:
    assert run(["study", "run", "sensitivity", *arguments]) == 2
    assert capsys.readouterr().err == f"fsar-ledger: {said}\n"
    assert not list(Path().glob("effects*"))
