"""Six architectures side by side: what is structural is marked and explained, and a rank counts where it holds."""

import re
from functools import cache

import pytest

from fsar_ledger.metrics.robustness import SystemNumber
from fsar_ledger.report import specs
from fsar_ledger.report.build import Document
from fsar_ledger.report.records import robustness_relations
from tests.report.made import column, made, said, system_number, systems

FAST, SLOW = (
    system_number("alliance", "policy_violations", dial="alliance.impatience_us", value=value, mean=at, low=at, high=at)
    for value, at in ((100_000, 0.5), (15_000_000, 0.01))
)


def beaten(architecture: str, metric: str, size: int) -> SystemNumber:
    """A number that is lower than any of FSAR's, as one more beside those of the architecture."""
    return system_number(architecture, metric, fleet_size=size, dial="another", value=1, mean=-9.0, low=-9.0, high=-9.0)


def ranks(document: Document, architecture: str) -> list[str]:
    """The words of its column, without the counts behind them."""
    return [re.sub(r" \d+ : \d+$", "", cell) for cell in column(document, "system-ranks", architecture)]


@cache
def page(*dials: SystemNumber) -> Document:
    return Document(made(), robustness=robustness_relations(systems=systems(*dials)))


def test_a_number_that_is_the_same_in_every_run_is_marked_and_has_its_reason() -> None:
    document = page()
    human = [cell for cell in column(document, "systems", "jade") if cell.endswith("†")]
    assert human == ["0.0†"] * 3
    assert not any(cell.endswith("†") for cell in column(document, "systems", "fsar"))
    assert "Human (%) of JADE (there is no supervisor to call)." in said(document)


def test_no_reason_says_that_fsar_names_a_supervisor_who_is_off_shift() -> None:
    reasons = {row["metric"]: row["why"] for row in specs.rows("structural") if "fsar" in row["architectures"]}
    assert set(reasons) == {"audit_attributability", "true_attribution"}
    assert all("shift" in why for why in reasons.values()), "no record names the supervisor then (R8)"


@pytest.mark.slow
def test_a_rank_holds_only_where_it_holds_at_every_size_and_for_every_value_of_a_dial() -> None:
    at = column(page(), "system-ranks", "short").index("Violations")
    assert ranks(page(), "alliance")[at] == "better"
    assert ranks(page(FAST), "alliance")[at] == "better"
    assert ranks(page(FAST, SLOW), "alliance")[at] == "turns"
    assert ranks(page(FAST, SLOW), "jade")[at] == "better"
    assert set(ranks(page(), "roboos")) == {"alike", "better"}
    half = page(beaten("roboos", "reassignment_latency_s", 4))
    assert "not better" in ranks(half, "roboos")
    assert ranks(page(), "jade")[column(page(), "system-ranks", "short").index("Human (%)")] == "alike†"


def test_behind_a_rank_stands_in_how_many_other_worlds_fsar_is_better_and_in_how_many_worse() -> None:
    shown = dict(zip(column(page(), "system-ranks", "short"), column(page(), "system-ranks", "jade"), strict=True))
    assert shown["Violations"] == "better 6 : 1"  # fewer is better, and FSAR has fewer in six
    assert shown["Clean success (%)"] == "alike 1 : 6"
    assert "which makes 9 other worlds for all six" in said(page())


def test_a_dial_names_what_is_told_apart_where_it_is_turned() -> None:
    turned = [
        system_number("jade", "policy_violations", dial="jade.permissions", value=value, mean=at, low=at, high=at)
        for value, at in ((0, 0.5), (1, 0.25))
    ]
    assert column(page(*turned), "system-switches", "moves") == ["Violations 0.50 → 0.25"]
    assert column(page(*turned), "system-switches", "setting") == ["0 → 1"]
    waits = (
        system_number("alliance", "policy_violations", dial="alliance.silence_us", value=value)
        for value in (10_000_000, 500_000)
    )
    assert column(page(*waits), "system-switches", "setting") == ["10 s → 0.5 s"]
    assert column(
        page(turned[0], system_number("jade", "policy_violations", dial="jade.permissions", value=1)),
        "system-switches",
        "moves",
    ) == ["nothing"]


def test_page_one_says_by_what_fsar_is_the_best_beside_the_published_systems() -> None:
    assert "FSAR is better than all of them by policy violations, whatever" in said(page(), "answer")
    assert "one of them is better by none; by the other 12 it depends" in said(page(), "answer")
    assert "FSAR is better than all of them by none" in said(page(FAST, SLOW), "answer")
    slower = page(*(beaten("roboos", "reassignment_latency_s", size) for size in (4, 8, 16)))
    assert "one of them is better by reassignment latency; by the other 11" in said(slower, "answer")
    assert "three published systems" not in said(Document(made()), "answer")


def test_a_published_system_has_its_own_grade_beside_the_paper_s() -> None:
    features = [{"feature": "single_agent_robot", "architecture": "fsar", "grade": "full"}]
    document = Document(made(features=features), robustness=robustness_relations(systems=systems()))
    assert column(document, "architectural-comparison", "jade_ours", "printed")[0] == "●"
    assert column(document, "architectural-comparison", "verdict")[0] == "RoboOS, JADE"
