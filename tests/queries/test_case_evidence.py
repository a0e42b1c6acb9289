"""The evidence of the paper's cases: what stays without a number, and the events behind each number."""

from collections.abc import Iterator
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pytest

from fsar_ledger.base.errors import QueryFailed
from fsar_ledger.designs.constants import Constants
from fsar_ledger.events import CONCERNS
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.metrics.database import from_rows, from_table
from fsar_ledger.metrics.library import library
from fsar_ledger.metrics.provenance import types_read
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from tests.queries.histories import answer, run
from tests.queries.test_cases import (
    INJECTED,
    ISSUED,
    JOINED,
    RECOVERY,
    SCENARIOS,
    TRUST,
    attempted,
    failed,
    queried,
    resolved,
)

JUDGES = dict(answer("cases/case_definitions", columns=("case_number", "judge")))


def test_runs_of_other_seeds_sizes_and_configurations_are_never_in_one_row() -> None:
    failures = (*JOINED, failed(), attempted("robot/D1"), resolved())
    others: list[dict[str, Any]] = [
        {},
        {"run": 1},
        {"seed": 7},
        {"fleet_size": 8},
        {"configuration": "without-trust-evaluation"},
        {"parameters": '{"a":1}'},
    ]
    runs = [run(*failures, run_id=f"r{number}", scenario=RECOVERY, **other) for number, other in enumerate(others)]
    columns = ("claim", "seed", "fleet_size", "configuration", "runs", "numerator", "denominator")
    rows = [
        row[1:]
        for row in answer("cases/case_2_recovery_containment", *runs, columns=columns)
        if row[0] == "contained locally"
    ]
    one = [(7, 4, "full"), (42, 8, "full"), (42, 4, "without-trust-evaluation"), (42, 4, "full")]
    assert sorted(rows) == sorted([(*key, 1, 1, 1) for key in one] + [(42, 4, "full", 2, 2, 2)])


def test_a_claim_has_no_number_where_its_scenario_was_not_run_or_is_not_observed_or_has_no_case() -> None:
    runs = [run(scenario="door-relay", architecture="elsewhere", run_id="elsewhere")]
    for number, scenario in SCENARIOS.items():
        runs += [run(scenario=scenario, architecture=f"blind {number}", run_id=f"blind {number}", observes=[])]
        runs += [run(scenario=scenario, architecture=f"empty {number}", run_id=f"empty {number}")]
    columns = (
        *("architecture", "case_number", "runs", "runs_with_case"),
        *("runs_not_observed", "numerator", "denominator", "value"),
    )
    for architecture, number, *found in answer("cases/case_claims", *runs, columns=columns):
        expected = {f"blind {number}": [0, 0, 1, None, None, None], f"empty {number}": [1, 0, 0, 0, 0, None]}
        assert found == expected.get(architecture, [0, 0, 0, None, None, None])


def variants() -> Iterator[pa.Table]:
    """One run of each scenario and baseline, and once for each concern as a source would record it that does not
    observe it."""
    concern_of = dict(answer("facts/event_concerns"))
    for architecture, scenario in [(one, other) for one in ("cfc", "dhma") for other in SCENARIOS.values()]:
        rows = encode([simulate_run(RunSpec(42, architecture, "full", scenario, 4, 3), Constants())])
        for missing in ("nothing", *CONCERNS):
            types = pa.array([tag for tag, concern in concern_of.items() if concern == missing], pa.string())
            left = rows.filter(pc.invert(pc.is_in(rows["type"], types)))
            name, rest = f"{architecture}:{missing}", [None] * (len(left) - 1)
            values = {"run_id": [f"{scenario}:{name}"] * len(left), "architecture": [name, *rest]}
            values["observes"] = [[one for one in CONCERNS if one != missing], *rest]
            for column, cells in values.items():
                left = left.set_column(
                    left.schema.get_field_index(column), column, pa.array(cells, left.schema.field(column).type)
                )
            yield left


@pytest.mark.slow
def test_a_claim_has_no_number_without_a_concern_that_it_rests_on_and_else_the_same_as_with_it() -> None:
    needed = {(judge, concern) for judge, concern, _ in answer("facts/judged_concerns")}
    with from_table(pa.concat_tables(variants())) as database:
        rows = {(row["architecture"], row["claim"]): row for row in database.query("cases/case_claims").to_pylist()}
    hidden = 0
    for (name, claim), row in rows.items():
        architecture, missing = name.split(":")
        numbers = [row[column] for column in ("numerator", "denominator", "value", "runs", "runs_not_observed")]
        if (JUDGES[row["case_number"]], missing) in needed:
            assert numbers == [None, None, None, 0, 1], (name, claim)
            hidden += 1
        else:
            assert numbers == [
                rows[f"{architecture}:nothing", claim][column]
                for column in ("numerator", "denominator", "value", "runs", "runs_not_observed")
            ]
    assert hidden > 100
    assert [
        rows["dhma:nothing", claim]["denominator"] > 0
        for claim in ("executed", "recovery loop", "conflicts", "internal events")
    ] == [True] * 4


@pytest.mark.parametrize("number", SCENARIOS)
def test_a_case_rests_on_the_concerns_of_all_events_that_its_evidence_reads(number: int) -> None:
    concern_of = dict(answer("facts/event_concerns"))
    types = types_read(library(), library().relations[f"case_{number}_evidence"])
    needed = {concern for judge, concern, _ in answer("facts/judged_concerns") if judge == JUDGES[number]}
    causes = (
        {"authority", "knowledge"} if number == 4 else set()
    )  # the chain of causes, by which a record is tied to its action, leads through them
    # A departure ends claims, too, but what observes authority has their releases.
    departures = {"fleet"} if number == 3 else set()
    assert types is not None
    assert needed == {concern_of[tag] for tag in types if tag in concern_of} - departures | causes


def test_the_events_behind_a_number_are_listed_with_the_action_to_explain() -> None:
    with from_rows(run(INJECTED, queried(), ISSUED, scenario=TRUST)) as database:
        found = database.query("cases/case_events", {"number": "1"}).to_pylist()
        with pytest.raises(
            QueryFailed, match="found number=1, claim=conflicts, expected those of a row of cases/case_definitions"
        ):
            database.query("cases/case_events", {"number": "1", "claim": "conflicts"})
    assert sorted(
        (row["claim"], row["case_seq"], row["counted"], row["seq"], row["type"], row["action_id"]) for row in found
    ) == [
        ("attempted", 1, 1, 3, "RequestIssued.v1", "x1"),
        ("discovered", 1, 1, 3, "RequestIssued.v1", "x1"),
        ("executed", 1, 0, None, None, "x1"),
    ]


@pytest.mark.slow
def test_the_evidence_of_each_claim_adds_up_to_its_number_and_names_events_of_the_run() -> None:
    specs = [
        RunSpec(42, architecture, "full", scenario, 4, 3)
        for architecture in PAPER_ARCHITECTURES
        for scenario in SCENARIOS.values()
    ]
    with from_table(encode([simulate_run(spec, Constants()) for spec in specs])) as database:
        claims = {(row["claim"], row["architecture"]): row for row in database.query("cases/case_claims").to_pylist()}
        events = database.query("cases/case_events").to_pylist()
    assert len(claims) == len(PAPER_ARCHITECTURES) * len(answer("cases/case_definitions"))
    assert {(row["counted"] > 0, row["type"] is not None) for row in events} == {(True, True), (False, False)}
    for (claim, architecture), row in claims.items():
        things = {
            (one["run_id"], one["case_seq"]): one["counted"]
            for one in events
            if (one["claim"], one["architecture"]) == (claim, architecture)
        }
        assert (sum(things.values()), len(things)) == (row["numerator"], row["denominator"]), (claim, architecture)
