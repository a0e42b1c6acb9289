"""Make the section "Every reading" of the report: its tables, its sentences and the specification curves.

The tables show the range of each cell over all readings of the text, which reading moves it most, and whether the
ranking survives.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from fsar_ledger.base.progress import Progress
from fsar_ledger.metrics import verdicts
from fsar_ledger.metrics.database import Database
from fsar_ledger.metrics.definitions import Metric, metric_named, published_metrics
from fsar_ledger.metrics.library import READINGS, library
from fsar_ledger.metrics.multiverse import (
    Cell,
    Multiverse,
    Reading,
    ReadingNames,
    Universe,
    cells,
    rankings,
    readings,
    universes,
)
from fsar_ledger.metrics.results import CONDITIONS
from fsar_ledger.report import figures, printing, specs
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


def _sets(found: Multiverse, sets: Sequence[ReadingNames] | None) -> str | None:
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


COLUMNS = 2
CURVE, MARK, GAP = 10.0, 1.0, 2.5
"""Heights in parts of a panel: of a curve, of one line of marks, and of the space below."""
PLACE = {"left": 0.213, "right": 0.99, "bottom": 0.025, "top": 0.98, "wspace": 0.79, "hspace": 0.04}
"""Where the panels stand. A computed layout would differ in its last digits from process to process."""
SMALL = 6.5  # points
OURS: dict[str, Any] = {"color": "#999999", "linewidth": 0.8, "linestyle": (0, (3, 2)), "zorder": 1}
PAPER: dict[str, Any] = figures.DIAMOND | {"markersize": 3.5, "markeredgewidth": 0.8, "zorder": 4}

Column = tuple[ReadingNames, dict[str, float]]
"""A combination of readings, and the mean of each architecture under it."""


def curves(found: Multiverse, kind: str = "svg") -> bytes:
    """Draw for each metric the means of the architectures under each combination of readings.

    Marks below each combination show its readings. The runs are those of the first setting, which is that of the
    paper's table where the ledger has it. Combinations are ordered by FSAR's lead.
    """
    chosen = [spec for spec in published_metrics() if any(one.metric == spec.name for one in found.universes)]
    pairs = [chosen[at : at + COLUMNS] for at in range(0, len(chosen), COLUMNS)] or [[]]
    moving = {spec.name: [one for one in found.readings if spec.name in one.moves] for spec in chosen}
    ratios = [
        ratio
        for pair in pairs
        for ratio in (CURVE, MARK * max((len(moving[spec.name]) for spec in pair), default=1), GAP)
    ]
    with figures.canvas(specs.figure("specification-curves"), len(ratios), COLUMNS, height_ratios=ratios) as (
        figure,
        axes,
    ):
        figure.set_layout_engine(None)
        figure.subplots_adjust(**PLACE)
        for panel in axes.flat:
            panel.set_visible(False)
        for row, pair in enumerate(pairs):
            for column, spec in enumerate(pair):
                columns = ordered(found.universes, spec)
                _curve(axes[3 * row, column], spec, columns, printed(found.cells, spec))
                _marks(
                    axes[3 * row + 1, column], moving[spec.name], columns, max(len(moving[one.name]) for one in pair)
                )
        figure.legend(*_legend(), loc="lower center", ncols=len(figures.COLOURS) + 2, frameon=False)
        return figures.rendered(figure, kind)


def ordered(universes: Sequence[Universe], spec: Metric) -> list[Column]:
    """Return the combinations of the metric's first setting with the means under each, by FSAR's lead.

    The smallest lead comes first; ties are ordered by their readings.
    """
    mine = [one for one in universes if one.metric == spec.name]
    place = [getattr(mine[0], name) for name in CONDITIONS] if mine else []
    means: dict[ReadingNames, dict[str, float]] = {}
    for one in mine:
        if [getattr(one, name) for name in CONDITIONS] == place:
            found = means.setdefault(one.readings, {})
            if one.mean is not None and one.architecture in figures.COLOURS:
                found[one.architecture] = one.mean * spec.factor
    return sorted(means.items(), key=lambda each: (lead(each[1], spec.better), len(each[0]), each[0]))


def lead(means: dict[str, float], better: str) -> float:
    """Return by how much FSAR is better than the better of the others; 0 where there is nothing to compare."""
    others = [mean for architecture, mean in means.items() if architecture != "fsar"]
    if "fsar" not in means or not others:
        return 0.0
    return means["fsar"] - max(others) if better == "higher" else min(others) - means["fsar"]


def printed(cells: Sequence[Cell], spec: Metric) -> dict[str, float]:
    """Return what the paper prints for each architecture; empty if it prints nothing for the first setting."""
    mine = [one for one in cells if one.metric == spec.name]
    place = [getattr(mine[0], name) for name in CONDITIONS] if mine else []
    return {
        one.architecture: one.paper * spec.factor
        for one in mine
        if one.architecture is not None
        and one.paper is not None
        and [getattr(one, name) for name in CONDITIONS] == place
    }


def _curve(panel: Any, spec: Metric, columns: Sequence[Column], paper: Mapping[str, float]) -> None:
    """Draw the means of each architecture, and the paper's on the line of our reading.

    Combinations under which FSAR is the best have a shaded ground.
    """
    panel.set_visible(True)
    for (architecture, colour), marker in zip(figures.COLOURS.items(), figures.MARKERS.values(), strict=True):
        points = [(at, means[architecture]) for at, (_, means) in enumerate(columns) if architecture in means]
        panel.plot(
            *zip(*points, strict=True) if points else ([], []),
            marker=marker,
            markersize=2.4,
            linewidth=0.4,
            color=colour,
            zorder=3,
        )
    best = [at for at, (_, means) in enumerate(columns) if lead(means, spec.better) > 0]
    if best:
        panel.axvspan(best[0] - 0.5, best[-1] + 0.5, color=figures.COLOURS["fsar"], alpha=0.08, linewidth=0, zorder=0)
    at = _frame(panel, columns)
    for architecture, mean in paper.items():
        panel.plot(at, mean, **PAPER | {"markeredgecolor": figures.COLOURS[architecture]})
    highest = max([*paper.values(), *(mean for _, means in columns for mean in means.values())], default=1.0)
    panel.set_ylim(0, figures.HEADROOM * highest or 1.0)
    panel.tick_params(axis="y", labelsize=6)
    panel.set_title(f"{spec.title}: FSAR best under {len(best)} of {len(columns)}", fontsize=7.5, loc="right")


def _marks(panel: Any, readings: Sequence[Reading], columns: Sequence[Column], lines: int) -> None:
    """Draw one of `lines` lines for each reading, with a mark below each combination that contains it."""
    panel.set_visible(True)
    for height, reading in enumerate(readings):
        places = [at for at, (names, _) in enumerate(columns) if reading.name in names]
        panel.plot(
            places,
            [height] * len(places),
            marker="|",
            markersize=4,
            markeredgewidth=1.1,
            linestyle="none",
            color="#444444",
        )
    _frame(panel, columns)
    panel.set_ylim(lines - 0.4, -0.6)
    panel.set_yticks(
        range(len(readings)), [f"{one.name.replace('_', ' ')} ({one.reading})" for one in readings], fontsize=SMALL
    )
    panel.tick_params(axis="y", length=0)
    panel.spines["bottom"].set_visible(False)
    panel.spines["left"].set_visible(False)


def _frame(panel: Any, columns: Sequence[Column]) -> int:
    """Make room for every combination, draw the line of our reading, and return its position."""
    ours = next((at for at, (names, _) in enumerate(columns) if not names), 0)
    panel.axvline(ours, **OURS)
    panel.set_xlim(-0.7, max(len(columns), 1) - 0.3)
    panel.set_xticks([])
    return ours


def _legend() -> tuple[list[Any], list[str]]:
    from matplotlib.lines import Line2D

    drawn = zip(figures.COLOURS.values(), figures.MARKERS.values(), strict=True)
    lines: list[Any] = [
        Line2D([], [], color=colour, marker=marker, markersize=3.5, linewidth=0.6) for colour, marker in drawn
    ]
    return [*lines, Line2D([], [], **OURS), Line2D([], [], **PAPER)], [
        *(name.upper() for name in figures.COLOURS),
        "our reading",
        "printed in the paper",
    ]
