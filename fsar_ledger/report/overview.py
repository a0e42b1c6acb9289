"""The figure of the first page: every printed number that has a margin, at its distance from ours. Same rows, same bytes."""

from collections.abc import Sequence
from typing import Any

from fsar_ledger.report import figures, specs
from fsar_ledger.report.curves import MARKERS
from fsar_ledger.report.findings import Row
from fsar_ledger.report.numbers import OPEN, STANDS, UNDECIDED

PANELS: dict[str, tuple[str, ...]] = {"Evaluation results": ("results",), "Ablation": ("ablation", "ablation_text"), "Scaling": ("scaling",)}
"""The panels, from left to right, and the tables of each."""

REACH = 80.0
"""Margins up to which the axes go; a number farther out stands at the edge."""
TICKS = (-30, -5, -1, 0, 1, 5, 30)
SPREAD = 0.76
"""The part of a metric's line over which its numbers are spread."""


def overview(rows: Sequence[Row], kind: str = "svg") -> bytes:
    """One panel for each table that is there: a point for each number, in margins of its metric, with its 90 % interval, or the range of an open dial.

    Rows: those of `numbers.numbers`.
    """
    shown = {
        title: [row for row in rows if row["table"] in tables and row["distance" if row["outcome"] != OPEN else "reach"] is not None]
        for title, tables in PANELS.items()
    }
    shown = {title: found for title, found in shown.items() if found} or {next(iter(PANELS)): []}
    metrics = [spec.name for spec in specs.metrics()]
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
        axes[0, 0].set_yticks(range(len(metrics)), [spec.short for spec in specs.metrics()])
        axes[0, len(shown) // 2].set_xlabel("(ours − paper) / margin: linear up to 1, logarithmic beyond")
        figure.legend(handles=_legend(), loc="outside lower center", ncols=7, frameon=False, handletextpad=0.4, columnspacing=1.3)
        return figures.rendered(figure, kind)


def _grounds(panel: Any, lines: int) -> None:
    """The band of one margin, and a line between each two metrics."""
    panel.axvspan(-1.0, 1.0, color="#e4e4e4", linewidth=0, zorder=0)
    panel.axvline(0, color="#999999", linewidth=0.6, zorder=1)
    for at in range(1, lines):
        panel.axhline(at - 0.5, color="#cccccc", linewidth=0.5, zorder=1)


def _number(panel: Any, row: Row, height: float) -> None:
    """A point and its interval; what an open dial gives is a range without a point."""
    colour = figures.COLOURS[row["architecture"]]
    if row["reach"] is not None:
        low, high = (max(-REACH, min(REACH, end)) for end in row["reach"])
        if row["outcome"] == OPEN:
            panel.plot([low, high], [height, height], color=colour, linewidth=0.9, linestyle=(0, (2, 1.2)), marker="|", markersize=3.2, zorder=2)
        else:
            panel.plot([low, high], [height, height], color=colour, linewidth=1.1, zorder=2)
    if row["outcome"] != OPEN:
        at = max(-REACH * 0.97, min(REACH * 0.97, row["distance"]))
        panel.plot(at, height, color=colour, zorder=3, **_look(row["outcome"], colour) | {"marker": MARKERS[row["architecture"]]})


def _look(outcome: str, colour: str) -> dict[str, Any]:
    """Filled where the number stands, hollow where it does not, grey where it is undecided: told apart without colour."""
    fill = {STANDS: colour, UNDECIDED: "#bbbbbb"}.get(outcome, "white")
    return {"markersize": 4.4, "markerfacecolor": fill, "markeredgecolor": colour, "markeredgewidth": 0.9, "linestyle": "none"}


def _legend() -> list[Any]:
    from matplotlib.lines import Line2D

    names: list[Any] = [
        Line2D([], [], marker=MARKERS[name], color=colour, markersize=4.4, linestyle="none", label=name.upper()) for name, colour in figures.COLOURS.items()
    ]
    looks = ((STANDS, "stands"), ("does not", "does not"), (UNDECIDED, "undecided"))
    names += [Line2D([], [], label=label, marker="o", **_look(outcome, "#444444")) for outcome, label in looks]
    return [*names, Line2D([], [], color="#444444", linewidth=0.9, linestyle=(0, (2, 1.2)), marker="|", markersize=3.2, label="open: over its dial")]
