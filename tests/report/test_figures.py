"""What the figures show, and that they are the same bytes each time."""

import re

import pytest

from fsar_ledger.metrics.definitions import published_metrics
from fsar_ledger.report import curves, figures, sections
from fsar_ledger.report.findings import Findings, Row


@pytest.fixture(scope="module")
def cells(findings: Findings) -> tuple[Row, ...]:
    return findings.cells


@pytest.fixture(scope="module")
def plain(cells: tuple[Row, ...]) -> bytes:
    """The evaluation figure of the ledger."""
    return figures.evaluation_results(cells)


def words(svg: bytes) -> list[str]:
    """The texts of a figure: matplotlib notes each above the glyphs that draw it."""
    return re.findall(r"<!-- (.*?) -->", svg.decode())


def test_evaluation_figure_has_a_panel_for_every_metric(plain: bytes) -> None:
    assert len(re.findall(r'id="axes_\d+"', plain.decode())) == 8
    for spec in published_metrics():
        assert spec.title in words(plain)
    assert [words(plain).count(name) for name in ("FSAR", "CFC", "DHMA")] == [8, 8, 8]


@pytest.mark.slow
def test_missing_value_is_said_in_its_panel_and_the_papers_stays(cells: tuple[Row, ...]) -> None:
    whole = [row | {"mean": 1.0, "ci_low": None, "ci_high": None} for row in cells]
    missing = [row | ({"mean": None} if row["architecture"] == "cfc" else {}) for row in whole]
    drawn = words(figures.evaluation_results(missing))
    assert drawn.count("no value") == 8
    assert "printed in the paper" in drawn
    assert "no value" not in words(figures.evaluation_results(whole))


def test_figures_are_the_same_bytes_twice_and_carry_no_date(cells: tuple[Row, ...], plain: bytes) -> None:
    assert figures.evaluation_results(cells) == plain
    assert b"dc:date" not in plain


def test_figures_show_the_rows(cells: tuple[Row, ...], plain: bytes) -> None:
    moved = [
        row | ({"mean": 0.2} if (row["metric"], row["architecture"]) == ("governance_locality", "fsar") else {})
        for row in cells
    ]
    assert figures.evaluation_results(moved) != plain


@pytest.mark.slow
def test_effects_are_drawn_beside_the_papers_and_what_has_none_leaves_the_papers_alone(findings: Findings) -> None:
    rows = [row | {"cohens_d": 1.5, "d_ci_low": 1.0, "d_ci_high": 2.0} for row in findings.tests]
    drawn = figures.effects(rows)
    assert drawn == figures.effects(rows)
    assert all(spec.title in words(drawn) for spec in published_metrics())
    assert {"FSAR \u2212 CFC", "FSAR \u2212 DHMA", "CFC \u2212 DHMA", "printed in the paper"} <= set(words(drawn))
    turned = [row | ({"paper_t": -row["paper_t"]} if row["metric"] == "governance_locality" else {}) for row in rows]
    assert figures.effects(turned) != drawn, "the paper's d has the sign of its t"
    without = [row | {"cohens_d": None, "d_ci_low": None, "d_ci_high": None} for row in rows]
    bare = figures.effects(without)
    assert bare != drawn
    assert bare.count(b"<use") == drawn.count(b"<use") - len(rows), "one mark less for each effect"


@pytest.mark.slow
def test_interval_that_misses_its_mean_by_a_rounding_error_is_drawn(cells: tuple[Row, ...]) -> None:
    close = [row | {"mean": 0.0, "ci_low": 1e-18, "ci_high": 0.04} for row in cells]
    assert b"<svg" in figures.evaluation_results(close)


@pytest.mark.slow
def test_figures_do_not_depend_on_the_users_matplotlib_settings(cells: tuple[Row, ...], plain: bytes) -> None:
    import matplotlib as mpl

    with mpl.rc_context({"font.size": 20, "axes.facecolor": "red"}):
        assert figures.evaluation_results(cells) == plain


def cost(architecture: str, robots: int, completed: float) -> Row:
    counted = dict.fromkeys(curves.COSTS, float(robots))
    return {"architecture": architecture, "fleet_size": robots, "completed": completed, **counted}


def test_the_cost_of_coordination_marks_where_an_architecture_breaks() -> None:
    whole = [cost(name, size, 1.0) for size in (4, 64, 1024) for name in ("fsar", "cfc", "dhma")]
    broken = [row | ({"completed": 0.4} if row["architecture"] == "cfc" else {}) for row in whole]
    drawn = curves.coordination_cost(whole)
    assert {"FSAR", "CFC", "DHMA", "1,024", *curves.COSTS.values()} <= set(words(drawn))
    assert curves.coordination_cost(broken) != drawn
    assert sections.breaks(broken) == [
        {"architecture": "FSAR", "is_broken": False, "robots": "1024", "completed": "100"},
        {"architecture": "CFC", "is_broken": True, "robots": "4", "completed": "40"},
        {"architecture": "DHMA", "is_broken": False, "robots": "1024", "completed": "100"},
    ]
    unmeasured = [row | {"hops": None} for row in whole]
    assert curves.coordination_cost(unmeasured) not in (drawn, b"")
