"""Draw the effects that the sensitivity study found: `study run sensitivity --svg`."""

import math
from collections.abc import Sequence
from typing import Any

from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.metrics.definitions import published_metrics
from fsar_ledger.metrics.effects import Effect, Sensitivity, reach
from fsar_ledger.report import figures

BOUNDS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)  # of a cell of the heat map, in margins
SHOWN_FROM = 0.5  # margins: a factor that moves no cell this far is only counted
MAX_SHOWN = 46  # factors that fit on a page


def heat_map(found: Sensitivity) -> bytes:
    """Draw the figure cell x factor: how far the factor moves the cell, in margins; dark is far, also in grey.

    A dot marks an effect within chance, a cross a cell that was undefined.
    """
    shown = [name for name, furthest in reach(found).items() if furthest >= SHOWN_FROM][:MAX_SHOWN] or [
        found.factors[0].name
    ]
    columns = [(spec.name, architecture) for spec in published_metrics() for architecture in PAPER_ARCHITECTURES]
    at = {(effect.factor, effect.metric, effect.architecture): effect for effect in found.effects}
    with figures.canvas(7.4, 1.7 + 0.135 * len(shown), 1, 1) as (figure, axes):
        panel = axes[0, 0]
        _cells(figure, panel, [[at.get((name, *column)) for column in columns] for name in shown])
        panel.set_yticks(range(len(shown)), [figures.label(name, 60) for name in shown], fontsize=6)
        panel.set_xticks(
            range(len(columns)), [architecture.upper() for _, architecture in columns], rotation=90, fontsize=6
        )
        top = panel.secondary_xaxis("top")
        titles = [one.short for one in published_metrics()]
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
        [math.nan if one is None or one.mu_star_margins is None else one.mu_star_margins for one in row] for row in rows
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
        for place, one in enumerate(row):
            if one is None or one.mu_star_margins is None:
                panel.plot(place, height, marker="x", markersize=3, color="black", markeredgewidth=0.5)
            elif one.mu_star_margins >= BOUNDS[0] and one.mu_star_margins <= (one.by_chance_margins or 0.0):
                dark = one.mu_star_margins >= BOUNDS[3]
                panel.plot(
                    place, height, marker=".", markersize=2.5, color="white" if dark else "black", markeredgewidth=0
                )
    bar = figure.colorbar(image, ax=panel, location="bottom", fraction=0.03, pad=0.02, aspect=50, ticks=BOUNDS)
    bar.ax.set_xticklabels([f"{bound:g}" for bound in BOUNDS], fontsize=6)
    bar.set_label("mean change of the cell over the range of the constant, in margins", fontsize=7)
