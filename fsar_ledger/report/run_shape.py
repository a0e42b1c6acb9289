"""Tell whether runs have the shape of the paper's tables: all five scenarios, equally many runs of each."""

from collections.abc import Iterable, Mapping

from fsar_ledger.printable import counted, some
from fsar_ledger.report.findings import ARCHITECTURES, COMPARISONS, SCENARIOS, Row

RunCounts = Mapping[str | None, int]
"""How many runs, or pairs of runs, there are of each scenario."""


def run_counts(rows: Iterable[Row], of: str) -> dict[str, dict[str | None, int]]:
    """Return the counts by scenario of each value of the column `of` (architecture or comparison)."""
    found: dict[str, dict[str | None, int]] = {}
    for row in rows:
        found.setdefault(row[of], {})[row["scenario"]] = row["runs"]
    return found


def is_complete(runs: RunCounts) -> bool:
    """Tell whether the runs cover every scenario of the tables equally often, and no other scenario."""
    return runs.keys() == set(SCENARIOS) and len(set(runs.values())) == 1


def unjudged(runs: Mapping[str, RunCounts], pairs: Mapping[str, RunCounts]) -> frozenset[str]:
    """Return the architectures and comparisons whose runs do not have the shape of the paper's tables."""
    partial = {name for name, of_scenarios in runs.items() if not is_complete(of_scenarios)}
    return frozenset(
        partial
        | {one for one in COMPARISONS if partial & {*one.split("-")} or (one in pairs and not is_complete(pairs[one]))}
    )


def why_unjudged(runs: Mapping[str, RunCounts], pairs: Mapping[str, RunCounts]) -> str | None:
    """Say what the ledger holds of each unjudged one, and what follows; None where everything is judged."""
    found = unjudged(runs, pairs)
    told: dict[str, list[str]] = {}
    for name in (one for one in ARCHITECTURES if one in found):
        told.setdefault(_listed(runs[name], "run"), []).append(name.upper())
    for name in COMPARISONS:
        if name in found and not {*name.split("-")} & found:  # else the runs of its sides already say why
            told.setdefault(_listed(pairs[name], "pair"), []).append(name.upper().replace("-", " vs "))
    if not told:
        return None
    of_each = "; ".join(f"of {some(names)} this ledger has {listed}" for listed, names in told.items())
    return (
        f"The printed tables are over {len(SCENARIOS)} scenarios with equally many runs of each, but {of_each}. They "
        "are therefore shown without a verdict."
    )


def _listed(of_scenarios: RunCounts, what: str) -> str:
    return some(
        f"{counted(count, what)} of {name or 'no scenario'}"
        for name, count in sorted(of_scenarios.items(), key=lambda item: item[0] or "")
    )
