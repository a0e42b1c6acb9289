"""The constants and their effects that the PDF prints."""

import shutil
from hashlib import sha256
from pathlib import Path

import msgspec
import pytest

from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.report import document, printing
from fsar_ledger.report.findings import Findings
from fsar_ledger.report.gather import gather
from fsar_ledger.report.printing import flat
from fsar_ledger.report.sensitivity import Section
from tests.report.conftest import PARAMETERS


@pytest.mark.slow
def test_the_effects_of_constants_stand_where_they_were_given(findings: Findings) -> None:
    effects = Section("70 were varied.", b"<svg/>", printing.table("sensitivity", []))
    data, without = document.data(findings, None, effects), document.data(findings, None, Section("None were varied."))
    assert (data["sensitivity"], without["sensitivity"]) == ("70 were varied.", "None were varied.")
    assert (
        data["tables"].keys() - without["tables"].keys()
        == data["figures"].keys() - without["figures"].keys()
        == {"sensitivity"}
    )
    assert document.drawings(findings, effects)["sensitivity.svg"] == b"<svg/>"
    assert "sensitivity.svg" not in document.drawings(findings)


def test_constants_of_the_first_run_are_listed_by_name(findings: Findings) -> None:
    assert findings.parameters == {
        "structure.poll_us": "1\u2009000\u2009000",
        "world.message": "0.05 to 0.5 s",
        "world.motion_share": "0.24",
    }
    assert [row["runs"] for row in findings.models] == [30]
    assert findings.runs[0]["seeds"] == "42"
    assert findings.runs[0]["numbers"] == "0 to 1"


@pytest.mark.slow
def test_constants_are_those_of_the_runs_in_the_tables_and_not_of_others_that_come_first(
    ledger: Path, tmp_path: Path, findings: Findings
) -> None:
    several = shutil.copytree(ledger, tmp_path / "several")
    kept = [run for run in open_ledger(ledger).runs() if run.run_id.startswith("fleet-contention-0-")]
    other = '{"world":{"motion_share":0.5}}'
    runs = [
        LedgerRun(
            f"0-{run.run_id}",
            run.times_us,
            run.caused_by,
            [msgspec.structs.replace(run.events[0], parameters=other), *run.events[1:]],
        )
        for run in kept
    ]
    with Writer(several, "test") as writer:
        writer.append(stage(several, runs))
    found = gather(several)
    assert len(found.models) == 2
    assert (found.parameters, found.parameters_sha256) == (findings.parameters, sha256(PARAMETERS.encode()).hexdigest())


def test_nested_constants_become_dotted_names() -> None:
    nested = {
        "b": [["nav", {"low_s": 2.0, "high_s": 6.5}], ["carry", -50.0]],
        "a": {"flag": True, "list": [1, 20_000], "none": []},
    }
    assert list(flat("", nested)) == [
        ("a.flag", "True"),
        ("a.list", "1, 20\u2009000"),
        ("a.none", ""),
        ("b.carry", "\u221250"),
        ("b.nav", "2 to 6.5 s"),
    ]
