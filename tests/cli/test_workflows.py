"""`simulate --workflow`: the paper's workflows on the command line, and what cannot be asked of them."""

import json
from pathlib import Path

import pytest

from .conftest import Call, one_message

ALL = ("--workflow", "human-supervision", "--workflow", "door-relay", "--workflow", "layered-recovery")


@pytest.mark.slow
def test_the_workflows_are_simulated_once_each_and_every_invariant_holds(call: Call, tmp_path: Path) -> None:
    assert call("simulate", tmp_path / "workflows", *ALL, "--workers", "1").code == 0
    found = json.loads(call("info", tmp_path / "workflows", "--json").out)
    assert (found["runs"], found["is_complete"]) == (3, True)
    audited = call("audit", tmp_path / "workflows")
    assert audited.code == 0, audited.out
    assert "10 of 10 invariants hold" in audited.out


def test_one_workflow_is_simulated_as_often_as_asked(call: Call, tmp_path: Path) -> None:
    assert (
        call("simulate", tmp_path / "workflows", "--workflow", "layered-recovery", "--runs", "4", "--seed", "7").code
        == 0
    )
    rows = json.loads(call("query", "skipped_levels", tmp_path / "workflows", "--json").out)["rows"]
    assert rows == []
    moves = json.loads(call("query", "recovery_moves", tmp_path / "workflows", "--json").out)["rows"]
    assert [move["level"] for move in moves] == ["local", "peer", "fleet", "human"] * 4


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (("--workflow", "door-rely"), ("unknown workflow 'door-rely'", "did you mean door-relay")),
        (
            ("--workflow", "door-relay", "--scenario", "door-relay"),
            ("--workflow and --scenario door-relay", "one or the other"),
        ),
        (
            ("--workflow", "door-relay", "--without", "shared-registry"),
            ("--workflow and --without shared-registry", "one or the other"),
        ),
        (
            ("--workflow", "door-relay", "--architecture", "fsar", "--architecture", "cfc"),
            ("--architecture cfc", "expected fsar"),
        ),
        (("--workflow", "door-relay", "--fleet-size", "8"), ("--fleet-size 8", "expected 4")),
        (("--workflow", "door-relay", "--teams-working", "1"), ("--teams-working 1", "one or the other")),
        (("--workflow", "door-relay", "--task-sets", "2"), ("--task-sets 2", "one or the other")),
        (("--workflow", "door-relay", "--runs", "0"), ("runs: found 0",)),
    ],
)
def test_what_a_workflow_does_not_have_cannot_be_asked_of_it(
    call: Call, tmp_path: Path, arguments: tuple[str, ...], parts: tuple[str, ...]
) -> None:
    one_message(call("simulate", tmp_path / "new", *arguments), 2, *parts)
    assert not (tmp_path / "new").exists()
