"""Draw why an event happened: the events that it rests on, in order of time, joined by arcs."""

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

from fsar_ledger.analysis.records import Line
from fsar_ledger.analysis.why import DecisionTrace
from fsar_ledger.base import printable
from fsar_ledger.report import figures

FONT = 7.5  # points
ROW, LINE_HEIGHT = 0.2, 0.135  # inches
ARCS, TIME, SEQ = 1.5, 0.75, 0.45  # widths of the columns for arcs, times and seqs, in inches
WORDS, READ = 4.6, 3.6  # widths of the texts, in inches
LETTERS = 82, 62  # characters of a line of each text
MAX_EVENTS, MAX_TEXT = 60, 300
TRIGGER, READS, QUIET, ROOT = "#1f4e79", "#b07a2a", "#666666", "#f3e6f0"
TEXT: dict[str, Any] = {"fontsize": FONT, "parse_math": False, "va": "top", "linespacing": 1.1}


def figure(seq: int, made: Sequence[DecisionTrace], lines: Mapping[int, Line], kind: str = "svg") -> bytes:
    """Draw the event with this seq and what it rests on, as SVG or PDF. The same answer gives the same bytes.

    Blue arcs lead from a trigger to what it triggered, brown ones from an event to a decision that read what it wrote.
    Beside each event stands what the decision in question read of it.
    """
    links = _links(seq, made)
    named = sorted({seq, *(end for link in links for end in link[:2])})
    shown = named[-MAX_EVENTS:]
    said = _said(made)
    texts = {one: _wrapped(_words(lines[one]), LETTERS[0]) for one in shown}
    notes = {one: _wrapped(said.get(one, ""), LETTERS[1]) for one in shown}
    tops, top = {}, 0.15 + ROW
    for one in shown:
        tops[one] = top
        top += ROW + LINE_HEIGHT * (max(len(texts[one]), len(notes[one]), 1) - 1)
    width = ARCS + TIME + SEQ + WORDS + READ
    with figures.plain_canvas(width, top + 0.1) as (canvas, axes):
        left_out = f"; {len(named) - len(shown):,} earlier events are not drawn" if len(shown) < len(named) else ""
        axes.text(ARCS, 0.08, f"blue: triggered; brown: wrote what was read{left_out}", color=QUIET, **TEXT)
        for one in shown:
            _event(axes, lines[one], tops[one], texts[one], notes[one], is_asked=one == seq)
        for cause, effect, is_trigger in links:
            if cause in tops:
                _arc(axes, tops[cause], tops[effect], top, TRIGGER if is_trigger else READS)
        return figures.rendered(canvas, kind)


def _links(seq: int, made: Sequence[DecisionTrace]) -> list[tuple[int, int, bool]]:
    """Return each pair of an event and what rests on it, and whether it triggered it; the asked one for its batch."""
    links = []
    for one in made:
        effect = seq if one is made[0] else one.seq
        links += [(cause, effect, cause == one.triggered_by) for cause in one.rests_on]
    return links


def _said(made: Sequence[DecisionTrace]) -> dict[int, str]:
    """Return by event what the decision in question read of it."""
    found: dict[int, dict[str, dict[str, None]]] = {}
    for read in (*made[0].scheduled_reads, *made[0].reads):
        for seq in (read.written_by, *read.elements):
            if seq is not None:
                found.setdefault(seq, {}).setdefault(read.place, {})[read.name] = None
    return {
        seq: "read: " + "; ".join(f"{place}: {printable.some(names)}" for place, names in places.items())
        for seq, places in found.items()
    }


def _words(line: Line) -> str:
    return f"{line.action_id}  {line.text}" if line.action_id else line.text


def _wrapped(text: str, letters: int) -> list[str]:
    return textwrap.wrap(figures.label(text, MAX_TEXT), letters)


def _event(axes: Any, line: Line, top: float, words: Sequence[str], read: Sequence[str], *, is_asked: bool) -> None:
    if is_asked:
        from matplotlib.patches import Rectangle

        tall = ROW + LINE_HEIGHT * (max(len(words), len(read)) - 1)
        axes.add_patch(Rectangle((ARCS, top - 0.04), TIME + SEQ + WORDS + READ, tall, facecolor=ROOT, zorder=0))
    left = ARCS + TIME
    axes.text(left, top, f"{line.time_s:.3f} s", ha="right", color=QUIET, **TEXT)
    axes.text(left + SEQ, top, f"{line.seq}", ha="right", color=QUIET, **TEXT)
    left += SEQ + 0.1
    axes.text(left, top, "\n".join(words), weight="bold" if is_asked else "normal", **TEXT)
    axes.text(left + WORDS, top, "\n".join(read), color=READS, **TEXT)


def _arc(axes: Any, above: float, below: float, height: float, colour: str) -> None:
    """Draw an arc at the left from one row down to another, the wider the longer it is."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    start, end = above + ROW / 3, below + ROW / 3
    reach = ARCS - 0.08 - (0.25 + (ARCS - 0.45) * (end - start) / height)
    points = [(ARCS - 0.05, start), (reach, start), (reach, end), (ARCS - 0.05, end)]
    codes = [Path.MOVETO, Path.CURVE4, Path.CURVE4, Path.CURVE4]
    axes.add_patch(PathPatch(Path(points, codes), facecolor="none", edgecolor=colour, linewidth=0.8, alpha=0.8))
    axes.plot([ARCS - 0.05], [end], marker=">", markersize=3, color=colour)
