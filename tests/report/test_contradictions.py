"""The paper's arithmetic against numbers worked out by hand from its printed tables."""

import math
import string
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsar_ledger.report import contradictions, printing, specs

LABELS = (Path(__file__).parent.parent / "paper_labels.txt").read_text("utf-8").split()


def fact(check: str, name: str) -> float:
    return float(contradictions.facts()[check][name])


CONFLICTS = math.log(14.1 / 8.1) / math.log(4)
FACTS = [  # the check, the number, its value, and to how much of a digit it is known
    ("printed-intervals", "half_fsar", 1.9208, 1e-9),  # 1.96 * 9.8 / 10
    ("printed-intervals", "half_cfc", 0.9604, 1e-9),  # 1.96 * 4.9 / 10
    ("printed-intervals", "low", 86.3, 0.05),
    ("printed-intervals", "high", 96.6, 0.05),
    ("printed-intervals", "human_half", 6.80, 0.005),  # sqrt(0.14 * 0.86) = 0.34699, 1.96 * 34.699 / 10; printed: 3.8
    ("printed-intervals", "human_printed", 3.8, 0),
    ("without-layered-recovery", "failing", 3, 1e-9),
    ("without-layered-recovery", "injected", 12, 1e-9),
    ("without-layered-recovery", "undegraded", 70, 1e-9),
    ("without-layered-recovery", "lost", 21, 1e-9),
    ("fractions-of-runs", "runs_fsar", 13.4, 1e-9),
    ("fractions-of-runs", "runs_dhma", 4.6, 1e-9),
    ("zero-conflicts", "sd", 0.52, 1e-9),  # 4 means of 1.3 and a 0: sqrt((1.04^2 + 4 * 0.26^2) / 5) = sqrt(0.2704)
    ("zero-conflicts", "half", 0.10, 0.005),  # 1.96 * 0.52 / 10 = 0.1019
    ("zero-conflicts", "printed", 0.03, 0),
    ("abstract", "said", 4.88, 0),
    ("abstract", "locality_dhma", 4.88, 0),
    ("abstract", "containment_cfc", 1.44, 0),
    ("abstract", "containment_dhma", 0.48, 0),
    ("negative-variance", "variance", -2.1179, 1e-4),  # (2.75 / 4.12)^2 + (7.07 / 5.16)^2 - (4.32 / 2.05)^2
    ("binary-effects", "d_fc", 0.4379, 5e-5),  # 0.18 / sqrt((0.1204 + 0.2176) / 2)
    ("binary-effects", "d_fd", 0.1350, 5e-5),  # 0.05 / sqrt((0.1204 + 0.1539) / 2)
    ("binary-effects", "d_cd", 0.3016, 5e-5),  # 0.13 / sqrt((0.2176 + 0.1539) / 2)
    ("binary-effects", "printed_fc", 0.42, 0),
    ("binary-effects", "printed_fd", 0.12, 0),
    ("binary-effects", "printed_cd", 0.29, 0),
    ("two-full-systems", "count", 4, 0),
    ("two-full-systems", "compared", 6, 0),
    ("growth", "agents_exponent", 1, 1e-9),
    ("growth", "exponent", CONFLICTS, 1e-9),
    ("caption", "text", 2, 0),
    ("caption", "caption", 3, 0),
]


@pytest.mark.parametrize(("check", "name", "value", "within"), FACTS)
def test_a_number_of_a_contradiction_is_what_the_printed_ones_give(
    check: str, name: str, value: float, within: float
) -> None:
    assert fact(check, name) == pytest.approx(value, rel=0, abs=within)


def test_conflicts_grow_sublinearly_and_what_is_printed_is_quoted() -> None:
    facts = contradictions.facts()
    assert fact("growth", "exponent") < 1
    assert facts["fractions-of-runs"]["fit_dhma"] == "3/13"
    assert "20" not in str(facts["fractions-of-runs"]["fit_fsar"]).replace("/", " ").split()
    assert "policy violations 0.40 and 0.46" in str(facts["two-full-systems"]["pairs"])


def test_conflicts_of_fsar_and_cfc_have_a_smaller_sd_by_the_half_widths_than_by_d() -> None:
    [row] = [
        row
        for row in contradictions.interval_rows()
        if (row["metric"], row["pair"]) == ("authority_conflicts", "FSAR vs CFC")
    ]
    # half widths 0.03 and 0.12: sqrt((0.15306^2 + 0.61224^2) / 2) = 0.44625; d: 2.75 / 4.12 = 0.66748
    assert row["interval_sd"] == pytest.approx(0.446246, abs=1e-6)
    assert row["effect_sd"] == pytest.approx(0.667476, abs=1e-6)


def test_effect_sizes_of_conflicts_violations_and_audit_imply_a_negative_variance_of_fsar() -> None:
    negative = {one.metric for one in contradictions.variances() if one.implied["FSAR"] < 0}
    assert negative == {"authority_conflicts", "policy_violations", "audit_attributability"}
    assert all(one.largest["FSAR"] < 0 for one in contradictions.variances() if one.metric in negative)


def test_every_contradiction_has_its_numbers_and_uses_them_and_nothing_else() -> None:
    facts = contradictions.facts()
    assert [one.id for one in specs.contradictions()] == list(facts)
    for one in specs.contradictions():
        named = {name for _, name, _, _ in string.Formatter().parse(one.claim + one.arithmetic) if name}
        assert named == facts[one.id].keys(), one.id
        assert one.table is None or one.table in contradictions.TABLES


def test_every_place_in_the_paper_exists() -> None:
    places = [one.paper for one in specs.contradictions()]
    places += [one.paper for one in specs.passages("readings")]
    places += [
        paper for name in ("evaluation-results", "statistical-significance") if (paper := specs.table(name).paper)
    ]
    places += [
        quote.where for topic in specs.quotes().values() for quote in topic.values() if quote.where != "abstract"
    ]
    assert len(places) > 20
    assert set(places) <= set(LABELS)


@given(st.floats(0.01, 100), st.integers(2, 10_000))
def test_sd_of_a_half_width_is_the_inverse_of_the_half_width(sd: float, n: int) -> None:
    assert contradictions.sd_of_half_width(contradictions.half_width(sd, n), n) == pytest.approx(sd)


@given(st.lists(st.floats(0.05, 5), min_size=3, max_size=3), st.lists(st.floats(0, 100), min_size=3, max_size=3))
def test_implied_variances_are_those_that_made_the_effect_sizes(sds: list[float], shifts: list[float]) -> None:
    names = ("FSAR", "CFC", "DHMA")
    means = {name: 200 * position + shift for position, (name, shift) in enumerate(zip(names, shifts, strict=True))}
    pairs = [(a, b) for a in range(3) for b in range(a + 1, 3)]
    d = {
        frozenset((names[a], names[b])): abs(means[names[a]] - means[names[b]])
        / math.sqrt((sds[a] ** 2 + sds[b] ** 2) / 2)
        for a, b in pairs
    }
    found = contradictions.implied_variances("x", means, d, mean_step=0.0, d_step=0.0)
    for name, sd in zip(names, sds, strict=True):
        assert found.implied[name] == pytest.approx(sd**2, rel=1e-6, abs=1e-6)
        assert found.largest[name] == pytest.approx(found.implied[name], abs=1e-6)


@given(st.integers(1, 40), st.data())
def test_fractions_of_a_percentage_round_back_to_it(n: int, data: st.DataObject) -> None:
    k = data.draw(st.integers(0, n))
    percent = math.floor(100 * k / n + 0.5)
    found = contradictions.counts_that_print(percent, n)
    assert any(entry.endswith(f"/{n}") for entry in found)
    for entry in found:
        top, bottom = map(int, entry.split("/"))
        assert percent - 0.5 <= 100 * top / bottom < percent + 0.5


def test_tables_of_the_contradictions_print_a_minus_sign_and_say_what_cannot_be() -> None:
    table = printing.table("implied-variances", contradictions.variance_rows())
    conflicts = next(row for row in table.rows if row[0].value == "authority_conflicts")
    assert conflicts[1].printed == "\u22122.12"
    assert (conflicts[-1].printed, conflicts[-1].tone) == ("no", "strong")
