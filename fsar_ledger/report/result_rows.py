"""Make the rows of the results beside what the paper prints: cells, tests, scenarios, margins and cases.

Runs are judged only where they have the shape of the paper's tables: all five scenarios, equally many runs of each.
"""

from collections.abc import Collection, Iterable, Mapping

import msgspec

from fsar_ledger.base.printable import counted, some
from fsar_ledger.metrics import verdicts
from fsar_ledger.metrics.database import Database
from fsar_ledger.metrics.definitions import published_metrics
from fsar_ledger.metrics.plans import completeness
from fsar_ledger.metrics.results import MetricRow, StatisticRow
from fsar_ledger.metrics.verdicts import Cell, Odds
from fsar_ledger.report import printing, specs
from fsar_ledger.report.findings import ARCHITECTURES, COMPARISONS, SCENARIOS, LedgerHead, Row, interval, with_agreement

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


def ledger_head(database: Database, model_version: str | None) -> LedgerHead:
    """Return the head of this ledger, with the model of the runs that are shown. Raises: as `Database.rows`."""
    head = database.head
    (runs,) = database.rows("SELECT count(*) AS runs FROM runs")
    commits, size, root = (0, 0, "") if head is None else (head.commits, head.size, head.root)
    return LedgerHead(commits, size, root, runs["runs"], completeness(database).sentence(), model_version)


def _blank(cls: type[msgspec.Struct]) -> Row:
    return dict.fromkeys(cls.__struct_fields__)


def cells_of(rows: Iterable[MetricRow], unjudged: Collection[str], drawn: Odds[Cell] | None) -> tuple[Row, ...]:
    """Return the cells of the results table beside the paper's; architectures in `unjudged` get no verdict."""
    found = {(row.metric, row.architecture): row for row in rows}
    judged = {
        (one.metric, one.architecture): one
        for one in verdicts.compare(found.values(), drawn)
        if one.architecture not in unjudged
    }
    printed = {(row["metric"], row["architecture"]): row["mean"] for row in specs.paper_table("results")}
    cells = []
    for spec in published_metrics():
        for architecture in ARCHITECTURES:
            key = (spec.name, architecture)
            row, paper = found.get(key), verdicts.published()[key].value
            cell = msgspec.structs.asdict(row) if row is not None else _blank(MetricRow)
            beside = {
                "paper": paper,
                "paper_printed": printed[spec.printed.results, architecture.upper()],
                "interval": interval(cell["ci_low"], cell["ci_high"]),
            }
            cells.append(cell | {"metric": spec.name, "architecture": architecture} | beside | _judged(judged.get(key)))
    return tuple(cells)


def _judged(one: verdicts.Comparison | None) -> Row:
    """Return difference, distance and answers of a cell; all None where the ledger has no value to judge."""
    if one is None or one.ours is None:
        return dict.fromkeys(("difference", "distance", "gives", "power", "share", "could"))
    return {
        "difference": interval(one.low, one.high),
        "distance": one.distance,
        "gives": one.gives,
        "power": one.power,
        "share": one.share,
        "could": one.could,
    }


def tests_of(rows: Iterable[StatisticRow], unjudged: Collection[str]) -> tuple[Row, ...]:
    """Return the pairwise tests beside those that the paper prints; comparisons in `unjudged` get no verdict."""
    found = {(row.metric, row.comparison): row for row in rows}
    printed = {(row["metric"], row["comparison"]): row for row in specs.paper_table("significance")}
    tests = []
    for spec in published_metrics():
        for comparison in COMPARISONS:
            paper = printed[spec.printed.significance, " vs ".join(comparison.upper().split("-"))]
            row = found.get((spec.name, comparison))
            test = msgspec.structs.asdict(row) if row is not None else _blank(StatisticRow)
            beside = {
                "paper_t": float(paper["t"]),
                "paper_p": paper["p"],
                "paper_d": float(paper["cohens_d"]),
                "paper_level": paper["significance"],
            }
            named = {
                "metric": spec.name,
                "comparison": comparison,
                "pooled_interval": interval(test["pooled_ci_low"], test["pooled_ci_high"]),
            }
            tests.append(with_agreement(test | named | _effect(test) | beside, is_judged=comparison not in unjudged))
    return tuple(tests)


def _effect(test: Row) -> Row:
    """Return Cohen's d without its sign, as the paper prints it, with its 95 % interval flipped accordingly."""
    if test["cohens_d"] is None or test["d_ci_low"] is None:
        return {"effect": None, "effect_interval": None}
    sign = -1 if test["cohens_d"] < 0 else 1
    return {
        "effect": sign * test["cohens_d"],
        "effect_interval": tuple(sorted((sign * test["d_ci_low"], sign * test["d_ci_high"]))),
    }


def scenarios_of(overall: Iterable[MetricRow], by_scenario: Iterable[MetricRow]) -> tuple[Row, ...]:
    """Return the mean of every metric and architecture, by scenario and over all."""
    means = {(row.metric, row.architecture, row.scenario or "mean"): row.mean for row in (*overall, *by_scenario)}
    return tuple(
        {"metric": spec.name, "architecture": architecture}
        | {name: means.get((spec.name, architecture, name)) for name in (*SCENARIOS, "mean")}
        for spec in published_metrics()
        for architecture in ARCHITECTURES
    )


def rule_of(cells: tuple[Row, ...]) -> tuple[Row, ...]:
    """Return the margin of every metric and, for each cell, the power of the verdict.

    The power is the chance that a model which gives exactly the printed number is found equivalent.
    """
    power = {(row["metric"], row["architecture"]): row["power"] for row in cells}
    return tuple(
        {"metric": spec.name, "margin": verdicts.MARGINS[spec.name]}
        | {name: power[spec.name, name] for name in ARCHITECTURES}
        for spec in published_metrics()
    )


Counts = Mapping[tuple[str, str], tuple[int, int]]
"""Numerator and denominator of each claim and architecture."""


def beside(claims: Iterable[Row]) -> tuple[Row, ...]:
    """Return a row for each number of the paper: its words, ours in both readings, what was counted, and its class.

    `claims` are the rows of `case_claims` for the runs of the report; those of several seeds are added up. Empty if
    none of these runs is of the scenario of a case.
    """
    counts: dict[tuple[str, str], tuple[int, int]] = {}
    for claim in claims:
        if claim["runs"]:
            key = (claim["claim"], claim["architecture"])
            counted, of_how_many = counts.get(key, (0, 0))
            counts[key] = (counted + claim["numerator"], of_how_many + claim["denominator"])
    return tuple(_case_row(cell, counts) for cell in specs.cases()) if counts else ()


def _case_row(cell: specs.CaseCell, counts: Counts) -> Row:
    printed = {(int(row["case"]), row["architecture"].lower()): row["value"] for row in specs.paper_table("cases")}
    counted, of_how_many = counts.get((cell.claim, cell.architecture), (0, 0))
    other, of_others = counts.get((cell.other or "", cell.architecture), (0, 0))
    total = "" if cell.of is None else f" of {printing.integer(counts.get((cell.of, cell.architecture), (0, 0))[0])}"
    return {
        "case": cell.case,
        "architecture": cell.architecture,
        "said": cell.said,
        "paper": printed[cell.case, cell.architecture],
        "value": counted / of_how_many if of_how_many else None,
        "counted": f"{printing.integer(counted)}{total} in {printing.integer(of_how_many)} {cell.unit}"
        if of_how_many
        else None,
        "other": f"{printing.number(other / of_others, 2)} ({printing.integer(other)} in {printing.integer(of_others)})"
        if of_others
        else None,
        "class": cell.kind,
    }
