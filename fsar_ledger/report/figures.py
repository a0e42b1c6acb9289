"""The figures, as SVG, PNG and PDF, with the same bytes for the same rows: no date, fixed ids, glyphs as paths."""

import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import Any
from unicodedata import combining

from fsar_ledger import printable
from fsar_ledger.report import specs

Row = Mapping[str, Any]

COLOURS = {"fsar": "#0072B2", "cfc": "#D55E00", "dhma": "#009E73"}  # Okabe and Ito: told apart by colour-blind readers
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
DIAMOND: dict[str, Any] = {"marker": "D", "markersize": 5, "markerfacecolor": "white", "markeredgecolor": "black", "markeredgewidth": 0.9, "linestyle": "none"}
HEADROOM = 1.1  # height of a panel, as a multiple of its highest value
BAND_SE = 2.0  # the acceptance band of the distance figure, in standard errors


@contextmanager
def canvas(spec: specs.FigureSpec, rows: int, columns: int, **grid: Any) -> Iterator[tuple[Any, Any]]:
    """A figure of the spec's size and its panels, with what matplotlib calls the ratios of rows and columns. Only Agg draws, with these settings."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    settings: dict[Any, Any] = {**mpl.rcParamsDefault, **STYLE, "backend": "agg"}  # not the user's matplotlibrc
    with mpl.rc_context(settings):
        figure = Figure(figsize=(spec.width_in, spec.height_in), layout="constrained")
        FigureCanvasAgg(figure)
        yield figure, figure.subplots(rows, columns, squeeze=False, **grid)


@contextmanager
def plain_canvas(width_in: float, height_in: float) -> Iterator[tuple[Any, Any]]:
    """A figure and its one panel: no axes, one unit is an inch, the origin is at the upper left. Only Agg draws, with these settings and no others."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    settings: dict[Any, Any] = {**mpl.rcParamsDefault, **STYLE, "backend": "agg"}
    with mpl.rc_context(settings):
        figure = Figure(figsize=(width_in, height_in))
        FigureCanvasAgg(figure)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set_xlim(0, width_in)
        axes.set_ylim(height_in, 0)
        axes.axis("off")
        yield figure, axes


def label(text: str, most: int) -> str:
    """The text as a figure shows it, cut after `most` characters: escaped where the font has no picture of a character, or a reader would not see it."""
    glyphs = _glyphs()
    return "".join(one if ord(one) in glyphs and not combining(one) else one.encode("unicode_escape").decode("ascii") for one in printable.value(text, most))


@lru_cache(maxsize=1)
def _glyphs() -> frozenset[int]:
    """The characters that the font of the figures can draw."""
    from matplotlib.font_manager import findfont, get_font

    return frozenset(get_font(findfont(STYLE["font.family"])).get_charmap())


def rendered(figure: Any, kind: str) -> bytes:
    """The figure as a file of this kind (svg, png, pdf), without date or maker. To be called while its canvas is open."""
    buffer = io.BytesIO()
    if kind == "pdf":
        figure.savefig(buffer, format="pdf", metadata={"CreationDate": None, "Creator": None, "Producer": None})
    elif kind == "svg":
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    else:
        figure.savefig(buffer, format="png", dpi=160, metadata={"Software": None})
    return buffer.getvalue()


def _panel(axes: Any, spec: specs.MetricSpec, rows: Sequence[Row]) -> None:
    """One metric: a bar with its 95 % interval for each architecture, the paper's value as a diamond."""
    for position, (architecture, colour) in enumerate(COLOURS.items()):
        found = [row for row in rows if (row["metric"], row["architecture"]) == (spec.name, architecture)]
        for row in found:
            axes.plot(position + 0.27, row["paper"] * spec.scale, zorder=4, **DIAMOND)
            if row["mean"] is None:
                axes.annotate("no value", (position - 0.08, 0), (0, 3), textcoords="offset points", rotation=90, ha="center", va="bottom", color="#777777")
                continue
            axes.bar(position - 0.08, row["mean"] * spec.scale, width=0.5, color=colour, alpha=0.75, zorder=2)
            if row["ci_low"] is not None:
                low, high = row["ci_low"] * spec.scale, row["ci_high"] * spec.scale
                # Around its own middle: at a share of 0 a Wilson interval may begin a rounding error above the mean.
                axes.errorbar(position - 0.08, (low + high) / 2, yerr=(high - low) / 2, fmt="none", ecolor="black", elinewidth=0.9, capsize=2.5, zorder=3)
    axes.set_title(spec.title)
    axes.set_xticks(range(len(COLOURS)), [name.upper() for name in COLOURS])
    axes.set_xlim(-0.55, len(COLOURS) - 0.35)
    axes.tick_params(axis="x", length=0)
    drawn = [row[key] for row in rows if row["metric"] == spec.name for key in ("paper", "mean", "ci_high") if row[key] is not None]
    axes.set_ylim(0, HEADROOM * spec.scale * max(drawn))
    axes.grid(axis="y", color="#dddddd", linewidth=0.5, zorder=0)
    axes.set_axisbelow(True)


def evaluation_results(rows: Sequence[Row], kind: str = "svg") -> bytes:
    """The figure "Evaluation results": eight panels, three architectures, the paper's values marked. Paper: fig:eval.

    Each row holds metric, architecture, mean, ci_low, ci_high (None: no value) and paper, all in stored units.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    with canvas(specs.figure("evaluation-results"), 2, 4) as (figure, axes):
        for panel, spec in zip(axes.flat, specs.metrics(), strict=True):
            _panel(panel, spec, rows)
        handles: list[Any] = [Patch(color=colour, alpha=0.75, label=f"{name.upper()}, this ledger") for name, colour in COLOURS.items()]
        handles.append(Line2D([], [], color="black", marker="|", markersize=9, linestyle="none", label="95 % interval"))
        handles.append(Line2D([], [], label="printed in the paper", **DIAMOND))
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, handletextpad=0.5, columnspacing=1.6)
        return rendered(figure, kind)


def distances(rows: Sequence[Row], kind: str = "svg") -> bytes:
    """The figure "Distance from the paper": each cell's distance in standard errors at n = 100, with the band of two.

    Each row holds metric, architecture and distance_se (None: no value).
    """
    with canvas(specs.figure("distances"), 1, 1) as (figure, axes):
        panel = axes[0, 0]
        names = [spec.name for spec in specs.metrics()]
        panel.axvspan(-BAND_SE, BAND_SE, color="#eeeeee", zorder=0)
        panel.axvline(0, color="#999999", linewidth=0.7, zorder=1)
        for offset, (architecture, colour) in zip((-0.22, 0.0, 0.22), COLOURS.items(), strict=True):
            found = [row for row in rows if row["architecture"] == architecture and row["distance_se"] is not None]
            heights = [names.index(row["metric"]) + offset for row in found]
            values = [row["distance_se"] for row in found]
            panel.hlines(heights, 0, values, color=colour, linewidth=1.0, zorder=2)
            panel.plot(values, heights, marker="o", markersize=4.5, color=colour, linestyle="none", label=architecture.upper(), zorder=3)
        reach = max([3.0, *(abs(row["distance_se"]) * 1.08 for row in rows if row["distance_se"] is not None)])
        panel.set_xlim(-reach, reach)
        panel.set_yticks(range(len(names)), [spec.title for spec in specs.metrics()])
        panel.set_ylim(len(names) - 0.5, -0.5)
        panel.tick_params(axis="y", length=0)
        panel.set_xlabel("(this ledger − paper) / standard error at n = 100")
        panel.legend(loc="upper right", frameon=False, bbox_to_anchor=(1.22, 1.0))
        return rendered(figure, kind)
