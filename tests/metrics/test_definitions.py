"""The registry of metrics: every fault is refused with its line and field, and every metric has its query."""

import pytest

from fsar_ledger.base.errors import UsageError
from fsar_ledger.designs.constants import Constants
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.metrics.definitions import metrics, metrics_in
from fsar_ledger.metrics.library import Query, library
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from tests.recycled import from_rows, from_table

MEASURED = ("run_id", "numerator", "denominator", "value", "not_observed")
"""Columns of every query that measures a metric, beside those without routine operations."""
REGISTRY = """\
[[metric]]
name = "calls"
title = "Calls (per run)"
short = "Calls"
scale = "count"
better = "lower"
rests_on = ["supervision"]
counted = "runs"
decimals = 2
"""


@pytest.mark.parametrize(
    ("now", "then", "message"),
    [
        ("[[metric]]\n", "[[metric]\n", "1: "),
        ("[[metric]]", "[[metrics]]", "1: metrics: found an unknown field, expected one of metric; did you"),
        ('"calls"', '"call"', "2: metric[0].name: found call, expected the name of a query in queries/metrics; did"),
        ('short = "Calls"\n', "", "1: metric[0].short: found nothing, expected a value"),
        ('"count"', '"counts"', "5: metric[0].scale: found counts, expected one of share, count, seconds, yes-no; did"),
        ("rests_on", "rest_on", "7: metric[0].rest_on: found an unknown field, expected one of name,"),
        ('"supervision"', '"supervison"', "7: metric[0].rests_on[0]: found supervison, expected one of the concerns ("),
        ("= 2", '= "2"', '9: metric[0].decimals: found "2", expected a whole number'),
        ("= 2\n", "= 2\n" + REGISTRY, "11: metric[1].name: found another metric of this name: calls, expected each"),
    ],
)
def test_a_wrong_registry_is_refused_with_its_line_and_field(now: str, then: str, message: str) -> None:
    assert REGISTRY.count(now) == 1
    with pytest.raises(UsageError) as refused:
        metrics_in(REGISTRY.replace(now, then), ["calls", "waits"])
    assert str(refused.value).startswith(f"reports/metrics.toml:{message}"), str(refused.value)


def test_metrics_of_the_paper_come_first() -> None:
    paper = '[metric.paper]\nresults = "waits"\nsignificance = "waits"\nelsewhere = "waits"\nmargin = 1.0\n'
    second = REGISTRY.replace("calls", "waits") + paper
    assert [one.name for one in metrics_in(REGISTRY + second, ["calls", "waits"])] == ["waits", "calls"]


def test_every_query_with_the_numbers_of_a_run_is_a_metric_and_every_metric_has_them() -> None:
    of_runs = [query for name, query in library().queries.items() if name.startswith("metrics/") and _is_of_runs(query)]
    assert {query.relation for query in of_runs} == {one.name for one in metrics()}
    with from_rows([]) as database:
        for metric in metrics():
            columns = set(database.query(f"metrics/{metric.name}").column_names)
            assert columns >= set(MEASURED), metric.name
            assert ("value_without_routine" in columns) == metric.counts_routine, metric.name


def test_values_are_numerators_over_denominators_on_the_scale_that_the_registry_names() -> None:
    specs = [
        RunSpec(42, one, "full", "failure-recovery-chain", 4, run) for one in PAPER_ARCHITECTURES for run in range(4)
    ]
    with from_table(encode([simulate_run(spec, Constants()) for spec in specs])) as database:
        for metric in metrics():
            rows = database.query(f"metrics/{metric.name}").to_pylist()
            counted = [row for row in rows if row["denominator"]]
            assert [row["value"] for row in counted] == pytest.approx(
                [row["numerator"] / row["denominator"] / metric.numerator_units for row in counted]
            ), metric.name
            values = {row["value"] for row in counted}
            assert all(value >= 0 for value in values), metric.name
            assert metric.scale != "share" or all(value <= 1 for value in values), metric.name
            assert metric.scale != "yes-no" or values <= {0, 1}, metric.name


def _is_of_runs(query: Query) -> bool:
    return query.key == {"run_id": False}
