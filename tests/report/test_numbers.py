"""The first page: every printed number once, with its class and what became of it, counted and drawn."""

from collections.abc import Iterable
from typing import Any

import pytest

from fsar_ledger.metrics.study_results import METRICS, Calibration, rules
from fsar_ledger.metrics.verdicts import MARGINS
from fsar_ledger.report import document, specs
from fsar_ledger.report.figures import overview_figure
from fsar_ledger.report.findings import Ablation, Findings, LedgerHead, Row, Scaling, with_agreement
from fsar_ledger.report.numbers import OPEN, OUTCOMES, STANDS, TABLES, UNDECIDED, numbers, said, tally
from tests.report.test_figures import words

HEAD = LedgerHead(1, 1, "root", 1, "complete", "2")
FAILS = "does not"


def cell(gives: str | None = "yes", kind: str = "informed", **other: Any) -> Row:
    """A cell of a table, of locality unless told; its interval is half a margin wide."""
    found = {
        "metric": "governance_locality",
        "architecture": "fsar",
        "configuration": "full",
        "fleet_size": 4,
        "scenario": None,
        "class": kind,
        "paper": 0.9,
        "paper_printed": "0.90",
        "mean": 0.92,
        "n": 5,
        "interval": (0.91, 0.93),
        "difference": (0.015, 0.025),
        "distance": 1.0,
        "gives": gives,
        "share": 0.2,
        "could": "yes",
        "one": 0.94,
    }
    return found | other


def findings(
    cells: Iterable[Row] = (),
    ablation: Iterable[Row] = (),
    scaling: Iterable[Row] = (),
    cases: Iterable[Row] = (),
    tests: Iterable[Row] = (),
    loads: Iterable[Row] = (),
) -> Findings:
    """What ledgers with these rows say."""
    points = (
        {
            "metric": "coordination_success",
            "architecture": "fsar",
            "configuration": "without-shared-registry",
            "scenario": None,
        },
    )
    curve = tuple(point | {"mean": mean} for point in points for mean in (0.1, 0.7))
    return Findings(
        *(1, 1, "", 1, tuple(cells), tuple(tests), (), (), (), (), (), {}, ()),
        cases=tuple(cases),
        ablation=Ablation(HEAD, 90.0, tuple(ablation), (), curve, ()) if ablation else None,
        scaling=Scaling(HEAD, tuple(scaling), tuple(loads)) if scaling else None,
    )


def outcomes(found: Findings) -> list[str]:
    return [row["outcome"] for row in numbers(found)]


def test_a_number_stands_or_does_not_by_the_answer_that_its_table_has() -> None:
    rows = [cell("yes"), cell("no"), cell("undecided"), cell(None)]
    assert (
        outcomes(findings(rows))
        == outcomes(findings(ablation=rows))
        == outcomes(findings(scaling=rows))
        == [STANDS, FAILS, UNDECIDED, UNDECIDED]
    )


def test_what_the_papers_own_text_excludes_does_not_stand_whatever_the_runs_say() -> None:
    rows = [cell(gives, "cannot follow") for gives in ("yes", "no", "undecided", None)]
    found = numbers(findings(ablation=rows))
    assert {row["outcome"] for row in found} == {FAILS}
    assert said(found)["drawn"] == 0, "an experiment on this model is no answer to what the text excludes"


def test_a_number_that_hangs_on_an_open_dial_has_no_verdict_but_the_range_that_the_dial_gives() -> None:
    registry = {
        "metric": "coordination_success",
        "configuration": "without-shared-registry",
        "distance": None,
        "difference": None,
    }
    ablated = cell(None, "unspecified", **registry, paper=0.8, mean=0.35)
    larger = cell(None, "unspecified", fleet_size=16, distance=None, difference=None, paper=0.93)
    found = numbers(findings(ablation=[ablated], scaling=[larger]))
    assert [row["outcome"] for row in found] == [OPEN, OPEN]
    success, locality = MARGINS["coordination_success"], MARGINS["governance_locality"]
    assert found[0]["reach"] == pytest.approx(((0.1 - 0.8) / success, (0.7 - 0.8) / success))
    assert found[1]["reach"] == pytest.approx(((0.92 - 0.93) / locality, (0.94 - 0.93) / locality))
    assert (said(found)["open"], said(found)["outside"]) == (2, 1), (
        "only the first is farther than a margin from all that the dial gives"
    )


def test_the_range_of_a_load_that_the_text_leaves_open_is_that_over_all_loads_at_this_size() -> None:
    larger = cell(None, "unspecified", fleet_size=16, distance=None, difference=None, paper=0.93)
    between, other = (
        larger | {"fleet_size": size, "teams_working": 2, "mean": mean} for size, mean in ((16, 0.99), (8, 0.1))
    )
    [found] = numbers(findings(scaling=[larger], loads=[between, other, between | {"mean": None}]))
    margin = MARGINS["governance_locality"]
    assert found["reach"] == pytest.approx(((0.92 - 0.93) / margin, (0.99 - 0.93) / margin)), (
        "one team gives 0.94, two give 0.99"
    )


def test_a_pairwise_test_stands_where_its_sign_and_its_level_come_out() -> None:
    def test(t: float | None, p: float = 0.02) -> Row:
        named = {"metric": "governance_locality", "comparison": "fsar-cfc", "n": 5}
        return named | with_agreement({"t": t, "p": p, "paper_t": -2.0, "paper_level": "p<.05"})

    found = outcomes(findings(tests=[test(-1.0), test(1.0), test(-1.0, 0.2), test(None)]))
    assert found == [STANDS, FAILS, FAILS, UNDECIDED]
    assert numbers(findings(tests=[test(None)])) == (), "no test at all is a table that is not there"


def test_a_number_of_a_case_is_decided_exactly_where_a_mechanism_restates_it_and_else_not() -> None:
    def case(paper: str, value: float | None, kind: str = "by construction") -> Row:
        return {"case": 1, "architecture": "cfc", "class": kind, "paper": paper, "value": value}

    rows = [
        case("all", 1.0),
        case("all", 0.9),
        case("3", 3.0),
        case("0", 0.01),
        case("0", None),
        case("0.85", 0.85, "informed"),
    ]
    found = numbers(findings(cases=rows))
    assert [row["outcome"] for row in found] == [STANDS, FAILS, STANDS, FAILS, UNDECIDED, UNDECIDED]
    assert [row["paper"] for row in found[:3]] == [1.0, 1.0, 3.0]
    counted = said(numbers(findings(cases=[*rows, case("0.85", None, "informed")])))
    assert (counted["undecided"], counted["unregistered"]) == (3, 1), (
        "what has no value, or stands by construction, lacks no margin"
    )


def test_every_number_of_a_table_is_counted_once_under_its_class_and_all_of_them_at_the_end() -> None:
    found = numbers(
        findings(
            [cell("yes"), cell("no")],
            [cell("yes"), cell("no", "cannot follow"), cell(None, "unspecified")],
            [cell("undecided")],
        )
    )
    rows = tally(found)
    assert [(row["table"], row["class"], row["printed"]) for row in rows] == [
        *(("Evaluation results", "fitted", 2), ("Ablation", "informed", 1)),
        *(("Ablation", "cannot follow", 1), ("Ablation", "unspecified", 1)),
        *(("Scaling", "informed", 1), ("All", "", 6)),
    ]
    assert all(sum(row[name] for name in OUTCOMES) == row["printed"] for row in rows)
    assert [rows[-1][name] for name in OUTCOMES] == [2, 2, 1, 1]
    counted = said(found)
    assert [counted[name] for name in ("printed", "stands", "fails", "undecided", "open")] == [6, 2, 2, 1, 1]
    assert counted["stands_by"] == [{"class": "fitted", "count": 1}, {"class": "informed", "count": 1}]
    assert tally(()) == []


def test_tables_of_which_no_run_is_there_are_named() -> None:
    found = said(numbers(findings([cell()], scaling=[cell()])))["missing"]
    assert found == ["Ablation", "Ablation (text)", "Cases", "Significance"]
    assert said(())["missing"] == list(TABLES.values())
    assert numbers(findings([cell(mean=None)])) == ()


def test_no_number_counts_as_fitted_where_the_fit_was_of_another_model_or_judged_by_unknown_queries(
    alone: Findings,
) -> None:
    def classes(record: Calibration) -> set[str]:
        return {row["class"] for row in document.counted(alone, record) if row["table"] == "results"}

    model, judges = alone.model_version, rules(METRICS)
    assert classes(Calibration(model_version=model, rules=judges)) == {"fitted"}
    assert "fitted" not in classes(Calibration(model_version="another", rules=judges))
    assert "fitted" not in classes(Calibration(model_version=model))


def test_the_numbers_of_a_ledger_are_those_of_its_tables(alone: Findings) -> None:
    found = numbers(alone)
    assert [(row["ours"], row["gives"]) for row in found if row["table"] == "results"] == [
        (row["mean"], row["gives"]) for row in alone.cells
    ]
    assert sum(row["table"] == "significance" for row in found) == len(specs.paper_table("significance"))
    assert document.data(alone, None)["tables"]["tally"].rows[-1][2].value == len(found)


@pytest.mark.slow
def test_the_figure_has_a_panel_for_each_table_that_is_there_and_shows_what_became_of_a_number() -> None:
    alone, both = numbers(findings([cell("yes")])), numbers(findings([cell("yes")], scaling=[cell("no")]))
    assert words(overview_figure(alone)).count("Scaling") == 0
    found = [words(overview_figure(both)).count(name) for name in ("Evaluation results", "Scaling", "Ablation")]
    assert found == [1, 1, 0]
    assert overview_figure(both) == overview_figure(both)
    drawn = {gives: overview_figure(numbers(findings([cell(gives)]))) for gives in ("yes", "no", "undecided")}
    assert len(set(drawn.values())) == 3, "what stands, what does not and what is undecided look different"
    assert overview_figure(numbers(findings([cell("yes", distance=1.2)]))) != drawn["yes"]
    assert b"<svg" in overview_figure(())


def test_a_number_far_out_stays_within_the_figure() -> None:
    far = cell("no", distance=-900.0, difference=(-19.0, -17.0))
    assert overview_figure(numbers(findings([far]))) == overview_figure(numbers(findings([far | {"distance": -950.0}])))


@pytest.mark.slow
def test_what_goes_beyond_the_edge_of_the_figure_has_an_arrow_there() -> None:
    margin = MARGINS["governance_locality"]

    def point(margins: float) -> bytes:
        return overview_figure(numbers(findings([cell("no", distance=-margins, difference=None)])))

    def interval(margins: float) -> bytes:
        return overview_figure(numbers(findings([cell("no", difference=(margin, margins * margin))])))

    def dial(margins: float) -> bytes:
        larger = cell(
            None,
            "unspecified",
            fleet_size=16,
            distance=None,
            difference=None,
            paper=0.0,
            mean=-margin,
            one=-margins * margin,
        )
        return overview_figure(numbers(findings(scaling=[larger])))

    for drawn in (point, interval, dial):
        assert drawn(79.9) != drawn(90)
    assert interval(80) != interval(90), "at the edge is not beyond it"
