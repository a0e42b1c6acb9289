"""How values are printed, and how tables keep them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsar_ledger.metrics.definitions import published_metrics
from fsar_ledger.report import printing, specs
from fsar_ledger.report.specs import Column


@pytest.mark.parametrize(
    ("value", "decimals", "printed"),
    [(0.935, 2, "0.94"), (-1.04, 1, "\u22121.0"), (-0.001, 2, "0.00"), (3.0, 0, "3"), (-0.05, 1, "\u22120.1")],
)
def test_number_has_a_real_minus_and_no_negative_zero(value: float, decimals: int, printed: str) -> None:
    assert printing.number(value, decimals) == printed


@pytest.mark.parametrize(
    ("value", "printed"),
    [
        *((365.4, "365"), (0.00823, "0.00823"), (-2.118, "\u22122.12"), (1563.3, "1563")),
        *((0, "0"), (1.0, "1.00"), (0.1, "0.100"), (10.0, "10.0")),
    ],
)
def test_three_significant_digits(value: float, printed: str) -> None:
    assert printing.significant(value, 3) == printed


@given(st.floats(1e-6, 1e6))
def test_significant_digits_keep_the_value_within_half_a_percent(value: float) -> None:
    assert float(printing.significant(value, 3)) == pytest.approx(value, rel=0.0051)


def test_integers_have_thin_spaces_from_five_digits_on() -> None:
    found = [printing.integer(value) for value in (0, 9999, 10_000, 1_234_567)]
    assert found == ["0", "9999", "10\u2009000", "1\u2009234\u2009567"]


def test_small_p_is_printed_as_smaller_than_the_smallest() -> None:
    assert [printing.probability(p) for p in (0.00009, 0.0001, 0.7440)] == ["<.0001", "0.0001", "0.7440"]


def test_shares_are_percent_only_where_the_paper_has_percent() -> None:
    assert printing.in_metric("coordination_success", 0.93) == "93.0"
    assert printing.in_metric("governance_locality", 0.93) == "0.930"


def test_missing_value_is_a_dash_not_a_zero() -> None:
    cell = printing.cell(
        Column(key="mean", head="Ours", format="metric"), {"metric": "governance_locality", "mean": None}
    )
    assert (cell.value, cell.printed) == (None, printing.NOTHING)


def test_table_keeps_values_beside_prints_and_begins_groups() -> None:
    rows = [
        {"metric": name, "architecture": "fsar", "paper": 0.5, "ours": 0.51234, "distance_margins": -1.26}
        for name in ("governance_locality", "governance_locality", "recovery_containment")
    ]
    table = printing.table("residuals", rows)
    assert [cell.printed for cell in table.rows[0]] == ["Governance locality", "FSAR", "0.500", "0.512", "\u22121.3"]
    assert [row[0].printed for row in table.rows] == ["Governance locality", "", "Recovery containment"]
    assert table.rows[1][0].value == "governance_locality"
    assert table.rows[0][3].value == 0.51234
    assert table.begins == (2,)


def test_eight_metrics_are_those_of_the_papers_tables() -> None:
    assert {spec.printed.results for spec in published_metrics()} == {
        row["metric"] for row in specs.paper_table("results")
    }
    assert {spec.printed.significance for spec in published_metrics()} == {
        row["metric"] for row in specs.paper_table("significance")
    }
    assert len(published_metrics()) == 8
