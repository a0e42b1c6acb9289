"""The section "Every reading" of the report, and the figure of `study run multiverse`."""

import re
from pathlib import Path

import pytest

from fsar_ledger.metrics.database import connect, from_rows
from fsar_ledger.metrics.definitions import metric_named, metrics
from fsar_ledger.metrics.multiverse import Multiverse, ReadingNames, Universe, cells, readings
from fsar_ledger.metrics.results import CONDITIONS
from fsar_ledger.metrics.robustness import rankings
from fsar_ledger.metrics.verdicts import published
from fsar_ledger.report import study_charts
from fsar_ledger.report.build import Document
from fsar_ledger.report.findings import Findings
from fsar_ledger.report.read import gather, multiverse_of, relations_of
from tests.report.made import column, made, names, said
from tests.report.test_charts import words

NAMES = ("level_four_is_fleet", "reviews_are_no_interventions")
Means = dict[ReadingNames, tuple[float | None, float | None, float | None]]
PAPER = published()["human_intervention", "fsar"].value


def multiverse(means: Means) -> Multiverse:
    """Human intervention of the three architectures under these combinations."""
    setting = {
        "configuration": "full",
        "fleet_size": 4,
        "seed": 1,
        "kind": "simulated",
        "source": None,
        "model_version": "2",
        "constants": None,
    }
    found = [
        Universe(
            metric="human_intervention",
            architecture=name,
            readings=chosen,
            mean=mean,
            runs_not_observed=0,
            **setting,  # type: ignore[arg-type]
        )
        for chosen, mine in means.items()
        for name, mean in zip(("fsar", "cfc", "dhma"), mine, strict=True)
    ]
    used = tuple(one for one in readings() if one.name in NAMES)
    return Multiverse(used, tuple(cells(found)), tuple(rankings(found, {"human_intervention": "lower"})), tuple(found))


def report(means: Means) -> Document:
    return Document(made(**relations_of(multiverse(means))))


def test_a_cell_has_its_range_and_the_reading_that_moves_it_most() -> None:
    found = report({(): (0.1, 0.3, 0.2), NAMES[:1]: (0.25, 0.3, 0.2), NAMES[1:]: (0.05, 0.3, 0.2)})
    number = next(one.reading for one in readings() if one.name == NAMES[0])
    assert column(found, "every-reading", "range")[0] == [0.05, 0.25]
    assert column(found, "every-reading", "moved_most_by")[0] == f"level four is fleet ({number})"
    assert column(found, "every-reading", "moved_by")[0] == pytest.approx(0.15)


@pytest.mark.parametrize(
    ("mean", "holds"), [(PAPER, True), (PAPER - 0.049, True), (PAPER - 0.051, False), (None, None)]
)
def test_the_range_holds_the_printed_number_give_or_take_a_margin(mean: float | None, holds: bool | None) -> None:
    assert column(report({(): (mean, 0.3, 0.2)}), "every-reading", "holds")[0] is holds


def test_the_smallest_combinations_under_which_fsar_is_not_the_best_are_named() -> None:
    worse = {NAMES[:1]: (0.4, 0.3, 0.2), NAMES[1:]: (0.1, 0.3, 0.2), NAMES: (0.5, 0.3, 0.2)}
    found = report({(): (0.1, 0.3, 0.2), **worse})
    keys = ("ordered", "combinations", "fsar_best", "same_order")
    assert [column(found, "rankings", key)[0] for key in keys] == ["FSAR > DHMA > CFC", 4, 2, 2]
    assert column(found, "rankings", "not_best_under") == ["level four is fleet"]


@pytest.mark.parametrize(
    ("other", "counts"),
    [
        ((0.05, 0.3, 0.2), "1 of 1 metrics, under some by 0, and under none by 0"),
        ((0.35, 0.3, 0.2), "0 of 1 metrics, under some by 1,"),
    ],
)
def test_the_sentences_count_by_how_many_metrics_fsar_is_best_under_all_some_and_no_combinations(
    other: tuple[float, float, float], counts: str
) -> None:
    assert counts in said(report({(): (0.1, 0.3, 0.2), NAMES[:1]: other}))
    assert "under none by 1" in said(report({(): (0.6, 0.3, 0.2)}))
    assert "every-reading" not in names(Document(made()), "table")


def test_no_ranking_of_three_is_counted_where_one_architecture_has_runs() -> None:
    alone = report({(): (0.1, None, None), NAMES[:1]: (0.2, None, None)})
    assert "best of the three" not in said(alone)
    assert "rankings" not in names(alone, "table")
    assert "every-reading" in names(alone, "table")


@pytest.mark.slow  # all combinations of all metrics
def test_the_report_has_the_multiverse_of_the_runs_that_its_tables_are_of(ledger: Path, findings: Findings) -> None:
    found = gather(ledger, reads_every_way=True)
    assert found.multiverse is not None
    ours = {(one.metric, one.architecture): one.ours for one in findings.numbers if one.table == "results"}
    assert {(cell.metric, cell.architecture): cell.ours for cell in found.multiverse.cells} == pytest.approx(
        ours, nan_ok=True
    )
    assert len(column(Document(found), "every-reading", "metric")) == 24
    assert {f"readings/{one.name}" for one in found.multiverse.readings} <= {source.name for source in found.sources}
    with connect(ledger) as database:
        assert multiverse_of(database, tuple("another" for _ in CONDITIONS)) is None


MEANS: Means = {
    (): (0.07, 0.29, 0.2),
    ("level_four_is_fleet",): (0.3, 0.29, 0.2),
    ("reviews_are_no_interventions",): (0.03, 0.24, 0.18),
    ("level_four_is_fleet", "reviews_are_no_interventions"): (None, 0.24, 0.18),
}


def found(means: Means = MEANS, metric: str = "human_intervention") -> Multiverse:
    """One metric of three architectures under these combinations, and once more for another seed, under which FSAR is
    the worst."""
    setting = {
        "configuration": "full",
        "fleet_size": 4,
        "kind": "simulated",
        "source": None,
        "model_version": "2",
        "constants": None,
    }
    universes = [
        Universe(
            metric=metric,
            architecture=name,
            readings=chosen,
            mean=mean,
            seed=seed,
            runs_not_observed=0,
            **setting,  # type: ignore[arg-type]
        )
        for chosen, mine in means.items()
        for seed, of_seed in ((1, mine), (2, (0.9, 0.1, 0.1)))
        for name, mean in zip(("fsar", "cfc", "dhma"), of_seed, strict=True)
    ]
    return Multiverse(
        tuple(one for one in readings() if metric in one.moves), tuple(cells(universes)), (), tuple(universes)
    )


def test_combinations_stand_in_the_order_of_fsars_lead_over_the_better_of_the_others() -> None:
    columns = study_charts.ordered(found().universes, metric_named("human_intervention"))
    assert [chosen for chosen, _ in columns] == [
        ("level_four_is_fleet",),
        ("level_four_is_fleet", "reviews_are_no_interventions"),
        (),
        ("reviews_are_no_interventions",),
    ]
    assert columns[2][1] == pytest.approx({"fsar": 7, "cfc": 29, "dhma": 20})
    assert columns[1][1] == pytest.approx({"cfc": 24, "dhma": 18})


@pytest.mark.parametrize(("better", "lead"), [("higher", -0.3), ("lower", 0.1)])
def test_the_lead_is_over_the_better_one(better: str, lead: float) -> None:
    assert study_charts.lead({"fsar": 0.5, "cfc": 0.6, "dhma": 0.8}, better) == pytest.approx(lead)
    assert study_charts.lead({"cfc": 0.6}, better) == study_charts.lead({"fsar": 0.6}, better) == 0.0


def test_the_figure_says_how_often_fsar_is_best_and_names_the_readings() -> None:
    drawn = words(study_charts.curves(found()))
    assert "Human interventions (%): FSAR best under 2 of 4" in drawn
    assert {
        *("level four is fleet (R9)", "reviews are no interventions (R37)", "FSAR"),
        *("CFC", "DHMA", "our reading", "printed in the paper"),
    } <= set(drawn)


def test_the_papers_numbers_stand_on_the_line_of_our_reading() -> None:
    assert study_charts.printed(found().cells, metric_named("human_intervention")) == pytest.approx(
        {"fsar": 14, "cfc": 32, "dhma": 19}
    )
    assert study_charts.printed(found(metric="policy_violations").cells, metric_named("human_intervention")) == {}


def test_the_figure_is_the_same_bytes_twice_and_shows_its_rows() -> None:
    plain = study_charts.curves(found())
    assert study_charts.curves(found()) == plain
    assert b"dc:date" not in plain
    assert study_charts.curves(found(MEANS | {(): (0.08, 0.29, 0.2)})) != plain


def test_nothing_to_draw_is_a_figure_without_panels() -> None:
    assert not re.findall(r'id="axes_\d+"', study_charts.curves(Multiverse((), (), (), ())).decode())


def test_which_way_is_better_is_the_same_in_the_queries_and_in_the_report() -> None:
    with from_rows([]) as database:
        asked = {row["metric"]: row["better"] for row in database.rows("SELECT metric, better FROM metric_definitions")}
    assert asked == {spec.name: spec.better for spec in metrics()}
