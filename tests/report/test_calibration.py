"""The record of the fit, whole, in parts, absent and broken."""

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest
import typst

from fsar_ledger.base.errors import FsarLedgerError
from fsar_ledger.metrics.study_results import METRICS, Calibration, Parameter, packaged, rules
from fsar_ledger.report import build, document, specs
from fsar_ledger.report.findings import Findings

WHOLE: dict[str, Any] = {
    "objective": {"description": "sum of squared distances", "start": 40.5, "accepted": 12.25},
    "seeds": [1, 2],
    "runs_per_scenario": 40,
    "evaluations": 7,
    "model_version": "1",
    "rules": rules(METRICS),
    "command": "fsar-ledger study run calibration --out FILE",
    "parameters": [
        {
            "name": "world.motion_share",
            "unit": "share",
            "start": 0.2,
            "accepted": 0.24,
            "meaning": "motion",
            "identified": False,
        }
    ],
    "residuals": [
        {"metric": "governance_locality", "architecture": "fsar", "paper": 0.94, "ours": 0.947, "distance_margins": 0.8}
    ],
    "directions": [{"singular_value": 3.0, "identified": True, "weights": {"a": 0.1, "b": -0.9, "c": 0.3, "d": 0.01}}],
    "a key of the future": [1],
}


@pytest.fixture(scope="module")
def drawings(findings: Findings) -> dict[str, bytes]:
    return document.drawings(findings)


def test_absent_record_is_none_and_said(tmp_path: Path, findings: Findings) -> None:
    assert packaged(Calibration, tmp_path) is None
    assert document.data(findings, None)["fit"] is None


@pytest.mark.parametrize("missing", [None, *(pytest.param(part, marks=pytest.mark.slow) for part in WHOLE)])
def test_record_is_read_and_typeset_whatever_part_is_missing(
    tmp_path: Path, findings: Findings, drawings: dict[str, bytes], missing: str | None
) -> None:
    (tmp_path / "calibration.json").write_text(
        json.dumps({key: value for key, value in WHOLE.items() if key != missing})
    )
    data = document.data(findings, packaged(Calibration, tmp_path))
    assert build.pdf(document.encoded(data), drawings).startswith(b"%PDF")


def test_record_is_quoted_with_its_numbers(tmp_path: Path, findings: Findings) -> None:
    (tmp_path / "calibration.json").write_text(json.dumps(WHOLE))
    data: dict[str, Any] = msgspec.json.decode(
        document.encoded(document.data(findings, packaged(Calibration, tmp_path)))
    )
    assert data["fit"]["objective"]["accepted"] == 12.25
    assert (data["fit"]["identified"], data["fit"]["directions"]) == (1, 1)
    found = [cell["printed"] for cell in data["tables"]["calibrated-parameters"]["rows"][0]][:5]
    assert found == ["world.motion_share", "0.2", "0.24", "share", "no"]
    assert data["tables"]["directions"]["rows"][0][3]["printed"] == "b \u22120.90, c 0.30, a 0.10"


def test_the_trial_is_told_of_a_fit_that_came_after_it_and_of_no_other(findings: Findings) -> None:
    told = {
        version: document.data(findings, Calibration(model_version=version))["fit"]["trial"] for version in ("1", "2")
    }
    assert told == {"1": False, "2": True}


def said_of_the_fit(folder: Path, findings: Findings, record: Calibration | None) -> list[str]:
    """The sentences, as they are typeset, that say that the record of the fit is of another model."""
    (folder / "report.typ").write_text(specs.text("templates", "report.typ"))
    (folder / "data.json").write_bytes(document.encoded(document.data(findings, record)))
    for name, svg in document.drawings(findings).items():
        (folder / name).write_bytes(svg)
    return [json.dumps(one, ensure_ascii=False) for one in json.loads(typst.query(folder / "report.typ", "<changed>"))]


@pytest.mark.slow
def test_a_fit_of_another_model_is_named_once_at_the_answer(tmp_path: Path, findings: Findings) -> None:
    record = Calibration(
        model_version="0", parameters=[Parameter(name="world.motion_share", unit="share", start=0.2, accepted=0.24)]
    )
    for found in (
        findings,
        msgspec.structs.replace(
            findings, unjudged="Other runs.", cells=tuple(row | {"gives": None} for row in findings.cells)
        ),
    ):
        [passage] = said_of_the_fit(tmp_path, found, record)
        assert (
            "The model has changed since the fit: the constants were fitted to model version 0, and these runs "
            "are of version 1." in passage
        )
        assert "So no cell counts as fitted." in passage


@pytest.mark.parametrize(
    "record", [pytest.param(None, marks=pytest.mark.slow), Calibration(model_version="1", rules=rules(METRICS))]
)
def test_a_fit_of_these_runs_model_is_not_doubted(
    tmp_path: Path, findings: Findings, record: Calibration | None
) -> None:
    assert said_of_the_fit(tmp_path, findings, record) == []


@pytest.mark.parametrize(
    ("fitted", "ran", "said"),
    [
        (None, ["2"], "a model whose version is not on record, and these runs are of version 2."),
        ("1", ["2", "1", "2"], "model version 1, and these runs are of versions 1, 2."),
        ("1", list("8765432"), "model version 1, and these runs are of versions 2, 3, 4, 5, 6 and 2 more."),
        ("1", ["\x1b[31m"], r"model version 1, and these runs are of version \x1b[31m."),
        ("1", [], None),
    ],
)
def test_every_model_of_the_runs_counts(
    findings: Findings, fitted: str | None, ran: list[str], said: str | None
) -> None:
    several = msgspec.structs.replace(
        findings, model_version=None, models=tuple({**findings.models[0], "model_version": one} for one in ran)
    )
    changed = document.data(several, Calibration(model_version=fitted, rules=rules(METRICS)))["fit"]["changed"]
    assert changed == (said and f"The model has changed since the fit: the constants were fitted to {said}")


def test_reasons_that_were_found_with_another_model_are_not_given(findings: Findings) -> None:
    miss = {"metric": "authority_conflicts", "architecture": "cfc", "gives": "no", "distance": 3.0}
    cells = tuple(
        row | miss if (row["metric"], row["architecture"]) == ("authority_conflicts", "cfc") else row
        for row in findings.cells
    )
    missing = msgspec.structs.replace(findings, cells=cells)

    def reason(fitted: str) -> str | None:
        misses = document.data(missing, Calibration(model_version=fitted, rules=rules(METRICS)))["misses"]
        found: str | None = next(
            one["reason"] for one in misses if one["title"] == "Authority conflicts (per run), CFC"
        )
        return found

    assert reason("1") is not None
    assert reason("0") is None


@pytest.mark.parametrize("content", ["{", '{"seeds": "many"}', '{"parameters": [{"name": "x"}]}'])
def test_broken_record_is_refused_with_its_place(tmp_path: Path, content: str) -> None:
    (tmp_path / "calibration.json").write_text(content)
    with pytest.raises(FsarLedgerError, match=r"reports/calibration\.json"):
        packaged(Calibration, tmp_path)


def test_packaged_record_can_be_typeset_if_it_is_there(findings: Findings, drawings: dict[str, bytes]) -> None:
    assert build.pdf(document.encoded(document.data(findings, packaged(Calibration))), drawings).startswith(b"%PDF")
