"""What the report says of the packaged records, and what became of the registered predictions."""

import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fsar_ledger.base.errors import FsarLedgerError, UsageError
from fsar_ledger.metrics import study_results as bound
from fsar_ledger.metrics.effects import Sensitivity
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
from fsar_ledger.report import build, specs
from fsar_ledger.report import records as laid_out
from fsar_ledger.report.build import Document
from fsar_ledger.report.findings import Findings
from fsar_ledger.report.printing import flat
from fsar_ledger.studies.comparison import judge
from tests import records
from tests.quick import few
from tests.records import KEPT, reasons, renew, stale
from tests.report.conftest import PARAMETERS
from tests.report.made import column, made, names, replaced, said
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
    document = Document(of_the_record(findings), packaged(Calibration))
    assert f"What judges the runs has changed since the fit: {CONFLICTS}." in said(document, "note")
    assert f"They were judged before {CONFLICTS} changed, and not again." in said(document, "changed")
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
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, made: dict[str, Any], is_same: bool
) -> None:
    monkeypatch.setattr(records, "MADE", tmp_path / "made")
    record = tmp_path / "predictions.json"
    record.write_text(json.dumps({"numbers": [1], "rules": {"facts/conflicts": "old"}}))
    before = record.read_text()
    again = json.dumps({**made, "rules": {"facts/conflicts": "new"}})

    def make(out: Path) -> None:
        out.write_text(again)

    assert renew(record, make) == is_same
    assert record.read_text() == (again if is_same else before)
    assert (tmp_path / "made" / record.name).exists() != is_same


def test_records_are_made_until_one_has_other_results(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(records, "renew", lambda record, _: record.name == "predictions.json")
    assert records.main(["--stale"]) == records.main([]) == 0
    assert capsys.readouterr().out.count("rests on what there is\n") == len(KEPT)
    other = edited(CONFLICTS, ("min(began_us)", "max(began_us)"))
    monkeypatch.setattr(bound, "library", lambda: other)
    assert records.main(["--stale"]) == 0
    assert capsys.readouterr().out == "".join(f"{name}.json: {CONFLICTS}\n" for name in KEPT)
    assert records.main([]) == 1
    out = capsys.readouterr().out
    assert out.startswith("predictions.json: the same results\ncomparison.json: other results; kept, and these are in ")


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


def test_the_report_says_which_registered_predictions_hold_and_which_fail(findings: Findings) -> None:
    registered = json.loads(specs.text("comparison.json"))["predictions"]
    document = Document(of_the_record(findings))
    assert column(document, "predictions", "name") == [one["name"] for one in registered]
    assert column(document, "predictions", "holds") == [one["holds"] for one in registered]
    assert column(document, "predictions", "checks") == [f"{one['held']} of {one['of']}" for one in registered]
    failed = [one["name"] for one in registered if not one["holds"]]
    assert f"{len(failed)} do not ({', '.join(failed)})" in said(document, "predicted")


def test_predictions_are_those_of_the_runs_model_and_constants_or_none(findings: Findings, tmp_path: Path) -> None:
    assert laid_out.packaged_for(findings, Comparison, tmp_path) is None, "no record"
    write(tmp_path, True, False)
    assert len(known(laid_out.packaged_for(findings, Comparison, tmp_path)).predictions) == 2
    assert laid_out.packaged_for(msgspec.structs.replace(findings, model_version="2"), Comparison, tmp_path) is None
    assert laid_out.packaged_for(msgspec.structs.replace(findings, parameters={}), Comparison, tmp_path) is None
    (tmp_path / "comparison.json").write_text("{}")
    with pytest.raises(FsarLedgerError, match=r"comparison\.json: .*; write it again"):
        laid_out.packaged_for(findings, Comparison, tmp_path)
    assert "predictions" not in names(Document(findings), "table")


@pytest.mark.parametrize(
    ("holds", "words"),
    [
        ((True, False, False), "1 holds (p0) and 2 do not (p1, p2)"),
        ((False, False), "0 hold and 2 do not (p0, p1)"),
        ((True, None), "1 holds (p0) and 0 do not"),
    ],
)
def test_the_sentence_counts_and_names_what_holds_and_what_does_not(
    tmp_path: Path, findings: Findings, holds: tuple[bool | None, ...], words: str
) -> None:
    write(tmp_path, *holds)
    document = Document(replaced(made(), **laid_out.predictions(laid_out.packaged_for(findings, Comparison, tmp_path))))
    assert f"Of {len(holds)} predictions registered before they were run, {words}" in said(document)
    assert ("1 cannot be decided: p1" in said(document)) == (None in holds)


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
    "directions": [{"singular_value": 3.0, "identified": True, "weights": {"a": 0.1}}],
    "a key of the future": [1],
}


@pytest.mark.parametrize("missing", few([None, *WHOLE], [None], [*WHOLE][::3]))
def test_a_record_of_the_fit_is_read_and_typeset_whatever_part_is_missing(
    tmp_path: Path, findings: Findings, missing: str | None
) -> None:
    (tmp_path / "calibration.json").write_text(json.dumps({key: one for key, one in WHOLE.items() if key != missing}))
    document = Document(findings, packaged(Calibration, tmp_path))
    assert build.pdf(document.encoded(), document.drawings).startswith(b"%PDF")
    if missing is None:
        assert "1 constant was moved so that the means come near" in said(document)
        assert "It went from 40.50 to 12.25." in said(document)
        assert "The cells identify 1 of 1 directions." in said(document)
        columns = [
            column(document, "calibrated-parameters", key, "printed")[0] for key in ("name", "start", "accepted")
        ]
        assert columns == ["world.motion_share", "0.200", "0.240"]


@pytest.mark.parametrize(
    ("fitted", "ran", "words"),
    [
        (None, ["2"], "a model whose version is not on record, and these runs are of version 2."),
        ("1", ["1", "2"], "model version 1, and these runs are of versions 1, 2."),
        ("1", list("2345678"), "model version 1, and these runs are of versions 2, 3, 4, 5, 6 and 2 more."),
        ("1", ["\x1b[31m"], r"model version 1, and these runs are of version \x1b[31m."),
        ("1", [], None),
        ("1", ["1"], "The record of the fit does not say which queries judged its runs."),
    ],
)
def test_a_fit_of_another_model_is_named(fitted: str | None, ran: list[str], words: str | None) -> None:
    findings = msgspec.structs.replace(made(), model_versions=tuple(ran))
    found = laid_out.fit_changed(findings, Calibration(model_version=fitted))
    assert found is None if words is None else known(found).endswith(words)


def test_runs_under_constants_of_their_own_are_not_those_of_the_fit(findings: Findings) -> None:
    record = known(packaged(Calibration))
    same = of_the_record(findings)
    assert laid_out.fit_changed(same, record) is None
    moved = msgspec.structs.replace(same, parameters=same.parameters | {"world.routine_rate_per_s": "0"})
    found = known(laid_out.fit_changed(moved, record))
    assert found == "These runs have constants of their own, not those of the fit: world.routine_rate_per_s."
    document = Document(moved, record)
    assert f"{found} So no number counts as fitted." in said(document, "note")
    assert "constants were fitted" not in said(document, "answer")


def test_effects_that_nobody_gave_are_left_out_of_a_report_of_other_runs(findings: Findings) -> None:
    assert laid_out.packaged_for(of_the_record(findings), Sensitivity) is not None
    for other in (made(), findings):
        assert laid_out.packaged_for(other, Sensitivity) is None


@pytest.mark.parametrize("text", ["{", "[]", '{"seeds": "x"}', '{"parameters": [{"name": 1}]}'])
def test_a_broken_record_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "calibration.json").write_text(text)
    with pytest.raises(FsarLedgerError, match="write it again"):
        packaged(Calibration, tmp_path)
