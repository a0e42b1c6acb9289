"""The ten invariants on whole runs: FSAR keeps them all, and each ablation breaks what it takes away."""

from collections.abc import Iterable

import pytest

from fsar_ledger.designs.constants import Constants, Outages
from fsar_ledger.designs.registered import PAPER_WORKFLOWS
from fsar_ledger.events.configuration import MECHANISMS, Configuration, without
from fsar_ledger.events.request import RequestUnanswered
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.metrics.invariants import audit_rows, chosen
from fsar_ledger.runtime.simulation import SCENARIOS, RunSpec, simulate_run
from tests.recycled import from_table
from tests.runtime.pinned import PINNED

BROKEN_WITHOUT: dict[Configuration, set[str]] = {
    "without-trust-evaluation": {"i5", "a5"},  # what an outsider asks for runs, with no supervisor on record
    "without-policy-composition": {"i3", "a3"},  # nobody composes the requester's policy and the fleet's rule
    "without-layered-recovery": {"i4"},  # every failure skips to a human
    "without-shared-registry": {"i5"},  # requests that find nobody name no executor
}
FOUND_BY_SEARCH = (  # runs in which an invariant once broke
    RunSpec(7, "fsar", "full", "mixed-trust-inspection", 4, 13),
)

DEFAULTS = Constants()


def broken(specs: Iterable[RunSpec], constants: Constants = DEFAULTS) -> set[tuple[str, str | None]]:
    """The invariants that these runs break, each with the first finding."""
    with from_table(encode([simulate_run(spec, constants) for spec in specs])) as database:
        return {
            (row.invariant.partition("_")[0], f"{row.first_run} seq {row.first_seq}: {row.first_found}")
            for row in audit_rows(database, chosen(()))
            if row.events
        }


@pytest.mark.parametrize("fleet_size", [4, pytest.param(8, marks=pytest.mark.slow)])
def test_all_ten_hold_on_fsar_in_every_scenario(fleet_size: int) -> None:
    assert (
        broken(RunSpec(42, "fsar", "full", scenario, fleet_size, run) for scenario in SCENARIOS for run in range(12))
        == set()
    )


@pytest.mark.slow
def test_nine_hold_where_robots_and_links_fail_and_i5_names_the_requests_that_found_nobody() -> None:
    """Reading R41: where the only robot that could serve is known to be silent, a request has no executor to name."""
    failing = Constants(outages=Outages(0.02, 8.0, 0.03, 6.0, 0.002))
    runs = [
        simulate_run(RunSpec(42, "fsar", "full", scenario, 4, run), failing)
        for scenario in SCENARIOS
        for run in range(8)
    ]
    unanswered = {
        event.subject.action_id
        for run in runs
        for event in run.events
        if isinstance(event, RequestUnanswered) and event.principals.executed_by is None
    }
    with from_table(encode(runs)) as database:
        assert {row.invariant.partition("_")[0] for row in audit_rows(database, chosen(())) if row.events} == {"i5"}
        lacking = {row["action_id"] for row in database.query("invariants/i5_audit_attributability").to_pylist()}
    assert lacking <= unanswered


def test_all_ten_hold_on_runs_that_once_broke_one() -> None:
    assert broken(FOUND_BY_SEARCH) == set()


@pytest.mark.parametrize("seed", [42, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3))])
def test_all_ten_hold_on_every_workflow(seed: int) -> None:
    assert (
        broken(RunSpec(seed, "fsar", "full", workflow, 4, run) for workflow in PAPER_WORKFLOWS for run in range(4))
        == set()
    )


@pytest.mark.slow  # tests/queries/test_mutated_handlers.py looks at each on fewer runs
@pytest.mark.parametrize("configuration", sorted(BROKEN_WITHOUT))
def test_each_ablation_breaks_what_it_takes_away(configuration: Configuration) -> None:
    specs = (RunSpec(42, "fsar", configuration, scenario, 4, run) for scenario in SCENARIOS for run in range(12))
    found = broken(specs, PINNED)
    assert {name for name, _ in found} == BROKEN_WITHOUT[configuration]


def test_without_any_mechanism_all_breaks_that_one_of_them_keeps() -> None:
    found = broken(
        RunSpec(42, "fsar", without(MECHANISMS), scenario, 4, run) for scenario in SCENARIOS for run in range(6)
    )
    assert {name for name, _ in found} == set().union(*BROKEN_WITHOUT.values())
