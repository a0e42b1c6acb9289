"""The first page: its plain sentences follow from the numbers, and every printed number is counted once."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa
import pytest

from fsar_ledger.metrics.robustness import CellSpread
from fsar_ledger.metrics.study_results import METRICS, Calibration, encoded, packaged, rules
from fsar_ledger.metrics.verdicts import Answer, ComparedEffect
from fsar_ledger.report import specs
from fsar_ledger.report.build import Document
from fsar_ledger.report.findings import Findings, arrow
from fsar_ledger.report.judge import OPEN, STANDS, UNDECIDED, Number, outcome_of
from fsar_ledger.report.records import robustness, robustness_relations
from tests.report.made import (
    HEAD,
    column,
    ensemble,
    made,
    names,
    number,
    of_table,
    paired,
    pairs_of,
    part,
    placebo,
    prior,
    results,
    said,
)

FAILS = "does not"
CLASSES = ("fitted", "informed", "by construction", "cannot follow", "unspecified")
CONTAINMENT_LOST: dict[str, Any] = {
    "architecture": "fsar",
    "configuration": "without-layered-recovery",
    "metric": "recovery_containment",
    "full_mean": 0.89,
    "without_mean": 0.1,
    "mean_difference": 0.79,
    "p_holm": 0.001,
    "ci_low": 0.7,
    "ci_high": 0.9,
    "position": 3,
    "n": 9,
    "differing_pairs": 9,
}


def page(
    *, robustness: Mapping[str, pa.Table] | None = None, differences: list[dict[str, Any]] | None = None, **ours: float
) -> Document:
    """A report in which the results are as the paper prints them, but for these."""
    numbers = results(**ours)
    more: dict[str, Any] = {} if differences is None else {"differences": differences}
    return Document(made(numbers, pairs_of(numbers), **more), robustness=robustness)


def test_a_cell_that_moves_changes_the_words() -> None:
    as_printed = page()
    assert "by 8 measures, and in our rebuilding of its simulation every one of these rankings comes out" in said(
        as_printed, "answer"
    )
    assert "In the main table nothing that can be decided fails to come out." in said(as_printed, "answer")
    assert column(as_printed, "claims", "holds") == [True] * 8
    moved = page(governance_locality__fsar=0.6)
    assert "7 of these rankings come out, and that by governance locality does not come out" in said(moved, "answer")
    assert "Of its main table one number does not come out: governance locality of FSAR." in said(moved, "answer")
    both = said(page(governance_locality__fsar=0.6, policy_violations__fsar=9.0), "answer")
    assert "and those by governance locality and policy violations do not come out" in both
    assert column(moved, "claims", "holds") == [True, False, *[True] * 6]
    assert column(moved, "claims", "fsar_ours")[1] == 0.6


def test_that_constants_were_fitted_to_the_main_table_is_said_where_it_is_judged() -> None:
    record = packaged(Calibration)
    assert record is not None
    numbers = results(governance_locality__fsar=0.6)
    of_its_model = msgspec.structs.replace(made(numbers, pairs_of(numbers)), model_version=record.model_version)
    found = said(Document(of_its_model, record), "answer")
    assert f"to which {len(record.parameters)} constants were fitted, one number does not come out: " in found
    assert "Of its main table one number" in said(Document(of_its_model), "answer")


def test_the_farthest_comes_first() -> None:
    found = said(page(governance_locality__dhma=0.6, audit_attributability__cfc=0.6), "answer")
    assert "the farthest first: audit attributability of CFC and governance locality of DHMA." in found


def test_the_sentences_are_plain() -> None:
    document = page(differences=[CONTAINMENT_LOST])
    found = said(document, "answer")
    assert not [word for word in CLASSES if word in found]
    assert not re.search(r"\(\d", found)
    assert 4 <= found.count(".") - found.count("..") <= 6


@pytest.mark.parametrize(
    ("first", "second", "claim"),
    [
        ("coordination_success", "human_intervention", ("CFC ≈ FSAR > DHMA", "FSAR ≈ DHMA > CFC")),
        ("reassignment_latency_s", "policy_violations", ("CFC > FSAR > DHMA", "FSAR > CFC > DHMA")),
    ],
)
def test_the_papers_ranking_is_that_of_its_own_means_and_tests(first: str, second: str, claim: tuple[str, str]) -> None:
    document = page()
    told = dict(zip(column(document, "claims", "metric"), column(document, "claims", "claim"), strict=True))
    assert (told[first], told[second]) == claim


def test_a_ranking_without_tests_is_undecided_and_those_that_are_alike_hold_within_the_margin() -> None:
    numbers = results()
    none = Document(made(numbers, ()))
    assert column(none, "claims", "holds") == [None] * 8
    assert "0 of these rankings come out" in said(none, "answer")
    assert "cannot be decided with these runs" in said(none, "answer")
    apart = page(coordination_success__fsar=0.80)
    assert column(apart, "claims", "holds")[0] is False, "FSAR and CFC are no longer alike"


def test_alike_ones_that_too_few_runs_put_apart_are_undecided() -> None:
    numbers = results(coordination_success__fsar=0.80)
    document = Document(made(numbers, [msgspec.structs.replace(one, p_holm=0.4) for one in pairs_of(numbers)]))
    assert column(document, "claims", "holds") == [None] * 8, "no test of ours finds a difference"


def test_what_fails_and_what_cannot_be_decided_are_both_said() -> None:
    numbers = results(governance_locality__fsar=0.6)
    tests = [one for one in pairs_of(numbers) if one.metric != "recovery_containment"]
    found = said(Document(made(numbers, tests)), "answer")
    assert "6 of these rankings come out, and that by governance locality does not come out" in found
    assert "By recovery containment it cannot be decided with these runs." in found
    assert "cannot be decided with these runs" not in said(page(governance_locality__fsar=0.6), "answer")


@pytest.mark.slow
def test_what_turns_without_a_mechanism_is_named() -> None:
    turned = page(differences=[CONTAINMENT_LOST])
    assert column(turned, "claims", "mechanisms") == [None, None, ["layered recovery"], *[None] * 5]
    assert "1 of them turns when a single mechanism is taken out of one of the three" in said(turned, "answer")
    for kept in ({"without_mean": 0.85}, {"p_holm": 0.2}):
        assert "mechanisms" not in part(page(differences=[CONTAINMENT_LOST | kept]), "claims")["keys"]


@pytest.mark.slow
def test_the_study_of_rankings_says_what_is_structure_and_what_hangs_on_constants() -> None:
    assert {"best", "prior", "around"}.isdisjoint(part(page(), "claims")["keys"])
    studies = robustness_relations(prior(policy_violations=94, coordination_success=100), ensemble(10))
    document = page(robustness=studies)
    assert column(document, "claims", "best") == [
        f"{94 if name == 'policy_violations' else 100} of 100" for name in column(document, "claims", "metric")
    ]
    assert column(document, "claims", "prior") == ["60 of 100"] * 8
    assert column(document, "claims", "around") == ["99 of 100"] * 8
    found = said(document, "answer")
    assert "human interventions and audit attributability follows from how the three are built" in found
    assert "What the paper says by coordination success and policy violations hangs on constants" in found
    nobody = page(robustness=robustness_relations(prior()))
    assert "around" not in part(nobody, "claims")["keys"]


def near(of: Number, within: int, plausible: int) -> CellSpread:
    blank: dict[str, Any] = dict.fromkeys(CellSpread.__struct_fields__, 0)
    return CellSpread(
        **blank
        | {
            "metric": of.metric,
            "architecture": of.architecture,
            "within_margin": within,
            "undefined": 20,
            "within_tolerance": 70,
        }
        | {"plausible_within_margin": plausible}
    )


def test_a_verdict_says_how_many_of_the_plausible_points_agree_and_of_all_where_none_is_plausible(
    findings: Findings,
) -> None:
    numbers = [
        msgspec.structs.replace(one, gives=answer)
        for one, answer in zip(findings.numbers, ("yes", "no", "undecided"), strict=False)
    ]
    cells = [near(one, 60, 8) for one in numbers]
    told = {}
    for plausible in (10, 0):
        document = Document(
            msgspec.structs.replace(findings, numbers=tuple(numbers)),
            robustness=robustness_relations(around=ensemble(plausible, *cells)),
        )
        told[plausible] = said(document)
        found = column(document, "evaluation-results", "agreeing")
        assert found == (["8 of 10", "2 of 10", None] if plausible else ["60 of 80", "20 of 80", None])
    assert "10 are plausible: each of the 24 cells" in told[10]
    assert "In all 10 plausible sets of constants, 1 of 2 differences of means have the paper's sign." in told[10]
    assert "The others have it in some of these sets: policy violations of FSAR and CFC (9)." in told[10]
    assert "none is plausible: each of the 24 cells" in told[0]
    assert "So _Agree_ counts over all of them" in told[0]
    assert "What these sets miss most often: " in told[0]


def test_the_results_of_the_studies_are_read_where_they_are_of_the_runs(tmp_path: Path) -> None:
    findings = msgspec.structs.replace(made(), model_version="1", parameters={"a": "1"})
    assert {table.num_rows for table in robustness(findings, tmp_path).values()} == {0}
    for result in (
        prior(),
        msgspec.structs.replace(ensemble(1), parameters='{"a":1}'),
        msgspec.structs.replace(placebo(), parameters='{"a":1}'),
    ):
        (tmp_path / result.FILE).write_bytes(encoded(result))

    def read(**other: Any) -> tuple[int, ...]:
        found = robustness(msgspec.structs.replace(findings, **other), tmp_path)
        return tuple(found[name].num_rows for name in ("prior", "around", "placebo"))

    assert read() == (1, 1, 1)
    assert read(parameters={"a": "2"}) == (1, 0, 0)
    assert read(model_version="0") == (0, 0, 0)


@pytest.mark.slow
def test_the_negative_control_stands_beside_the_tests(findings: Findings) -> None:
    assert "negative-control" not in names(Document(findings), "table")
    tests = (("governance_locality", "p"), ("governance_locality", "wilcoxon_p"), ("any", "p_holm"))
    document = Document(findings, robustness=robustness_relations(control=placebo(*tests)))
    assert "9 pairs of runs met the same world, the largest mean difference of any metric is 0" in said(document)
    shown = [column(document, "negative-control", key) for key in ("t", "wilcoxon", "mcnemar", "holm")]
    assert shown == [["0.050 (0.020 to 0.110)", None]] * 2 + [[None, None], [None, "0.050 (0.020 to 0.110)"]]
    none = placebo(("audit_attributability", "p"))
    [rejected] = none.tests
    one = msgspec.structs.replace(none, tests=[msgspec.structs.replace(rejected, rejected=0, kept=1, undefined=99)])
    document = Document(findings, robustness=robustness_relations(control=one))
    assert column(document, "negative-control", "t") == ["0.050 (0.020 to 0.110) of 1"]


def test_what_must_be_known_before_stands_first(findings: Findings, document: Document) -> None:
    assert "Not covered, for want of runs: Ablation, Ablation (text), Scaling and Workflows" in said(document, "note")
    gone = {f"{one.metric}__{name}": None for one in results() for name in ("cfc", "dhma")}
    nothing = results(**gone)
    assert "There are no runs of CFC and DHMA in full with four robots" in said(Document(made(nothing)), "note")
    assert "The ledger holds no run in full with four robots" in said(Document(made()), "note")
    assert document.sections[0]["title"] == "", "the first page has no heading"
    assert names(document, "table")[0] == "claims"
    assert names(document, "figure")[0] == "overview"


@pytest.mark.slow
def test_every_number_is_counted_once_by_table_and_class() -> None:
    numbers = [
        *(number(outcome=STANDS, kind="fitted"), number(outcome=FAILS, kind="fitted")),
        *(number("ablation"), number("ablation", outcome=FAILS, kind="cannot follow")),
        *(number("ablation", outcome=OPEN, kind="unspecified"), number("scaling", outcome=UNDECIDED)),
    ]
    rows = Document(made(numbers)).tally
    assert [(row["table"], row["class"], row["printed"]) for row in rows] == [
        *(("Evaluation results", "fitted", 2), ("Ablation", "informed", 1), ("Ablation", "cannot follow", 1)),
        *(("Ablation", "unspecified", 1), ("Scaling", "informed", 1), ("All", "", 6)),
    ]
    assert [rows[-1][name] for name in (STANDS, FAILS, UNDECIDED, OPEN)] == [2, 2, 1, 1]
    assert "Of the 6 numbers and tests of the paper that are compared here, 2 come out, 2 do not" in said(
        Document(made(numbers)), "answer"
    )
    assert Document(made()).tally == []
    assert Document(made([number(ours=None)])).numbers == [], "a table without runs is not there"


@pytest.mark.parametrize(
    ("kind", "gives", "outcome"),
    [
        *(("fitted", "yes", STANDS), ("informed", "no", FAILS), ("fitted", "undecided", UNDECIDED)),
        *(("fitted", None, UNDECIDED), ("unspecified", None, OPEN)),
    ],
)
def test_the_outcome_follows_the_registered_answer(kind: str, gives: str | None, outcome: str) -> None:
    assert outcome_of(kind, gives) == outcome


@pytest.mark.parametrize("gives", ["yes", "no", "undecided", None])
def test_what_the_papers_own_text_excludes_does_not_come_out_whatever_the_runs_say(gives: str | None) -> None:
    assert outcome_of("cannot follow", gives) == FAILS


@pytest.mark.slow
def test_no_number_counts_as_fitted_where_the_fit_was_of_another_model_or_judged_by_unknown_queries(
    findings: Findings,
) -> None:
    def classes(record: Calibration) -> set[str]:
        as_fitted = msgspec.structs.replace(findings, parameters={})
        return {row["class"] for row in Document(as_fitted, record).numbers if row["table"] == "results"}

    model, judges = findings.model_version, rules(METRICS)
    assert classes(Calibration(model_version=model, rules=judges)) == {"fitted", "count", "dial", "by construction"}
    for record in (Calibration(model_version="another", rules=judges), Calibration(model_version=model)):
        assert classes(record) == {"informed", "by construction"}


def test_a_pairwise_test_comes_out_where_pairs_like_the_papers_could_have_printed_its_effect_size() -> None:
    comparisons = ("fsar-cfc", "fsar-dhma", "cfc-dhma")
    asked: tuple[tuple[str, float | None, Answer | None], ...] = (
        ("fsar-cfc", 0.3, "yes"),
        ("fsar-dhma", 0.0, "no"),
        ("cfc-dhma", None, None),
    )
    effects = [
        ComparedEffect(metric="governance_locality", comparison=name, ours=0.2, paper=0.1, share=share, could=could)
        for name, share, could in asked
    ]
    rows = [paired("governance_locality", name, 0.25, 0.0001) for name in comparisons]
    document = Document(made([], rows, predictive=arrow(effects, ComparedEffect)))
    told = {row["comparison"]: row["outcome"] for row in document.numbers if row["metric"] == "governance_locality"}
    assert told == dict(zip(comparisons, (STANDS, FAILS, UNDECIDED), strict=True))
    shown = zip(
        column(document, "statistical-significance", "metric"),
        column(document, "statistical-significance", "chance", "printed"),
        strict=True,
    )
    assert [chance for metric, chance in shown if metric == "governance_locality"] == ["0.3000", "0 of 4,000", "–"]
    assert "Of 2 printed effect sizes, 100 pairs of ours could have printed 1." in said(document)


def claim(
    name: str, architecture: str, numerator: int | None, denominator: int | None, runs: int = 20
) -> dict[str, Any]:
    return {
        "claim": name,
        "architecture": architecture,
        "numerator": numerator,
        "denominator": denominator,
        "runs": runs,
    }


def test_a_number_of_a_case_is_decided_exactly_where_a_mechanism_restates_it_and_else_not() -> None:
    found = Document(
        made(
            claims_of_cases=[
                *(claim("executed", "dhma", 4, 4), claim("discovered", "fsar", 1, 100)),
                *(claim("unattributed events", "cfc", 180, 60), claim("events", "cfc", 420, 60)),
                *(claim("conflict for H_F", "cfc", 85, 100), claim("contained locally", "fsar", 8, 11)),
                claim("contained locally (degradation)", "fsar", 2, 3),
            ]
        )
    )
    cells = {(row["case"], row["architecture"]): row for row in found.numbers}
    assert [cells[key]["outcome"] for key in ((1, "dhma"), (1, "fsar"), (4, "cfc"), (3, "cfc"), (4, "dhma"))] == [
        *(STANDS, FAILS, STANDS, UNDECIDED, UNDECIDED)
    ]
    assert (cells[1, "dhma"]["paper"], cells[4, "cfc"]["ours"]) == (1.0, 3.0)
    counted = dict(
        zip(
            zip(column(found, "cases", "case"), column(found, "cases", "architecture"), strict=True),
            column(found, "cases", "counted"),
            strict=True,
        )
    )
    assert counted[4, "cfc"] == "180 of 420 in 60 handoffs"
    assert counted[2, "fsar"] == "8 in 11 runs with a failure"
    assert column(found, "cases", "other")[2] == "0.67 (2 in 3)"
    assert counted[4, "dhma"] is None


def test_seeds_that_are_asked_for_together_are_added_and_what_has_no_run_has_no_table() -> None:
    rows = [claim("recovery loop", "dhma", 1, 4), claim("recovery loop", "dhma", 2, 8)]
    both = Document(made(claims_of_cases=rows))
    assert [row["ours"] for row in both.numbers if row["ours"] is not None] == [0.25]
    nothing = made(claims_of_cases=[claim("conflicts", "fsar", None, None, runs=0)])
    assert "cases" not in names(Document(nothing), "table")


def test_runs_of_another_model_say_so() -> None:
    other = {"ablation": HEAD.__class__(1, 1, "root", 1, "not complete: 3 runs are missing", "1")}
    found = said(Document(made(of_table("ablation"), heads=other)))
    assert "These runs are of model version 1, and those of the results are not." in found
    assert "The ledger is not complete: 3 runs are missing." in found


def test_the_sections_name_only_what_is_there() -> None:
    """No section says that something was not looked at: a report of no run has the first page and the paper's own."""
    titles = [section["title"] for section in Document(made()).sections]
    assert titles == ["", "Contradictions in the paper", "Provenance"]
    assert "sensitivity" not in said(Document(made()))
    assert set(specs.sections()) >= {"00-answer", "11-contradictions"}
