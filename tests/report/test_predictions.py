"""What was registered before it was run, and what became of it, on the first page and in a table."""

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest
import typst

from fsar_ledger.errors import FsarLedgerError
from fsar_ledger.metrics.study_results import METRICS, Comparison, Outcome, encoded, rules
from fsar_ledger.report import document, predictions, specs
from fsar_ledger.report.findings import Findings
from fsar_ledger.report.printing import flat
from tests.report.conftest import PARAMETERS


def of_the_record(findings: Findings, **other: Any) -> Findings:
    """The same, of the model and the constants that the packaged record is of."""
    record = json.loads(specs.text("comparison.json"))
    parameters = dict(flat("", json.loads(record["parameters"])))
    return msgspec.structs.replace(
        findings, **({"model_version": record["model_version"], "parameters": parameters} | other)
    )


def write(folder: Path, *holds: bool | None) -> None:
    told = [
        Outcome(name=f"p{n}", implies="as said", holds=one, held=3 if one else 1, of=3, checks=[])
        for n, one in enumerate(holds)
    ]
    result = Comparison(model_version="1", parameters=PARAMETERS, rules=rules(METRICS), cells=[], predictions=told)
    (folder / "comparison.json").write_bytes(encoded(result))


@pytest.mark.slow
def test_the_first_page_says_which_registered_predictions_fail_and_a_table_says_all(
    findings: Findings, tmp_path: Path
) -> None:
    registered = json.loads(specs.text("comparison.json"))["predictions"]
    found = of_the_record(findings)
    data = document.data(found, None)
    rows = data["tables"]["predictions"].rows
    assert [(row[0].value, row[3].value) for row in rows] == [(one["name"], one["holds"]) for one in registered]
    assert [row[2].printed for row in rows] == [f"{one['held']} of {one['of']}" for one in registered]
    (tmp_path / "report.typ").write_text(specs.text("templates", "report.typ"))
    (tmp_path / "data.json").write_bytes(document.encoded(data))
    for name, svg in document.drawings(found).items():
        (tmp_path / name).write_bytes(svg)
    [passage] = json.loads(typst.query(tmp_path / "report.typ", "<predicted>"))
    failed = [one["name"] for one in registered if not one["holds"]]
    assert f"{len(failed)} do not ({', '.join(failed)})." in json.dumps(passage, ensure_ascii=False)


def test_predictions_are_those_of_the_runs_model_and_constants_or_none(findings: Findings, tmp_path: Path) -> None:
    assert predictions.judged(findings, tmp_path) is None, "no record"
    write(tmp_path, True, False)
    assert len(predictions.outcomes(predictions.judged(findings, tmp_path))) == 2
    assert predictions.judged(msgspec.structs.replace(findings, model_version="2"), tmp_path) is None
    assert predictions.judged(msgspec.structs.replace(findings, parameters={}), tmp_path) is None
    (tmp_path / "comparison.json").write_text("{}")
    with pytest.raises(FsarLedgerError, match=r"comparison\.json: .*; write it again"):
        predictions.judged(findings, tmp_path)


@pytest.mark.parametrize(
    ("holds", "words"),
    [
        ((True, False, False), "1 holds (p0) and 2 do not (p1, p2)."),
        ((True, False), "1 holds (p0) and 1 does not (p1)."),
        ((False, False), "0 hold and 2 do not (p0, p1)."),
        ((True, None), "1 holds (p0) and 0 do not; 1 cannot be decided (p1)."),
    ],
)
def test_the_sentence_counts_and_names_what_holds_and_what_does_not(
    findings: Findings, tmp_path: Path, holds: tuple[bool | None, ...], words: str
) -> None:
    write(tmp_path, *holds)
    assert predictions.said(predictions.judged(findings, tmp_path)) == {
        "sentence": f"Of {len(holds)} predictions registered before they were run, {words}"
    }
    assert predictions.said(None) is None
