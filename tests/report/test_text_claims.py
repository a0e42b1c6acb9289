"""What the paper's running text claims beside its tables is answered, and what the report says of it is counted."""

from typing import Any

import msgspec

from fsar_ledger.metrics.registration import registration
from fsar_ledger.report import specs
from fsar_ledger.report.build import Document
from fsar_ledger.report.judge import OPEN
from tests.report.made import column, made, number, paired, pairs_of, results, said

SCENARIOS = (
    *("door-relay", "collaborative-delivery", "failure-recovery-chain", "mixed-trust-inspection", "fleet-contention"),
)


def means(metric: str, **of: tuple[float, ...]) -> list[dict[str, Any]]:
    """The means of a metric in the five scenarios, in order, of each architecture."""
    return [
        {"metric": metric, "architecture": name, "scenario": scenario, "mean": mean}
        for name, row in of.items()
        for scenario, mean in zip(SCENARIOS, row, strict=True)
    ]


MEASURED = [
    *means("authority_conflicts", fsar=(1, 1, 1, 1, 5), cfc=(4, 4, 4, 4, 4), dhma=(8, 8, 8, 8, 8)),
    *means("policy_violations", fsar=(1, 1, 1, 1, 1), cfc=(2, 2, 2, 2, 2), dhma=(3, 3, 3, 3, 3)),
    *means("coordination_success", fsar=(1, 0.9, 0.9, 0.9, 0.9), cfc=(1, 1, 1, 1, 0.5), dhma=(0.9, 0.8, 0.7, 0.6, 0.9)),
    *means("governance_locality", cfc=(0.701, 0.702, 0.703, 0.704, 0.705)),
]


def test_what_the_abstract_says_of_all_scenarios_is_counted_scenario_by_scenario() -> None:
    found = said(Document(made(measured=MEASURED)), "in-all-scenarios")
    assert "Here it has the fewest conflicts in 4 of 5, and the fewest violations in 5." in found


def test_what_the_text_says_of_scenarios_stands_beside_ours() -> None:
    found = said(Document(made(measured=MEASURED)), "said-of-scenarios")
    assert "an SD of 9.8 and 4.9 %; here it is 4.5 and 22.4 %." in found, "0.1 and 0.5 over the root of 5"
    assert "here it is 0.701 and 0.702 there, and 0.703, 0.704 and 0.705 in the others." in found
    assert "it is lowest in mixed trust inspection and failure recovery chain." in found
    four = [row for row in MEASURED if row["scenario"] != "door-relay"]
    assert not said(Document(made(measured=four)), "said-of-scenarios"), "it speaks of five scenarios"


def test_levels_of_significance_of_both_tests_are_compared() -> None:
    tests = [paired("governance_locality", pair, 0.1, p=0.02) for pair in ("fsar-cfc", "fsar-dhma", "cfc-dhma")]
    both = [msgspec.structs.replace(one, wilcoxon_p=p) for one, p in zip(tests, (0.04, 0.009, 0.011), strict=True)]
    assert "at 0.05, 0.01 and 0.001, those of 2 of 3 tests agree." in said(
        Document(made(tests=both)), "wilcoxon-levels"
    )


def test_numbers_that_move_with_the_open_dial_are_named_though_registered_otherwise() -> None:
    dialled: dict[str, Any] = {"configuration": "without-shared-registry"}
    numbers = [
        number("ablation", metric="authority_conflicts", **dialled),
        number("ablation", metric="policy_violations", **dialled),
        number("ablation", metric="coordination_success", outcome=OPEN, **dialled),
    ]
    ends = {"coordination_success": (0.9, 0.1), "authority_conflicts": (1.0, 0.35), "policy_violations": (0.4, 0.3)}
    encounters = [
        {"metric": metric, "scenario": None, "encounter_mean_s": at, "mean": mean, "ci_low": None, "ci_high": None}
        for metric, pair in ends.items()
        for at, mean in zip((30.0, 300.0), pair, strict=True)
    ]
    found = said(Document(made(numbers, encounters=encounters)), "moved-by-encounters")
    assert "from 30 to 300 s conflicts (1.00 to 0.35) move by more than a margin." in found


def test_places_on_the_curve_of_the_load_are_said_to_be_so_far_apart() -> None:
    wanted: dict[str, Any] = {"metric": "authority_conflicts", "fleet_size": 16, "outcome": OPEN, "paper": 2.0}
    numbers = [number("scaling", architecture=name, printed="2.0", **wanted) for name in ("fsar", "cfc")]
    loads = [
        {"metric": "authority_conflicts", "architecture": name, "fleet_size": 16, "teams_working": teams, "mean": mean}
        for name, ends in (("fsar", (1.0, 3.0)), ("cfc", (0.0, 2.5)))
        for teams, mean in zip((1, 4), ends, strict=True)
    ]
    rows = [row | {"ci_low": None, "ci_high": None} for row in loads]
    assert "They are at most 1.03 teams apart." in said(Document(made(numbers, loads=rows))), "at 2.00 and 3.03"


def test_the_paper_ranks_by_all_its_measures_whatever_the_ledger_holds() -> None:
    lost = {f"recovery_containment__{name}": None for name in ("fsar", "cfc", "dhma")}
    numbers = results(**lost)
    document = Document(made(numbers, pairs_of(numbers)))
    assert column(document, "claims", "holds") == [True, True, None, *[True] * 5]
    found = said(document, "answer")
    assert "by 8 measures; " in found
    assert "7 of these rankings come out, and that by recovery containment cannot be decided" in found


def test_every_registered_class_is_explained_where_numbers_are_counted_by_class() -> None:
    [tally] = [one for one in specs.sections()["01-results"].part if getattr(one, "name", "") == "tally"]
    assert isinstance(tally, specs.Table)
    for name in sorted({cell.kind for cell in registration().cell} | {"fitted", "informed"}):
        assert f"_{name.replace('_', ' ').capitalize()}_:" in tally.caption
