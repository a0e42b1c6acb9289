"""The paper's tables of grades and its four cases beside ours, from a ledger of results and one of workflows."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fsar_ledger.base.errors import UsageError
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.metrics.database import connect, plain_rows
from fsar_ledger.report import document, grades, result_rows, specs
from fsar_ledger.report.document import data
from fsar_ledger.report.findings import Findings
from fsar_ledger.report.gather import gather
from fsar_ledger.runtime.experiment import run_experiment, workflow_experiment
from tests.queries.histories import answer

Make = Callable[..., Path]


@pytest.fixture(scope="module")
def findings(ledger: Path, workflows: Path) -> Findings:
    return gather(ledger, workflows)


def printed(findings: Findings) -> dict[str, Any]:
    decoded: dict[str, Any] = msgspec.json.decode(document.encoded(document.data(findings, None)))
    return decoded


def column(table: dict[str, Any], name: str, key: str, what: str = "value") -> list[Any]:
    position = [one.key for one in specs.table(name).column].index(key)
    return [row[position][what] for row in table["rows"]]


def test_the_papers_marks_are_printed_as_they_are() -> None:
    rows = {row["feature"]: row for row in grades.features([])}
    assert [row["feature"] for row in rows.values()] == [
        row["feature"] for row in specs.paper_table("architecture_features")
    ]
    assert (rows["policy_composition"]["fsar_paper"], rows["policy_composition"]["cfc_paper"]) == ("full", "partial")
    assert rows["policy_composition"]["jade"] == "partial"
    assert {row["verdict"] for row in rows.values()} == {None}


@pytest.mark.parametrize(
    ("ours", "verdict"),
    [
        (("full", "full", "none"), "agrees"),
        (("full", "none", "none"), "differs: CFC"),
        (("none", None, "full"), "differs: FSAR, DHMA"),
        ((None, "full", None), "agrees"),
    ],
)
def test_a_feature_agrees_or_differs_where_the_ledger_shows_it(ours: tuple[str | None, ...], verdict: str) -> None:
    graded = [
        {"feature": "single_agent_robot", "architecture": name, "grade": grade}
        for name, grade in zip(("fsar", "cfc", "dhma"), ours, strict=True)
    ]
    assert grades.features(graded)[0]["verdict"] == verdict


def test_workflows_of_another_seed_have_no_part_in_the_table(make_ledger: Make, tmp_path: Path) -> None:
    ours = make_ledger(architectures=("fsar",), scenarios=("workflow-door-relay",))
    several = shutil.copytree(ours, tmp_path / "several")
    kept = next(open_ledger(ours).runs())
    other = LedgerRun("another", (0,), (None,), [msgspec.structs.replace(kept.events[0], seed=43)])
    with Writer(several, "test") as writer:
        writer.append(stage(several, [other]))
    alone, found = grades.workflows(ours), grades.workflows(several)
    assert (alone.others, found.others, found.run_count) == (0, 1, 3)
    assert found.coverage == alone.coverage
    assert any(row["workflow-door-relay_ours"] for row in found.coverage)


@pytest.mark.slow
def test_the_tables_hold_the_answers_of_their_queries(ledger: Path, findings: Findings) -> None:
    tables = printed(findings)["tables"]
    with connect(ledger) as database:
        rows = {
            (row["feature"], row["architecture"]): row
            for row in plain_rows(database.query("tables/architecture_features"))
        }
    evidence = tables["feature-evidence"]
    parts = (column(evidence, "feature-evidence", name) for name in ("feature", "architecture"))
    keys = list(zip(*parts, strict=True))
    assert len(keys) == len(set(keys)) == 24
    assert column(evidence, "feature-evidence", "grade") == [rows[key]["grade"] for key in keys]
    assert column(evidence, "feature-evidence", "evidence") == [rows[key]["evidence"] for key in keys]
    for architecture in ("fsar", "cfc", "dhma"):
        ours = column(tables["architectural-comparison"], "architectural-comparison", f"{architecture}_ours")
        assert ours == [rows[feature, architecture]["grade"] for feature in specs.labels("feature")]


def test_marks_are_the_papers_signs_and_a_mark_that_is_not_shown_is_a_dash(findings: Findings) -> None:
    table = printed(findings)["tables"]["architectural-comparison"]
    assert "".join(column(table, "architectural-comparison", "fsar_paper", "printed")) == "●——●●●●●"
    trust = list(specs.labels("feature")).index("trust_scoped_delegation")
    assert column(table, "architectural-comparison", "fsar_ours", "printed")[trust] == "–"
    assert {"RoboOS*", "JADE*", "ALLIANCE*"} <= set(table["heads"])


def test_every_feature_mechanism_and_difference_of_the_paper_has_its_words() -> None:
    assert list(specs.labels("feature")) == [row["feature"] for row in specs.paper_table("architecture_features")]
    assert list(specs.labels("mechanism")) == [row["mechanism"] for row in specs.paper_table("mechanism_coverage")]
    assert set(specs.labels("workflow")) == set(grades.WORKFLOWS)
    for name in specs.labels("difference"):
        workflow, mechanism, cell = name.split("/")
        assert workflow in grades.WORKFLOWS
        assert mechanism in specs.labels("mechanism")
        assert cell


def test_every_cell_of_the_coverage_stands_beside_the_papers_and_agrees_or_has_its_reason(findings: Findings) -> None:
    assert findings.workflows is not None
    for row in findings.workflows.coverage:
        differing = [name for name in grades.WORKFLOWS if row[f"{name}_paper"] != row[f"{name}_ours"]]
        assert row["verdict"] == (
            f"differs: {', '.join(specs.labels('workflow')[name] for name in differing)}" if differing else "agrees"
        )
    cells = {row["mechanism"]: row["workflow-layered-recovery_ours"] for row in findings.workflows.coverage}
    assert {name: cell for name, cell in cells.items() if cell is not None} == {
        row["mechanism"]: row["workflow_2_layered_recovery"]
        for row in specs.paper_table("mechanism_coverage")
        if row["workflow_2_layered_recovery"]
    }


@pytest.mark.slow
def test_both_figures_are_drawn_from_the_ledger_of_workflows(findings: Findings, alone: Findings) -> None:
    drawn = document.drawings(findings)
    assert set(drawn) == {f"{name}.svg" for name in printed(findings)["figures"]}
    assert b"query: door.open.secure" in drawn["workflow-door-relay.svg"]
    assert b"budget exhausted" in drawn["workflow-layered-recovery.svg"]
    assert set(document.drawings(alone)) == {"overview.svg", "evaluation-results.svg", "effects.svg"}


def test_the_tables_name_their_queries_and_the_appendix_the_heads_that_were_asked(findings: Findings) -> None:
    assert findings.workflows is not None
    data = printed(findings)
    assert data["tables"]["mechanism-coverage"]["source"] == "queries/tables/mechanism_coverage.sql"
    assert data["figures"]["workflow-door-relay"]["source"] == "queries/audit/request_timeline.sql"
    assert [(one["name"], one["root"]) for one in data["heads"]] == [("Workflows", findings.workflows.root)]
    assert data["head"]["root"] == findings.root != findings.workflows.root
    assert {"tables/mechanism_coverage", "audit/request_timeline", "facts/messages"} <= {
        source.name for source in findings.sources
    }


def test_without_workflows_the_report_says_so_and_a_ledger_without_them_is_refused(
    alone: Findings, ledger: Path, make_ledger: Make
) -> None:
    said = printed(alone)
    assert said["workflows"] is None
    assert "mechanism-coverage" not in said["tables"]
    with pytest.raises(UsageError, match="found no run of workflow-door-relay"):
        gather(ledger, make_ledger(runs=1, architectures=("cfc",)))


@pytest.mark.slow
def test_a_ledger_with_one_workflow_shows_what_it_has(ledger: Path, tmp_path: Path) -> None:
    run_experiment(tmp_path / "one", workflow_experiment(7, 1, ("workflow-layered-recovery",)), 1)
    found = gather(ledger, tmp_path / "one")
    assert found.workflows is not None
    assert (found.workflows.timeline, bool(found.workflows.recovery)) == ((), True)
    assert {row["verdict"] for row in found.workflows.coverage} == {"agrees"}
    assert set(printed(found)["figures"]) == {"overview", "evaluation-results", "effects", "workflow-layered-recovery"}


def claim(name: str, architecture: str, numerator: int, denominator: int, runs: int = 20) -> dict[str, Any]:
    return {
        "claim": name,
        "architecture": architecture,
        "numerator": numerator,
        "denominator": denominator,
        "runs": runs,
    }


def test_every_number_of_the_paper_has_one_cell_with_claims_that_the_queries_know() -> None:
    printed = [(int(row["case"]), row["architecture"].lower()) for row in specs.paper_table("cases")]
    assert [(cell.case, cell.architecture) for cell in specs.cases()] == printed
    taken = {row[0]: row[1:] for row in answer("cases/case_definitions", columns=("claim", "case_number", "is_taken"))}
    for cell in specs.cases():
        assert taken[cell.claim] == (cell.case, True)
        assert cell.of is None or taken[cell.of] == (cell.case, True)
        assert cell.other is None or taken[cell.other] == (cell.case, False)


def test_ours_stands_beside_the_papers_in_both_readings_with_what_was_counted() -> None:
    rows = result_rows.beside(
        [
            claim("contained locally", "fsar", 8, 11),
            claim("contained locally (degradation)", "fsar", 2, 3),
            claim("unattributed events", "cfc", 180, 60),
            claim("events", "cfc", 420, 60),
        ]
    )
    found = {(row["case"], row["architecture"]): row for row in rows}
    contained, handed = found[2, "fsar"], found[4, "cfc"]
    assert (contained["paper"], contained["value"]) == ("0.67", 8 / 11)
    assert (contained["counted"], contained["other"]) == ("8 in 11 runs with a failure", "0.67 (2 in 3)")
    assert (handed["paper"], handed["value"], handed["counted"]) == ("3", 3.0, "180 of 420 in 60 handoffs")
    assert handed["other"] is None
    assert [row["class"] for row in rows].count("by construction") == 6


def test_seeds_that_are_asked_for_together_are_added_and_what_has_no_case_or_no_run_has_no_number() -> None:
    rows = result_rows.beside(
        [claim("recovery loop", "dhma", 1, 4), claim("recovery loop", "dhma", 2, 8), claim("conflicts", "fsar", 0, 0)]
    )
    found = {(row["case"], row["architecture"]): row for row in rows}
    assert found[2, "dhma"]["value"] == 0.25
    assert [
        found[case, name][column]
        for case, name in ((3, "fsar"), (1, "fsar"))
        for column in ("value", "counted", "other")
    ] == [None] * 6
    nothing = claim("conflicts", "fsar", 0, 0, runs=0) | {"numerator": None, "denominator": None}
    assert result_rows.beside([nothing]) == ()


@pytest.mark.slow
def test_the_report_has_the_cases_of_the_runs_that_it_is_of_and_no_table_of_none(
    ledger: Path, make_ledger: Callable[..., Path]
) -> None:
    table = data(gather(ledger), None)["tables"]["cases"]
    cells = {(row[0].value, row[1].value): row for row in table.rows}
    assert cells[2, "fsar"][4].value is not None
    assert cells[4, "cfc"][4].printed == "–"
    assert "cases" not in data(gather(make_ledger(scenarios=("door-relay",))), None)["tables"]
    assert "cases" not in data(gather(make_ledger(fleet_size=8)), None)["tables"]
