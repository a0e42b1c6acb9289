"""Draw the timeline of a request, of the recovery of a failure, and of what an event rests on.

The same rows give the same bytes.

Texts from a ledger are escaped and cut (`figures.label`), and the number of steps is limited to keep a figure below a
megabyte; the rest is counted. `sequence` draws life lines and messages (`queries/audit/request_timeline.sql`), `ladder`
the levels of recovery (`queries/audit/failure_timeline.sql`), `arcs` events and their links. Lengths are in inches; a
figure grows with its rows.
"""

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import accumulate, groupby
from typing import Any

from fsar_ledger.base import printable
from fsar_ledger.report import figures
from fsar_ledger.report.printing import Row

FONT = 7.5  # points
LETTER = 0.056  # width of a letter of that size in inches, slightly above the mean
LINE = 0.135  # height of a line of text
TIME = 1.2  # left columns, for the times and the positions in the run (seq)
LANE = 1.55  # between two life lines
AGENT_LANE = 1.15  # the same in a figure with many life lines
DEED = 2.4  # the maximum width of a deed's text
HEAD = 0.45
TEXT: dict[str, Any] = {"fontsize": FONT, "parse_math": False}
ARROW: dict[str, Any] = {"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 0}
FILLS = {
    "robot": "#e3f1e3",
    "agent": "#f3e6f0",
    "service": "#e1ebf7",
    "coordinator": "#e1ebf7",
    "supervisor": "#fbe7d3",
}
NOBODY = "not on record"
LEVEL_FILLS = {"local": "#dff0df", "peer": "#fbf6cf", "fleet": "#fbe7c9", "human": "#f7d9d6"}
GOOD, BAD, QUIET = "#2e7d32", "#b23b3b", "#666666"
GOOD_RESULTS = ("success", "resolved", "helped")
MAX_STEPS, MAX_LANES, MAX_LETTERS = 120, 12, 8_000  # a letter takes some 90 bytes of SVG
MAX_NAME, MAX_WORDS, MAX_LINE = 40, 240, 80  # characters of a principal, of a step's text, of a line of it in a box
NAMES = ("sender", "receiver", "decided_by", "level", "to_level")
ROW = 0.2  # the first line of an event that arcs lead to
ARCS, ARC_TIME, ARC_SEQ = 1.5, 0.75, 0.45  # columns for arcs, times and seqs
ARC_WORDS, ARC_READ = 4.6, 3.6  # the texts beside them
ARC_LETTERS = 82, 62  # characters of a line of each text
MAX_EVENTS, MAX_TEXT = 60, 300
TRIGGER, READS, ROOT = "#1f4e79", "#b07a2a", "#f3e6f0"


# See docs/decisions/verdicts-are-not-logged.md. Python only draws.
def drawable(rows: Sequence[Row]) -> tuple[list[dict[str, Any]], str]:
    """Return the steps to draw, with their texts ready for a figure, and a line that counts the others.

    The line is empty if there are no others.
    """
    drawn: list[dict[str, Any]] = []
    characters = 0
    for row in rows[:MAX_STEPS]:
        step = {
            name: figures.label(value, MAX_NAME if name in NAMES else MAX_WORDS) if isinstance(value, str) else value
            for name, value in row.items()
        }
        characters += sum(len(value) for value in step.values() if isinstance(value, str))
        if drawn and characters > MAX_LETTERS:
            break
        drawn.append(step)
    return drawn, f"... and {len(rows) - len(drawn):,} more steps, which are not drawn" if len(drawn) < len(
        rows
    ) else ""


def _in_lanes(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows with all principals beyond the last lane merged into one."""
    names = lanes(rows)
    if len(names) <= MAX_LANES:
        return rows
    others = f"{len(names) - MAX_LANES + 1:,} others"
    lane = {name: name if position < MAX_LANES - 1 else others for position, name in enumerate(names)}
    return [row | {side: lane.get(row[side] or NOBODY, others) for side in ("sender", "receiver")} for row in rows]


def lanes(rows: Sequence[Row]) -> list[str]:
    """Return the principals in order of appearance; one lane stands for all that are not on record."""
    named = [
        row[side] or NOBODY
        for row in rows
        for side in (("sender", "receiver") if row["kind"] == "message" else ("sender",))
    ]
    return list(dict.fromkeys(named))


def sequence(rows: Sequence[Row], kind: str = "svg") -> bytes:
    """Draw the timeline as a sequence diagram. Paper: fig:wf1.

    Each principal has a life line, each message an arrow and each evaluation a box. Each row holds sender, receiver,
    kind, message, note, time_s, seq, is_tied; at least one row.
    """
    with drawn_sequence(rows) as figure:
        return figures.rendered(figure, kind)


@contextmanager
def drawn_sequence(rows: Sequence[Row]) -> Iterator[Any]:
    """Yield the figure of `sequence` with its settings active, to be rendered or measured."""
    drawn, more = drawable(rows)
    rows = _in_lanes(drawn)
    names = lanes(rows)
    step = LANE if len(names) <= 5 else AGENT_LANE
    centre_of = {name: TIME + 0.55 + step * position for position, name in enumerate(names)}
    deeds = (row for row in rows if row["kind"] == "deed")
    ends = [centre_of[row["sender"] or NOBODY] + 0.2 + min(LETTER * len(_words(row)), DEED) for row in deeds]
    width = max(max(centre_of.values()) + step / 2, *ends, 0.0)
    texts = [_lines(row, centre_of) for row in rows]
    heights = [_height(row, lines) for row, lines in zip(rows, texts, strict=True)]
    tops = [HEAD + 0.08 + sum(heights[:position]) for position in range(len(rows))]
    height = HEAD + 0.2 + sum(heights) + (LINE if more else 0)
    with figures.plain_canvas(width, height) as (figure, axes):
        for name, x in centre_of.items():
            axes.plot([x, x], [HEAD, height - 0.05], color="#bbbbbb", linewidth=0.8, zorder=1)
            fill, words = FILLS.get(name.partition("/")[0], "white"), name.replace("/", "\n", 1)
            _box(axes, x, HEAD - 0.2, step - 0.1, 0.34, fill, words, weight="bold")
        previous = None
        for row, lines, top, room in zip(rows, texts, tops, heights, strict=True):
            time = f"{row['time_s']:.3f} s"
            level = top + room - 0.06 if row["kind"] == "message" else top + room / 2
            if time != previous:
                axes.text(0.08, level, time, ha="left", va="center", color=QUIET, **TEXT)
            axes.text(TIME, level, f"{row['seq']}", ha="right", va="center", color=QUIET, **TEXT)
            previous = time
            _step(axes, row, lines, centre_of, top, room)
        if more:
            axes.text(0.08, height - 0.1, more, ha="left", va="center", color=QUIET, **TEXT)
        yield figure


def _words(row: Row) -> str:
    return str(row["message"]) if row["note"] is None else f"{row['message']} ({row['note']})"


def _lines(row: Row, centre_of: Mapping[str, float]) -> list[str]:
    """Wrap the text of the row to its width."""
    if row["kind"] == "evaluation":
        texts = [row["message"], *(row["note"].split("; ") if row["note"] else ())]
        return [part for text in texts for part in (textwrap.wrap(text, MAX_LINE) if len(text) > MAX_LINE else [text])]
    width = (
        abs(centre_of[row["receiver"] or NOBODY] - centre_of[row["sender"] or NOBODY]) - 0.15
        if row["kind"] == "message"
        else DEED
    )
    return textwrap.wrap(_words(row), max(int(width / LETTER), 12))


def _height(row: Row, lines: Sequence[str]) -> float:
    return LINE * len(lines) + (0.2 if row["kind"] == "evaluation" else 0.13)


def _step(axes: Any, row: Row, lines: Sequence[str], centre_of: Mapping[str, float], top: float, room: float) -> None:
    """Draw one message, evaluation or deed."""
    x = centre_of[row["sender"] or NOBODY]
    words = "\n".join(lines)
    style = "--" if not row["is_tied"] else "-"
    paper = {"boxstyle": "square,pad=0.08", "facecolor": "white", "edgecolor": "none"}
    if row["kind"] == "evaluation":
        box = max(map(len, lines)) * LETTER + 0.2
        _box(axes, x, top + room / 2, box, room - 0.08, "#efefef", words)
    elif row["kind"] == "message":
        receiver_x = centre_of[row["receiver"] or NOBODY]
        below = top + room - 0.06
        look = {"color": "#1f4e79", "linewidth": 1.0, "linestyle": style, "mutation_scale": 8}
        axes.annotate("", (receiver_x, below), (x, below), arrowprops=ARROW | look, zorder=3)
        above = {"ha": "center", "va": "bottom", "bbox": paper, "zorder": 2, "linespacing": 1.05}
        axes.text((x + receiver_x) / 2, below - 0.035, words, **above, **TEXT)
    else:
        axes.plot([x], [top + room / 2], marker="o", markersize=3, color="#444444", zorder=3)
        beside = {"ha": "left", "va": "center", "bbox": paper, "zorder": 2, "color": "#333333", "style": "italic"}
        axes.text(x + 0.08, top + room / 2, words, **beside, **TEXT)


def _box(
    axes: Any,
    x: float,
    y: float,
    width: float,
    height: float,
    fill: str,
    words: str,
    *,
    weight: str = "normal",
    style: str = "-",
) -> None:
    from matplotlib.patches import FancyBboxPatch

    edge: dict[str, Any] = {"edgecolor": "#444444", "linewidth": 0.8, "linestyle": style}
    shape: dict[str, Any] = {"boxstyle": "round,pad=0,rounding_size=0.05", "facecolor": fill, "zorder": 4}
    axes.add_patch(FancyBboxPatch((x - width / 2, y - height / 2), width, height, **edge, **shape))
    axes.text(x, y, words, ha="center", va="center", zorder=5, weight=weight, linespacing=1.1, **TEXT)


def rungs(rows: Sequence[Row]) -> list[Row]:
    """Return the rows of a ladder, without resolutions that only repeat the result of the step before."""
    return [
        row
        for previous, row in zip([None, *rows], rows, strict=False)
        if row["what"] != "resolved" or previous is None or previous["result"] not in GOOD_RESULTS
    ]


def ladder(rows: Sequence[Row], kind: str = "svg") -> bytes:
    """Draw the recovery of one action's failures, level below level, with why each level was left. Paper: fig:wf3.

    Each row holds failure, seq, level_number, level, to_level, spent_s, time_s, until_s, what, result, achieved,
    budget_s, decided_by; at least one row.
    """
    with drawn_ladder(rows) as figure:
        return figures.rendered(figure, kind)


@contextmanager
def drawn_ladder(rows: Sequence[Row]) -> Iterator[Any]:
    """Yield the figure of `ladder` with its settings active, to be rendered or measured."""
    rows, more = drawable(rows)
    steps = rungs(rows)
    box, tall, left, middle = 2.9, 0.3, 1.35, 1.35 + 1.45 + 1.45
    width, height = middle + box / 2 + 2.1, 0.15 + (tall + 0.14) * len(steps) + (LINE if more else 0)
    with figures.plain_canvas(width, height) as (figure, axes):
        heights = [0.12 + tall / 2 + (tall + 0.14) * position for position in range(len(steps))]
        for row, y, below in zip(steps, heights, [*heights[1:], None], strict=True):
            is_way = row["to_level"] is not None
            fill = "white" if is_way else LEVEL_FILLS.get(row["level"], "white")
            _box(axes, middle, y, box, tall, fill, _rung(row, rows), style="--" if is_way else "-")
            axes.text(left + 0.3, y, f"{row['time_s']:.3f} s", ha="left", va="center", color=QUIET, **TEXT)
            axes.text(left + 1.35, y, f"{row['seq']}", ha="right", va="center", color=QUIET, **TEXT)
            if row["result"] and not is_way:
                colour = GOOD if row["result"] in GOOD_RESULTS or row["result"].startswith("to ") else BAD
                look = {"ha": "left", "va": "center", "color": colour, "weight": "bold"}
                axes.text(middle + box / 2 + 0.12, y, _outcome(row), **look, **TEXT)
            if below is not None:
                arrow = ARROW | {"color": "#888888", "linewidth": 0.9, "mutation_scale": 7}
                axes.annotate("", (middle, below - tall / 2), (middle, y + tall / 2), arrowprops=arrow, zorder=3)
        _levels(axes, steps, heights, left, tall)
        if more:
            axes.text(0.08, height - 0.1, more, ha="left", va="center", color=QUIET, **TEXT)
        yield figure


def _levels(axes: Any, steps: Sequence[Row], heights: Sequence[float], left: float, tall: float) -> None:
    """Draw the name of each level beside its steps, and how long recovery stayed there."""
    placed = list(zip(steps, heights, strict=True))
    for (failure, number, level), group in groupby(
        placed, key=lambda placed_row: (placed_row[0]["failure"], placed_row[0]["level_number"], placed_row[0]["level"])
    ):
        rows = list(group)
        first, last = rows[0][1] - tall / 2, rows[-1][1] + tall / 2
        axes.plot([left + 0.15, left + 0.15], [first, last], color=figures.COLOURS["cfc"], linewidth=1.4, zorder=2)
        spent = "" if rows[0][0]["spent_s"] is None else f"\n{rows[0][0]['spent_s']:.3f} s"
        which = "" if failure == 1 else f"failure {failure}, "
        axes.text(
            left + 0.05, (first + last) / 2, f"{which}level {number}: {level}{spent}", ha="right", va="center", **TEXT
        )


def _rung(row: Row, rows: Sequence[Row]) -> str:
    """Return who took which step; for leaving a level, why."""
    if row["to_level"] is None:
        return f"{row['decided_by']}: {row['what']}" if row["decided_by"] else str(row["what"])
    mates = [
        other
        for other in rows
        if (other["failure"], other["level"]) == (row["failure"], row["level"]) and other["budget_s"] is not None
    ]
    budget = f" ({printable.number(mates[0]['budget_s'])} s, {len(mates)})" if mates else ""
    return "\n".join(textwrap.wrap(f"{row['result'] or row['what']}{budget}", 52))


def _outcome(row: Row) -> str:
    until = f" at {row['until_s']:.3f} s" if row["result"] in GOOD_RESULTS and row["until_s"] is not None else ""
    achieved = f": {row['achieved']}" if row["achieved"] else ""
    return "\n".join(textwrap.wrap(f"{row['result']}{achieved}{until}", 34))


def arcs(rows: Sequence[Row], links: Sequence[tuple[int, int, bool]], asked: int, kind: str) -> bytes:
    """Draw events in order of time, the last that fit, joined by arcs: what the event `asked` rests on.

    Each row holds seq, time_s, words, and read: what the decision in question read of the event. Each link has a cause,
    its effect, and whether that was triggered (blue) or read what the cause wrote (brown).
    """
    drawn = rows[-MAX_EVENTS:]
    texts = [(_wrapped(row["words"], ARC_LETTERS[0]), _wrapped(row["read"], ARC_LETTERS[1])) for row in drawn]
    heights = [ROW + LINE * (max(len(words), len(read), 1) - 1) for words, read in texts]
    *starts, end = accumulate(heights, initial=0.15 + ROW)
    tops = {row["seq"]: top for row, top in zip(drawn, starts, strict=True)}
    with figures.plain_canvas(ARCS + ARC_TIME + ARC_SEQ + ARC_WORDS + ARC_READ, end + 0.1) as (figure, axes):
        left_out = f"; {len(rows) - len(drawn):,} earlier events are not drawn" if len(drawn) < len(rows) else ""
        legend = f"blue: triggered; brown: wrote what was read{left_out}"
        axes.text(ARCS, 0.08, legend, color=QUIET, va="top", linespacing=1.1, **TEXT)
        for row, (words, read) in zip(drawn, texts, strict=True):
            _event(axes, row, tops[row["seq"]], words, read, is_asked=row["seq"] == asked)
        for cause, effect, is_trigger in links:
            if cause in tops:
                _arc(axes, tops[cause], tops[effect], end, TRIGGER if is_trigger else READS)
        return figures.rendered(figure, kind)


def _wrapped(text: str, letters: int) -> list[str]:
    return textwrap.wrap(figures.label(text, MAX_TEXT), letters)


def _event(axes: Any, row: Row, top: float, words: Sequence[str], read: Sequence[str], *, is_asked: bool) -> None:
    if is_asked:
        from matplotlib.patches import Rectangle

        tall = ROW + LINE * (max(len(words), len(read)) - 1)
        width = ARC_TIME + ARC_SEQ + ARC_WORDS + ARC_READ
        axes.add_patch(Rectangle((ARCS, top - 0.04), width, tall, facecolor=ROOT, zorder=0))
    left, below = ARCS + ARC_TIME, {"va": "top", "linespacing": 1.1, **TEXT}
    axes.text(left, top, f"{row['time_s']:.3f} s", ha="right", color=QUIET, **below)
    axes.text(left + ARC_SEQ, top, f"{row['seq']}", ha="right", color=QUIET, **below)
    left += ARC_SEQ + 0.1
    axes.text(left, top, "\n".join(words), weight="bold" if is_asked else "normal", **below)
    axes.text(left + ARC_WORDS, top, "\n".join(read), color=READS, **below)


def _arc(axes: Any, above: float, below: float, height: float, colour: str) -> None:
    """Draw an arc at the left from one row down to another; longer arcs are wider."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    start, end = above + ROW / 3, below + ROW / 3
    reach = ARCS - 0.08 - (0.25 + (ARCS - 0.45) * (end - start) / height)
    points = [(ARCS - 0.05, start), (reach, start), (reach, end), (ARCS - 0.05, end)]
    codes = [Path.MOVETO, Path.CURVE4, Path.CURVE4, Path.CURVE4]
    axes.add_patch(PathPatch(Path(points, codes), facecolor="none", edgecolor=colour, linewidth=0.8, alpha=0.8))
    axes.plot([ARCS - 0.05], [end], marker=">", markersize=3, color=colour)
