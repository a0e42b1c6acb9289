"""Draw figures as SVG, PNG or PDF. The same rows give the same bytes: no date, fixed ids, glyphs as paths."""

import io
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import Any
from unicodedata import combining

from fsar_ledger.base import printable
from fsar_ledger.metrics.definitions import Metric, published_metrics
from fsar_ledger.report import specs
from fsar_ledger.report.numbers import OPEN, STANDS, UNDECIDED

Row = Mapping[str, Any]

COLOURS = {"fsar": "#0072B2", "cfc": "#D55E00", "dhma": "#009E73"}  # Okabe and Ito: safe for colour-blind readers
MARKERS = {"fsar": "o", "cfc": "s", "dhma": "^"}  # distinguishable in grey, too
STYLE: dict[str, Any] = {
    "svg.hashsalt": "fsar-ledger",
    "svg.fonttype": "path",
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
}
DIAMOND: dict[str, Any] = {
    "marker": "D",
    "markersize": 5,
    "markerfacecolor": "white",
    "markeredgecolor": "black",
    "markeredgewidth": 0.9,
    "linestyle": "none",
}
COMPARED = {"fsar-cfc": ("o", "#0072B2"), "fsar-dhma": ("s", "#009E73"), "cfc-dhma": ("^", "#D55E00")}
"""Marker and colour of each comparison; in grey the marker tells them apart."""

HEADROOM = 1.1  # height of a panel, as a multiple of its highest value


@contextmanager
def canvas(spec: specs.FigureSpec, rows: int, columns: int, **grid: Any) -> Iterator[tuple[Any, Any]]:
    """Yield a figure of the spec's size and its panels, drawn by Agg with these settings alone.

    `grid` holds matplotlib's ratios of rows and columns.
    """
    with _figure(spec.width_in, spec.height_in, layout="constrained") as figure:
        yield figure, figure.subplots(rows, columns, squeeze=False, **grid)


@contextmanager
def plain_canvas(width_in: float, height_in: float) -> Iterator[tuple[Any, Any]]:
    """Yield a figure and its one panel without axes, in inches from the upper left corner.

    It is drawn by Agg with these settings alone.
    """
    with _figure(width_in, height_in) as figure:
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set_xlim(0, width_in)
        axes.set_ylim(height_in, 0)
        axes.axis("off")
        yield figure, axes


@contextmanager
def _figure(width_in: float, height_in: float, **options: Any) -> Iterator[Any]:
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    settings: dict[Any, Any] = {**mpl.rcParamsDefault, **STYLE, "backend": "agg"}  # not the user's matplotlibrc
    with mpl.rc_context(settings):
        figure = Figure(figsize=(width_in, height_in), **options)
        FigureCanvasAgg(figure)
        yield figure


def label(text: str, most: int) -> str:
    """Return the text as a figure shows it, cut after `most` characters.

    Characters that the font cannot draw, or that a reader would not see, are escaped.
    """
    glyphs = _glyphs()
    return "".join(
        one if ord(one) in glyphs and not combining(one) else one.encode("unicode_escape").decode("ascii")
        for one in printable.value(text, most)
    )


@lru_cache(maxsize=1)
def _glyphs() -> frozenset[int]:
    """Return the characters that the font of the figures can draw."""
    from matplotlib.font_manager import findfont, get_font

    return frozenset(get_font(findfont(STYLE["font.family"])).get_charmap())


def rendered(figure: Any, kind: str = "svg") -> bytes:
    """Return the open figure as a file of this kind (svg, png, pdf), without date or creator."""
    buffer = io.BytesIO()
    if kind == "pdf":
        figure.savefig(buffer, format="pdf", metadata={"CreationDate": None, "Creator": None, "Producer": None})
    elif kind == "svg":
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    else:
        figure.savefig(buffer, format="png", dpi=160, metadata={"Software": None})
    return buffer.getvalue()


def say_no_value(panel: Any, at: float) -> None:
    """Write upright in the place of a bar that there is none."""
    upright = {"rotation": 90, "ha": "center", "va": "bottom", "color": "#777777"}
    panel.annotate("no value", (at, 0), (0, 3), textcoords="offset points", **upright)


def whisker(panel: Any, at: float, low: float, high: float, colour: str = "black", capsize: float = 2) -> None:
    """Draw an interval around its own centre: at a share of 0 rounding may lift a Wilson interval above the mean."""
    look = {"fmt": "none", "ecolor": colour, "elinewidth": 0.9, "capsize": capsize, "zorder": 3}
    panel.errorbar(at, (low + high) / 2, yerr=(high - low) / 2, **look)


def from_zero(panel: Any, highest: float) -> None:
    """Let a panel begin at 0 and leave room above its highest value."""
    panel.set_ylim(0, HEADROOM * highest)
    panel.grid(axis="y", color="#dddddd", linewidth=0.5, zorder=0)
    panel.set_axisbelow(True)


def named_lines(size: float = 4, **look: Any) -> list[Any]:
    """Return a handle of a legend for each architecture."""
    from matplotlib.lines import Line2D

    return [
        Line2D([], [], color=colour, marker=MARKERS[name], markersize=size, label=name.upper(), **look)
        for name, colour in COLOURS.items()
    ]


def legend_below(figure: Any, handles: Sequence[Any], **look: Any) -> None:
    """Draw the legend below the panels, in one row."""
    figure.legend(handles=handles, frameon=False, **{"loc": "outside lower center", "ncols": len(handles), **look})


def _panel(axes: Any, spec: Metric, rows: Sequence[Row]) -> None:
    """Draw one metric: a bar with its 95 % interval for each architecture, the paper's value as a diamond."""
    for position, (architecture, colour) in enumerate(COLOURS.items()):
        found = [row for row in rows if (row["metric"], row["architecture"]) == (spec.name, architecture)]
        for row in found:
            axes.plot(position + 0.27, row["paper"] * spec.factor, zorder=4, **DIAMOND)
            if row["mean"] is None:
                say_no_value(axes, position - 0.08)
                continue
            axes.bar(position - 0.08, row["mean"] * spec.factor, width=0.5, color=colour, alpha=0.75, zorder=2)
            if row["ci_low"] is not None:
                low, high = row["ci_low"] * spec.factor, row["ci_high"] * spec.factor
                whisker(axes, position - 0.08, low, high, capsize=2.5)
    axes.set_title(spec.title)
    axes.set_xticks(range(len(COLOURS)), [name.upper() for name in COLOURS])
    axes.set_xlim(-0.55, len(COLOURS) - 0.35)
    axes.tick_params(axis="x", length=0)
    drawn = [
        row[key]
        for row in rows
        if row["metric"] == spec.name
        for key in ("paper", "mean", "ci_high")
        if row[key] is not None
    ]
    from_zero(axes, spec.factor * max(drawn))


def evaluation_results(rows: Sequence[Row]) -> bytes:
    """Draw the figure "Evaluation results": eight panels, three architectures, the paper's values. Paper: fig:eval.

    Each row holds metric, architecture, mean, ci_low, ci_high (None: no value) and paper, all in stored units.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    with canvas(specs.figure("evaluation-results"), 2, 4) as (figure, axes):
        for panel, spec in zip(axes.flat, published_metrics(), strict=True):
            _panel(panel, spec, rows)
        handles: list[Any] = [
            Patch(color=colour, alpha=0.75, label=f"{name.upper()}, this ledger") for name, colour in COLOURS.items()
        ]
        handles.append(Line2D([], [], color="black", marker="|", markersize=9, linestyle="none", label="95 % interval"))
        handles.append(Line2D([], [], label="printed in the paper", **DIAMOND))
        legend_below(figure, handles, handletextpad=0.5, columnspacing=1.6)
        return rendered(figure)


def _first_less_second(comparison: str) -> str:
    """Write a comparison as a difference: FSAR − CFC."""
    return " − ".join(comparison.upper().split("-"))


def _effect_legend(figure: Any) -> None:
    """Draw the legend below the panel: the comparisons, and the diamond of the paper."""
    from matplotlib.lines import Line2D

    compared = [
        Line2D([], [], marker=marker, color=colour, markersize=4.5, linewidth=1.6, label=_first_less_second(name))
        for name, (marker, colour) in COMPARED.items()
    ]
    handles = [*compared, Line2D([], [], label="printed in the paper", **DIAMOND)]
    legend_below(figure, handles, handletextpad=0.5, columnspacing=1.6)


def effects(rows: Sequence[Row]) -> bytes:
    """Draw "Effect sizes": Cohen's d of each pairwise test with its 95 % interval. Paper: tab:significance.

    The paper's d are drawn with the sign of its t. Each row holds metric, comparison, cohens_d, d_ci_low, d_ci_high
    (None: no effect), paper_d and paper_t.
    """
    with canvas(specs.figure("effects"), 1, 1) as (figure, axes):
        panel = axes[0, 0]
        names = [spec.name for spec in published_metrics()]
        for at in range(1, len(names), 2):
            panel.axhspan(at - 0.5, at + 0.5, color="#f2f2f2", linewidth=0, zorder=0)
        panel.axvline(0, color="#999999", linewidth=0.7, zorder=1)
        for offset, (comparison, (marker, colour)) in zip((-0.27, 0.0, 0.27), COMPARED.items(), strict=True):
            for row in (row for row in rows if row["comparison"] == comparison):
                height = names.index(row["metric"]) + offset
                panel.plot(
                    row["paper_d"] * (1 if row["paper_t"] > 0 else -1),
                    height,
                    zorder=4,
                    **(DIAMOND | {"markerfacecolor": "none"}),
                )
                if row["cohens_d"] is None:
                    continue
                if row["d_ci_low"] is not None:
                    panel.hlines(height, row["d_ci_low"], row["d_ci_high"], color=colour, linewidth=1.6, zorder=2)
                panel.plot(
                    row["cohens_d"], height, marker=marker, markersize=4.5, color=colour, linestyle="none", zorder=3
                )
        numbers = [
            row[key] for row in rows for key in ("cohens_d", "d_ci_low", "d_ci_high", "paper_d") if row[key] is not None
        ]
        reach = 1.25 * max([2.0, *map(abs, numbers)])
        panel.set_xscale("symlog", linthresh=1.0, linscale=1.0)
        panel.set_xlim(-reach, reach)
        ticks = [tick for tick in (-20, -10, -5, -2, -1, -0.5, 0, 0.5, 1, 2, 5, 10, 20) if abs(tick) <= reach]
        panel.set_xticks(ticks, [f"{tick:g}".replace("-", "\u2212") for tick in ticks])
        panel.minorticks_off()
        panel.set_yticks(range(len(names)), [spec.title for spec in published_metrics()])
        panel.set_ylim(len(names) - 0.5, -0.5)
        panel.tick_params(axis="y", length=0)
        panel.set_xlabel("effect in standard deviations, first minus second (linear up to 1, logarithmic beyond)")
        _effect_legend(figure)
        return rendered(figure)


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


def overview_figure(rows: Sequence[Row]) -> bytes:
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
    with canvas(specs.figure("overview"), 1, len(shown), sharey=True) as (figure, axes):
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
            handles=_overview_legend(),
            loc="outside lower center",
            ncols=7,
            frameon=False,
            handletextpad=0.4,
            columnspacing=1.3,
        )
        return rendered(figure)


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
    colour = COLOURS[row["architecture"]]
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


def _overview_legend() -> list[Any]:
    from matplotlib.lines import Line2D

    names = named_lines(4.4, linestyle="none")
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
