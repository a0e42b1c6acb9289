"""Draw the figure of the first page: every printed number that has a margin, at its distance from ours.

The same rows give the same bytes.
"""

import math
from collections.abc import Sequence
from typing import Any

from fsar_ledger.metrics.definitions import published_metrics
from fsar_ledger.report import figures, specs
from fsar_ledger.report.curves import MARKERS
from fsar_ledger.report.findings import Row
from fsar_ledger.report.numbers import OPEN, STANDS, UNDECIDED

PANELS: dict[str, tuple[str, ...]] = {
    "Evaluation results": ("results",),
    "Ablation": ("ablation", "ablation_text"),
    "Scaling": ("scaling",),
}
"""The panels from left to right, and the tables of each."""

REACH = 80.0
"""Margins up to which the axes go; a number farther out is drawn near the edge, with an arrow."""
TICKS = (-30, -5, -1, 0, 1, 5, 30)
INSIDE = 0.8
"""Where on the axis (as a part of it) a number farther out stands, so that its arrow is visible."""
CARETLEFTBASE, CARETRIGHTBASE = 8, 9
"""Matplotlib's arrowheads that stand on the edge and point outwards; naming them would import it."""
SPREAD = 0.76
"""The part of a metric's line over which its numbers are spread."""


def overview(rows: Sequence[Row], kind: str = "svg") -> bytes:
    """Draw a panel for each table that has runs: a point for each number, in margins of its metric.

    Each has its 90 % interval, or the range of an open dial. `rows` are those of `numbers.numbers`.
    """
    shown = {
        title: [
            row
            for row in rows
            if row["table"] in tables and row["distance" if row["outcome"] != OPEN else "reach"] is not None
        ]
        for title, tables in PANELS.items()
    }
    shown = {title: found for title, found in shown.items() if found} or {next(iter(PANELS)): []}
    metrics = [spec.name for spec in published_metrics()]
    with figures.canvas(specs.figure("overview"), 1, len(shown), sharey=True) as (figure, axes):
        for panel, (title, found) in zip(axes.flat, shown.items(), strict=True):
            _grounds(panel, len(metrics))
            for at, metric in enumerate(metrics):
                mine = [row for row in found if row["metric"] == metric]
                for number, row in enumerate(mine):
                    _number(panel, row, at + SPREAD * ((number + 0.5) / len(mine) - 0.5))
            panel.set_title(title)
            panel.set_xscale("symlog", linthresh=1.0, linscale=0.8)
            panel.set_xlim(-REACH, REACH)
            panel.set_xticks(TICKS, [f"{tick:g}".replace("-", "\u2212") for tick in TICKS])
            panel.minorticks_off()
            panel.set_ylim(len(metrics) - 0.5, -0.5)
            panel.tick_params(axis="y", length=0)
        axes[0, 0].set_yticks(range(len(metrics)), [spec.short for spec in published_metrics()])
        axes[0, len(shown) // 2].set_xlabel("(ours − paper) / margin: linear up to 1, logarithmic beyond")
        figure.legend(
            handles=_legend(), loc="outside lower center", ncols=7, frameon=False, handletextpad=0.4, columnspacing=1.3
        )
        return figures.rendered(figure, kind)


def _grounds(panel: Any, lines: int) -> None:
    """Draw the band of one margin, and a line between neighbouring metrics."""
    panel.axvspan(-1.0, 1.0, color="#e4e4e4", linewidth=0, zorder=0)
    panel.axvline(0, color="#999999", linewidth=0.6, zorder=1)
    for at in range(1, lines):
        panel.axhline(at - 0.5, color="#cccccc", linewidth=0.5, zorder=1)


def _number(panel: Any, row: Row, height: float) -> None:
    """Draw a point and its interval; an open dial gives a range without a point.

    An arrow at the edge shows that the number, or its range, goes farther.
    """
    colour = figures.COLOURS[row["architecture"]]
    ends = [*(row["reach"] or ()), *([] if row["outcome"] == OPEN else [row["distance"]])]
    for edge, caret in ((-REACH, CARETLEFTBASE), (REACH, CARETRIGHTBASE)):
        if any(end / edge > 1 for end in ends):
            panel.plot(
                edge, height, color=colour, marker=caret, markersize=3.2, linestyle="none", clip_on=False, zorder=2.5
            )
    if row["reach"] is not None:
        low, high = (max(-REACH, min(REACH, end)) for end in row["reach"])
        if row["outcome"] == OPEN:
            panel.plot(
                [low, high],
                [height, height],
                color=colour,
                linewidth=0.9,
                linestyle=(0, (2, 1.2)),
                marker="|",
                markersize=3.2,
                zorder=2,
            )
        else:
            panel.plot([low, high], [height, height], color=colour, linewidth=1.1, zorder=2)
    if row["outcome"] != OPEN:
        at = row["distance"] if abs(row["distance"]) <= REACH else math.copysign(REACH * INSIDE, row["distance"])
        panel.plot(
            at,
            height,
            color=colour,
            clip_on=False,
            zorder=3,
            **_look(row["outcome"], colour) | {"marker": MARKERS[row["architecture"]]},
        )


def _look(outcome: str, colour: str) -> dict[str, Any]:
    """Return the style: filled if the number stands, hollow if not, grey if undecided; distinct without colour."""
    fill = {STANDS: colour, UNDECIDED: "#bbbbbb"}.get(outcome, "white")
    return {
        "markersize": 4.4,
        "markerfacecolor": fill,
        "markeredgecolor": colour,
        "markeredgewidth": 0.9,
        "linestyle": "none",
    }


def _legend() -> list[Any]:
    from matplotlib.lines import Line2D

    names: list[Any] = [
        Line2D([], [], marker=MARKERS[name], color=colour, markersize=4.4, linestyle="none", label=name.upper())
        for name, colour in figures.COLOURS.items()
    ]
    looks = ((STANDS, "stands"), ("does not", "does not"), (UNDECIDED, "undecided"))
    names += [Line2D([], [], label=label, marker="o", **_look(outcome, "#444444")) for outcome, label in looks]
    return [
        *names,
        Line2D(
            [],
            [],
            color="#444444",
            linewidth=0.9,
            linestyle=(0, (2, 1.2)),
            marker="|",
            markersize=3.2,
            label="open: over its dial",
        ),
    ]
