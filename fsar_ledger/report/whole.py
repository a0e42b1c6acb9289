"""Whether runs are of the shape that the paper's tables are over: all five scenarios, equally many runs of each."""

from collections.abc import Iterable, Mapping

from fsar_ledger.printable import counted, some
from fsar_ledger.report.findings import ARCHITECTURES, COMPARISONS, SCENARIOS, Row

Held = Mapping[str | None, int]
"""Runs, or pairs of runs, by scenario."""


def held(rows: Iterable[Row], of: str) -> dict[str, dict[str | None, int]]:
    """The counts of each architecture, or comparison, by scenario."""
    found: dict[str, dict[str | None, int]] = {}
    for row in rows:
        found.setdefault(row[of], {})[row["scenario"]] = row["runs"]
    return found


def is_whole(runs: Held) -> bool:
    """Whether the runs are of every scenario of the tables, equally many of each, and of no other."""
    return runs.keys() == set(SCENARIOS) and len(set(runs.values())) == 1


def apart(runs: Mapping[str, Held], pairs: Mapping[str, Held]) -> frozenset[str]:
    """The architectures, and the comparisons, whose numbers are not those of the paper's tables."""
    partial = {name for name, of_scenarios in runs.items() if not is_whole(of_scenarios)}
    return frozenset(
        partial
        | {one for one in COMPARISONS if partial & {*one.split("-")} or (one in pairs and not is_whole(pairs[one]))}
    )


def why_apart(runs: Mapping[str, Held], pairs: Mapping[str, Held]) -> str | None:
    """What the ledger holds of each of these, and what that means, in words; None where there are none."""
    found = apart(runs, pairs)
    told: dict[str, list[str]] = {}
    for name in (one for one in ARCHITECTURES if one in found):
        told.setdefault(_listed(runs[name], "run"), []).append(name.upper())
    for name in (
        one for one in COMPARISONS if one in found and not {*one.split("-")} & found
    ):  # else the runs of its sides say it
        told.setdefault(_listed(pairs[name], "pair"), []).append(name.upper().replace("-", " vs "))
    if not told:
        return None
    of_each = "; ".join(f"of {some(names)} this ledger has {listed}" for listed, names in told.items())
    return (
        f"The printed tables are over {len(SCENARIOS)} scenarios with equally many runs of each, but {of_each}. They "
        "are therefore shown without a verdict."
    )


def _listed(of_scenarios: Held, what: str) -> str:
    return some(
        f"{counted(count, what)} of {name or 'no scenario'}"
        for name, count in sorted(of_scenarios.items(), key=lambda item: item[0] or "")
    )
