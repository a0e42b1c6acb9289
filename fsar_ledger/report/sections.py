"""Make the sections "Ablation" and "Scaling": their tables, figures and the numbers of their sentences."""

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from fsar_ledger.metrics.definitions import metric_named
from fsar_ledger.report import curves, printing, specs
from fsar_ledger.report.findings import ARCHITECTURES, Findings, LedgerHead, Row
from fsar_ledger.report.printing import Table

Sourced = Callable[[str | None], str]
"""Maps the name of a query to the source line of a table."""

Drawer = Callable[[], bytes]
"""Draws a figure as SVG."""


def tables(findings: Findings, sourced: Sourced) -> dict[str, Table]:
    """Return the tables of both sections by name; none for a section that no ledger provides."""
    found: dict[str, Table] = {}
    for name, rows in _rows(findings).items():
        if rows:
            found[name] = printing.table(name, rows, sourced(specs.table(name).query))
    return found


def _rows(findings: Findings) -> dict[str, Sequence[Row]]:
    found: dict[str, Sequence[Row]] = {}
    if (ablation := findings.ablation) is not None:
        by_metric = sorted(ablation.cells, key=lambda row: curves.ABLATED.index(row["metric"]))
        found |= {
            "ablation": by_metric,
            "ablation-text": ablation.text,
            "encounters": ablation.rates if len(ablation.rates) > 1 else (),
        }
    if (scaling := findings.scaling) is not None:
        by_metric = sorted(scaling.cells, key=lambda row: curves.SCALED.index(row["metric"]))
        costs = [row | {"coordination_success": row["completed"]} for row in scaling.costs]
        found |= {"scaling": by_metric, "beyond": _beyond(scaling.curve), "coordination-cost": costs}
    return found


def _beyond(curve: Sequence[Row]) -> list[Row]:
    """Return one row for each fleet beyond the paper's, load and architecture, with a column for each metric."""
    found: dict[tuple[int, int, str], Row] = {}
    for row in curve:
        if row["fleet_size"] > curves.LARGEST:
            key = (row["fleet_size"], row["teams_working"], row["architecture"])
            line = found.setdefault(
                key,
                dict.fromkeys(curves.SCALED)
                | dict(zip(("fleet_size", "teams_working", "architecture"), key, strict=True))
                | {"n": 0},
            )
            line[row["metric"]] = row["mean"]
            line["n"] = max(line["n"], row["n"])
    return [found[key] for key in sorted(found, key=lambda key: (key[0], key[1], ARCHITECTURES.index(key[2])))]


def drawers(findings: Findings) -> dict[str, Drawer]:
    """Return how to draw the figures of both sections, by name; a dial with a single position has no figure."""
    found: dict[str, Drawer] = {}
    if (ablation := findings.ablation) is not None:
        found["ablation"] = partial(curves.ablation, ablation.cells)
        if len(ablation.rates) > 1:
            found["encounters"] = partial(curves.encounters, ablation.curve, _dialled(findings))
    if (scaling := findings.scaling) is not None and scaling.curve:
        found["scaling"] = partial(curves.scaling, scaling.curve, scaling.cells)
        if len({row["teams_working"] for row in scaling.curve if row["fleet_size"] == curves.LARGEST}) > 1:
            found["loads"] = partial(curves.loads, scaling.curve, scaling.cells)
    if scaling is not None and len({row["fleet_size"] for row in scaling.costs}) > 1:
        found["coordination-cost"] = partial(curves.coordination_cost, scaling.costs)
    return found


def _dialled(findings: Findings) -> list[Row]:
    """Return the printed success without a shared registry, over all scenarios and for those that the text names."""
    ablation = findings.ablation
    every = () if ablation is None else (*ablation.cells, *ablation.text)
    return [
        row
        for row in every
        if row["configuration"] == "without-shared-registry" and row["metric"] == "coordination_success"
    ]


def ablation(findings: Findings) -> dict[str, Any] | None:
    """Return the numbers of the sentences on the ablations; None without any.

    They count the answers, say where on the dial the printed numbers lie, and what cannot follow and why.
    """
    found = findings.ablation
    if found is None:
        return None
    meets = []
    for row in _dialled(findings):
        points = curves.points_of(found.curve, "encounter_mean_s", metric=row["metric"], scenario=row["scenario"])
        at = [printing.significant(one, 2) for one in curves.crossings(points, row["paper"])] if len(points) > 1 else []
        meets.append(
            {
                "scenario": (row["scenario"] or "all scenarios").replace("-", " "),
                "paper": row["paper_printed"],
                "at": at,
            }
        )
    proofs = [
        _named(row) | {"because": row["because"]}
        for row in (*found.cells, *found.text)
        if row["class"] == "cannot follow"
    ]
    mean = found.encounter_mean_s
    return {
        **head_words(findings, found.head),
        **_answers((*found.cells, *found.text)),
        "encounter_mean_s": None if mean is None else printing.significant(mean, 2),
        "meets": meets if len(found.rates) > 1 else [],
        "proofs": proofs,
    }


def scaling(findings: Findings) -> dict[str, Any] | None:
    """Return the numbers of the sentences on larger fleets; None without any.

    They count the answers, say where the printed numbers lie between the ends of the load, and which load they need.
    """
    found = findings.scaling
    if found is None:
        return None
    lies = Counter(row["lies"] for row in found.cells if row["lies"] is not None)
    loads = []
    for row in found.cells:
        if row["fleet_size"] == curves.LARGEST and row["metric"] == "authority_conflicts":
            at_size = [one for one in found.curve if one["fleet_size"] == curves.LARGEST]
            points = curves.points_of(at_size, "teams_working", metric=row["metric"], architecture=row["architecture"])
            at = [printing.number(one, 1) for one in curves.crossings(points, row["paper"])] if len(points) > 1 else []
            loads.append({"architecture": row["architecture"].upper(), "paper": row["paper_printed"], "at": at})
    return {
        **head_words(findings, found.head),
        **_answers([row for row in found.cells if row["lies"] is None]),
        "open": sum(lies.values()),
        "between": lies["between"],
        "below": lies["below both"],
        "above": lies["above both"],
        "loads": loads,
        "breaks": breaks(found.costs),
    }


def breaks(costs: Sequence[Row]) -> list[dict[str, Any]]:
    """Return, by architecture, the smallest fleet in which it breaks, or the largest one if it breaks in none."""
    found = []
    for architecture in ARCHITECTURES:
        rows = [row for row in costs if row["architecture"] == architecture and row["completed"] is not None]
        broken = [row for row in rows if curves.is_broken(row)]
        if rows:
            row = min(broken, key=_robots) if broken else max(rows, key=_robots)
            found.append(
                {
                    "architecture": architecture.upper(),
                    "is_broken": bool(broken),
                    "robots": printing.integer(row["fleet_size"]),
                    "completed": printing.number(100 * row["completed"], 0),
                }
            )
    return found


def _robots(row: Row) -> int:
    return int(row["fleet_size"])


def head_words(findings: Findings, head: LedgerHead) -> dict[str, Any]:
    """Return the head of the ledger, and the model of its runs if the results are of another."""
    another = (
        head.model_version
        if findings.model_version is not None and head.model_version != findings.model_version
        else None
    )
    named = {
        "size": printing.integer(head.size),
        "root": head.root,
        "runs": printing.integer(head.run_count),
        "commits": head.commits,
    }
    return {**named, "completeness": head.completeness, "another_model": another and printing.words(another)}


def _answers(rows: Sequence[Row]) -> dict[str, int]:
    given, could = Counter(row["gives"] for row in rows), Counter(row["could"] for row in rows)
    counts = {
        "judged": sum(given.values()) - given[None],
        "drawn": sum(could.values()) - could[None],
        "could": could["yes"],
        "could_not": could["no"],
    }
    return counts | {"gives": given["yes"], "gives_not": given["no"], "undecided": given["undecided"]}


def _named(row: Row) -> dict[str, str]:
    """Describe a cell: its metric, configuration and scenario, and the printed number."""
    where = "" if row["scenario"] is None else f", {row['scenario'].replace('-', ' ')}"
    return {
        "title": f"{metric_named(row['metric']).title}, {printing.configuration(row['configuration'])}{where}",
        "paper": row["paper_printed"],
    }
