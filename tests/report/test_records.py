"""What the report says of the packaged records, and what became of the registered predictions."""

import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import msgspec
import pytest
import typst

from fsar_ledger.base.errors import FsarLedgerError, UsageError
from fsar_ledger.metrics import study_results as bound
from fsar_ledger.metrics.library import Library, library, plain_sql
from fsar_ledger.metrics.study_results import (
    CLAIMS,
    METRICS,
    Calibration,
    Comparison,
    Outcome,
    changed,
    encoded,
    packaged,
    rules,
)
from fsar_ledger.report import document, numbers, specs
from fsar_ledger.report.findings import Findings
from fsar_ledger.report.printing import flat
from fsar_ledger.studies.comparison import judge
from tests import records
from tests.records import KEPT, reasons, renew, stale
from tests.report.conftest import PARAMETERS
from tests.sure import known

CONFLICTS = "facts/conflicts"


def kept(name: str) -> dict[str, Any]:
    """A packaged record."""
    record: dict[str, Any] = json.loads(files("fsar_ledger.reports").joinpath(f"{name}.json").read_text())
    return record


def edited(name: str, edit: tuple[str, str]) -> Library:
    """The packaged queries with this text of one of them replaced."""
    query = library().queries[name]
    assert edit[0] in query.sql
    other = msgspec.structs.replace(query, sql=query.sql.replace(*edit))
    return Library([*(one for one in library().queries.values() if one is not query), other])


@pytest.mark.parametrize("name", KEPT)
def test_a_record_rests_on_the_queries_as_they_are(name: str) -> None:
    assert reasons(name) == "", "see docs/contributing/judging-rule.md"


def test_a_changed_rule_is_named_by_every_record(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, findings: Findings
) -> None:
    before = rules(METRICS)
    other = edited(CONFLICTS, ("min(began_us)", "max(began_us)"))
    monkeypatch.setattr(bound, "library", lambda: other)
    assert [name for name, digest in rules(METRICS).items() if before[name] != digest] == [CONFLICTS]
    for name in KEPT:
        assert stale(name) == [CONFLICTS]
        assert changed(kept(name)["rules"]) == [CONFLICTS]
    fit = document.data(of_the_record(findings), packaged(Calibration))["fit"]
    assert CONFLICTS in fit["changed"]
    told = known(numbers.predictions_said(numbers.judged(of_the_record(findings))))
    assert f"they were judged before {CONFLICTS} changed" in told["sentence"]
    place = tmp_path / "predictions.json"
    place.write_bytes(files("fsar_ledger.reports").joinpath("predictions.json").read_bytes())
    with pytest.raises(UsageError, match=f"{CONFLICTS}; judge them"):
        judge(place, tmp_path / "comparison.json")
    assert list(tmp_path.iterdir()) == [place]


def test_a_query_that_is_gone_is_named() -> None:
    left = Library(one for one in library().queries.values() if one.name != CONFLICTS)
    assert changed(rules(METRICS), left) == [CONFLICTS]


def test_comments_and_layout_are_no_rules() -> None:
    query = library().queries[CONFLICTS]
    spaced = query.sql.replace("\n", "\n\n    -- a remark, it's said\n").replace(" AS ", "  AS\t")
    assert spaced != query.sql
    assert plain_sql(spaced) == plain_sql(query.sql)
    assert plain_sql("SELECT 'a  b -- c' /* d */ AS x") == "SELECT 'a  b -- c' AS x"
    assert plain_sql("SELECT 'a  b'") != plain_sql("SELECT 'a b'")


def test_what_has_the_fields_of_events_is_no_rule() -> None:
    named = rules(METRICS, CLAIMS)
    assert CONFLICTS in named
    assert not any(library().queries[name].tags for name in named)


@pytest.mark.parametrize(("made", "is_same"), [({"numbers": [1]}, True), ({"numbers": [2]}, False)])
def test_a_record_is_renewed_only_if_its_results_are_the_same(
    tmp_path: Path, made: dict[str, Any], is_same: bool
) -> None:
    record = tmp_path / "predictions.json"
    record.write_text(json.dumps({"numbers": [1], "rules": {"facts/conflicts": "old"}}))
    before = record.read_text()
    again = json.dumps({**made, "rules": {"facts/conflicts": "new"}})

    def make(out: Path) -> None:
        out.write_text(again)

    assert renew(record, make) == is_same
    assert record.read_text() == (again if is_same else before)


def test_records_are_made_until_one_has_other_results(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert records.main(["--stale"]) == records.main([]) == 0
    assert capsys.readouterr().out.count("rests on what there is\n") == len(KEPT)
    other = edited(CONFLICTS, ("min(began_us)", "max(began_us)"))
    monkeypatch.setattr(bound, "library", lambda: other)
    monkeypatch.setattr(records, "renew", lambda record, _: record.name == "predictions.json")
    assert records.main(["--stale"]) == 0
    assert capsys.readouterr().out == "".join(f"{name}.json: {CONFLICTS}\n" for name in KEPT)
    assert records.main([]) == 1
    assert capsys.readouterr().out == "predictions.json: the same results\ncomparison.json: other results; kept\n"


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
    assert numbers.judged(findings, tmp_path) is None, "no record"
    write(tmp_path, True, False)
    assert len(numbers.outcomes(numbers.judged(findings, tmp_path))) == 2
    assert numbers.judged(msgspec.structs.replace(findings, model_version="2"), tmp_path) is None
    assert numbers.judged(msgspec.structs.replace(findings, parameters={}), tmp_path) is None
    (tmp_path / "comparison.json").write_text("{}")
    with pytest.raises(FsarLedgerError, match=r"comparison\.json: .*; write it again"):
        numbers.judged(findings, tmp_path)


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
    assert numbers.predictions_said(numbers.judged(findings, tmp_path)) == {
        "sentence": f"Of {len(holds)} predictions registered before they were run, {words}"
    }
    assert numbers.predictions_said(None) is None
