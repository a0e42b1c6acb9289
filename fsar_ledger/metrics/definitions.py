"""Define the metrics as `reports/metrics.toml` lists them: meaning, concerns, units and printed form.

The file is the one list of metrics. What SQL needs of it becomes relations here (`metric_definitions`,
`metric_concerns`, `metric_measurements`); the report, the statistics and the pages read the same rows.
"""

from collections.abc import Iterable
from functools import cache
from importlib.resources import files
from typing import Literal

import msgspec


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
    paper: Paper | None = None

    @property
    def printed(self) -> Paper:
        """Where the paper prints it. Raises: KeyError where it does not."""
        if self.paper is None:
            raise KeyError(f"{self.name}: the paper does not print it")
        return self.paper


@cache
def metrics() -> tuple[Metric, ...]:
    """Return every metric: those of the paper in its order, then the others."""
    text = files("fsar_ledger.reports").joinpath("metrics.toml").read_bytes()
    found = msgspec.toml.decode(text, type=dict[str, tuple[Metric, ...]])["metric"]
    return tuple(sorted(found, key=lambda one: one.paper is None))


@cache
def published_metrics() -> tuple[Metric, ...]:
    """Return the metrics that the paper prints, in its order."""
    return tuple(one for one in metrics() if one.paper is not None)


def metric_named(name: str) -> Metric:
    """Return the metric of this name. Raises: KeyError when there is none."""
    return {one.name: one for one in metrics()}[name]


DEFINITIONS = (
    "position, metric, scale, better, is_pooled, numerator_units, published_value, undefined_value, is_published"
)


def definitions_sql() -> str:
    """Return the SELECT of what SQL must know of each metric."""
    rows = [
        f"({at}, '{one.name}', '{one.scale}', '{one.better}', {_sql(one.is_pooled)}, {one.numerator_units}, "
        f"{_sql(one.published_value)}::DOUBLE, NULL::DOUBLE, {_sql(one.paper is not None)})"
        for at, one in enumerate(metrics(), 1)
    ]
    return _values("definitions", DEFINITIONS, rows)


def concerns_sql() -> str:
    """Return the SELECT of what each metric rests on."""
    rows = [f"('{one.name}', '{concern}')" for one in metrics() for concern in one.rests_on]
    return _values("needed", "judge, concern", rows)


def measured_sql() -> str:
    """Return the SELECT of what every metric measures of each run."""
    return "UNION ALL BY NAME\n".join(
        f"SELECT\n    '{one.name}' AS metric,\n    {_measures(one)}\nFROM {one.name}\n" for one in metrics()
    )


def _measures(metric: Metric) -> str:
    columns = ["run_id", "value", "numerator", "denominator", "not_observed"]
    return ",\n    ".join([*columns, *(["value_without_routine"] if metric.counts_routine else [])])


def _values(name: str, columns: str, rows: Iterable[str]) -> str:
    lines = ",\n    ".join(rows)
    return f"WITH {name} ({columns}) AS (\n    VALUES\n    {lines}\n)\n\nSELECT {columns}\nFROM {name}\n"


def _sql(value: bool | float | None) -> str:
    return "NULL" if value is None else str(value).upper()
