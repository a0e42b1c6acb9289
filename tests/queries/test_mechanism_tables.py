"""The paper's table of mechanisms in workflows: given rows, the cells; and rows that change each."""

from typing import Any

import pytest

from fsar_ledger.metrics.database import Value, plain_rows
from tests.queries.histories import Row, S, act, event, run
from tests.queries.test_tables import (
    FOUND,
    JOINED,
    B,
    C,
    about,
    admitted,
    asked,
    failed,
    left,
    recovery,
    started,
    tried,
)
from tests.recycled import from_rows


def cells(*events: Row, scenario: str = "workflow-door-relay") -> dict[str, str]:
    """The mechanisms that these events exercise, with their cells."""
    with from_rows(run(*events, scenario=scenario)) as database:
        rows = plain_rows(database.query("tables/mechanism_coverage"))
    assert len(rows) == 9
    return {row["mechanism"]: row["cell"] for row in rows if row["cell"] is not None}


STANDARD: dict[str, Value] = {
    "trust": "task",
    "may_request": True,
    "may_execute": True,
    "override": "none",
    "is_audited": True,
}
CALL = act(
    "SupervisorCalled", 3 * S, "t1/1.1", supervisor="supervisor/fleet", purpose="ordering", robot=B, competing="t2/1.1"
)


def test_the_door_relay_has_the_papers_cells() -> None:
    assert cells(FOUND, asked(), {**admitted(), **STANDARD}, started()) == {
        "inter_robot_request": "yes",
        "trust_evaluation": "task",
        "authority_tuple": "standard",
        "policy_composition": "allow",
        "registry_discovery": "single",
        "delegation_chain": "single",
    }


def test_the_layered_recovery_has_the_papers_cells() -> None:
    nobody = event("RegistryQueried", 12 * S, **about(None), capability="grasp.*", candidates=[])
    decided = event("ReassignmentDecided", 12 * S, **about("service/recovery"), robot=B, failure=1)
    steps = (tried(B), left("local", "peer", B), nobody, left("peer", "fleet"), decided, left("fleet", "human"))
    assert cells(*failed(*steps)) == {
        "inter_robot_request": "via recovery",
        "registry_discovery": "no peer",
        "layered_recovery": "all 4 levels",
        "fleet_reassignment": "attempted",
        "human_escalation": "level 4",
    }


def test_the_human_supervision_shows_both_scopes_and_a_conflict() -> None:
    second = {**admitted(action="t2/1.1"), **STANDARD, "trust": "capability"}
    assert cells(FOUND, asked(), asked(action="t2/1.1"), CALL, {**admitted(), **STANDARD}, second) == {
        "inter_robot_request": "yes",
        "trust_evaluation": "task, capability",
        "authority_tuple": "standard",
        "policy_composition": "review",
        "registry_discovery": "conflict",
        "human_escalation": "conflict",
        "delegation_chain": "single",
    }


@pytest.mark.parametrize(
    ("mechanism", "cell", "events"),
    [
        ("authority_tuple", "other", ({**admitted(), **STANDARD, "override": "hard-preempt"},)),
        ("policy_composition", "deny", (asked(), event("RequestDenied", 3 * S, **about(B), reason="policy"))),
        ("registry_discovery", "several", ({**FOUND, "candidates": [B, C]},)),
        (
            "layered_recovery",
            "2 of 4 levels",
            failed(tried(B), left("local", "peer"), recovery("AssistanceRequested", B, "peer", helper=C)),
        ),
        (
            "fleet_reassignment",
            "done",
            (event("ReassignmentDecided", 12 * S, **about("service/recovery"), robot=B, failure=1, helper=C),),
        ),
        ("human_escalation", "review", ({**CALL, "purpose": "review", "competing": None},)),
        ("delegation_chain", "several links", ({**asked(), "relay": C},)),
    ],
)
def test_other_events_give_other_cells(mechanism: str, cell: str, events: tuple[Row, ...]) -> None:
    assert cells(*events)[mechanism] == cell


OTHERWISE: dict[str, dict[str, Any]] = {
    "seed": {"seed": 43},
    "fleet_size": {"fleet_size": 8},
    "constants": {"parameters": '{"world":{"rate_per_s":0.03}}'},
    "model_version": {"model_version": "another"},
    "kind": {"kind": "live"},
}


LOW = '{"world":{"rate_per_s":0.01}}'


def made_otherwise(query: str, *events: Row, **dimensions: Any) -> tuple[list[Row], list[Row]]:
    """The rows of one run that did nothing, alone and beside a run each that was made otherwise, of these events."""
    ours = run(**{"parameters": LOW, **dimensions})
    others = [
        row
        for name, more in OTHERWISE.items()
        for row in run(*events, run_id=name, **{"parameters": LOW, **dimensions, **more})
    ]
    with from_rows(ours) as alone, from_rows([*ours, *others]) as together:
        return list(plain_rows(alone.query(query))), list(plain_rows(together.query(query)))


def test_features_of_runs_made_otherwise_are_marked_apart() -> None:
    alone, together = made_otherwise("tables/architecture_features", *JOINED, asked())
    assert len(together) == 8 * (1 + len(OTHERWISE))
    dimensions = ("architecture", "configuration", "fleet_size", "seed", "kind", "source", "model_version", "constants")
    assert len({tuple(row[name] for name in dimensions) for row in together}) == 1 + len(OTHERWISE)
    kept = [
        (row["feature"], row["evidence"])
        for row in together
        if row["grade"] is None and row["feature"] == "single_agent_robot"
    ]
    assert kept == [("single_agent_robot", "robots that appear as one principal not shown")]
    assert {row["grade"] for row in alone} == {None}


def test_mechanisms_of_workflows_made_otherwise_are_in_rows_of_their_own() -> None:
    alone, together = made_otherwise("tables/mechanism_coverage", FOUND, asked(), scenario="workflow-door-relay")
    [ours] = {row["made_alike"] for row in alone}
    assert len(together) == 9 * (1 + len(OTHERWISE))
    assert {row["cell"] for row in together if row["made_alike"] == ours} == {None}
    assert {row["cell"] for row in together if row["mechanism"] == "inter_robot_request"} == {None, "yes"}


def test_only_workflows_are_covered_and_runs_that_differ_show_both_cells() -> None:
    with from_rows([*run(FOUND), *run(FOUND, scenario="workflow-door-relay", run_id="r2")]) as database:
        assert {row["workflow"] for row in plain_rows(database.query("tables/mechanism_coverage"))} == {
            "workflow-door-relay"
        }
    several = run({**FOUND, "candidates": [B, C]}, scenario="workflow-door-relay", run_id="r2")
    with from_rows([*run(FOUND, scenario="workflow-door-relay"), *several]) as database:
        rows = {
            row["mechanism"]: (row["cell"], row["runs"])
            for row in plain_rows(database.query("tables/mechanism_coverage"))
        }
    assert rows["registry_discovery"] == ("several / single", 2)
