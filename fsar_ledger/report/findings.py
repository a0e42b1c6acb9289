"""Define what the report prints, as plain rows in stored units, before formatting and drawing."""

from typing import Any, TypeAlias

import msgspec

from fsar_ledger.events.envelope import Scenario
from fsar_ledger.metrics.multiverse import Multiverse

Row: TypeAlias = dict[str, Any]

ARCHITECTURES = ("fsar", "cfc", "dhma")
COMPARISONS = ("fsar-cfc", "fsar-dhma", "cfc-dhma")
MAIN_CONFIGURATION = "full"
MAIN_FLEET_SIZE = 4  # robots, as in the paper's main table
SCENARIOS: tuple[Scenario, ...] = (
    "door-relay",
    "collaborative-delivery",
    "failure-recovery-chain",
    "mixed-trust-inspection",
    "fleet-contention",
)


class Source(msgspec.Struct, frozen=True):
    """One packaged query: its name, and the SHA-256 of its text in hex."""

    name: str
    sha256: str


def interval(low: float | None, high: float | None) -> tuple[float, float] | None:
    """Return the interval between these ends; None if either is missing."""
    return None if low is None or high is None else (low, high)


class Workflows(msgspec.Struct, frozen=True):
    """What one head of a ledger of the paper's workflows shows.

    coverage: one row per mechanism: its cell in the paper and ours for each workflow, and the verdict; None where
    nothing exercises it.
    others: runs of workflows under another setting than most (seed, constants, model), which are left out.
    timeline: the steps of the first request of the door relay; recovery: those of the first failure of the layered
    recovery; empty without such a run.
    """

    commits: int
    size: int
    root: str
    run_count: int
    coverage: tuple[Row, ...]
    timeline: tuple[Row, ...]
    recovery: tuple[Row, ...]
    others: int = 0


class LedgerHead(msgspec.Struct, frozen=True):
    """The head of a ledger (commits, events, root), its number of runs, whether it is complete, and its model."""

    commits: int
    size: int
    root: str
    run_count: int
    completeness: str
    model_version: str | None


class Ablation(msgspec.Struct, frozen=True):
    """FSAR without some of its mechanisms, from one head. Paper: tab:ablation, sec:evaluation:ablation.

    cells: the 30 cells of the table; text: the eight numbers of the text; both in the paper's order. curve: means of
    the configuration without a shared registry for each metric, by scenario and over all, by `encounter_mean_s`; rates:
    one row for each `encounter_mean_s`, with a column per metric.
    """

    head: LedgerHead
    encounter_mean_s: float | None
    cells: tuple[Row, ...]
    text: tuple[Row, ...]
    curve: tuple[Row, ...]
    rates: tuple[Row, ...]


class Scaling(msgspec.Struct, frozen=True):
    """Larger fleets, from one head. Paper: tab:scaling.

    cells: the 45 cells of the table, with our means where all teams work and where one does; curve: our means for each
    metric, architecture, fleet size and number of working teams; costs: what coordination costs where all teams work,
    as in `metrics/coordination_cost`, for each architecture and fleet size.
    """

    head: LedgerHead
    cells: tuple[Row, ...]
    curve: tuple[Row, ...]
    costs: tuple[Row, ...] = ()


class Mechanisms(msgspec.Struct, frozen=True):
    """Every architecture in full and without one mechanism on the same worlds, from one head.

    rows: one per architecture, mechanism and metric, as in `statistics/mechanism_differences`, with interval, is_marked
    (it excludes 0) and stands (p adjusted over all these tests is below 0.05).
    parameters_sha256: the SHA-256 of the constants as these runs record them; more than one if runs write the same
    values differently.
    """

    head: LedgerHead
    rows: tuple[Row, ...]
    parameters_sha256: tuple[str, ...] = ()


class Findings(msgspec.Struct, frozen=True):
    """Everything that the report shows of one head of a ledger.

    cells: 24 rows metric x architecture: paper (stored units), paper_printed, mean, sd, n, ci_low, ci_high,
        denominator, published_convention_mean, interval, difference (its 90 % interval), distance (in margins), gives,
        power, share and could (`verdicts.Comparison`); None where the ledger has no runs.
    tests: 24 rows metric x comparison: t, p, cohens_d, p_holm, wilcoxon_p, n and paper_t, paper_p, paper_d,
        paper_level; None likewise; effect and effect_interval (d unsigned, its interval flipped likewise), pooled_* and
        pooled_interval where the metric is pooled.
    scenarios: 24 rows metric x architecture with one mean per scenario and one over all of them.
    rule: one row per metric: margin (stored units) and, for each architecture, the chance that a model which gives
        exactly the printed number is found equivalent.
    table_share: the share of experiments drawn from the runs that print a table as far out as the paper's; None if none
        are drawn.
    others: means of runs under other settings (configuration, fleet size, seed, kind, model, constants), one column per
        metric.
    runs: one row per architecture, configuration and fleet size: runs, scenarios, seeds, run_low, run_high.
    parameters: the constants of the runs in the tables by dotted name; parameters_sha256: their SHA-256 as recorded
        (`models` counts all sets of the ledger).
    features: one row per architectural feature: the paper's grade and ours for each architecture, the paper's grades of
        the systems that were not run, and the verdict.
    evidence: one row per feature and architecture: the grade and what it rests on.
    background: one row per architecture: the share of routine in what is counted, and the share of supervisors off
        shift in what is not attributable.
    cases: one row per number of the paper's four cases: its words and number, ours in both readings; empty without runs
        of their scenarios.
    completeness: whether all planned runs are there, as a clause.
    workflows, ablation, scaling, mechanisms: sections from this or another ledger: the paper's workflows, FSAR without
        a mechanism, larger fleets, and what each mechanism of any architecture carries; None without such runs.
    multiverse: the cells under every reading of the text; None if not asked for, or if the runs do not have the shape
        of the paper's tables.
    model_version: that of the runs in the tables; shown: which runs these are, if the ledger holds others of the same
        configuration and fleet size.
    unjudged: which numbers are not compared with the printed tables because their runs have another shape, in words;
        None if all are.
    differing: the pairs of runs that are left out because they met different worlds, in words.
    """

    commits: int
    size: int
    root: str
    run_count: int
    cells: tuple[Row, ...]
    tests: tuple[Row, ...]
    scenarios: tuple[Row, ...]
    rule: tuple[Row, ...]
    others: tuple[Row, ...]
    runs: tuple[Row, ...]
    models: tuple[Row, ...]
    parameters: dict[str, str]
    sources: tuple[Source, ...]
    features: tuple[Row, ...] = ()
    evidence: tuple[Row, ...] = ()
    background: tuple[Row, ...] = ()
    cases: tuple[Row, ...] = ()
    completeness: str = ""
    workflows: Workflows | None = None
    ablation: Ablation | None = None
    scaling: Scaling | None = None
    mechanisms: Mechanisms | None = None
    multiverse: Multiverse | None = None
    model_version: str | None = None
    shown: str | None = None
    unjudged: str | None = None
    table_share: float | None = None
    differing: tuple[str, ...] = ()
    parameters_sha256: str | None = None


LEVELS = ((0.001, "p<.001"), (0.01, "p<.01"), (0.05, "p<.05"))


def significance_level(p: float) -> str:
    """Return the level that the paper prints for this p value: p<.001, p<.01, p<.05 or n.s."""
    return next((name for bound, name in LEVELS if p < bound), "n.s.")


def with_agreement(test: Row, *, is_judged: bool = True) -> Row:
    """Return the test with `sign_agrees`, `level` and `level_agrees` against the paper's row.

    All None if the ledger has no such test, or it is not judged.
    """
    if test["t"] is None or test["p"] is None or not is_judged:
        return test | {"sign_agrees": None, "level": None, "level_agrees": None}
    level = significance_level(test["p"])
    same_sign = (test["t"] > 0) == (test["paper_t"] > 0) and test["t"] != 0
    return test | {"sign_agrees": same_sign, "level": level, "level_agrees": level == test["paper_level"]}


def answer(findings: Findings) -> Row:
    """Count how the 24 cells and the 24 tests came out, and name what is missing for the rest."""
    judged = [row for row in findings.cells if row["gives"] is not None]
    given, could = [row["gives"] for row in judged], [row["could"] for row in judged if row["could"] is not None]
    tests = [row for row in findings.tests if row["sign_agrees"] is not None]
    present = {row["architecture"] for row in findings.cells if row["mean"] is not None}
    return {
        "cells": len(findings.cells),
        "valued": sum(row["mean"] is not None for row in findings.cells),
        "judged": len(judged),
        "gives": given.count("yes"),
        "gives_not": given.count("no"),
        "undecided": given.count("undecided"),
        "drawn": len(could),
        "could": could.count("yes"),
        "could_not": could.count("no"),
        "table_share": findings.table_share,
        "tests": len(findings.tests),
        "tested": len(tests),
        "signs": sum(row["sign_agrees"] for row in tests),
        "levels": sum(row["level_agrees"] for row in tests),
        "missing_architectures": [name.upper() for name in ARCHITECTURES if name not in present],
        "undefined": [row for row in _names(findings) if row[1] in present],
    }


def _names(findings: Findings) -> list[tuple[str, str]]:
    """Return metric and architecture of the cells without a value."""
    return [(row["metric"], row["architecture"]) for row in findings.cells if row["mean"] is None]
