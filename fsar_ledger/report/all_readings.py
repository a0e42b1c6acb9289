"""Make the section "Every reading" of the report.

It shows the range of each cell over all readings of the text, which reading moves it most, and whether the ranking
survives.
"""

from collections.abc import Sequence
from typing import Any

from fsar_ledger.metrics import verdicts
from fsar_ledger.metrics.database import Database
from fsar_ledger.metrics.definitions import metric_named, published_metrics
from fsar_ledger.metrics.library import READINGS, library
from fsar_ledger.metrics.multiverse import Chosen, Multiverse, cells, rankings, readings, universes
from fsar_ledger.metrics.progress import Progress
from fsar_ledger.report import printing, specs
from fsar_ledger.report.findings import ARCHITECTURES, Row
from fsar_ledger.report.printing import Table

MAX_SETS = 2
"""How many combinations of readings a cell of a table names; the others are counted."""


def multiverse_of(
    database: Database, setting: Row, *, pools_seeds: bool = False, progress: Progress | None = None
) -> Multiverse | None:
    """Return the multiverse of all metrics for the three architectures, over the runs of this setting.

    None if there are none. Raises: as `Database.rows`.
    """
    better = {spec.name: spec.better for spec in published_metrics()}
    found = [
        one
        for one in universes(database, list(better), pools_seeds=pools_seeds, progress=progress)
        if one.architecture in ARCHITECTURES and all(getattr(one, name) == value for name, value in setting.items())
    ]
    return Multiverse(readings(), tuple(cells(found)), tuple(rankings(found, better)), tuple(found)) if found else None


def queries() -> tuple[str, ...]:
    """Return the packaged queries that replace ours."""
    return tuple(sorted(name for name in library().queries if name.startswith(READINGS)))


def tables(found: Multiverse | None) -> dict[str, Table]:
    """Return the tables of ranges and rankings by name; none without a multiverse."""
    if found is None:
        return {}
    filled = {"every-reading": ranges(found), "rankings": orders(found)}
    return {name: printing.table(name, rows, f"queries/{specs.table(name).query}.sql") for name, rows in filled.items()}


def ranges(found: Multiverse) -> list[Row]:
    """Return a row for each cell: the paper's number, ours, the range of all readings, what moves it most.

    `holds` tells whether the printed number lies in the range, give or take a margin.
    """
    rows = []
    for cell in found.cells:
        margin = verdicts.MARGINS[cell.metric]
        is_held = None
        if cell.paper is not None and cell.lowest is not None and cell.highest is not None:
            is_held = cell.lowest - margin <= cell.paper <= cell.highest + margin
        rows.append(
            {
                name: getattr(cell, name)
                for name in ("metric", "architecture", "paper", "ours", "combinations", "moved_by")
            }
            | {"range": None if cell.lowest is None else (cell.lowest, cell.highest), "holds": is_held}
            | {"most_moving": cell.most_moving and _named(found, cell.most_moving)}
        )
    return rows


def orders(found: Multiverse) -> list[Row]:
    """Return a row for each metric: how the architectures rank under our readings, and how often that survives.

    `same_order` and `fsar_best` count the combinations with the same order, and those with FSAR as the best.
    """
    return [
        {
            "metric": one.metric,
            "order": one.order and one.order.upper(),
            "combinations": one.combinations,
            "same_order": one.same_order,
            "fsar_best": one.fsar_best,
            "not_best_under": _sets(found, one.fsar_not_best_under),
        }
        for one in found.rankings
    ]


def _sets(found: Multiverse, sets: Sequence[Chosen] | None) -> str | None:
    """Name the smallest combinations under which FSAR is not the best, those of fewest readings first."""
    if not sets:
        return None
    named = [
        " with ".join(_named(found, name) for name in one) or "our own readings"
        for one in sorted(sets, key=lambda one: (len(one), one))
    ]
    return "; ".join(named[:MAX_SETS] + ([f"and {len(named) - MAX_SETS} more"] if len(named) > MAX_SETS else []))


def _named(found: Multiverse, name: str) -> str:
    """Name a reading, with the number of the one of ours that it replaces."""
    number = next(one.reading for one in found.readings if one.name == name)
    return f"{name.replace('_', ' ')} ({number})"


def said(found: Multiverse | None) -> dict[str, Any] | None:
    """Return the counts for the sentences of the section.

    They count readings, combinations, the metrics by which FSAR is the best under all, some or none of them, and the
    orders that survive.
    """
    if found is None:
        return None
    judged = [one for one in found.rankings if one.fsar_best is not None]
    ordered = [one for one in found.rankings if one.same_order is not None]
    held = [row["holds"] for row in ranges(found) if row["holds"] is not None]
    always = [one for one in judged if one.fsar_best == one.combinations]
    never = [one for one in judged if one.fsar_best == 0]
    return {
        "readings": len(found.readings),
        "questions": len({one.question for one in found.readings}),
        "combinations": sum(one.combinations for one in found.rankings),
        "judged": len(judged),
        "always": len(always),
        "always_by": ", ".join(_title(one.metric) for one in always),
        "never": len(never),
        "never_by": ", ".join(_title(one.metric) for one in never),
        "sometimes": len(judged) - len(always) - len(never),
        "ordered": len(ordered),
        "same": sum(one.same_order == one.combinations for one in ordered),
        "cells": len(held),
        "held": sum(held),
    }


def _title(metric: str) -> str:
    return metric_named(metric).title.partition(" (")[0].lower()
