"""The record of the fit, whole, in parts, absent and broken."""

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fsar_ledger.errors import FsarLedgerError
from fsar_ledger.report import document, typeset
from fsar_ledger.report.calibration import recorded
from fsar_ledger.report.findings import Findings
from fsar_ledger.report.gather import gather

WHOLE: dict[str, Any] = {
    "objective": {"description": "sum of squared distances", "start": 40.5, "accepted": 12.25},
    "seeds": [1, 2],
    "runs_per_scenario": 40,
    "evaluations": 7,
    "model_version": "1",
    "command": "fsar-ledger calibrate --out FILE",
    "parameters": [{"name": "world.motion_share", "unit": "share", "start": 0.2, "accepted": 0.24, "meaning": "motion", "identified": False}],
    "residuals": [{"metric": "governance_locality", "architecture": "fsar", "paper": 0.94, "ours": 0.947, "distance_se": 0.8}],
    "directions": [{"singular_value": 3.0, "identified": True, "weights": {"a": 0.1, "b": -0.9, "c": 0.3, "d": 0.01}}],
    "switch_offs": [{"mechanism": "closing", "metric": "governance_locality", "architecture": "fsar", "with_mechanism": 0.947, "without": 0.991}],
    "a key of the future": [1],
}


@pytest.fixture(scope="module")
def findings(ledger: Path) -> Findings:
    return gather(ledger)


@pytest.fixture(scope="module")
def drawings(findings: Findings) -> dict[str, bytes]:
    return document.drawings(findings)


def test_absent_record_is_none_and_said(tmp_path: Path, findings: Findings) -> None:
    assert recorded(tmp_path) is None
    assert document.data(findings, None)["fit"] is None


@pytest.mark.parametrize("missing", [None, *WHOLE])
def test_record_is_read_and_typeset_whatever_part_is_missing(tmp_path: Path, findings: Findings, drawings: dict[str, bytes], missing: str | None) -> None:
    (tmp_path / "calibration.json").write_text(json.dumps({key: value for key, value in WHOLE.items() if key != missing}))
    data = document.data(findings, recorded(tmp_path))
    assert typeset.pdf(document.encoded(data), drawings).startswith(b"%PDF")


def test_record_is_quoted_with_its_numbers(tmp_path: Path, findings: Findings) -> None:
    (tmp_path / "calibration.json").write_text(json.dumps(WHOLE))
    data: dict[str, Any] = msgspec.json.decode(document.encoded(document.data(findings, recorded(tmp_path))))
    assert data["fit"]["objective"]["accepted"] == 12.25
    assert (data["fit"]["identified"], data["fit"]["directions"]) == (1, 1)
    assert [cell["printed"] for cell in data["tables"]["calibrated-parameters"]["rows"][0]][:5] == ["world.motion_share", "0.2", "0.24", "share", "no"]
    assert data["tables"]["directions"]["rows"][0][3]["printed"] == "b \u22120.90, c 0.30, a 0.10"
    assert [cell["printed"] for cell in data["tables"]["switch-offs"]["rows"][0]][3:] == ["0.947", "0.991"]


@pytest.mark.parametrize("content", ["{", '{"seeds": "many"}', '{"parameters": [{"name": "x"}]}'])
def test_broken_record_is_refused_with_its_place(tmp_path: Path, content: str) -> None:
    (tmp_path / "calibration.json").write_text(content)
    with pytest.raises(FsarLedgerError, match=r"reports/calibration\.json"):
        recorded(tmp_path)


def test_packaged_record_can_be_typeset_if_it_is_there(findings: Findings, drawings: dict[str, bytes]) -> None:
    assert typeset.pdf(document.encoded(document.data(findings, recorded())), drawings).startswith(b"%PDF")
