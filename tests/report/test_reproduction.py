"""The numbers of a report for programs: all that its tables say, of which heads, and the same bytes again."""

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fsar_ledger.base.errors import UsageError
from fsar_ledger.metrics.study_results import Calibration, packaged
from fsar_ledger.report.build import Document, write_report
from fsar_ledger.report.findings import Findings
from tests.report.test_readings import found


@pytest.fixture(scope="module")
def written(document: Document) -> dict[str, Any]:
    decoded: dict[str, Any] = json.loads(document.reproduction())
    return decoded


def test_it_holds_every_printed_number_with_ours_and_what_became_of_it(
    findings: Findings, document: Document, written: dict[str, Any]
) -> None:
    results = [row for row in written["numbers"] if row["table"] == "results"]
    numbers = [one for one in findings.numbers if one.table == "results"]
    assert len(results) == len(numbers) == 24
    for row, one in zip(results, numbers, strict=True):
        assert row["class"] == one.kind
        for name in ("metric", "architecture", "paper", "printed", "ours", "n", "gives", "share", "could", "distance"):
            assert row[name] == getattr(one, name)
        assert row["interval"] == (None if one.interval is None else list(one.interval))
    assert sum(row["table"] == "significance" for row in written["numbers"]) == 24
    assert written["tally"] == document.tally
    assert written["tally"][-1]["printed"] == len(written["numbers"])
    assert [row["t"] for row in written["tests"]] == [row["t"] for row in findings.relations["paired"].to_pylist()]
    assert len(written["claims"]) == 8
    assert {row["scenario"] for row in written["measured"]} >= {None, "door-relay"}


def test_it_names_the_heads_the_model_the_constants_and_the_queries(
    findings: Findings, written: dict[str, Any]
) -> None:
    head = findings.heads["results"]
    assert written["ledgers"] == {
        "results": {"commits": head.commits, "events": head.events, "root": head.root, "runs": head.runs}
    }
    assert written["queries"] == {one.name: one.sha256 for one in findings.sources}
    assert (written["model_version"], written["constants"]) == (findings.model_version, findings.parameters)
    assert written["parameters_sha256"] in {row["sha256"] for row in findings.relations["models"].to_pylist()}
    assert {"fsar-ledger", "duckdb"} <= written["versions"].keys()
    assert (written["multiverse"], written["mechanisms"]) == (None, None)


def test_it_holds_the_means_under_every_reading_where_they_were_asked_for(findings: Findings) -> None:
    read = found()
    rows = json.loads(Document(msgspec.structs.replace(findings, multiverse=read)).reproduction())["multiverse"]
    assert len(rows["universes"]) == len(read.universes)
    assert [row["lowest"] for row in rows["cells"]] == [cell.lowest for cell in read.cells]


@pytest.mark.slow
def test_it_is_written_beside_the_report_and_holds_the_same_numbers(whole_report: Path, findings: Findings) -> None:
    assert whole_report.read_bytes().startswith(b"%PDF")
    written = json.loads(whole_report.with_name("report.pdf.json").read_bytes())
    expected = json.loads(Document(findings, packaged(Calibration)).reproduction())
    for part in ("numbers", "tally", "tests", "claims", "measured", "constants", "table_share"):
        assert written[part] == expected[part]
    assert written["ledgers"]["results"] == expected["ledgers"]["results"]


def test_it_is_not_written_into_a_ledger(ledger: Path, tmp_path: Path) -> None:
    before = sorted(ledger.rglob("*"))
    with pytest.raises(UsageError, match="inside the ledger"):
        write_report(ledger, tmp_path / "report.pdf", numbers_out=ledger / "numbers.json")
    assert (sorted(ledger.rglob("*")), list(tmp_path.iterdir())) == (before, [])
