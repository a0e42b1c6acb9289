"""The paper's arithmetic against numbers worked out by hand from its printed tables."""

import math
from pathlib import Path

import pytest

from fsar_ledger.report import specs
from fsar_ledger.report.build import Document
from tests.report.made import column, made, part, said

LABELS = (Path(__file__).parent.parent / "paper_labels.txt").read_text("utf-8").split()
IN_ORDER = ("FSAR", "CFC", "DHMA")


@pytest.fixture(scope="module")
def paper() -> Document:
    """A report of no run: all of this is computed from the paper alone."""
    return Document(made())


@pytest.mark.parametrize(
    ("contradiction", "words"),
    [
        ("printed-intervals", "9.8 / sqrt(100) = 1.92$ (FSAR, printed 1.9)"),
        ("printed-intervals", "4.9 / sqrt(100) = 0.96$ (CFC, printed 1.0)"),
        ("printed-intervals", "of 93 out of 100 would be 86.3 to 96.6"),
        # sqrt(0.14 * 0.86) = 0.34699, 1.96 * 34.699 / 10
        (
            "printed-intervals",
            "at 14 % it is 34.7 %, and the half width $1.96 times 34.7 / sqrt(100) = 6.8$ %, printed 3.8",
        ),
        ("printed-intervals", "In 24 of 24 pairs"),
        # it can for CFC and DHMA in locality: (0.16 - 0.01) / 2.035 = 0.0737, and half widths of 0.015 give 0.0765
        ("printed-intervals", "in 21 of them rounding cannot close the gap"),
        (
            "without-layered-recovery",
            "= 3$ % of runs, while injection alone reaches 12 % of them and the success lost is 21",
        ),
        ("without-layered-recovery", "leaves 70 % of the runs without degradation"),
        ("fractions-of-runs", "times 20 = 13.4$ runs (the neighbours are 65 % and 70 %)"),
        ("fractions-of-runs", "times 20 = 4.6$ runs (20 % and 25 %)"),
        ("fractions-of-runs", "67 % can be 2/3, 4/6, 6/9, 8/12, 10/15, 12/18, but 23 % only 3/13;"),
        ("zero-conflicts", "If these are all conflicts of the scenario"),
        # 4 means of 1.3 and a 0: sqrt((1.04^2 + 4 * 0.26^2) / 5) = sqrt(0.2704); 1.96 * 0.52 / 10 = 0.1019
        ("zero-conflicts", "the other 4 average 1.30, and the SD of the 5 is smallest when they are equal: 0.52"),
        ("zero-conflicts", "= 0.10$, not 0.03"),
        ("abstract", "The table gives containment $d = 1.44$ (vs CFC) and $0.48$ (vs DHMA)"),
        ("abstract", "governance locality against DHMA (4.88; against CFC 2.91)"),
        # (2.75 / 4.12)^2 + (7.07 / 5.16)^2 - (4.32 / 2.05)^2
        ("negative-variance", "= 0.446 + 1.877 - 4.441 = \u22122.118$"),
        ("negative-variance", "cannot make it positive for conflicts, violations and audit (@tab-implied-variances)."),
        ("binary-effects", "0.14 and 0.32 give 0.438"),  # 0.18 / sqrt((0.1204 + 0.2176) / 2)
        ("binary-effects", "0.14 and 0.19 give 0.135"),
        ("binary-effects", "0.32 and 0.19 give 0.302"),
        ("two-full-systems", "4 of the 6 means that both tables print differ"),
        ("two-full-systems", "policy violations 0.40 and 0.46"),
        # 1.18 - 1.04 and 0.46 - 0.40 against 0.03 and 0.01; success 95 - 93 against 1.9 and what rounding leaves
        ("two-full-systems", "does not explain those of authority conflicts and policy violations."),
        ("growth", 'match "super-linear conflict growth" under "Scaling analysis"'),
        ("growth", "16, 32, 64 agents for 4, 8, 16 robots (exponent 1.00)"),
        ("growth", f"= {math.log(14.1 / 8.1) / math.log(4):.2f}$, which is sub-linear"),
        # stats.t.sf(2.88 + 0.005, 99) and of 2.88 - 0.005, twice, by scipy alone
        ("printed-p", "Of the 9 values of $p$ that are printed as numbers, 4 do not follow from their $t$"),
        ("printed-p", "0.00480 to 0.00495 from $t = 2.88$ (printed 0.0047)"),
        ("printed-p", "All 9 follow with 112 to 135 degrees of freedom"),
        # 0.05, 0.42 and 0.12 times the root of 50 are 0.35, 2.97 and 0.85, near 0.33, 2.93 and 0.88; 2.91 gives 20.58
        ("printed-p", "which rounding allows for 3 of the 24 printed $t$ and $d$."),
        # (5 * 0.69 - 0.3) / 4
        ("worked-locality", "3 / 10 = 0.30$. If other runs of Scenario 1 are like it, the other 4 scenarios average"),
        ("worked-locality", "= 0.79$: Scenario 1 lowers the aggregate"),
        ("worked-locality", 'escalation", but failures are injected in Scenarios 3 and 5 alone.'),
        ("caption", "as Workflow 2."),
        ("caption", "is captioned Workflow 3."),
    ],
)
def test_a_number_of_a_contradiction_is_what_the_printed_ones_give(
    paper: Document, contradiction: str, words: str
) -> None:
    assert words in said(paper, contradiction)


def test_conflicts_of_fsar_and_cfc_have_a_smaller_sd_by_the_half_widths_than_by_d(paper: Document) -> None:
    row = column(paper, "printed-intervals", "metric").index("authority_conflicts")
    # half widths 0.03 and 0.12: sqrt((0.15306^2 + 0.61224^2) / 2) = 0.44625; d: 2.75 / 4.12 = 0.66748
    assert column(paper, "printed-intervals", "interval_fc")[row] == pytest.approx(0.446246, abs=1e-6)
    assert column(paper, "printed-intervals", "effect_fc")[row] == pytest.approx(0.667476, abs=1e-6)


def test_implied_variances_give_the_published_effect_sizes_again(paper: Document) -> None:
    named = {row["in_significance"]: row["metric"] for row in _metrics()}
    means = {(row["metric"], row["architecture"]): float(row["mean"]) for row in specs.paper_table("results")}
    results = {row["metric"]: row["in_results"] for row in _metrics()}
    variances = {
        (metric, name): column(paper, "implied-variances", name.lower())[at]
        for at, metric in enumerate(column(paper, "implied-variances", "metric"))
        for name in IN_ORDER
    }
    for row in specs.paper_table("significance"):
        metric, pair = named[row["metric"]], row["comparison"].split(" vs ")
        difference = abs(means[results[metric], pair[0]] - means[results[metric], pair[1]])
        pooled = (variances[metric, pair[0]] + variances[metric, pair[1]]) / 2
        assert difference / math.sqrt(pooled) == pytest.approx(float(row["cohens_d"])), "also where one is negative"


def _metrics() -> list[dict[str, str]]:
    from fsar_ledger.report.build import _metrics as metrics

    return list(metrics().to_pylist())


def test_what_cannot_be_is_printed_with_a_minus_sign_and_in_bold(paper: Document) -> None:
    rows = {row[0].value: row for row in part(paper, "implied-variances")["rows"]}
    assert rows["authority_conflicts"][1].printed == "\u22122.12"
    assert (rows["authority_conflicts"][-1].printed, rows["authority_conflicts"][-1].tone) == ("no", "strong")
    assert {name for name, row in rows.items() if row[-1].value == "no"} == {
        *("authority_conflicts", "policy_violations", "audit_attributability")
    }


def test_every_place_in_the_paper_exists() -> None:
    places = [row["where"] for row in specs.quotes() if row["where"] != "abstract"]
    places += [row["paper"] for row in specs.rows("readings")]
    assert len(places) > 20
    assert set(places) <= set(LABELS)
