"""How likely a printed table is among experiments of its size that are drawn from the model."""

import numpy as np
import pytest

from fsar_ledger.metrics.paper_numbers import Printed
from fsar_ledger.metrics.verdicts import odds

RNG = np.random.default_rng(7)
CELL = ("policy_violations", "fsar")
OTHER = ("authority_conflicts", "fsar")


def test_the_share_is_of_experiments_that_print_a_number_as_far_out_on_either_side() -> None:
    drawn = {CELL: [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0]}
    shares = {value: odds(drawn, {CELL: Printed(value, 0.1)}).cells[CELL] for value in (0.1, 0.2, 0.5, 1.0, 1.1)}  # type: ignore[union-attr]
    assert shares == pytest.approx({0.1: 0.2, 0.2: 0.4, 0.5: 1.0, 1.0: 0.2, 1.1: 0.0})


def test_a_number_that_rounds_to_the_printed_one_is_the_printed_one() -> None:
    found = odds({CELL: [0.934, 0.936, 0.944]}, {CELL: Printed(0.94, 0.01)})
    assert found is not None
    assert found.cells[CELL] == pytest.approx(1.0)


def test_a_table_drawn_from_the_model_is_refused_as_often_as_alpha_says() -> None:
    """Two cells that go together: with min-p the error of the whole table is alpha, whatever their dependence."""
    first = RNG.normal(size=(2000, 1))
    tables = 0.8 * first + 0.6 * RNG.normal(size=(2000, 2))
    drawn = {CELL: tables[:, 0], OTHER: tables[:, 1]}
    refused = 0
    for _ in range(400):
        base = RNG.normal()
        one, two = (0.8 * base + 0.6 * RNG.normal() for _ in range(2))
        found = odds(drawn, {CELL: Printed(one, 0.001), OTHER: Printed(two, 0.001)})
        assert found is not None
        refused += found.table < 0.05
    assert 6 <= refused <= 36, "20 expected, give or take three and a half standard deviations"


def test_a_table_with_one_number_that_the_model_never_gives_is_refused_as_a_whole() -> None:
    drawn = {CELL: RNG.normal(size=1000), OTHER: RNG.normal(size=1000)}
    found = odds(drawn, {CELL: Printed(0.0, 0.01), OTHER: Printed(9.0, 0.01)})
    assert found is not None
    assert found.cells[CELL] > 0.5
    assert found.cells[OTHER] == found.table == 0.0


def test_what_an_experiment_leaves_undefined_counts_neither_way_and_a_cell_without_numbers_has_no_share() -> None:
    found = odds(
        {CELL: [0.1, None, 0.3], OTHER: [None, None, None]}, {CELL: Printed(0.1, 0.1), OTHER: Printed(0.1, 0.1)}
    )
    assert found is not None
    assert found.cells == pytest.approx({CELL: 1.0})
    assert odds({OTHER: [None]}, {OTHER: Printed(0.1, 0.1)}) is None
