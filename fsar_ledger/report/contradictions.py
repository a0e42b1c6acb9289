"""Show where the paper's printed numbers contradict its own definitions, with the arithmetic.

`facts()` computes, for each paragraph of `reports/contradictions.toml`, the numbers that it quotes; the `*_rows`
functions make its tables. Everything is computed from the paper's printed numbers.
"""

import math
from collections.abc import Callable, Mapping
from typing import TypeAlias

from fsar_ledger.metrics.definitions import published_metrics
from fsar_ledger.report import arithmetic, specs
from fsar_ledger.report.arithmetic import ARCHITECTURES, Variances

Facts: TypeAlias = Mapping[str, float | int | str]
Row: TypeAlias = dict[str, object]


def _decimals(printed: str) -> int:
    return len(printed.partition(".")[2])


def _results() -> dict[str, dict[str, dict[str, str]]]:
    """Return the rows of the paper's results table by metric (name in the queries) and architecture."""
    named = {spec.printed.results: spec.name for spec in published_metrics()}
    found: dict[str, dict[str, dict[str, str]]] = {}
    for row in specs.paper_table("results"):
        found.setdefault(named[row["metric"]], {})[row["architecture"]] = row
    return found


def _effects() -> dict[str, dict[frozenset[str], float]]:
    """Return the paper's Cohen's d by metric (name in the queries) and pair of architectures."""
    named = {spec.printed.significance: spec.name for spec in published_metrics()}
    found: dict[str, dict[frozenset[str], float]] = {}
    for row in specs.paper_table("significance"):
        found.setdefault(named[row["metric"]], {})[frozenset(row["comparison"].split(" vs "))] = float(row["cohens_d"])
    return found


def _design() -> tuple[int, int, int]:
    """Return the number of scenarios, of runs of each, and of runs of an architecture."""
    design = specs.quotes()["design"]
    scenarios, runs = int(design["scenarios"].value), int(design["runs_per_scenario"].value)
    return scenarios, runs, scenarios * runs


def variances() -> list[Variances]:
    """Return the variances that the published pairwise d imply, by metric."""
    results, effects = _results(), _effects()
    found = []
    for spec in published_metrics():
        rows = results[spec.name]
        means = {one: float(rows[one]["mean"]) for one in ARCHITECTURES}
        found.append(
            arithmetic.implied_variances(
                spec.name, means, effects[spec.name], mean_step=10.0 ** -_decimals(rows["FSAR"]["mean"])
            )
        )
    return found


def variance_rows() -> list[Row]:
    """Return the table of implied variances: a row per metric, in squared printed units.

    `possible` says whether rounding leaves room for a variance of FSAR.
    """
    rows: list[Row] = []
    for one in variances():
        row: Row = {"metric": one.metric}
        for name in ARCHITECTURES:
            row[name.lower()] = one.implied[name]
        row["largest"] = one.largest["FSAR"]
        row["possible"] = "no" if one.largest["FSAR"] < 0 else "only by rounding" if one.implied["FSAR"] < 0 else "yes"
        rows.append(row)
    return rows


def _pooled_of_intervals(rows: tuple[dict[str, str], ...], n: int, slack: float) -> float:
    """Return the pooled SD implied by half widths, each widened by `slack` units of its last printed place."""
    halves = [float(row["printed_ci95"]) + slack * 10.0 ** -_decimals(row["printed_ci95"]) for row in rows]
    return math.sqrt(sum(arithmetic.sd_of_half_width(half, n) ** 2 for half in halves) / len(halves))


def interval_rows() -> list[Row]:
    """Return, per metric and pair, the pooled SD implied by the printed intervals and the one implied by d."""
    results, effects = _results(), _effects()
    _, _, n = _design()
    rows: list[Row] = []
    for spec in published_metrics():
        for first, second in (("FSAR", "CFC"), ("FSAR", "DHMA"), ("CFC", "DHMA")):
            a, b = results[spec.name][first], results[spec.name][second]
            difference, d = float(a["mean"]) - float(b["mean"]), effects[spec.name][frozenset((first, second))]
            by_interval, by_effect = _pooled_of_intervals((a, b), n, 0.0), arithmetic.pooled_sd(difference, d)
            widest = _pooled_of_intervals((a, b), n, 0.5)
            row: Row = {
                "metric": spec.name,
                "pair": f"{first} vs {second}",
                "interval_sd": by_interval,
                "effect_sd": by_effect,
            }
            rows.append(row | {"ratio": by_effect / by_interval, "ratio_rounded": by_effect / widest})
    return rows


def _printed_intervals() -> Facts:
    results = _results()
    scenarios, _, n = _design()
    sds = specs.quotes()["success_sd_pct"]
    success = results["coordination_success"]
    low, high = arithmetic.wilson(float(success["FSAR"]["mean"]) / 100, n)
    human = results["human_intervention"]["FSAR"]
    share = float(human["mean"]) / 100
    rows = interval_rows()
    found: dict[str, float | int | str] = {
        "scenarios": scenarios,
        "n": n,
        "success": float(success["FSAR"]["mean"]),
        "low": 100 * low,
        "high": 100 * high,
    }
    for name in ("FSAR", "CFC"):
        key = name.lower()
        found |= {
            f"sd_{key}": sds[name].value,
            f"half_{key}": arithmetic.half_width(sds[name].value, n),
            f"printed_{key}": success[name]["printed_ci95"],
        }
    found |= {
        "human": float(human["mean"]),
        "human_sd": 100 * math.sqrt(share * (1 - share)),
        "human_printed": human["printed_ci95"],
    }
    found["human_half"] = arithmetic.half_width(float(found["human_sd"]), n)
    found |= {
        "pairs": len(rows),
        "narrower": sum(float(str(row["ratio"])) > 1 for row in rows),
        "surely": sum(float(str(row["ratio_rounded"])) > 1 for row in rows),
    }
    return found


def _without_layered_recovery() -> Facts:
    ablation = {row["configuration"]: row for row in specs.paper_table("ablation")}
    without, full = ablation["without_layered_recovery"], ablation["full"]
    text = next(row for row in specs.paper_table("ablation_text") if row["configuration"] == "without_layered_recovery")
    scenarios, _, _ = _design()
    design = specs.quotes()["design"]
    p, affected = design["failure_probability"].value, int(design["failure_scenarios"].value)
    return {
        "containment": without["recovery_containment"],
        "full_containment": full["recovery_containment"],
        "failing": 100 * (1 - float(without["recovery_containment"])),
        "injected": 100 * p * affected / scenarios,
        "lost": 100 * (float(full["success"]) - float(without["success"])),
        "success": text["ablated"],
        "full_success": text["full_fsar"],
        "probability": p,
        "undegraded": 100 * (1 - p),
    }


def _case(case: int, architecture: str) -> float:
    rows = [
        row for row in specs.paper_table("cases") if (int(row["case"]), row["architecture"]) == (case, architecture)
    ]
    return float(rows[0]["value"])


def _fractions_of_runs() -> Facts:
    _, runs, _ = _design()
    found: dict[str, float | int | str] = {"runs": runs}
    for name in ("FSAR", "DHMA"):
        key, share = name.lower(), _case(2, name)
        fitting = arithmetic.counts_that_print(round(100 * share), runs)
        found |= {f"pct_{key}": round(100 * share), f"runs_{key}": share * runs}
        found |= {
            f"below_{key}": 100 * math.floor(share * runs) / runs,
            f"above_{key}": 100 * math.ceil(share * runs) / runs,
            f"fit_{key}": ", ".join(fitting),
        }
    return found


def _zero_conflicts() -> Facts:
    scenarios, _, n = _design()
    row = _results()["authority_conflicts"]["FSAR"]
    mean = float(row["mean"])
    sd = arithmetic.smallest_sd_with_a_zero(mean, scenarios)
    zero = _case(3, "FSAR")
    other = mean * scenarios / (scenarios - 1)
    return {
        "zero": int(zero),
        "mean": mean,
        "scenarios": scenarios,
        "others": scenarios - 1,
        "other": other,
        "sd": sd,
        "n": n,
        "half": arithmetic.half_width(sd, n),
        "printed": row["printed_ci95"],
    }


def _abstract() -> Facts:
    effects, said = _effects(), specs.quotes()["abstract_d"]
    fc, fd = frozenset(("FSAR", "CFC")), frozenset(("FSAR", "DHMA"))
    containment, locality = effects["recovery_containment"], effects["governance_locality"]
    return {
        "said": said["recovery_containment"].value,
        "said_locality": said["governance_locality"].value,
        "containment_cfc": containment[fc],
        "containment_dhma": containment[fd],
        "locality_cfc": locality[fc],
        "locality_dhma": locality[fd],
        "contained": 100 * float(_results()["recovery_containment"]["FSAR"]["mean"]),
    }


def _negative_variance() -> Facts:
    found = variances()
    effects, results = _effects()["authority_conflicts"], _results()["authority_conflicts"]
    means = {name: float(results[name]["mean"]) for name in ARCHITECTURES}
    squared: dict[str, float | int | str] = {}
    for first, second in (("FSAR", "CFC"), ("FSAR", "DHMA"), ("CFC", "DHMA")):
        key, d = (first[0] + second[0]).lower(), effects[frozenset((first, second))]
        squared |= {
            f"diff_{key}": abs(means[first] - means[second]),
            f"d_{key}": d,
            f"var_{key}": (abs(means[first] - means[second]) / d) ** 2,
        }
    titles = {spec.name: spec.short.partition(" (")[0].lower() for spec in published_metrics()}
    squared["variance"] = next(one for one in found if one.metric == "authority_conflicts").implied["FSAR"]
    squared["negative"] = _listed([titles[one.metric] for one in found if one.implied["FSAR"] < 0])
    squared["impossible"] = _listed([titles[one.metric] for one in found if one.largest["FSAR"] < 0])
    return squared


def _binary_effects() -> Facts:
    effects, results = _effects()["human_intervention"], _results()["human_intervention"]
    found: dict[str, float | int | str] = {}
    for first, second in (("FSAR", "CFC"), ("FSAR", "DHMA"), ("CFC", "DHMA")):
        key = (first[0] + second[0]).lower()
        a, b = float(results[first]["mean"]) / 100, float(results[second]["mean"]) / 100
        found |= {
            f"a_{key}": a,
            f"b_{key}": b,
            f"d_{key}": arithmetic.binary_d(a, b),
            f"printed_{key}": effects[frozenset((first, second))],
        }
    return found


def _two_full_systems() -> Facts:
    full = next(row for row in specs.paper_table("ablation") if row["configuration"] == "full")
    results = _results()
    pairs = []
    columns = {spec.printed.elsewhere: spec for spec in published_metrics() if spec.printed.elsewhere in full}
    for column, spec in columns.items():
        main = float(results[spec.name]["FSAR"]["mean"]) / spec.factor
        if round(main, 4) != round(float(full[column]), 4):
            pairs.append(f"{spec.title.partition(' (')[0].lower()} {main:.2f} and {float(full[column]):.2f}")
    return {"pairs": _listed(pairs), "count": len(pairs), "compared": len(columns)}


def _growth() -> Facts:
    rows = [row for row in specs.paper_table("scaling") if row["architecture"] == "DHMA"]
    sizes = [int(row["fleet_size"]) for row in rows]
    conflicts = [float(row["authority_conflicts"]) for row in rows]
    each = int(specs.quotes()["scaling"]["agents_per_robot"].value)
    agents = [each * size for size in sizes]
    return {
        "sizes": ", ".join(map(str, sizes)),
        "agents": ", ".join(map(str, agents)),
        "agents_exponent": arithmetic.growth_exponent(sizes, agents),
        "first": conflicts[0],
        "last": conflicts[-1],
        "robots_ratio": sizes[-1] / sizes[0],
        "conflicts_ratio": conflicts[-1] / conflicts[0],
        "exponent": arithmetic.growth_exponent(sizes, conflicts),
    }


def _caption() -> Facts:
    said = specs.quotes()["figures"]
    return {"text": int(said["workflow_in_text"].value), "caption": int(said["workflow_in_caption"].value)}


def _listed(names: list[str]) -> str:
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1]))) if names else "none"


CHECKS: Mapping[str, Callable[[], Facts]] = {
    "printed-intervals": _printed_intervals,
    "without-layered-recovery": _without_layered_recovery,
    "fractions-of-runs": _fractions_of_runs,
    "zero-conflicts": _zero_conflicts,
    "abstract": _abstract,
    "negative-variance": _negative_variance,
    "binary-effects": _binary_effects,
    "two-full-systems": _two_full_systems,
    "growth": _growth,
    "caption": _caption,
}

TABLES: Mapping[str, Callable[[], list[Row]]] = {"implied-variances": variance_rows, "printed-intervals": interval_rows}


def facts() -> dict[str, Facts]:
    """Return the computed numbers of every contradiction, by its id."""
    return {name: check() for name, check in CHECKS.items()}
