"""What the charts show, and that they are the same bytes each time."""

import re
from typing import Any

import pytest

from fsar_ledger.report import figures, specs
from fsar_ledger.report.build import Document
from fsar_ledger.report.judge import OPEN
from tests.report.made import made, number, pairs_of, results

BARS = specs.Bars(name="x", title="", alt="")
LYING = specs.Bars(name="x", title="", alt="", lying=True)
CURVE = specs.Curve(name="x", title="", alt="", x_scale=2, styles={"dotted": "grows"}, hollow="broken")


def words(svg: bytes) -> list[str]:
    """The texts of a figure: matplotlib notes each above the glyphs that draw it."""
    return re.findall(r"<!-- (.*?) -->", svg.decode())


def bar(value: float | None = 0.5, **other: Any) -> dict[str, Any]:
    named = {"panel": "Success", "category": "FSAR", "series": "fsar", "paper": 0.4, "is_hatched": False}
    return {**named, "value": value, "low": 0.4, "high": 0.6, **other}


@pytest.mark.slow
def test_bars_name_their_panels_series_and_what_has_no_value() -> None:
    rows = [bar(), bar(None, series="cfc", category="CFC", low=None, high=None), bar(panel="Audit")]
    drawn = figures.bars(BARS, rows)
    assert {"Success", "FSAR", "CFC", "no value", "FSAR, this ledger", "printed in the paper"} <= set(words(drawn))
    assert figures.bars(BARS, rows) == drawn
    assert b"dc:date" not in drawn
    for changed in (bar(0.6), bar(paper=0.5), bar(low=0.3), bar(is_hatched=True)):
        assert figures.bars(BARS, [changed, *rows[1:]]) != drawn


def test_an_interval_that_misses_its_mean_by_a_rounding_error_is_drawn() -> None:
    assert b"<svg" in figures.bars(BARS, [bar(0.0, low=1e-18, high=0.04)])


@pytest.mark.slow
def test_charts_do_not_depend_on_the_users_matplotlib_settings() -> None:
    import matplotlib as mpl

    plain = figures.bars(BARS, [bar()])
    with mpl.rc_context({"font.size": 20, "axes.facecolor": "red"}):
        assert figures.bars(BARS, [bar()]) == plain


def point(x: float, **other: Any) -> dict[str, Any]:
    named = {"panel": "Messages", "series": "fsar", "style": "solid", "low": None, "high": None, "is_hollow": False}
    return {**named, "x": x, "y": x, **other}


def test_a_curve_has_lines_points_the_papers_diamonds_and_a_legend_of_them() -> None:
    rows = [point(4), point(8), point(8, style="paper", y=5.0), point(4, series="guide", style="dotted")]
    drawn = figures.curve(CURVE, rows)
    assert {"FSAR", "grows", "broken", "printed in the paper"} <= set(words(drawn))
    assert figures.curve(CURVE, rows) == drawn
    for changed in (point(8, is_hollow=True), point(8, y=9.0), point(8, low=7.0, high=9.0), point(8, style="dashed")):
        assert figures.curve(CURVE, [rows[0], changed, *rows[2:]]) != drawn
    assert figures.curve(CURVE, [*rows, point(8, y=None)]) == drawn, "what is undefined is not drawn"


def distance(margins: float | None, outcome: str = "stands", **other: Any) -> dict[str, Any]:
    named = {"panel": "Results", "line": "Audit", "series": "fsar", "reach": None}
    return {**named, "distance": margins, "outcome": outcome, **other}


@pytest.mark.slow
def test_distances_show_what_became_of_a_number() -> None:
    drawn = {
        outcome: figures.distances(LYING, [distance(0.5, outcome)]) for outcome in ("stands", "does not", "undecided")
    }
    assert len(set(drawn.values())) == 3, "what comes out, what does not and what is undecided look different"
    assert figures.distances(LYING, [distance(0.7)]) != drawn["stands"]
    assert b"<svg" in figures.distances(LYING, [])


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["point", "interval", "dial"])
def test_what_goes_beyond_the_edge_has_an_arrow_there(kind: str) -> None:
    def drawn(margins: float) -> bytes:
        rows = {
            "point": distance(-margins, "does not"),
            "interval": distance(1.5, "does not", reach=(1.0, margins)),
            "dial": distance(None, OPEN, reach=(-margins, -1.0)),
        }
        return figures.distances(LYING, [rows[kind]])

    assert drawn(79.9) != drawn(90)
    assert drawn(900) == drawn(950), "it stays within the figure"


@pytest.mark.slow
def test_the_figures_of_the_report_show_its_numbers() -> None:
    def drawings(**ours: float) -> dict[str, bytes]:
        numbers = results(**ours)
        measured = [{"metric": "governance_locality", "architecture": "fsar", "scenario": None, "mean": 1.0}]
        return Document(made([*numbers, number("scaling")], pairs_of(numbers), measured=measured)).drawings

    plain, moved = drawings(), drawings(governance_locality__fsar=0.5)
    assert plain.keys() == moved.keys() >= {"overview.svg", "evaluation-results.svg"}
    assert drawings() == plain
    assert all(plain[name] != moved[name] for name in ("overview.svg", "evaluation-results.svg"))
    found = words(plain["overview.svg"])
    assert [found.count(name) for name in ("Evaluation results", "Scaling", "Ablation")] == [1, 1, 0]
