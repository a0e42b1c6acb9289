"""The records of the evaluation rest on the queries as they are, and say which of them judges otherwise now."""

import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fsar_ledger.errors import UsageError
from fsar_ledger.metrics import study_results as bound
from fsar_ledger.metrics.library import Library, library, plain_sql
from fsar_ledger.metrics.study_results import CLAIMS, METRICS, Calibration, changed, packaged, rules
from fsar_ledger.report import document, predictions
from fsar_ledger.report.findings import Findings
from fsar_ledger.studies.comparison import judge
from tests import records
from tests.records import RELATIONS, renew, stale
from tests.report.test_predictions import of_the_record

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


@pytest.mark.parametrize("name", RELATIONS)
def test_a_record_rests_on_the_queries_as_they_are(name: str) -> None:
    assert stale(name) == [], "see docs/contributing/judging-rule.md"


def test_a_changed_rule_is_named_by_every_record(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, findings: Findings
) -> None:
    before = rules(METRICS)
    other = edited(CONFLICTS, ("min(began_us)", "max(began_us)"))
    monkeypatch.setattr(bound, "library", lambda: other)
    assert [name for name, digest in rules(METRICS).items() if before[name] != digest] == [CONFLICTS]
    for name in RELATIONS:
        assert stale(name) == [CONFLICTS]
        assert changed(kept(name)["rules"]) == [CONFLICTS]
    fit = document.data(of_the_record(findings), packaged(Calibration))["fit"]
    assert CONFLICTS in fit["changed"]
    told = predictions.said(predictions.judged(of_the_record(findings)))
    assert told is not None
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
    assert capsys.readouterr().out.count("rests on the queries as they are\n") == 3
    other = edited(CONFLICTS, ("min(began_us)", "max(began_us)"))
    monkeypatch.setattr(bound, "library", lambda: other)
    monkeypatch.setattr(records, "renew", lambda record, _: record.name == "predictions.json")
    assert records.main(["--stale"]) == 0
    assert capsys.readouterr().out == "".join(f"{name}.json: {CONFLICTS}\n" for name in RELATIONS)
    assert records.main([]) == 1
    assert capsys.readouterr().out == "predictions.json: the same results\ncomparison.json: other results; kept\n"
