"""Draw the results of two studies: `study run sensitivity --svg` and `study run multiverse --svg`."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.metrics.definitions import Metric, published_metrics
from fsar_ledger.metrics.effects import Effect, Sensitivity, reach
from fsar_ledger.metrics.multiverse import Cell, Multiverse, Reading, ReadingNames, Universe
from fsar_ledger.metrics.results import setting_of
from fsar_ledger.report import figures

COLUMNS = 2
CURVE, MARK, GAP = 10.0, 1.0, 2.5
"""Relative heights: of a curve, of one line of marks, and of the space below."""
PLACE = {"left": 0.213, "right": 0.99, "bottom": 0.025, "top": 0.98, "wspace": 0.79, "hspace": 0.04}
"""The position of the panels. A computed layout would differ in its last digits between processes."""
SMALL = 6.5  # points
OURS: dict[str, Any] = {"color": "#999999", "linewidth": 0.8, "linestyle": (0, (3, 2)), "zorder": 1}
PAPER: dict[str, Any] = figures.DIAMOND | {"markersize": 3.5, "markeredgewidth": 0.8, "zorder": 4}

Column = tuple[ReadingNames, dict[str, float]]
"""A combination of readings, and the mean of each architecture under it."""


def curves(found: Multiverse) -> bytes:
    """Draw for each metric the means of the architectures under each combination of readings.

    Marks below each combination show its readings. The runs are those of the first setting, which is that of the
    paper's table if the ledger has it. Combinations are ordered by FSAR's lead.
    """
    chosen = [spec for spec in published_metrics() if any(universe.metric == spec.name for universe in found.universes)]
    pairs = [chosen[index : index + COLUMNS] for index in range(0, len(chosen), COLUMNS)] or [[]]
    moving = {spec.name: [reading for reading in found.readings if spec.name in reading.moves] for spec in chosen}
    ratios = [
        ratio
        for pair in pairs
        for ratio in (CURVE, MARK * max((len(moving[spec.name]) for spec in pair), default=1), GAP)
    ]
    with figures.canvas(7.2, 9.6, len(ratios), COLUMNS, height_ratios=ratios) as (
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
                    axes[3 * row + 1, column],
                    moving[spec.name],
                    columns,
                    max(len(moving[other.name]) for other in pair),
                )
        figure.legend(*_legend(), loc="lower center", ncols=len(figures.COLOURS) + 2, frameon=False)
        return figures.rendered(figure)


def ordered(universes: Sequence[Universe], spec: Metric) -> list[Column]:
    """Return the combinations of the metric's first setting with the means under each, by FSAR's lead.

    The smallest lead comes first; ties are ordered by their readings.
    """
    of_metric = [universe for universe in universes if universe.metric == spec.name]
    setting = setting_of(of_metric[0]) if of_metric else None
    means: dict[ReadingNames, dict[str, float]] = {}
    for universe in of_metric:
        if setting_of(universe) == setting:
            by_architecture = means.setdefault(universe.readings, {})
            if universe.mean is not None and universe.architecture in figures.COLOURS:
                by_architecture[universe.architecture] = universe.mean * spec.factor
    return sorted(means.items(), key=lambda entry: (lead(entry[1], spec.better), len(entry[0]), entry[0]))


def lead(means: dict[str, float], better: str) -> float:
    """Return by how much FSAR is better than the best of the others; 0 where there is nothing to compare."""
    others = [mean for architecture, mean in means.items() if architecture != "fsar"]
    if "fsar" not in means or not others:
        return 0.0
    return means["fsar"] - max(others) if better == "higher" else min(others) - means["fsar"]


def printed(cells: Sequence[Cell], spec: Metric) -> dict[str, float]:
    """Return the paper's number for each architecture; empty if it prints none for the first setting."""
    of_metric = [cell for cell in cells if cell.metric == spec.name]
    setting = setting_of(of_metric[0]) if of_metric else None
    return {
        cell.architecture: cell.paper * spec.factor
        for cell in of_metric
        if cell.architecture is not None and cell.paper is not None and setting_of(cell) == setting
    }


def _curve(panel: Any, spec: Metric, columns: Sequence[Column], paper: Mapping[str, float]) -> None:
    """Draw the means of each architecture, and the paper's on the line of our reading.

    Combinations under which FSAR is the best have a shaded background.
    """
    panel.set_visible(True)
    for (architecture, colour), marker in zip(figures.COLOURS.items(), figures.MARKERS.values(), strict=True):
        points = [(index, means[architecture]) for index, (_, means) in enumerate(columns) if architecture in means]
        panel.plot(
            *zip(*points, strict=True) if points else ([], []),
            marker=marker,
            markersize=2.4,
            linewidth=0.4,
            color=colour,
            zorder=3,
        )
    best = [index for index, (_, means) in enumerate(columns) if lead(means, spec.better) > 0]
    if best:
        panel.axvspan(best[0] - 0.5, best[-1] + 0.5, color=figures.COLOURS["fsar"], alpha=0.08, linewidth=0, zorder=0)
    ours = _frame(panel, columns)
    for architecture, mean in paper.items():
        panel.plot(ours, mean, **PAPER | {"markeredgecolor": figures.COLOURS[architecture]})
    highest = max([*paper.values(), *(mean for _, means in columns for mean in means.values())], default=1.0)
    panel.set_ylim(0, figures.HEADROOM * highest or 1.0)
    panel.tick_params(axis="y", labelsize=6)
    panel.set_title(f"{spec.title}: FSAR best under {len(best)} of {len(columns)}", fontsize=7.5, loc="right")


def _marks(panel: Any, readings: Sequence[Reading], columns: Sequence[Column], lines: int) -> None:
    """Draw one of `lines` lines for each reading, with a mark below each combination that contains it."""
    panel.set_visible(True)
    for height, reading in enumerate(readings):
        positions = [position for position, (names, _) in enumerate(columns) if reading.name in names]
        panel.plot(
            positions,
            [height] * len(positions),
            marker="|",
            markersize=4,
            markeredgewidth=1.1,
            linestyle="none",
            color="#444444",
        )
    _frame(panel, columns)
    panel.set_ylim(lines - 0.4, -0.6)
    panel.set_yticks(
        range(len(readings)),
        [f"{reading.name.replace('_', ' ')} ({reading.reading})" for reading in readings],
        fontsize=SMALL,
    )
    panel.tick_params(axis="y", length=0)
    panel.spines["bottom"].set_visible(False)
    panel.spines["left"].set_visible(False)


def _frame(panel: Any, columns: Sequence[Column]) -> int:
    """Make room for every combination, draw the line of our reading, and return its position."""
    ours = next((position for position, (names, _) in enumerate(columns) if not names), 0)
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


BOUNDS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)  # of a cell of the heat map, in margins
SHOWN_FROM = 0.5  # margins: a factor that moves no cell this far is only counted
MAX_SHOWN = 46  # factors that fit on a page


def heat_map(found: Sensitivity) -> bytes:
    """Draw the heat map of cells and factors: how far the factor moves the cell, in margins; darker is farther.

    A dot marks an effect within chance, a cross an undefined cell.
    """
    factors = [name for name, furthest in reach(found).items() if furthest >= SHOWN_FROM][:MAX_SHOWN] or [
        found.factors[0].name
    ]
    columns = [(spec.name, architecture) for spec in published_metrics() for architecture in PAPER_ARCHITECTURES]
    by_cell = {(effect.factor, effect.metric, effect.architecture): effect for effect in found.effects}
    with figures.canvas(7.4, 1.7 + 0.135 * len(factors), 1, 1) as (figure, axes):
        panel = axes[0, 0]
        _cells(figure, panel, [[by_cell.get((name, *column)) for column in columns] for name in factors])
        panel.set_yticks(range(len(factors)), [figures.label(name, 60) for name in factors], fontsize=6)
        panel.set_xticks(
            range(len(columns)), [architecture.upper() for _, architecture in columns], rotation=90, fontsize=6
        )
        top = panel.secondary_xaxis("top")
        titles = [metric.short for metric in published_metrics()]
        top.set_xticks([3 * number + 1 for number in range(len(titles))], titles, rotation=25, ha="left", fontsize=7)
        for axis in (panel, top):
            axis.tick_params(length=0)
        for number in range(1, len(titles)):
            panel.axvline(3 * number - 0.5, color="black", linewidth=0.5)
        return figures.rendered(figure)


def _cells(figure: Any, panel: Any, rows: Sequence[Sequence[Effect | None]]) -> None:
    """Draw the squares and their scale."""
    import matplotlib as mpl
    from matplotlib.colors import BoundaryNorm

    values = [
        [math.nan if effect is None or effect.mu_star_margins is None else effect.mu_star_margins for effect in row]
        for row in rows
    ]
    colours = mpl.colormaps["Greys"].resampled(len(BOUNDS) + 1)
    image = panel.imshow(
        values,
        aspect="auto",
        cmap=colours,
        norm=BoundaryNorm(BOUNDS, colours.N, extend="both"),
        interpolation="nearest",
    )
    for height, row in enumerate(rows):
        for column, effect in enumerate(row):
            if effect is None or effect.mu_star_margins is None:
                panel.plot(column, height, marker="x", markersize=3, color="black", markeredgewidth=0.5)
            elif effect.mu_star_margins >= BOUNDS[0] and effect.mu_star_margins <= (effect.by_chance_margins or 0.0):
                dark = effect.mu_star_margins >= BOUNDS[3]
                panel.plot(
                    column, height, marker=".", markersize=2.5, color="white" if dark else "black", markeredgewidth=0
                )
    bar = figure.colorbar(image, ax=panel, location="bottom", fraction=0.03, pad=0.02, aspect=50, ticks=BOUNDS)
    bar.ax.set_xticklabels([f"{bound:g}" for bound in BOUNDS], fontsize=6)
    bar.set_label("mean change of the cell over the range of the constant, in margins", fontsize=7)
