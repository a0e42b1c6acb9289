"""What `compare` says below its numbers, so that they are not read as those of `statistics`."""

from pathlib import Path

import pytest
from msgspec import structs

from fsar_ledger import open_ledger
from fsar_ledger.api.compare import _how_to_read
from tests.cli.conftest import Call, one_message


def test_metrics_whose_t_test_counts_fewer_pairs_than_that_of_statistics_are_named(ledger: Path) -> None:
    found = open_ledger(ledger).compare("fsar", "cfc")
    row = found.rows[0]
    fewer = structs.replace(row, metric="authority_conflicts", test="paired t", n=100, differing_pairs=85)
    every = structs.replace(row, metric="governance_locality", test="paired t", n=100, differing_pairs=100)
    said = [line for line in _how_to_read(structs.replace(found, rows=[fewer, every])) if "degrees of freedom" in line]
    assert said == [
        "paired t: the degrees of freedom are the differing pairs minus one; `statistics` counts all pairs, so its p "
        "differs: authority_conflicts"
    ]
    assert not [line for line in _how_to_read(structs.replace(found, rows=[every])) if "degrees of freedom" in line]


def test_what_holm_adjusts_together_is_said_of_each_kind_of_metric(ledger: Path) -> None:
    found = open_ledger(ledger).compare("fsar", "cfc")
    row = structs.replace(found.rows[0], p=0.04, n=4)

    def told(*rows: tuple[str, int, float | None]) -> str:
        made = [structs.replace(row, metric=name, family_tests=tests, p=p) for name, tests, p in rows]
        return _how_to_read(structs.replace(found, rows=made))[0].partition("all pairs")[2]

    of_paper, further = ("authority_conflicts", 8, 0.04), ("missed_reviews", 1, 0.04)
    alone = "separately each metric that the paper does not print"
    assert told(of_paper, further) == f"; Holm adjusts 8 tests together and {alone}"
    assert told(further) == f"; Holm adjusts {alone}"
    assert told(of_paper, ("policy_violations", 6, 0.04)) == "; Holm adjusts 6 to 8 tests of a seed together"
    assert told(("authority_conflicts", 0, None)) == ""


def test_why_a_row_has_no_test_is_said(ledger: Path) -> None:
    found = open_ledger(ledger).compare("fsar", "cfc")
    row = structs.replace(found.rows[0], n=4, test=None, p=None, differing_pairs=2, mean_difference=0.0)
    even = structs.replace(row, metric="recovery_containment")
    undefined = structs.replace(row, metric="reassignment_latency_s", mean_difference=None, differing_pairs=0)
    assert _how_to_read(structs.replace(found, rows=[even, undefined]))[1:] == [
        "undefined on one side or both, so there is no difference: reassignment_latency_s",
        "neither side is higher in any pair, so there is no test: recovery_containment",
    ]


def test_compare_says_that_human_intervention_is_a_share_of_runs(call: Call, ledger: Path) -> None:
    said = call("compare", ledger, "--first", "fsar", "--second", "cfc").out.splitlines()
    assert "human_intervention is the share of runs that called the fleet supervisor" in said


@pytest.mark.slow
def test_pairs_of_forks_and_bases_of_one_model_are_not_said_to_be_of_several(
    call: Call, ledger: Path, tmp_path: Path
) -> None:
    place = tmp_path / "forks"
    changed = ("--all-runs", "--architecture", "fsar", "--change", "drop window:*")
    call("whatif", ledger, *changed, "--out", place).good()
    said = call("compare", place, "--first", "fsar+fork", "--second", "fsar@A/4").good().out
    assert "models differ" not in said
    assert (
        "4 pairs by seed, scenario and number: 4 share seed, scenario and number, but not the facts; whether forks and "
        "workflows share draws is not compared\n"
    ) in said


def test_a_remark_over_several_seeds_names_each_metric_once_with_the_seeds_that_it_is_about(ledger: Path) -> None:
    found = open_ledger(ledger).compare("fsar", "cfc")
    row = structs.replace(found.rows[0], n=4)
    rows = [
        structs.replace(row, seed=seed, metric=metric, differing_pairs=differing)
        for metric, of_seeds in (("true_attribution", (0, 0, 0)), ("missed_reviews", (0, 1, 0)))
        for seed, differing in zip((7, 8, 9), of_seeds, strict=True)
    ]
    said = [line for line in _how_to_read(structs.replace(found, rows=rows)) if "no pair differs" in line]
    assert said == ["no pair differs, so there is no test: true_attribution, missed_reviews (seeds 7, 9)"]


@pytest.mark.slow
def test_forks_by_several_changes_are_told_apart_and_compared(call: Call, ledger: Path, tmp_path: Path) -> None:
    place = tmp_path / "forks"
    for change in ("drop window:*", "density all 1"):
        call("whatif", ledger, "--all-runs", "--architecture", "fsar", "--change", change, "--out", place).good()
    said = call("compare", place, "--first", "fsar+fork1", "--second", "fsar+fork2").good().out.splitlines()
    assert said[0].startswith("first: fsar:full@A/4+fork1 (4 runs with drop window:*)")
    assert said[1].startswith("second: fsar:full@A/4+fork2 (4 runs with density all 1)")
    one_message(call("compare", place, "--first", "fsar+fork", "--second", "fsar"), 2, "found 2 sides", "name one of")
