"""The paper's four cases in the report: each number beside ours, in both readings, and never one of nothing."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from fsar_ledger.report import result_rows, specs
from fsar_ledger.report.document import data
from fsar_ledger.report.gather import gather
from tests.queries.histories import answer


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
    assert (contained["paper"], contained["value"], contained["counted"], contained["other"]) == (
        "0.67",
        8 / 11,
        "8 in 11 runs with a failure",
        "0.67 (2 in 3)",
    )
    assert (handed["paper"], handed["value"], handed["counted"], handed["other"]) == (
        "3",
        3.0,
        "180 of 420 in 60 handoffs",
        None,
    )
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
