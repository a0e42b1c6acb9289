"""Draw figures as SVG, PNG or PDF. The same rows give the same bytes: no date, fixed ids, glyphs as paths."""

import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import Any
from unicodedata import combining

from fsar_ledger.base import printable

Row = Mapping[str, Any]

COLOURS = {  # Okabe and Ito: safe for colour-blind readers
    "fsar": "#0072B2",
    "cfc": "#D55E00",
    "dhma": "#009E73",
    "jade": "#CC79A7",
    "alliance": "#E69F00",
    "roboos": "#56B4E9",
}
MARKERS = {"fsar": "o", "cfc": "s", "dhma": "^", "jade": "D", "alliance": "v", "roboos": "P"}  # also told apart in grey
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
    """Yield a figure of this size and its panels, drawn by Agg with these settings alone.

    `grid` holds matplotlib's ratios of rows and columns.
    """
    with _figure(width_in, height_in, layout="constrained") as figure:
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


def legend_below(figure: Any, handles: Sequence[Any], **look: Any) -> None:
    """Draw the legend below the panels, in one row."""
    figure.legend(handles=handles, frameon=False, **{"loc": "outside lower center", "ncols": len(handles), **look})
