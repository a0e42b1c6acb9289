"""Read the numbers that the paper prints, in our unit, each with the step of its last digit.

A table is read only when it is asked for.
"""

import csv
from collections.abc import Iterator
from functools import cache
from importlib.resources import files
from typing import Literal, NamedTuple

from fsar_ledger.events.configuration import FULL

from .definitions import published_metrics

Table = Literal["results", "ablation", "ablation_text", "scaling"]

_FSAR, _FLEET = "fsar", 4


class Printed(NamedTuple):
    """A printed number in our unit, and the step of its last digit."""

    value: float
    step: float


class Place(NamedTuple):
    """Where a number is printed, in the names of our queries; `scenario` None: over all of them."""

    table: Table
    metric: str
    architecture: str
    configuration: str
    fleet_size: int
    scenario: str | None = None


class PrintedTest(NamedTuple):
    """A printed comparison of two architectures: its t, and its Cohen's d with the sign of t, which the paper omits."""

    t: float
    d: Printed


@cache
def printed_tests() -> dict[tuple[str, str], PrintedTest]:
    """Return the printed tests by metric and comparison (`first-second`), in their order. Paper: tab:significance."""
    names = {metric.printed.significance: metric.name for metric in published_metrics()}
    found = {}
    for row in _lines("significance"):
        t, d = float(row["t"]), _number(row["cohens_d"])
        comparison = row["comparison"].lower().replace(" vs ", "-")
        found[names[row["metric"]], comparison] = PrintedTest(t, d._replace(value=d.value if t > 0 else -d.value))
    return found


@cache
def printed(table: Table) -> dict[Place, Printed]:
    """Return the numbers of one table of the paper, in its order, by their place.

    Paper: tab:results, tab:ablation, sec:evaluation:ablation, tab:scaling.
    """
    read = {"results": _results, "ablation": _ablation, "ablation_text": _ablation_text, "scaling": _scaling}[table]
    return dict(read(_lines(table)))


@cache
def features() -> tuple[str, ...]:
    """Return the features by which the paper compares architectures. Paper: tab:baseline_context."""
    return tuple(row["feature"] for row in _lines("architecture_features"))


def _lines(table: str) -> list[dict[str, str]]:
    text = files("fsar_ledger.reports").joinpath("paper", f"{table}.csv").read_text("utf-8")
    return list(csv.DictReader(text.splitlines()))


def _results(rows: list[dict[str, str]]) -> Iterator[tuple[Place, Printed]]:
    means = {(row["metric"], row["architecture"]): row["mean"] for row in rows}
    for metric in published_metrics():
        for architecture in ("FSAR", "CFC", "DHMA"):
            number = _number(means[metric.printed.results, architecture], metric.factor)
            yield Place("results", metric.name, architecture.lower(), FULL, _FLEET), number


def _ablation(rows: list[dict[str, str]]) -> Iterator[tuple[Place, Printed]]:
    for row in rows:
        configuration = _hyphened(row.pop("configuration"))
        for name, text in row.items():
            yield Place("ablation", _metric(name), _FSAR, configuration, _FLEET), _number(text)


def _ablation_text(rows: list[dict[str, str]]) -> Iterator[tuple[Place, Printed]]:
    """Yield the two numbers of each claim of the text: in full, and without the mechanism."""
    for row in rows:
        for configuration, text in ((FULL, row["full_fsar"]), (_hyphened(row["configuration"]), row["ablated"])):
            yield (
                Place(
                    "ablation_text", _metric(row["metric"]), _FSAR, configuration, _FLEET, _hyphened(row["scenario"])
                ),
                _number(text),
            )


def _scaling(rows: list[dict[str, str]]) -> Iterator[tuple[Place, Printed]]:
    for row in rows:
        size, architecture = int(row.pop("fleet_size")), row.pop("architecture").lower()
        for name, text in row.items():
            yield Place("scaling", _metric(name), architecture, FULL, size), _number(text)


def _number(text: str, unit: float = 1.0) -> Printed:
    return Printed(float(text) / unit, 10.0 ** -len(text.partition(".")[2]) / unit)


def _metric(name: str) -> str:
    """Return the metric that tables other than the results call so; such tables print our units."""
    return next(metric.name for metric in published_metrics() if metric.printed.elsewhere == name)


def _hyphened(name: str) -> str:
    """Replace the underscores of the paper's tables by the hyphens of our names."""
    return name.replace("_", "-")
