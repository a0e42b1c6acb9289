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
        *((365.4, "365"), (0.00823, "0.00823"), (-2.118, "\u22122.12"), (1563.3, "1,563")),
        *((0, "0"), (1.0, "1.00"), (0.1, "0.100"), (10.0, "10.0")),
    ],
)
def test_three_significant_digits(value: float, printed: str) -> None:
    assert printing.significant(value, 3) == printed


@given(st.floats(1e-6, 1e6))
def test_significant_digits_keep_the_value_within_half_a_percent(value: float) -> None:
    assert float(printing.significant(value, 3).replace(",", "")) == pytest.approx(value, rel=0.0051)


def test_integers_have_commas_as_in_every_command() -> None:
    found = [printing.integer(value) for value in (0, 9999, 10_000, 1_234_567)]
    assert found == ["0", "9,999", "10,000", "1,234,567"]


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


TABLE = specs.Table(
    name="t",
    title="T",
    columns=(
        Column("metric", "Metric", "title", align="left", group=True),
        Column("architecture", "Arch.", "architecture"),
        Column("ours", "Ours", "metric"),
        Column("nothing", "Nothing", optional=True),
    ),
)


def test_a_table_keeps_values_beside_prints_begins_groups_and_leaves_out_what_is_optional() -> None:
    rows = [
        {"metric": name, "architecture": "fsar", "ours": 0.51234, "nothing": None}
        for name in ("governance_locality", "governance_locality", "recovery_containment")
    ]
    table = printing.table(TABLE, rows)
    assert [cell.printed for cell in table.rows[0]] == ["Governance locality", "FSAR", "0.512"]
    assert [row[0].printed for row in table.rows] == ["Governance locality", "", "Recovery containment"]
    assert table.rows[1][0].value == "governance_locality"
    assert (table.rows[0][2].value, table.begins, table.keys) == (0.51234, (2,), ("metric", "architecture", "ours"))
    some = printing.table(TABLE, [rows[0] | {"nothing": "x"}, *rows[1:]])
    assert [row[-1].printed for row in some.rows] == ["x", "–", "–"]


def test_a_sentence_is_filled_with_values_as_they_are_printed_and_lists_are_listed() -> None:
    row = {
        "n": 12_345,
        "one": 1,
        "share": 0.00001,
        "mean": -1.25,
        "names": ["a", "b_c", "d"],
        "metrics": ["audit_attributability"],
    }
    template = "{n}; {share:probability}; {mean:.1f}; {names}; {metrics:lower}; {names:raw}; {n:are|is}; {one:are|is}"
    said = printing.sentence(template, row)
    assert said.split("; ") == [
        *("12,345", "\\<\\.0001", "\u22121.2", "a, b\\_c and d"),
        *("audit attributability", "a, b_c and d", "12,345 are", "1 is"),
    ]
    with pytest.raises(KeyError):
        printing.sentence("{unknown}", row)


def test_a_difference_is_printed_with_its_sign_unless_it_is_printed_as_0() -> None:
    told = [printing.signed("authority_conflicts", value) for value in (0.5, -0.5, 0.001, -0.001)]
    assert told == ["+0.50", "\u22120.50", "0.00", "0.00"]


def test_nested_constants_become_dotted_names() -> None:
    nested = {
        "b": [["nav", {"low_s": 2.0, "high_s": 6.5}], ["carry", -50.0]],
        "a": {"flag": True, "list": [1, 20_000], "none": []},
    }
    assert list(printing.flat("", nested)) == [
        ("a.flag", "True"),
        ("a.list", "1, 20,000"),
        ("a.none", ""),
        ("b.carry", "\u221250"),
        ("b.nav", "2 to 6.5 s"),
    ]


def test_eight_metrics_are_those_of_the_papers_tables() -> None:
    assert {spec.printed.results for spec in published_metrics()} == {
        row["metric"] for row in specs.paper_table("results")
    }
    assert {spec.printed.significance for spec in published_metrics()} == {
        row["metric"] for row in specs.paper_table("significance")
    }
    assert len(published_metrics()) == 8
