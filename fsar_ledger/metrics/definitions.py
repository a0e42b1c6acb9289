"""The metrics as `reports/metrics.toml` lists them (meaning, concerns, units, printed form), and the paper's numbers.

The file is the only list of metrics. What SQL needs of it becomes relations here (`metric_definitions`,
`metric_concerns`, `metric_measurements`); the report, the statistics and the pages read the same rows. The numbers that
the paper prints are in our unit, each with the step of its last digit; a table is read only when needed.
"""

import csv
from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import cache
from importlib.resources import files
from typing import Literal, NamedTuple

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError
from fsar_ledger.designs.registered import Field, at_line, decoded
from fsar_ledger.events import CONCERNS
from fsar_ledger.events.configuration import FULL
from fsar_ledger.ledger.rows.schema import RECORDS

from .sql_values import sql_literal

FILE = "reports/metrics.toml"


class Paper(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Where the paper prints a metric: its names in `results.csv`, in `significance.csv` and in all other tables.

    `margin` is the half-width within which a difference from a printed number does not matter, in the metric's unit.
    """

    results: str
    significance: str
    elsewhere: str
    margin: float


class Metric(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One metric, measured by `queries/metrics/NAME.sql`.

    `scale` is what its value is: a share, a count, seconds, or yes-no (0 or 1 for each run). A pooled metric is the sum
    of its numerators over the sum of its denominators, `numerator_units` of which make one of the value; any other is
    the mean of the runs' values. `published_value` is what the paper counts for a run in which it is undefined. The
    printed number is the value times `factor`, with `decimals` decimals; `counted` says what its denominator counts. A
    metric that counts routine operations has a column `value_without_routine`. `paper` is None for a metric that the
    paper does not print.
    """

    name: str
    title: str
    short: str
    scale: Literal["share", "count", "seconds", "yes-no"]
    better: Literal["higher", "lower"]
    rests_on: tuple[str, ...]
    counted: str
    decimals: int
    factor: int = 1
    is_pooled: bool = False
    counts_routine: bool = False
    numerator_units: int = 1
    published_value: float | None = None
    records: tuple[str, ...] = ()
    paper: Paper | None = None

    @property
    def printed(self) -> Paper:
        """Return where the paper prints it. Raises: KeyError where it does not."""
        if self.paper is None:
            raise KeyError(f"{self.name}: the paper does not print it")
        return self.paper


class Registry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The metrics file: its metrics in their order."""

    metric: tuple[Metric, ...]


@cache
def metrics() -> tuple[Metric, ...]:
    """Return every metric: those of the paper in its order, then the others."""
    text = files("fsar_ledger.reports").joinpath("metrics.toml").read_text("utf-8")
    queries = files("fsar_ledger.queries").joinpath("metrics").iterdir()
    return metrics_in(text, [file.name.removesuffix(".sql") for file in queries])


def metrics_in(text: str, queries: Collection[str]) -> tuple[Metric, ...]:
    """Return the metrics of this registry, each measured by one of these queries; those of the paper first.

    Raises:
        UsageError: a field is missing, unknown or of another type, a name occurs twice or matches no query, or a
            concern is unknown; with line and field.
    """
    listed = decoded(text, Registry, FILE).metric
    names: list[str] = []
    for index, metric in enumerate(listed):
        if metric.name in names:
            raise _wrong(text, ("metric", index, "name"), f"another metric of this name: {metric.name}", "each once")
        if metric.name not in queries:
            expected = f"the name of a query in queries/metrics{printable.did_you_mean(metric.name, queries)}"
            raise _wrong(text, ("metric", index, "name"), metric.name, expected)
        for number, concern in enumerate(metric.rests_on):
            if concern not in CONCERNS:
                expected = f"one of the concerns ({', '.join(CONCERNS)}){printable.did_you_mean(concern, CONCERNS)}"
                raise _wrong(text, ("metric", index, "rests_on", number), concern, expected)
        for number, record in enumerate(metric.records):
            if record not in RECORDS:
                expected = (
                    f"an event type, or TYPE.FIELD of one that may be NULL{printable.did_you_mean(record, RECORDS)}"
                )
                raise _wrong(text, ("metric", index, "records", number), record, expected)
        names.append(metric.name)
    return tuple(sorted(listed, key=lambda metric: metric.paper is None))


def _wrong(text: str, field: Field, value: str, expected: str) -> UsageError:
    return UsageError(f"{at_line(FILE, text, field)}: found {printable.value(value)}, expected {expected}")


@cache
def published_metrics() -> tuple[Metric, ...]:
    """Return the metrics that the paper prints, in its order."""
    return tuple(metric for metric in metrics() if metric.paper is not None)


def metric_named(name: str) -> Metric:
    """Return the metric of this name. Raises: KeyError when there is none."""
    return {metric.name: metric for metric in metrics()}[name]


DEFINITIONS = (
    "position, metric, scale, better, is_pooled, numerator_units, published_value, undefined_value, is_published"
)


def definitions_sql(of: Sequence[Metric] | None = None) -> str:
    """Return the SELECT of the definition of each metric (of these, or of all)."""
    rows = [
        f"({at}, '{one.name}', '{one.scale}', '{one.better}', {sql_literal(one.is_pooled)}, {one.numerator_units}, "
        f"{sql_literal(one.published_value)}::DOUBLE, NULL::DOUBLE, {sql_literal(one.paper is not None)})"
        for at, one in enumerate(of or metrics(), 1)
    ]
    return _values("definitions", DEFINITIONS, rows)


def concerns_sql() -> str:
    """Return the SELECT of the concerns that each metric rests on."""
    rows = [f"('{metric.name}', '{concern}')" for metric in metrics() for concern in metric.rests_on]
    return _values("needed", "judge, concern", rows)


def records_sql() -> str:
    """Return the SELECT of the event types and fields that each metric rests on, where it lists them."""
    return _values(
        "needed",
        "judge, record",
        [f"('{metric.name}', '{record}')" for metric in metrics() for record in metric.records],
    )


def measured_sql(of: Sequence[Metric] | None = None) -> str:
    """Return the SELECT of the measurements of every metric (of these, or of all) for each run."""
    return "UNION ALL BY NAME\n".join(
        f"SELECT\n    '{metric.name}' AS metric,\n    {_measures(metric)}\nFROM {metric.name}\n"
        for metric in of or metrics()
    )


def _measures(metric: Metric) -> str:
    columns = ["run_id", "value", "numerator", "denominator", "not_observed"]
    return ",\n    ".join([*columns, *(["value_without_routine"] if metric.counts_routine else [])])


def _values(name: str, columns: str, rows: Iterable[str]) -> str:
    lines = ",\n    ".join(rows)
    return f"WITH {name} ({columns}) AS (\n    VALUES\n    {lines}\n)\n\nSELECT {columns}\nFROM {name}\n"


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
    tests = {}
    for row in _lines("significance"):
        t, d = float(row["t"]), _number(row["cohens_d"])
        comparison = row["comparison"].lower().replace(" vs ", "-")
        tests[names[row["metric"]], comparison] = PrintedTest(t, d._replace(value=d.value if t > 0 else -d.value))
    return tests


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
    """Return the metric with this name in tables other than the results; such tables print our units."""
    return next(metric.name for metric in published_metrics() if metric.printed.elsewhere == name)


def _hyphened(name: str) -> str:
    """Replace the underscores of the paper's tables by the hyphens of our names."""
    return name.replace("_", "-")
