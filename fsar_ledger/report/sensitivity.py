"""Show the effects that the sensitivity study found."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.parameters import read_parameters
from fsar_ledger.metrics.definitions import published_metrics
from fsar_ledger.metrics.effects import ARCHITECTURES, MADE_BY, Effect, Sensitivity, dozen, reach
from fsar_ledger.metrics.study_results import changed
from fsar_ledger.report import figures, printing, specs

BOUNDS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)  # of a cell of the heat map, in margins
SHOWN_FROM = 0.5  # margins: a factor that moves no cell this far is only counted
MAX_SHOWN = 46  # factors that fit on a page
MAX_NAMED = 5  # differing constants that a message names


class Section(msgspec.Struct, frozen=True):
    """What the report shows: a sentence, the heat map of the effects (SVG) and the table of the dozen."""

    sentence: str
    figure: bytes | None = None
    table: printing.Table | None = None


def section(found: Sensitivity | None, model_version: str | None, parameters: Mapping[str, str]) -> Section:
    """Return what a report about runs of this model says about the effects.

    `parameters` are the constants of these runs by dotted name, as `Findings` has them.
    """
    if found is None:
        return Section(
            f"How much each number depends on each constant was not looked at for this report; {MADE_BY} does it in "
            "most of an hour."
        )
    still = sum(furthest == 0 for furthest in reach(found).values())
    if found.model_version != model_version:
        return Section(f"The effects that were given are not of these runs: {_of_another_model(found, model_version)}.")
    theirs = dict(printing.flat("", read_parameters(found.parameters)))
    differing = [name for name in {**theirs, **parameters} if theirs.get(name) != parameters.get(name)]
    if differing:
        more = f" and {len(differing) - MAX_NAMED} more" if len(differing) > MAX_NAMED else ""
        named = ", ".join(map(printable.value, differing[:MAX_NAMED])) + more
        return Section(
            f"The effects that were given are not of these runs: found effects around other constants ({named}); make "
            f"them again: {MADE_BY}."
        )
    sentence = (
        f"{len(found.factors)} factors, all constants of world and structure, the load and the size of the fleet, were "
        f"each varied {found.trajectories} times, "
        f"over {found.evaluations} evaluations of {found.runs} runs per scenario and architecture; {still} of them "
        "move nothing."
    )
    if later := changed(found.rules):
        sentence += f" They were judged before {printable.some(map(printing.words, later))} changed."
    return Section(sentence, heat_map(found), printing.table("sensitivity", dozen(found)))


def _of_another_model(effects: Sensitivity, expected: str | None) -> str:
    found, wanted = (printable.value(one or "unknown") for one in (effects.model_version, expected))
    return f"found effects of model {found}, expected those of model {wanted}; make them again: {MADE_BY}"


def heat_map(found: Sensitivity) -> bytes:
    """Draw the figure cell x factor: how far the factor moves the cell, in margins; dark is far, also in grey.

    A dot marks an effect within chance, a cross a cell that was undefined.
    """
    shown = [name for name, furthest in reach(found).items() if furthest >= SHOWN_FROM][:MAX_SHOWN] or [
        found.factors[0].name
    ]
    columns = [(spec.name, architecture) for spec in published_metrics() for architecture in ARCHITECTURES]
    at = {(effect.factor, effect.metric, effect.architecture): effect for effect in found.effects}
    spec = msgspec.structs.replace(specs.figure("sensitivity"), height_in=1.7 + 0.135 * len(shown))
    with figures.canvas(spec, 1, 1) as (figure, axes):
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
