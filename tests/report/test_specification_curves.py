"""The specification curves show the rows: every combination in the order of FSAR's lead, what each is made of, and
where FSAR is the best one."""

import re

import pytest

from fsar_ledger.metrics.database import from_rows
from fsar_ledger.metrics.definitions import metric_named, metrics
from fsar_ledger.metrics.multiverse import Multiverse, ReadingNames, Universe, cells, readings
from fsar_ledger.report import all_readings

MEANS: dict[ReadingNames, tuple[float | None, float, float]] = {
    (): (0.07, 0.29, 0.2),
    ("level_four_is_fleet",): (0.3, 0.29, 0.2),
    ("reviews_are_no_interventions",): (0.03, 0.24, 0.18),
    ("level_four_is_fleet", "reviews_are_no_interventions"): (None, 0.24, 0.18),
}


def found(
    means: dict[ReadingNames, tuple[float | None, float, float]] = MEANS, metric: str = "human_intervention"
) -> Multiverse:
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


def words(svg: bytes) -> list[str]:
    return re.findall(r"<!-- (.*?) -->", svg.decode())


def test_combinations_stand_in_the_order_of_fsars_lead_over_the_better_of_the_others() -> None:
    columns = all_readings.ordered(found().universes, metric_named("human_intervention"))
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
    assert all_readings.lead({"fsar": 0.5, "cfc": 0.6, "dhma": 0.8}, better) == pytest.approx(lead)
    assert all_readings.lead({"cfc": 0.6}, better) == all_readings.lead({"fsar": 0.6}, better) == 0.0


def test_the_figure_says_how_often_fsar_is_best_and_names_the_readings() -> None:
    drawn = words(all_readings.curves(found()))
    assert "Human interventions (%): FSAR best under 2 of 4" in drawn
    assert {
        "level four is fleet (R9)",
        "reviews are no interventions (R37)",
        "FSAR",
        "CFC",
        "DHMA",
        "our reading",
        "printed in the paper",
    } <= set(drawn)


def test_the_papers_numbers_stand_on_the_line_of_our_reading() -> None:
    assert all_readings.printed(found().cells, metric_named("human_intervention")) == pytest.approx(
        {"fsar": 14, "cfc": 32, "dhma": 19}
    )
    assert all_readings.printed(found(metric="policy_violations").cells, metric_named("human_intervention")) == {}


def test_the_figure_is_the_same_bytes_twice_and_shows_its_rows() -> None:
    plain = all_readings.curves(found())
    assert all_readings.curves(found()) == plain
    assert b"dc:date" not in plain
    assert all_readings.curves(found(MEANS | {(): (0.08, 0.29, 0.2)})) != plain


def test_nothing_to_draw_is_a_figure_without_panels() -> None:
    assert not re.findall(r'id="axes_\d+"', all_readings.curves(Multiverse((), (), (), ())).decode())


def test_which_way_is_better_is_the_same_in_the_queries_and_in_the_report() -> None:
    with from_rows([]) as database:
        asked = {row["metric"]: row["better"] for row in database.rows("SELECT metric, better FROM metric_definitions")}
    assert asked == {spec.name: spec.better for spec in metrics()}
