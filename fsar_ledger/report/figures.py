"""Draw figures as SVG, PNG or PDF, and the charts of the report from rows: bars, distances and curves.

The same rows give the same bytes: no date, fixed ids, glyphs as paths. The rows determine what is drawn, and in which
unit. Every row names its panel; panels are in the order in which rows name them. Series differ in colour, and also in
marker and line style for grey prints.
"""

import io
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import Any
from unicodedata import combining

from fsar_ledger.base import printable
from fsar_ledger.report import specs
from fsar_ledger.report.judge import FAILS, OPEN, STANDS, UNDECIDED
from fsar_ledger.report.printing import OUTCOMES, Row

COLOURS = {  # Okabe and Ito: safe for colour-blind readers
    "fsar": "#0072B2",
    "cfc": "#D55E00",
    "dhma": "#009E73",
    "jade": "#CC79A7",
    "alliance": "#E69F00",
    "roboos": "#56B4E9",
}
MARKERS = {"fsar": "o", "cfc": "s", "dhma": "^", "jade": "D", "alliance": "v", "roboos": "P"}  # distinct also in grey
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
HEADROOM = 1.1  # height of a panel, as a multiple of its highest value


@contextmanager
def canvas(width_in: float, height_in: float, rows: int, columns: int, **grid: Any) -> Iterator[tuple[Any, Any]]:
    """Yield a figure of this size and its panels, drawn by Agg with only these settings.

    `grid` holds matplotlib's ratios of rows and columns.
    """
    with _figure(width_in, height_in, layout="constrained") as figure:
        yield figure, figure.subplots(rows, columns, squeeze=False, **grid)


@contextmanager
def plain_canvas(width_in: float, height_in: float) -> Iterator[tuple[Any, Any]]:
    """Yield a figure and its one panel without axes, in inches from the upper left corner.

    It is drawn by Agg with only these settings.
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
    """Return the text for a figure, cut after `most` characters.

    Characters that the font cannot draw, or that would be invisible, are escaped.
    """
    glyphs = _glyphs()
    return "".join(
        character
        if ord(character) in glyphs and not combining(character)
        else character.encode("unicode_escape").decode("ascii")
        for character in printable.value(text, most)
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
    """Write upright, in place of a bar, that there is no value."""
    upright = {"rotation": 90, "ha": "center", "va": "bottom", "color": "#777777"}
    panel.annotate("no value", (at, 0), (0, 3), textcoords="offset points", **upright)


def whisker(panel: Any, at: float, low: float, high: float, colour: str = "black") -> None:
    """Draw an interval around its own centre: at a share of 0 rounding may lift a Wilson interval above the mean."""
    look = {"fmt": "none", "ecolor": colour, "elinewidth": 0.9, "capsize": 2, "zorder": 3}
    panel.errorbar(at, (low + high) / 2, yerr=(high - low) / 2, **look)


def from_zero(panel: Any, highest: float) -> None:
    """Start a panel's axis at 0 and leave room above its highest value."""
    panel.set_ylim(0, HEADROOM * highest)
    panel.grid(axis="y", color="#dddddd", linewidth=0.5, zorder=0)
    panel.set_axisbelow(True)


def legend_below(figure: Any, handles: Sequence[Any], **look: Any) -> None:
    """Draw the legend below the panels, in one row."""
    figure.legend(handles=handles, frameon=False, **{"loc": "outside lower center", "ncols": len(handles), **look})


OTHER_COLOURS = ("black", "#0072B2", "#D55E00", "#009E73")
OTHER_MARKERS = ("o", "s", "^", "v")
GUIDE = "#999999"
LINES = {"solid": "-", "dashed": "--", "dotted": ":"}
PALE = "#8fb8d6"


def name_of(series: str) -> str:
    """Return the printed name of a series; architectures have names of their own."""
    return {"roboos": "RoboOS"}.get(series, series.upper()) if series in COLOURS else series


def panels_of(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Return the rows of each panel, in the order in which the rows name the panels."""
    panels: dict[str, list[Row]] = {}
    for row in rows:
        panels.setdefault(row["panel"], []).append(row)
    return panels


def _looks(rows: Sequence[Row]) -> dict[str, tuple[str, str]]:
    """Return the colour and the marker of each series; those of architectures are fixed."""
    names = list(dict.fromkeys(row["series"] for row in rows))
    others = [name for name in names if name not in COLOURS]
    return {
        name: (COLOURS[name], MARKERS[name])
        if name in COLOURS
        else (OTHER_COLOURS[others.index(name) % 4], OTHER_MARKERS[others.index(name) % 4])
        for name in names
    }


def bars(spec: specs.Bars, rows: Sequence[Row]) -> bytes:
    """Draw a bar with its 95 % interval for each category, the paper's value as a diamond beside it.

    Each row holds panel, category, series, value, low, high, paper and is_hatched; None: no value, or no interval. The
    series `pale` is a lighter shade of the first.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    colours = {name: colour for name, (colour, _) in _looks(rows).items()} | {"pale": PALE, "dark": COLOURS["fsar"]}
    with canvas(spec.width_in, spec.height_in, *spec.panels) as (figure, axes):
        for panel, (title, panel_rows) in zip(axes.flat, panels_of(rows).items(), strict=False):
            for index, row in enumerate(panel_rows):
                panel.plot(index + 0.3, row["paper"], zorder=4, **DIAMOND)
                if row["value"] is None:
                    say_no_value(panel, index - 0.08)
                    continue
                look = {
                    "hatch": "///" if row["is_hatched"] else None,
                    "edgecolor": "white",
                    "linewidth": 0,
                    "zorder": 2,
                }
                panel.bar(index - 0.08, row["value"], width=0.52, color=colours[row["series"]], **look)
                if row["low"] is not None:
                    whisker(panel, index - 0.08, row["low"], row["high"])
            _categories(panel, title, [row["category"] for row in panel_rows])
            from_zero(
                panel, max(row[key] for row in panel_rows for key in ("paper", "value", "high") if row[key] is not None)
            )
        handles: list[Any] = [
            Patch(color=colours[name], label=f"{name_of(name)}, this ledger")
            for name in colours
            if spec.legend and name in COLOURS
        ]
        handles.append(Line2D([], [], color="black", marker="|", markersize=9, linestyle="none", label="95 % interval"))
        handles.append(Line2D([], [], label="printed in the paper", **DIAMOND))
        legend_below(figure, handles, handletextpad=0.5, columnspacing=1.6)
        return rendered(figure)


def _categories(panel: Any, title: str, names: Sequence[str]) -> None:
    is_long = any(len(name) > 6 for name in names)
    rotation: dict[str, Any] = {"rotation": 30, "ha": "right", "rotation_mode": "anchor"} if is_long else {}
    panel.set_title(title)
    panel.set_xticks(range(len(names)), names, **rotation)
    panel.tick_params(axis="x", length=0)
    panel.set_xlim(-0.6, len(names) - 0.4)


def curve(spec: specs.Curve, rows: Sequence[Row]) -> bytes:
    """Draw a line for each series and style, with its 95 % intervals, and the paper's points as diamonds.

    Each row holds panel, series, style (solid, dashed, dotted, or paper for a diamond), x, y, low, high and is_hollow;
    None: no interval. The series `guide` is a grey line without points.
    """
    looks = _looks([row for row in rows if row["series"] != "guide"]) | {"guide": (GUIDE, "")}
    with canvas(spec.width_in, spec.height_in, *spec.panels) as (figure, axes):
        panels = panels_of(rows)
        for panel, (title, panel_rows) in zip(axes.flat, panels.items(), strict=False):
            ticks = sorted({row["x"] for row in panel_rows if row["style"] != "paper"})
            if spec.shaded_from is not None and ticks and ticks[-1] > spec.shaded_from:
                panel.axvspan(spec.shaded_from * 1.19, ticks[-1] * 1.19, color="#eeeeee", zorder=0)
            for (series, style), points in _lines(panel_rows).items():
                _line(panel, points, style, *looks[series])
            _axes(panel, spec, ticks)
            if len(panels) > 1:
                panel.set_title(title)
        for panel in list(axes.flat)[len(panels) :]:
            panel.set_visible(False)
        legend_below(figure, _curve_legend(spec, looks, rows), columnspacing=1.2, handletextpad=0.5)
        return rendered(figure)


def _lines(rows: Sequence[Row]) -> dict[tuple[str, str], list[Row]]:
    lines: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        if row["y"] is not None:
            lines.setdefault((row["series"], row["style"]), []).append(row)
    return lines


def _line(panel: Any, points: Sequence[Row], style: str, colour: str, marker: str) -> None:
    if style == "paper":
        for row in points:
            panel.plot(row["x"], row["y"], zorder=5, **DIAMOND | {"markeredgecolor": colour})
        return
    x, y = ([row[name] for row in points] for name in ("x", "y"))
    panel.plot(x, y, color=colour, linestyle=LINES[style], linewidth=1.2 if marker else 0.9, zorder=3 if marker else 1)
    for row in points if marker else ():
        face = "white" if row["is_hollow"] else colour
        panel.plot(row["x"], row["y"], color=colour, marker=marker, markersize=3.5, markerfacecolor=face, zorder=3)
        if row["low"] is not None:
            whisker(panel, row["x"], row["low"], row["high"], colour)


def _axes(panel: Any, spec: specs.Curve, ticks: Sequence[float]) -> None:
    if spec.x_scale:
        panel.set_xscale("log", base=spec.x_scale)
    if spec.y_scale:
        panel.set_yscale("log", base=spec.y_scale)
    else:
        panel.set_ylim(bottom=0)
    panel.set_xticks(ticks, [f"{tick:,g}" for tick in ticks])
    panel.minorticks_off()
    panel.set_xlabel(spec.x_label)
    panel.set_ylabel(spec.y_label)
    panel.grid(axis="y", color="#dddddd", linewidth=0.5, zorder=0)


def _curve_legend(spec: specs.Curve, looks: Mapping[str, tuple[str, str]], rows: Sequence[Row]) -> list[Any]:
    """Return the handles of the legend: the series, the styles, the hollow points and the paper's."""
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=colour, marker=marker, markersize=4, label=name_of(name))
        for name, (colour, marker) in looks.items()
        if marker
    ]
    for style, label in spec.styles.items():
        is_guide = any((row["series"], row["style"]) == ("guide", style) for row in rows)
        handles.append(Line2D([], [], color=GUIDE if is_guide else "black", ls=LINES[style], label=label))
    if spec.hollow is not None:
        hollow: dict[str, Any] = {"marker": "o", "markersize": 4, "markerfacecolor": "white", "linestyle": "none"}
        handles.append(Line2D([], [], color="black", label=spec.hollow, **hollow))
    if any(row["style"] == "paper" for row in rows):
        handles.append(Line2D([], [], label="printed in the paper", **DIAMOND))
    return handles


REACH = 80.0
"""Ends of the axes in margins; a number farther out is drawn near the edge, with an arrow."""
TICKS = (-30, -5, -1, 0, 1, 5, 30)
INSIDE = 0.8
"""Position of a number farther out, as a part of the axis, so that its arrow is visible."""
CARETLEFTBASE, CARETRIGHTBASE = 8, 9
"""Matplotlib's arrowheads on the edge that point outwards; using their names would import it."""
SPREAD = 0.76
"""The part of a line's height over which its numbers are spread."""
DIAL: dict[str, Any] = {"linewidth": 0.9, "linestyle": (0, (2, 1.2)), "marker": "|", "markersize": 3.2}


def distances(spec: specs.Bars, rows: Sequence[Row]) -> bytes:
    """Draw a panel for each table and a line for each metric: a point for each number at its distance, in margins.

    Each row holds panel, line, series, outcome, distance and reach (low, high): its 90 % interval, or the range of an
    open dial, which has no distance.
    """
    lines = list(dict.fromkeys(row["line"] for row in rows))
    panels = panels_of(rows)
    with canvas(spec.width_in, spec.height_in, 1, max(len(panels), 1), sharey=True) as (figure, axes):
        for panel, (title, panel_rows) in zip(axes.flat, panels.items(), strict=False):
            panel.axvspan(-1.0, 1.0, color="#e4e4e4", linewidth=0, zorder=0)
            panel.axvline(0, color="#999999", linewidth=0.6, zorder=1)
            for index, line in enumerate(lines):
                panel.axhline(index + 0.5, color="#cccccc", linewidth=0.5, zorder=1)
                line_rows = [row for row in panel_rows if row["line"] == line]
                for number, row in enumerate(line_rows):
                    _number(panel, row, index + SPREAD * ((number + 0.5) / len(line_rows) - 0.5))
            panel.set_title(title)
            panel.set_xscale("symlog", linthresh=1.0, linscale=0.8)
            panel.set_xlim(-REACH, REACH)
            panel.set_xticks(TICKS, [f"{tick:g}".replace("-", "\u2212") for tick in TICKS])
            panel.minorticks_off()
            panel.set_ylim(len(lines) - 0.5, -0.5)
            panel.tick_params(axis="y", length=0)
        axes[0, 0].set_yticks(range(len(lines)), lines)
        axes[0, len(panels) // 2].set_xlabel("(ours − paper) / margin: linear up to 1, logarithmic beyond")
        legend_below(
            figure,
            _distance_legend([name for name in COLOURS if any(row["series"] == name for row in rows)]),
            handletextpad=0.4,
            columnspacing=1.3,
        )
        return rendered(figure)


def _number(panel: Any, row: Row, height: float) -> None:
    """Draw a point and its interval; an open dial gives a range without a point; an arrow marks what lies farther."""
    colour, is_open = COLOURS[row["series"]], row["outcome"] == OPEN
    ends = [*(row["reach"] or ()), *([] if is_open else [row["distance"]])]
    for edge, caret in ((-REACH, CARETLEFTBASE), (REACH, CARETRIGHTBASE)):
        if any(end / edge > 1 for end in ends):
            look = {"marker": caret, "markersize": 3.2, "linestyle": "none", "clip_on": False, "zorder": 2.5}
            panel.plot(edge, height, color=colour, **look)
    if row["reach"] is not None:
        span = [max(-REACH, min(REACH, end)) for end in row["reach"]]
        panel.plot(span, [height, height], color=colour, zorder=2, **DIAL if is_open else {"linewidth": 1.1})
    if not is_open:
        is_far = abs(row["distance"]) > REACH
        position = math.copysign(REACH * INSIDE, row["distance"]) if is_far else row["distance"]
        look = _look(row["outcome"], colour) | {"marker": MARKERS[row["series"]]}
        panel.plot(position, height, color=colour, clip_on=False, zorder=3, **look)


def _look(outcome: str, colour: str) -> dict[str, Any]:
    """Return the style: filled if the number stands, hollow if not, grey if undecided; distinct without colour."""
    fill = {STANDS: colour, UNDECIDED: "#bbbbbb"}.get(outcome, "white")
    edge = {"markerfacecolor": fill, "markeredgecolor": colour, "markeredgewidth": 0.9}
    return {"markersize": 4.4, "linestyle": "none", **edge}


def _distance_legend(series: Sequence[str]) -> list[Any]:
    from matplotlib.lines import Line2D

    names = [
        Line2D([], [], color=COLOURS[name], marker=MARKERS[name], markersize=4.4, linestyle="none", label=name_of(name))
        for name in series
    ]
    outcomes = [
        Line2D([], [], label=OUTCOMES[outcome], marker="o", **_look(outcome, "#444444"))
        for outcome in (STANDS, FAILS, UNDECIDED)
    ]
    return [*names, *outcomes, Line2D([], [], color="#444444", label="open: over its dial", **DIAL)]
