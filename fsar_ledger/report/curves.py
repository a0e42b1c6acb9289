"""Draw the figures of "Ablation" and "Scaling".

They are bars beside the printed numbers, and curves over what the paper leaves open.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from fsar_ledger.metrics.definitions import Metric, metric_named
from fsar_ledger.metrics.paper_numbers import printed
from fsar_ledger.report import printing, specs
from fsar_ledger.report.figures import (
    COLOURS,
    DIAMOND,
    MARKERS,
    Row,
    canvas,
    from_zero,
    legend_below,
    named_lines,
    rendered,
    say_no_value,
    whisker,
)

ABLATED, SCALED = (tuple(dict.fromkeys(place.metric for place in printed(table))) for table in ("ablation", "scaling"))
"""The metrics of the ablation and the scaling table, in their order."""
LETTERS = {
    "full": "full",
    "without-trust-evaluation": "− trust",
    "without-policy-composition": "− policy",
    "without-layered-recovery": "− recovery",
    "without-shared-registry": "− registry",
}
SCENARIO_STYLES = {
    None: ("black", "-", "o"),
    "door-relay": ("#0072B2", "--", "s"),
    "collaborative-delivery": ("#D55E00", ":", "^"),
}
LARGEST = 16
"""Robots of the paper's largest fleet."""
HALF = 0.5
"""An architecture breaks where it completes a smaller share of the tasks within their budget."""
COSTS = {
    "messages": "Messages",
    "decisions": "Decisions",
    "hops": "Hops of decisions",
    "look_ups": "Look-ups",
    "robots_named": "Robots named in answers",
    "checks": "Checks",
}
"""What is counted for each request, and the title of its panel."""


def ablation(rows: Sequence[Row]) -> bytes:
    """Draw "Without one mechanism": six panels, five configurations, the paper's values marked.

    `rows` are the cells of the ablation table.
    """
    from matplotlib.lines import Line2D

    with canvas(specs.figure("ablation"), 2, 3) as (figure, axes):
        for panel, metric in zip(axes.flat, ABLATED, strict=True):
            spec = metric_named(metric)
            found = [row for row in rows if row["metric"] == metric]
            for position, row in enumerate(found):
                panel.plot(position + 0.3, row["paper"] * spec.factor, zorder=4, **DIAMOND)
                if row["mean"] is None:
                    say_no_value(panel, position - 0.08)
                    continue
                colour = COLOURS["fsar"] if row["configuration"] == "full" else "#8fb8d6"
                hatch = "///" if row["class"] in ("unspecified", "cannot follow") else None
                panel.bar(
                    position - 0.08,
                    row["mean"] * spec.factor,
                    width=0.55,
                    color=colour,
                    hatch=hatch,
                    edgecolor="white",
                    linewidth=0,
                    zorder=2,
                )
                _whisker(panel, position - 0.08, row["interval"], spec.factor)
            panel.set_title(spec.title)
            panel.set_xticks(
                range(len(found)),
                [LETTERS[row["configuration"]] for row in found],
                rotation=30,
                ha="right",
                rotation_mode="anchor",
            )
            panel.tick_params(axis="x", length=0)
            panel.set_xlim(-0.6, len(found) - 0.4)
            drawn = [value for row in found for value in (row["paper"], row["mean"] or 0.0, *(row["interval"] or ()))]
            from_zero(panel, max((value * spec.factor for value in drawn), default=1.0))
        handles: list[Any] = [
            Line2D([], [], color="black", marker="|", markersize=9, linestyle="none", label="95 % interval")
        ]
        handles.append(Line2D([], [], label="printed in the paper", **DIAMOND))
        legend_below(figure, handles)
        return rendered(figure)


def encounters(curve: Sequence[Row], printed: Sequence[Row]) -> bytes:
    """Draw "Success without a registry": success over how often robots meet.

    A diamond marks where a curve has the paper's value.
    """
    with canvas(specs.figure("encounters"), 1, 1) as (figure, axes):
        panel = axes[0, 0]
        for scenario, (colour, style, marker) in SCENARIO_STYLES.items():
            points = points_of(curve, "encounter_mean_s", metric="coordination_success", scenario=scenario)
            if not points:
                continue
            name = "all scenarios" if scenario is None else scenario.replace("-", " ")
            paper = next((row["paper"] for row in printed if row["scenario"] == scenario), None)
            label = name if paper is None else f"{name} (paper: {printing.number(100 * paper, 0)} %)"
            _line(panel, points, 100, color=colour, linestyle=style, marker=marker, label=label)
            for at, value in () if paper is None else [(one, paper) for one in crossings(points, paper)]:
                panel.plot(at, 100 * value, zorder=5, **DIAMOND)
        panel.set_xscale("log")
        ticks = sorted({row["encounter_mean_s"] for row in curve if row["encounter_mean_s"] is not None})
        panel.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        panel.minorticks_off()
        panel.set_xlabel("mean time between encounters of two robots (s)")
        panel.set_ylabel("Coordination success (%)")
        panel.set_ylim(0, 100)
        panel.grid(axis="y", color="#dddddd", linewidth=0.5, zorder=0)
        panel.legend(frameon=False)
        return rendered(figure)


def scaling(curve: Sequence[Row], cells: Sequence[Row]) -> bytes:
    """Draw "Larger fleets": each metric over the number of robots, with all teams working and with one.

    The paper's points are marked; it has none beyond 16 robots.
    """
    with canvas(specs.figure("scaling"), 2, 3) as (figure, axes):
        largest = max(row["fleet_size"] for row in curve)
        for panel, metric in zip(axes.flat, SCALED, strict=False):
            spec = metric_named(metric)
            if largest > LARGEST:
                panel.axvspan(LARGEST * 1.19, largest * 1.19, color="#eeeeee", zorder=0)
            for architecture, colour in COLOURS.items():
                same = {"metric": metric, "architecture": architecture}
                all_teams = [row for row in curve if row["teams_working"] == row["fleet_size"] // 4]
                for style, rows in (("-", all_teams), ("--", [row for row in curve if row["teams_working"] == 1])):
                    points = points_of(rows, "fleet_size", **same)
                    _line(panel, points, spec.factor, color=colour, linestyle=style, marker=MARKERS[architecture])
                for row in cells:
                    if (row["metric"], row["architecture"]) == (metric, architecture):
                        panel.plot(
                            row["fleet_size"],
                            row["paper"] * spec.factor,
                            zorder=5,
                            **{**DIAMOND, "markeredgecolor": colour},
                        )
            panel.set_xscale("log", base=2)
            sizes = sorted({row["fleet_size"] for row in curve})
            panel.set_xticks(sizes, [str(size) for size in sizes])
            panel.minorticks_off()
            panel.set_xlim(sizes[0] / 1.19, sizes[-1] * 1.19)
            _titled(panel, spec, "robots")
        _legend(axes.flat[len(SCALED)], (("-", "all teams work"), ("--", "one team works")))
        return rendered(figure)


def loads(curve: Sequence[Row], cells: Sequence[Row]) -> bytes:
    """Draw "How much there is to do": each metric over the number of working teams, at the paper's largest fleet.

    A diamond marks where a curve has the paper's value.
    """
    with canvas(specs.figure("loads"), 2, 3) as (figure, axes):
        at_size = [row for row in curve if row["fleet_size"] == LARGEST]
        for panel, metric in zip(axes.flat, SCALED, strict=False):
            spec = metric_named(metric)
            for architecture, colour in COLOURS.items():
                points = points_of(at_size, "teams_working", metric=metric, architecture=architecture)
                _line(panel, points, spec.factor, color=colour, linestyle="-", marker=MARKERS[architecture])
                for row in cells:
                    if (row["metric"], row["architecture"], row["fleet_size"]) == (metric, architecture, LARGEST):
                        panel.axhline(row["paper"] * spec.factor, color=colour, linewidth=0.8, linestyle=":", zorder=1)
                        for at in crossings(points, row["paper"]):
                            panel.plot(
                                at, row["paper"] * spec.factor, zorder=5, **{**DIAMOND, "markeredgecolor": colour}
                            )
            panel.set_xticks(sorted({row["teams_working"] for row in at_size}))
            _titled(panel, spec, "teams working")
        _legend(axes.flat[len(SCALED)], (("-", "this ledger"), (":", "the paper's number")))
        return rendered(figure)


def coordination_cost(costs: Sequence[Row]) -> bytes:
    """Draw "What coordination costs": counts for each request over the number of robots, on logarithmic scales.

    Where an architecture completes less than half of its tasks in time, the points are hollow. Grey lines grow with the
    number of robots, and with its logarithm.
    """
    from matplotlib.lines import Line2D

    sizes = sorted({row["fleet_size"] for row in costs})
    with canvas(specs.figure("coordination-cost"), 2, 3) as (figure, axes):
        for panel, (name, title) in zip(axes.flat, COSTS.items(), strict=True):
            for style, growth in ((":", [size / sizes[0] for size in sizes]), ("--", _logarithms(sizes))):
                panel.plot(sizes, growth, color="#999999", linestyle=style, linewidth=0.9, zorder=1)
            for architecture, colour in COLOURS.items():
                rows = [row for row in costs if row["architecture"] == architecture and row[name]]
                panel.plot(
                    [row["fleet_size"] for row in rows], [row[name] for row in rows], color=colour, linewidth=1.2
                )
                for row in rows:
                    face = "white" if is_broken(row) else colour
                    look = {"marker": MARKERS[architecture], "markersize": 4, "zorder": 3}
                    panel.plot(row["fleet_size"], row[name], color=colour, markerfacecolor=face, **look)
            panel.set_xscale("log", base=2)
            panel.set_yscale("log")
            panel.set_xticks(sizes, [f"{size:,}" for size in sizes], rotation=30 if len(sizes) > 4 else 0)
            panel.minorticks_off()
            panel.set_title(title)
            panel.grid(axis="y", color="#dddddd", linewidth=0.5, zorder=0)
        for panel in axes[-1]:
            panel.set_xlabel("robots")
        handles = named_lines()
        hollow: dict[str, Any] = {"marker": "o", "markersize": 4, "markerfacecolor": "white", "linestyle": "none"}
        handles.append(Line2D([], [], color="black", label="under half of the tasks in time", **hollow))
        growths: tuple[tuple[Any, str], ...] = ((":", "grows as $n$"), ("--", "grows as $\\log n$"))
        handles += [Line2D([], [], color="#999999", ls=style, label=label) for style, label in growths]
        legend_below(figure, handles)
        return rendered(figure)


def is_broken(row: Row) -> bool:
    """Return whether the architecture completes less than half of the tasks of this fleet within their budget."""
    return row["completed"] is not None and row["completed"] < HALF


def _logarithms(sizes: Sequence[int]) -> list[float]:
    return [math.log(size) / math.log(sizes[0]) for size in sizes]


def points_of(curve: Sequence[Row], dial: str, **same: Any) -> list[tuple[float, Row]]:
    """Return the defined points of a curve over a dial: the rows with these values, one for each position."""
    found = {
        row[dial]: row
        for row in curve
        if row["mean"] is not None and row[dial] is not None and all(row[name] == value for name, value in same.items())
    }
    return sorted(found.items())


def crossings(points: Sequence[tuple[float, Row]], value: float) -> list[float]:
    """Return where on the dial a curve has this value, by linear interpolation over the logarithm of the dial."""
    found = []
    for (left, first), (right, second) in pairwise(points):
        low, high = first["mean"] - value, second["mean"] - value
        if low == 0 or low * high < 0:
            share = low / (low - high) if low != high else 0.0
            found.append(math.exp(math.log(left) + share * math.log(right / left)))
    return found + [place for place, row in points[-1:] if row["mean"] == value]


def _line(panel: Any, points: Sequence[tuple[float, Row]], scale: float, **look: Any) -> None:
    panel.plot(
        [at for at, _ in points],
        [row["mean"] * scale for _, row in points],
        markersize=3.5,
        linewidth=1.2,
        zorder=3,
        **look,
    )
    for at, row in points:
        _whisker(panel, at, row["interval"], scale, look["color"])


def _whisker(panel: Any, at: float, interval: tuple[float, float] | None, scale: float, colour: str = "black") -> None:
    if interval is not None:
        whisker(panel, at, interval[0] * scale, interval[1] * scale, colour)


def _titled(panel: Any, spec: Metric, dial: str) -> None:
    panel.set_title(spec.title)
    panel.set_xlabel(dial)
    panel.set_ylim(bottom=0)
    panel.grid(axis="y", color="#dddddd", linewidth=0.5, zorder=0)


def _legend(panel: Any, styles: Sequence[tuple[Any, str]]) -> None:
    """Name the lines of the other five panels in the last one."""
    from matplotlib.lines import Line2D

    panel.axis("off")
    handles = named_lines()
    handles += [Line2D([], [], color="black", ls=style, label=label) for style, label in styles]
    handles.append(Line2D([], [], label="printed in the paper", **DIAMOND))
    panel.legend(handles=handles, loc="center", frameon=False)
