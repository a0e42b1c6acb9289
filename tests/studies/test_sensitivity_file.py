"""The file, the table and the figure of a study."""

import re
from pathlib import Path

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fsar_ledger.base.errors import UsageError
from fsar_ledger.cli.app import run
from fsar_ledger.designs.constants import Constants, write_constants
from fsar_ledger.metrics.effects import METADATA, Sensitivity, dozen, open_effects, parquet, reach
from fsar_ledger.metrics.study_results import METRICS, rules
from fsar_ledger.report.document import Document
from fsar_ledger.report.printing import flat
from fsar_ledger.report.sensitivity import heat_map
from fsar_ledger.runtime.simulation import ARCHITECTURES, MODEL_VERSION
from fsar_ledger.studies.evaluations import CELLS
from fsar_ledger.studies.factors import factors, setting
from fsar_ledger.studies.sensitivity import Size, study
from tests.report.made import column, made, names, said
from tests.studies.conftest import NAMES


def test_a_file_is_read_as_it_was_written(file: Path, found: Sensitivity) -> None:
    assert parquet(found) == file.read_bytes()
    assert len(found.effects) == len(CELLS) * len(NAMES)


def constants(given: Constants) -> dict[str, str]:
    """The constants by dotted name, as the findings of a ledger have them."""
    return dict(flat("", msgspec.json.decode(write_constants(given))))


OWN = constants(Constants())


def test_a_file_of_another_kind_is_refused(file: Path, tmp_path: Path) -> None:
    foreign, text = tmp_path / "foreign.parquet", tmp_path / "text.parquet"
    pq.write_table(pa.table({"a": [1]}), foreign)
    text.write_text("no parquet")
    renamed = pq.read_table(file).drop_columns(["mu"])
    pq.write_table(renamed, tmp_path / "column.parquet")
    assert METADATA in renamed.schema.metadata
    pq.write_table(pq.read_table(file).slice(1), tmp_path / "row.parquet")
    for path in (foreign, text, tmp_path / "column.parquet", tmp_path / "row.parquet"):
        with pytest.raises(UsageError, match="found no file of effects"):
            open_effects(path)
    for path in (tmp_path / "nowhere.parquet", tmp_path):
        with pytest.raises(UsageError, match="found no such file, expected one of `fsar-ledger study run sensitivity"):
            open_effects(path)


def report(model: str | None, parameters: dict[str, str], given: Sensitivity) -> Document:
    """A report of runs of this model and these constants, with these effects."""
    return Document(msgspec.structs.replace(made(), model_version=model, parameters=parameters), effects=given)


def test_a_report_has_the_effects_of_its_runs_or_says_how_to_make_them(found: Sensitivity) -> None:
    there = report(MODEL_VERSION, OWN, found)
    assert column(there, "sensitivity", "factor") == list(found.about.dozen)
    assert "1 of them move nothing" in said(there)
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
        assert "fsar-ledger study run sensitivity --out FILE.parquet" in said(missing, "note")


def test_effects_name_the_queries_that_judged_them_and_the_report_those_that_changed(found: Sensitivity) -> None:
    assert found.about.rules == rules(METRICS)
    for given, is_said in (({"facts/conflicts": "0"}, True), (None, False)):  # None: of a version that kept no digests
        about = msgspec.structs.replace(found.about, rules=given)
        told = said(report(MODEL_VERSION, OWN, Sensitivity(about, found.effects)))
        assert ("They were judged before facts/conflicts changed." in told) == is_said


def test_the_table_names_the_cell_that_each_of_the_dozen_moves_furthest(found: Sensitivity) -> None:
    rows = dozen(found)
    assert (
        [row["factor"] for row in rows]
        == list(found.about.dozen)
        == [name for name, furthest in reach(found).items() if furthest]
    )
    assert rows[0]["range"] == "(0.025 to 0.25) to (0.1 to 1)"
    assert rows[0]["metric"] in ("governance_locality", "audit_attributability")  # the smallest margins
    assert rows[0]["mu_star_margins"] == pytest.approx(6 / 0.02, rel=1e-5)


@pytest.mark.slow
def test_the_heat_map_is_the_same_again_and_another_where_an_effect_is_another(found: Sensitivity) -> None:
    drawn = heat_map(found)
    assert drawn == heat_map(found)
    for other in (0.3, None):
        effects = [
            msgspec.structs.replace(one, mu_star_margins=other) if one.factor == "world.message" else one
            for one in found.effects
        ]
        assert heat_map(Sensitivity(found.about, tuple(effects))) != drawn


@pytest.mark.slow
def test_a_small_study_of_the_simulator_is_the_same_with_any_number_of_workers(tmp_path: Path) -> None:
    subject = tuple(
        factor
        for factor in factors()
        if factor.name in ("structure.sync_period_us", "world.floor_teams", "world.window_mean_s")
    )
    made = [study(tmp_path / f"{workers}.parquet", Size(2, 1, 0), workers, subject=subject) for workers in (1, 2)]
    assert made[0] == made[1]
    assert (tmp_path / "1.parquet").read_bytes() == (tmp_path / "2.parquet").read_bytes()
    moved = {(effect.factor, effect.architecture) for effect in made[0].effects if effect.mu_star}
    assert moved == {
        ("structure.sync_period_us", "cfc"),
        *(("world.window_mean_s", architecture) for architecture in ARCHITECTURES),
    }


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--out", "effects.csv"), "--out effects.csv: found a file name that ends in '.csv', expected .parquet"),
        (("--out", "effects.parquet", "--runs", "0"), "--runs 0: expected 1 to 9999"),
        (("--out", "effects.parquet", "--trajectories", "1"), "--trajectories 1: expected 2 to 9999"),
        (("--out", "effects.parquet", "--points", "-1"), "--points -1: expected 0 to 65536"),
    ],
)
def test_a_call_that_cannot_be_carried_out_is_one_message(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], said: str
) -> None:
    assert run(["study", "run", "sensitivity", *arguments]) == 2
    assert capsys.readouterr().err == f"fsar-ledger: {said}\n"
    assert not list(Path().glob("effects*"))
