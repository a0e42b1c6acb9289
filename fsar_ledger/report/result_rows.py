"""Make the rows of the results: cells, tests, scenarios and margins beside what the paper prints."""

from collections.abc import Collection, Iterable

import msgspec

from fsar_ledger.metrics import verdicts
from fsar_ledger.metrics.definitions import published_metrics
from fsar_ledger.metrics.odds import Cell, Odds
from fsar_ledger.metrics.results import MetricRow, StatisticRow
from fsar_ledger.report import specs
from fsar_ledger.report.findings import ARCHITECTURES, COMPARISONS, SCENARIOS, Row, with_agreement


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
                "interval": _interval(cell),
            }
            cells.append(cell | {"metric": spec.name, "architecture": architecture} | beside | _judged(judged.get(key)))
    return tuple(cells)


def _interval(row: Row, low: str = "ci_low", high: str = "ci_high") -> tuple[float, float] | None:
    """Return the 95 % interval of a row, or None if it has none."""
    return None if row[low] is None or row[high] is None else (row[low], row[high])


def _judged(one: verdicts.Comparison | None) -> Row:
    """Return difference, distance and answers of a cell; all None where the ledger has no value to judge."""
    if one is None or one.ours is None:
        return dict.fromkeys(("difference", "distance", "gives", "power", "share", "could"))
    difference = None if one.low is None or one.high is None else (one.low, one.high)
    return {
        "difference": difference,
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
                "pooled_interval": _interval(test, "pooled_ci_low", "pooled_ci_high"),
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
