"""The numbers of a report for programs: all that its tables say, of which heads, and the same bytes again."""

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fsar_ledger.base.errors import UsageError
from fsar_ledger.metrics.study_results import Calibration, packaged
from fsar_ledger.report import document
from fsar_ledger.report.build import write_report
from fsar_ledger.report.findings import Findings
from fsar_ledger.report.numbers import reproduction, tally
from tests.report.test_all_readings import found


@pytest.fixture(scope="module")
def written(alone: Findings) -> dict[str, Any]:
    decoded: dict[str, Any] = json.loads(reproduction(alone, document.counted(alone, None)))
    return decoded


def test_it_holds_every_printed_number_with_ours_and_what_became_of_it(
    alone: Findings, written: dict[str, Any]
) -> None:
    results = {(row["metric"], row["architecture"]): row for row in written["numbers"] if row["table"] == "results"}
    assert len(results) == 24
    for cell in alone.cells:
        row = results[cell["metric"], cell["architecture"]]
        assert (row["paper"], row["printed"], row["ours"]) == (cell["paper"], cell["paper_printed"], cell["mean"])
        assert row["n"] == cell["n"]
        assert (row["gives"], row["share"], row["could"], row["distance"]) == tuple(
            cell[name] for name in ("gives", "share", "could", "distance")
        )
        assert row["interval"] == (None if cell["interval"] is None else list(cell["interval"]))
    assert written["tally"] == tally(document.counted(alone, None))
    assert [row["t"] for row in written["tests"]] == [row["t"] for row in alone.tests]


def test_it_names_the_heads_the_model_the_constants_and_the_queries(alone: Findings, written: dict[str, Any]) -> None:
    assert written["ledgers"] == {
        "results": {"commits": alone.commits, "events": alone.size, "root": alone.root, "runs": alone.run_count}
    }
    assert written["queries"] == {one.name: one.sha256 for one in alone.sources}
    assert (written["model_version"], written["constants"]) == (alone.model_version, alone.parameters)
    assert written["parameters_sha256"] in {row["parameters_sha256"] for row in alone.models}
    assert {"fsar-ledger", "duckdb"} <= written["versions"].keys()
    assert written["multiverse"] is None


def test_it_holds_the_means_under_every_reading_where_they_were_asked_for(alone: Findings) -> None:
    read = found()
    rows = json.loads(reproduction(msgspec.structs.replace(alone, multiverse=read), ()))["multiverse"]
    assert len(rows["universes"]) == len(read.universes)
    assert [row["lowest"] for row in rows["cells"]] == [cell.lowest for cell in read.cells]


@pytest.mark.slow
def test_it_is_written_beside_the_report_and_holds_the_same_numbers(whole_report: Path, alone: Findings) -> None:
    assert whole_report.read_bytes().startswith(b"%PDF")
    written = json.loads(whole_report.with_name("report.pdf.json").read_bytes())
    expected = json.loads(reproduction(alone, document.counted(alone, packaged(Calibration))))
    for part in ("numbers", "tally", "tests", "scenarios", "constants", "table_share"):
        assert written[part] == expected[part]
    assert written["ledgers"]["results"] == expected["ledgers"]["results"]


def test_it_is_not_written_into_a_ledger(ledger: Path, tmp_path: Path) -> None:
    before = sorted(ledger.rglob("*"))
    with pytest.raises(UsageError, match="inside the ledger"):
        write_report(ledger, tmp_path / "report.pdf", numbers_out=ledger / "numbers.json")
    assert (sorted(ledger.rglob("*")), list(tmp_path.iterdir())) == (before, [])
