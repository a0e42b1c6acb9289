"""Show where the paper's printed numbers contradict its own definitions, with the arithmetic.

Everything is computed from the paper's printed numbers, without any ledger. `facts()` computes, for each paragraph of
`reports/contradictions.toml`, the numbers that it quotes; the `*_rows` functions make its tables.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from typing import TypeAlias

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.metrics.definitions import published_metrics
from fsar_ledger.report import specs

Z95 = 1.96  # two-sided 95 % quantile of the normal distribution, as rounded in the paper's intervals
ARCHITECTURES = ("FSAR", "CFC", "DHMA")
PAIRS = tuple(combinations(ARCHITECTURES, 2))


def half_width(sd: float, n: int) -> float:
    """Return the half width of a 95 % interval around a mean of `n` values with this SD. Unit: that of `sd`."""
    return Z95 * sd / math.sqrt(n)


def sd_of_half_width(half: float, n: int) -> float:
    """Return the SD implied by a printed 95 % half width of `n` values: the inverse of `half_width`."""
    return half * math.sqrt(n) / Z95


def wilson(share: float, n: int) -> tuple[float, float]:
    """Return the Wilson 95 % interval of a share observed on `n` trials. Unit: share."""
    centre = (share + Z95**2 / (2 * n)) / (1 + Z95**2 / n)
    reach = Z95 / (1 + Z95**2 / n) * math.sqrt(share * (1 - share) / n + Z95**2 / (4 * n * n))
    return centre - reach, centre + reach


def pooled_sd(difference: float, d: float) -> float:
    """Return the pooled SD implied by Cohen's d: |difference| / d. Unit: that of the difference."""
    return abs(difference) / d


def binary_d(first: float, second: float) -> float:
    """Return Cohen's d of a 0/1 value, which follows from its two means (shares) alone."""
    return abs(first - second) / math.sqrt((first * (1 - first) + second * (1 - second)) / 2)


def smallest_sd_with_a_zero(mean: float, groups: int) -> float:
    """Return the least SD of `groups` group means that average `mean` while one of them is 0.

    It is least when the others are equal, mean x groups / (groups - 1) each. The divisor is `groups`, which gives the
    smaller SD.
    """
    other = mean * groups / (groups - 1)
    return math.sqrt((mean**2 + (groups - 1) * (other - mean) ** 2) / groups)


def counts_that_print(percent: int, largest: int) -> list[str]:
    """Return the fractions "k/n" with n up to `largest` that round to this percentage, one k for each n."""
    found = []
    for n in range(1, largest + 1):
        k = round(percent * n / 100)
        if 100 * k >= (percent - 0.5) * n and 100 * k < (percent + 0.5) * n:
            found.append(f"{k}/{n}")
    return found


class Variances(msgspec.Struct, frozen=True):
    """Variances implied by three pairwise d, and the largest that rounding of the printed values still allows."""

    metric: str
    implied: Mapping[str, float]
    largest: Mapping[str, float]


def _squared_sd_range(first: float, second: float, d: float, mean_step: float, d_step: float) -> tuple[float, float]:
    difference = abs(first - second)
    least = max(difference - mean_step, 0.0) / (d + d_step / 2)
    most = (difference + mean_step) / (d - d_step / 2)
    return least**2, most**2


def implied_variances(
    metric: str, means: Mapping[str, float], d: Mapping[frozenset[str], float], mean_step: float, d_step: float = 0.01
) -> Variances:
    """Return the three variances that follow from (v_a + v_b) / 2 = ((m_a - m_b) / d_ab)^2 for each pair.

    `mean_step` and `d_step` are one unit in the last printed place; `largest` uses all the room that rounding leaves.
    """
    squared, ranges = {}, {}
    for pair in map(frozenset, combinations(means, 2)):
        first, second = (means[name] for name in pair)
        squared[pair] = pooled_sd(first - second, d[pair]) ** 2
        ranges[pair] = _squared_sd_range(first, second, d[pair], mean_step, d_step)
    implied, largest = {}, {}
    for name in means:
        other, third = (one for one in means if one != name)
        near, far, opposite = frozenset((name, other)), frozenset((name, third)), frozenset((other, third))
        implied[name] = squared[near] + squared[far] - squared[opposite]
        largest[name] = ranges[near][1] + ranges[far][1] - ranges[opposite][0]
    return Variances(metric=metric, implied=implied, largest=largest)


def growth_exponent(sizes: Sequence[float], values: Sequence[float]) -> float:
    """Return the exponent b of value ~ size^b between the first and the last point; above 1 is super-linear."""
    return math.log(values[-1] / values[0]) / math.log(sizes[-1] / sizes[0])


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
    return [
        implied_variances(
            spec.name,
            {name: float(row["mean"]) for name, row in results[spec.name].items()},
            effects[spec.name],
            mean_step=10.0 ** -_decimals(results[spec.name]["FSAR"]["mean"]),
        )
        for spec in published_metrics()
    ]


def variance_rows() -> list[Row]:
    """Return the table of implied variances: a row per metric, in squared printed units.

    `possible` says whether rounding leaves room for a variance of FSAR.
    """
    return [
        {name.lower(): one.implied[name] for name in ARCHITECTURES}
        | {
            "metric": one.metric,
            "largest": one.largest["FSAR"],
            "possible": "no" if one.largest["FSAR"] < 0 else "only by rounding" if one.implied["FSAR"] < 0 else "yes",
        }
        for one in variances()
    ]


def _pooled_of_intervals(rows: tuple[dict[str, str], ...], n: int, slack: float) -> float:
    """Return the pooled SD implied by half widths, each widened by `slack` units of its last printed place."""
    halves = [float(row["printed_ci95"]) + slack * 10.0 ** -_decimals(row["printed_ci95"]) for row in rows]
    return math.sqrt(sum(sd_of_half_width(half, n) ** 2 for half in halves) / len(halves))


def interval_rows() -> list[Row]:
    """Return, per metric and pair, the pooled SD implied by the printed intervals and the one implied by d."""
    results, effects = _results(), _effects()
    _, _, n = _design()
    rows: list[Row] = []
    for spec in published_metrics():
        for first, second in PAIRS:
            a, b = results[spec.name][first], results[spec.name][second]
            difference, d = float(a["mean"]) - float(b["mean"]), effects[spec.name][frozenset((first, second))]
            by_interval, by_effect = _pooled_of_intervals((a, b), n, 0.0), pooled_sd(difference, d)
            widest = _pooled_of_intervals((a, b), n, 0.5)
            row: Row = {"metric": spec.name, "pair": f"{first} vs {second}"}
            row |= {"interval_sd": by_interval, "effect_sd": by_effect}
            rows.append(row | {"ratio": by_effect / by_interval, "ratio_rounded": by_effect / widest})
    return rows


def _printed_intervals() -> Facts:
    results = _results()
    scenarios, _, n = _design()
    sds = specs.quotes()["success_sd_pct"]
    success = results["coordination_success"]
    low, high = wilson(float(success["FSAR"]["mean"]) / 100, n)
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
            f"half_{key}": half_width(sds[name].value, n),
            f"printed_{key}": success[name]["printed_ci95"],
        }
    found |= {
        "human": float(human["mean"]),
        "human_sd": 100 * math.sqrt(share * (1 - share)),
        "human_printed": human["printed_ci95"],
    }
    found["human_half"] = half_width(float(found["human_sd"]), n)
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
        fitting = counts_that_print(round(100 * share), runs)
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
    sd = smallest_sd_with_a_zero(mean, scenarios)
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
        "half": half_width(sd, n),
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
    for first, second in PAIRS:
        key, d = (first[0] + second[0]).lower(), effects[frozenset((first, second))]
        squared |= {
            f"diff_{key}": abs(means[first] - means[second]),
            f"d_{key}": d,
            f"var_{key}": (abs(means[first] - means[second]) / d) ** 2,
        }
    titles = {spec.name: spec.short.partition(" (")[0].lower() for spec in published_metrics()}
    squared["variance"] = next(one for one in found if one.metric == "authority_conflicts").implied["FSAR"]
    squared["negative"] = printable.every([titles[one.metric] for one in found if one.implied["FSAR"] < 0])
    squared["impossible"] = printable.every([titles[one.metric] for one in found if one.largest["FSAR"] < 0])
    return squared


def _binary_effects() -> Facts:
    effects, results = _effects()["human_intervention"], _results()["human_intervention"]
    found: dict[str, float | int | str] = {}
    for first, second in PAIRS:
        key = (first[0] + second[0]).lower()
        a, b = float(results[first]["mean"]) / 100, float(results[second]["mean"]) / 100
        found |= {
            f"a_{key}": a,
            f"b_{key}": b,
            f"d_{key}": binary_d(a, b),
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
    return {"pairs": printable.every(pairs), "count": len(pairs), "compared": len(columns)}


def _growth() -> Facts:
    rows = [row for row in specs.paper_table("scaling") if row["architecture"] == "DHMA"]
    sizes = [int(row["fleet_size"]) for row in rows]
    conflicts = [float(row["authority_conflicts"]) for row in rows]
    each = int(specs.quotes()["scaling"]["agents_per_robot"].value)
    agents = [each * size for size in sizes]
    return {
        "sizes": ", ".join(map(str, sizes)),
        "agents": ", ".join(map(str, agents)),
        "agents_exponent": growth_exponent(sizes, agents),
        "first": conflicts[0],
        "last": conflicts[-1],
        "robots_ratio": sizes[-1] / sizes[0],
        "conflicts_ratio": conflicts[-1] / conflicts[0],
        "exponent": growth_exponent(sizes, conflicts),
    }


def _caption() -> Facts:
    quotes = specs.quotes()["figures"]
    return {"text": int(quotes["workflow_in_text"].value), "caption": int(quotes["workflow_in_caption"].value)}


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
