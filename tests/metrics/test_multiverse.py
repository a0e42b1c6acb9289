"""Ranges and rankings over given means, and the relations that combinations of readings share."""

from collections.abc import Mapping

import pytest
from msgspec import structs

from fsar_ledger.metrics.database import from_rows
from fsar_ledger.metrics.multiverse import (
    Cell,
    ReadingNames,
    Relations,
    Universe,
    cells,
    combinations,
    multiverse,
    readings,
)
from fsar_ledger.metrics.robustness import OrderUnderReadings, ranked, rankings, smallest
from tests.queries.histories import event, run

Means = Mapping[ReadingNames, Mapping[str, float | None]]


def universes(means: Means, metric: str = "m", seed: int = 42) -> list[Universe]:
    """One setting: for each combination of readings the mean of each architecture."""
    setting = {
        "configuration": "full",
        "fleet_size": 4,
        "seed": seed,
        "kind": "simulated",
        "source": None,
        "model_version": "2",
        "constants": None,
    }
    return [
        Universe(metric=metric, architecture=name, readings=chosen, mean=mean, runs_not_observed=0, **setting)  # type: ignore[arg-type]
        for chosen, found in means.items()
        for name, mean in found.items()
    ]


def cell(means: Mapping[ReadingNames, float | None]) -> Cell:
    (found,) = cells(universes({chosen: {"fsar": mean} for chosen, mean in means.items()}))
    return found


def ranking(means: Means, better: str = "higher") -> OrderUnderReadings:
    (found,) = rankings(universes(means), {"m": better})
    return found


def test_a_cell_has_its_range_and_the_reading_that_alone_moves_it_most() -> None:
    found = cell({(): 0.5, ("a",): 0.4, ("b",): 0.75, ("a", "b"): 0.9})
    assert (found.ours, found.lowest, found.highest, found.combinations, found.undefined) == (0.5, 0.4, 0.9, 4, 0)
    assert (found.most_moving, found.moved_by) == ("b", 0.25)
    assert (found.lowest_under, found.highest_under) == (("a",), ("a", "b"))


def test_a_cell_that_no_reading_moves_says_so() -> None:
    found = cell({(): 0.5, ("a",): 0.5})
    assert (found.lowest, found.highest, found.most_moving, found.moved_by) == (0.5, 0.5, None, None)
    assert found.lowest_under == ()


def test_what_is_undefined_is_in_no_range_and_counted() -> None:
    found = cell({(): 0.5, ("a",): None, ("b",): 0.6})
    assert (found.lowest, found.highest, found.combinations, found.undefined) == (0.5, 0.6, 3, 1)
    nothing = cell({(): None, ("a",): 0.6})
    assert (nothing.ours, nothing.most_moving, nothing.moved_by, nothing.undefined) == (None, None, None, 1)


@pytest.mark.parametrize(
    ("better", "order"), [("higher", (("cfc", "fsar"), ("dhma",))), ("lower", (("dhma",), ("cfc", "fsar")))]
)
def test_the_best_stands_first_and_equals_together(better: str, order: tuple[tuple[str, ...], ...]) -> None:
    assert ranked(universes({(): {"fsar": 2.0, "dhma": 1.0, "cfc": 2.0}}), better) == order


def test_means_that_differ_in_their_last_bits_alone_are_equal() -> None:
    one, other = 1 / 3 + 1 + 1, 1 + 1 + 1 / 3
    assert one != other
    found = ranking({(): {"fsar": other, "cfc": one}, ("a",): {"fsar": one, "cfc": other}})
    assert (found.order, found.same_order, found.fsar_best) == ("cfc = fsar", 2, 0)
    still = cell({(): one, ("a",): other})
    assert (still.most_moving, still.moved_by, still.highest_under) == (None, None, ())


def test_a_ranking_that_survives_and_one_that_does_not() -> None:
    kept = ranking({(): {"fsar": 0.9, "cfc": 0.5}, ("a",): {"fsar": 0.6, "cfc": 0.1}})
    assert (kept.order, kept.combinations, kept.same_order, kept.fsar_best) == ("fsar > cfc", 2, 2, 2)
    assert (kept.changed_under, kept.fsar_not_best_under) == ((), ())
    lost = ranking(
        {
            (): {"fsar": 0.9, "cfc": 0.5},
            ("a",): {"fsar": 0.3, "cfc": 0.3},
            ("b",): {"fsar": 0.9, "cfc": 0.5},
            ("a", "b"): {"fsar": 0.1, "cfc": 0.3},
        }
    )
    assert (lost.same_order, lost.fsar_best, lost.changed_under) == (2, 2, (("a",),))
    assert lost.fsar_not_best_under == (("a",),)


def test_an_order_may_change_below_the_best_one() -> None:
    found = ranking(
        {(): {"fsar": 1.0, "cfc": 2.0, "dhma": 3.0}, ("a",): {"fsar": 1.0, "cfc": 3.0, "dhma": 2.0}}, "lower"
    )
    assert (found.order, found.same_order, found.fsar_best) == ("fsar > cfc > dhma", 1, 2)
    assert found.changed_under == (("a",),)


def test_fewer_than_two_architectures_are_no_ranking_and_none_without_fsar_is_won() -> None:
    for alone in ({"fsar": 1.0}, {"fsar": 1.0, "cfc": None}, {"fsar": None, "cfc": None}):
        found = ranking({(): alone, ("a",): alone})
        assert (found.order, found.same_order, found.fsar_best, found.changed_under) == (None, None, None, None)
        assert found.fsar_not_best_under is None
    others = ranking({(): {"cfc": 1.0, "dhma": 2.0}})
    assert (others.order, others.same_order, others.fsar_best) == ("dhma > cfc", 1, None)


def test_an_architecture_that_a_reading_leaves_undefined_is_not_ranked_as_before() -> None:
    found = ranking({(): {"fsar": 0.9, "cfc": 0.5}, ("a",): {"fsar": None, "cfc": 0.5}})
    assert (found.same_order, found.fsar_best, found.fsar_not_best_under) == (1, 1, (("a",),))


def test_of_combinations_the_smallest_are_named() -> None:
    assert smallest([("a",), ("a", "b"), ("b", "c"), ("b", "c", "d")]) == (("a",), ("b", "c"))
    assert smallest([(), ("a",)]) == ((),)


def test_the_papers_number_stands_beside_cells_of_its_table_alone() -> None:
    shown = universes({(): {"fsar": 0.1, "cfc": 0.3, "other": 0.2}}, "human_intervention")
    assert [one.paper for one in cells(shown)] == [0.14, 0.32, None]
    assert [
        one.paper
        for changed in ({"fleet_size": 8}, {"configuration": "no-trust"}, {"kind": "fork"})
        for one in cells([structs.replace(shown[0], **changed)])
    ] == [None, None, None]


@pytest.mark.parametrize(("scenarios", "printed"), [(["door-relay"], 0.14), (["door-relay", "yard"], None)])
def test_no_number_of_the_paper_stands_beside_runs_of_other_scenarios(
    scenarios: list[str], printed: float | None
) -> None:
    runs = [row for one in scenarios for row in run(run_id=one, scenario=one)]
    with from_rows(runs) as database:
        [found] = multiverse(database, ["human_intervention"]).cells
    assert (found.architecture, found.paper) == ("fsar", printed)


def test_settings_are_never_ranked_together() -> None:
    both = [*universes({(): {"fsar": 1.0, "cfc": 2.0}}, seed=1), *universes({(): {"fsar": 2.0, "cfc": 1.0}}, seed=2)]
    assert [(row.seed, row.order) for row in rankings(both, {"m": "higher"})] == [(1, "cfc > fsar"), (2, "fsar > cfc")]
    found = [(one.seed, one.architecture, one.ours) for one in cells(both)]
    assert found == [(1, "fsar", 1.0), (1, "cfc", 2.0), (2, "fsar", 2.0), (2, "cfc", 1.0)]


def test_a_relation_that_no_chosen_reading_touches_is_the_same_one_for_all() -> None:
    with from_rows(run(event("SupervisorCalled", supervisor="supervisor/fleet", purpose="review"))) as database:
        relations = Relations(database, readings())
        assert relations.under("conflicts", frozenset(["instants_are_shared"])) != relations.under(
            "conflicts", frozenset()
        )
        assert relations.under("conflicts", frozenset(["late_tasks_succeed"])) == relations.under(
            "conflicts", frozenset()
        )
        assert relations.under("unobservable", frozenset(["instants_are_shared"])) == "unobservable"
        made = "SELECT table_name FROM information_schema.tables WHERE table_name LIKE 'conflicts_%'"
        assert len(database.rows(made)) == 2
        relations.forget()
        assert database.rows(made) == []


def test_seeds_are_read_each_by_itself_or_together() -> None:
    called = event("SupervisorCalled", supervisor="supervisor/fleet", purpose="review")
    rows = [*run(called, run_id="r1", seed=1), *run(run_id="r2", seed=2)]
    with from_rows(rows) as database:
        apart = multiverse(database, ["human_intervention"])
        together = multiverse(database, ["human_intervention"], pools_seeds=True)
    found = [(one.seed, one.ours, one.lowest, one.combinations) for one in apart.cells]
    assert found == [(1, 1.0, 0.0, 4), (2, 0.0, 0.0, 4)]
    assert [(one.seed, one.ours, one.lowest) for one in together.cells] == [(None, 0.5, 0.0)]
    assert {one.name for one in apart.readings} == {"reviews_are_no_interventions", "level_four_is_fleet"}


def test_a_ledger_without_runs_has_no_cells() -> None:
    with from_rows([]) as database:
        found = multiverse(database, ["authority_conflicts"])
    assert (found.cells, found.rankings, found.universes) == ((), (), ())
    assert len(combinations("authority_conflicts")) == 8
