"""Every number that the paper prints has its place, its unit and the step of its last digit, and a class that was
registered."""

from collections import Counter

import pytest

from fsar_ledger.metrics.definitions import Place, Table, printed
from fsar_ledger.metrics.registration import registration
from fsar_ledger.metrics.verdicts import MARGINS


@pytest.mark.parametrize(("table", "count"), [("results", 24), ("ablation", 30), ("ablation_text", 8), ("scaling", 45)])
def test_each_table_has_its_cells_by_metrics_that_have_margins(table: Table, count: int) -> None:
    cells = printed(table)
    assert len(cells) == count
    assert {place.metric for place in cells} <= MARGINS.keys()
    assert {place.table for place in cells} == {table}


def test_numbers_are_in_our_unit_with_the_step_of_their_last_digit() -> None:
    assert printed("results")[Place("results", "coordination_success", "fsar", "full", 4)] == pytest.approx(
        (0.93, 0.001)
    )
    assert printed("ablation")[
        Place("ablation", "coordination_success", "fsar", "without-shared-registry", 4)
    ] == pytest.approx((0.46, 0.01))
    assert printed("scaling")[Place("scaling", "authority_conflicts", "dhma", "full", 16)] == pytest.approx((14.1, 0.1))


def test_a_claim_of_the_text_is_a_number_in_full_and_one_without_the_mechanism() -> None:
    of = {
        place.configuration: number.value
        for place, number in printed("ablation_text").items()
        if place.scenario == "mixed-trust-inspection"
    }
    assert of == {"full": 1.20, "without-trust-evaluation": 2.85}


def test_cells_have_the_class_that_was_registered_for_them_and_are_informed_otherwise() -> None:
    def classes(table: Table) -> Counter[str]:
        return Counter(registration().declaration_for(table, place._asdict()).kind for place in printed(table))

    assert classes("results") == {"fitted": 18, "count": 2, "dial": 2, "by_construction": 2}
    assert classes("ablation") == {"informed": 28, "unspecified": 1, "cannot_follow": 1}
    assert classes("ablation_text") == {"informed": 5, "unspecified": 2, "cannot_follow": 1}
    assert classes("scaling") == {"informed": 15, "unspecified": 30}


def test_only_classes_with_a_meaning_are_given_and_what_cannot_follow_has_its_proof() -> None:
    said = registration()
    given = [*said.cell, *(said.declaration_for(table, {}) for table in said.cells)]
    assert {one.kind for one in given} <= said.classes.keys()
    assert all(one.because for one in said.cell if one.kind == "cannot_follow")
    assert all(one.dial for one in said.cell if one.kind == "unspecified")
