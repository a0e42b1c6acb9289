"""Which mechanism carries which number: pairs with and without one, and what the query answers."""

from collections.abc import Iterator
from contextlib import AbstractContextManager
from typing import Any

import msgspec
import pytest
from scipy import stats

from fsar_ledger.base.errors import InvalidExperiment
from fsar_ledger.designs.constants import Constants
from fsar_ledger.designs.registered import PAPER_SCENARIOS
from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.configuration import MECHANISMS, MECHANISMS_OF, without
from fsar_ledger.events.envelope import flat, with_columns
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.events.request import ContractQuestioned, InternalHandoff
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.metrics.database import Database
from fsar_ledger.metrics.definitions import metrics
from fsar_ledger.report.build import Document
from fsar_ledger.report.findings import experiments_of
from fsar_ledger.runtime.experiment import Experiment
from fsar_ledger.runtime.experiment_arguments import experiment_of
from fsar_ledger.runtime.knockouts import KNOCKOUTS, Knockout
from fsar_ledger.runtime.paper import paper_ledger
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from tests.recycled import from_table
from tests.report.made import column, made, said

COPIES, CLAIMS, UNNAMED = "synced-copies", "safe-stop-claims", "unnamed-requests"
CALM = msgspec.structs.replace(Constants().world, context_rate_per_s=0.0)


def played(*experiments: Experiment) -> AbstractContextManager[Database]:
    return from_table(encode([simulate_run(spec, one.constants) for one in experiments for spec in one.specs()]))


def of_cfc(*names: str, runs: int = 2, constants: Constants = Constants()) -> Experiment:  # noqa: B008
    return Experiment(("cfc",), PAPER_SCENARIOS, runs, 42, 4, ("full", *(without([name]) for name in names)), constants)


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    both = Experiment(
        ("cfc",), PAPER_SCENARIOS, 3, 42, 4, (without([CLAIMS, COPIES]),)
    )  # is in no family of those that lack one
    with played(of_cfc(CLAIMS, COPIES, UNNAMED, runs=3), both) as opened:
        yield opened


def test_every_mechanism_that_has_a_name_can_be_taken_out_and_names_are_of_one_architecture() -> None:
    assert [(one.architecture, one.name) for one in KNOCKOUTS] == [
        (architecture, name) for architecture, names in MECHANISMS_OF.items() for name in names
    ]
    assert len({one.name for one in KNOCKOUTS}) == len(KNOCKOUTS)
    assert {one.name for one in KNOCKOUTS if not one.decides and one.change is None} == set(MECHANISMS), (
        "only these are known to the handlers"
    )


def test_of_two_mechanisms_that_are_taken_out_neither_puts_the_other_back() -> None:
    for architecture in MECHANISMS_OF:
        replaced = [command for one in KNOCKOUTS if one.architecture == architecture for command in one.decides]
        assert len(replaced) == len(set(replaced)), "the second would decide as if the first were there"
    names = [
        without(some)
        for some in ((), ("planner-claims",), ("contract-questioning",), ("planner-claims", "contract-questioning"))
    ]
    made = [
        simulate_run(RunSpec(5, "dhma", name, "mixed-trust-inspection", 4, 0), Constants()).events for name in names
    ]
    claims = [
        any(isinstance(event, AuthorityClaimed) and event.reason == "context change" for event in events)
        for events in made
    ]
    questions = [any(isinstance(event, ContractQuestioned) for event in events) for events in made]
    assert claims == [True, False, True, False]
    assert questions == [True, True, False, False]


def test_the_ledger_of_ablations_holds_every_architecture_without_each_mechanism() -> None:
    held = {
        (one, name)
        for part in paper_ledger("ablation", 3).parts
        for one in part.architectures
        for name in part.configurations
    }
    assert held == {
        (architecture, name)
        for architecture, names in MECHANISMS_OF.items()
        for name in ("full", *map(without, ([one] for one in names)))
    }


ON_RECORD_ALONE = frozenset(
    {"engine-closing", "unnamed-requests", "central-decisions", "handoff-records", "agent-decisions"}
)
"""The mechanisms without which robots do the same at the same times, but the record names others or holds less.

Taking them out shows how a metric counts.
"""


@pytest.mark.parametrize(
    "knockout", [one for one in KNOCKOUTS if one.name in ON_RECORD_ALONE], ids=lambda one: one.name
)
def test_without_what_is_on_record_alone_the_same_is_done_at_the_same_times(knockout: Knockout) -> None:
    whole, less = (
        simulate_run(RunSpec(5, knockout.architecture, name, "door-relay", 4, 0), Constants())
        for name in ("full", knockout.configuration)
    )
    done, done_less = (
        [(time, what(event)) for time, event in zip(run.times_us, run.events, strict=True) if is_deed(event)]
        for run in (whole, less)
    )
    assert done == done_less
    assert whole.events[1:] != less.events[1:]


def is_deed(event: Event) -> bool:
    return not isinstance(event, RunStarted | InternalHandoff)


def what(event: Event) -> Any:
    """The event without who is on record for it."""
    anybody: dict[str, Any] = {
        name: None if name != "path" else () for name in ("decided_by", "requested_by", "path") if name in flat(event)
    }
    return with_columns(event, **anybody)


def test_a_mechanism_is_looked_for_in_the_architecture_that_has_it() -> None:
    asked = experiment_of(None, None, 1, 42, 4, [COPIES])
    assert (asked.architectures, asked.configurations) == (("cfc",), ("without-synced-copies",))


@pytest.mark.parametrize(
    ("architectures", "asked", "why"),
    [
        (None, ["synced-copy"], "did you mean synced-copies"),
        (["fsar"], [COPIES], "without synced-copies: found architecture fsar, expected cfc alone"),
        (None, [COPIES, "hop-latency"], "found architecture cfc, expected dhma alone"),
        (None, [f"{COPIES}+hop-latency"], "expected full, or without- and some of .*, of one architecture"),
    ],
)
def test_what_an_architecture_does_not_have_cannot_be_taken_out_of_it(
    architectures: list[str] | None, asked: list[str], why: str
) -> None:
    with pytest.raises(InvalidExperiment, match=why):
        experiment_of(architectures, None, 1, 42, 4, asked)


def test_where_a_mechanism_has_nothing_to_do_every_difference_is_exactly_0() -> None:
    with played(of_cfc(CLAIMS, constants=Constants(CALM))) as calm:
        rows = calm.rows("SELECT * FROM mechanism_differences WHERE NOT pools_seeds")
    assert len(rows) == len(metrics())
    assert {(row["n"], row["differing_pairs"], row["mean_difference"]) for row in rows} == {(10, 0, 0.0)}
    assert {row["p"] for row in rows} == {None}


@pytest.mark.slow
def test_a_difference_is_in_full_minus_without_and_its_interval_that_of_the_paired_t_test(database: Database) -> None:
    values = {
        name: [
            row["value"]
            for row in database.rows(
                "SELECT value FROM run_metrics WHERE metric = $m AND configuration = $c ORDER BY scenario, run", about
            )
        ]
        for name in ("full", without([CLAIMS]))
        if (about := {"m": "authority_conflicts", "c": name})
    }
    full, less = values.values()
    assert full != less
    expected = stats.ttest_rel(full, less)
    [row] = [
        one
        for one in database.rows("SELECT * FROM mechanism_differences WHERE NOT pools_seeds")
        if _is(one, CLAIMS, "authority_conflicts")
    ]
    low, high = expected.confidence_interval()
    assert row["mean_difference"] == pytest.approx(sum(full) / len(full) - sum(less) / len(less))
    # differing pairs set the degrees of freedom, so the interval is no narrower than that of all pairs
    assert row["ci_low"] <= low + 1e-9
    assert row["ci_high"] >= high - 1e-9
    assert row["ci_low"] > 0


def _is(row: dict[str, Any], mechanism: str, metric: str) -> bool:
    return (row["configuration"], row["metric"]) == (without([mechanism]), metric)


def test_holm_adjusts_the_tests_of_all_mechanisms_together(database: Database) -> None:
    rows = experiments_of(database)["mechanisms"].relations["differences"].to_pylist()
    tested = sorted((row for row in rows if row["p"] is not None), key=lambda row: row["p"])
    assert {row["family_tests"] for row in rows} == {len(tested)}
    expected = 0.0
    for at, row in enumerate(tested):
        expected = max(expected, min(1.0, (len(tested) - at) * row["p"]))
        assert row["p_holm"] == pytest.approx(expected)


def test_what_never_decided_is_named_and_what_is_not_observed_is_no_zero() -> None:
    def row(architecture: str, mechanism: str, times: int | None, scenario: str = "door-relay") -> dict[str, Any]:
        named = {"architecture": architecture, "scenario": scenario}
        return {**named, "part": "registry", "mechanism": mechanism, "times": times}

    uses = [
        *(row("fsar", "seen", 3), row("cfc", "seen", 0), row("fsar", "seen", 1, "fleet-contention")),
        *(row("fsar", "never", 0), row("cfc", "never", 0), row("fsar", "hidden", None), row("cfc", "hidden", 0)),
    ]
    document = Document(made(uses=uses))
    assert column(document, "mechanism-uses", "mechanism") == ["hidden", "seen"]
    assert column(document, "mechanism-uses", "door-relay") == ["– / 0", "3 / 0"]
    assert column(document, "mechanism-uses", "fleet-contention") == [None, "1"]
    assert "1 never did in these runs" in said(document)
    assert "for or against them: registry (never)." in said(document)
