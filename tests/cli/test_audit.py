"""`audit` says which invariants hold, where they do not, and tells scripts by its exit code."""

import json
from pathlib import Path

import pytest

from tests.cli.conftest import Call, one_message

NAMES = ["i1", "i2", "i3", "i4", "i5", "a1", "a2", "a3", "a4", "a5"]


@pytest.mark.slow
def test_fsar_satisfies_all_ten(call: Call, ledger: Path) -> None:
    said = call("audit", ledger, "--architecture", "fsar")
    assert (said.code, said.err) == (0, "")
    assert said.out.endswith("\n10 of 10 invariants hold\n")
    assert [line.split("_")[0] for line in said.out.splitlines()[2:12]] == NAMES


def test_a_broken_invariant_is_exit_code_1_and_names_the_first_event(call: Call, ledger: Path) -> None:
    said = call("audit", ledger)
    answer = json.loads(call("audit", ledger, "--json").out)
    assert (said.code, said.err, answer["holds"]) == (1, "", False)
    row = next(
        row
        for row in answer["rows"]
        if (row["invariant"], row["architecture"]) == ("i2_local_execution_ownership", "cfc")
    )
    assert f"{row['first_run']} seq {row['first_seq']}: {row['first_found']}" in said.out
    listed = json.loads(call("query", "i2_local_execution_ownership", ledger, "--json").out)["rows"]
    events = sorted((one["run_id"], one["seq"]) for one in listed if one["run_id"].startswith("cfc."))
    assert (row["events"], (row["first_run"], row["first_seq"])) == (len(set(events)), events[0])


@pytest.mark.slow
def test_the_footer_counts_for_each_architecture_and_names_the_ledger(call: Call, ledger: Path) -> None:
    rows = json.loads(call("audit", ledger, "--json").out)["rows"]
    held = {
        one: sum(row["holds"] is True for row in rows if row["architecture"] == one) for one in ("fsar", "cfc", "dhma")
    }
    footer = call("audit", ledger).out.partition("\n\n")[2].splitlines()
    assert held["fsar"] == 10 > held["cfc"]
    assert [line.partition(" of 10 ")[0] for line in footer if " of 10 " in line] == [
        f"{one}: {count}" for one, count in held.items()
    ]
    first = next(row["invariant"] for row in rows if row["holds"] is False)
    assert (
        footer[-1] == f"`fsar-ledger query {first} {ledger}` lists all offending events of the first broken invariant"
    )


@pytest.mark.slow
def test_json_has_a_row_for_each_invariant_and_architecture(call: Call, ledger: Path) -> None:
    answer = json.loads(call("audit", ledger, "--json").out)
    assert [(row["invariant"][:2], row["architecture"]) for row in answer["rows"]] == [
        (name, one) for name in NAMES for one in ("fsar", "cfc", "dhma")
    ]
    assert answer["head"] == json.loads(call("info", ledger, "--json").out)["head"]
    assert {row["runs"] for row in answer["rows"]} == {4}


@pytest.mark.parametrize(("names", "shown"), [(["A2"], ["a2"]), (["a1", "i4_outward_recovery", "a1"], ["i4", "a1"])])
def test_only_what_was_asked_for_is_checked(call: Call, ledger: Path, names: list[str], shown: list[str]) -> None:
    options = [part for name in names for part in ("--invariant", name)]
    said = call("audit", ledger, "--architecture", "fsar", "--json", *options)
    assert (said.code, [row["invariant"][:2] for row in json.loads(said.out)["rows"]]) == (0, shown)


def test_a_broken_invariant_that_was_not_asked_for_does_not_count(call: Call, ledger: Path) -> None:
    assert call("audit", ledger, "--architecture", "cfc", "--invariant", "a2").code == 0
    assert call("audit", ledger, "--architecture", "cfc", "--invariant", "i2").code == 1


def test_an_unknown_name_is_answered_with_the_nearest(call: Call, ledger: Path) -> None:
    one_message(call("audit", ledger, "--invariant", "i4_outward_recvery"), 2, "i4_outward_recovery")
    one_message(call("audit", ledger, "--architecture", "fsra"), 2, "did you mean fsar")
    one_message(call("audit", ledger.parent), 2, str(ledger.parent))


def test_nothing_is_said_to_hold_where_there_is_nothing_to_check(call: Call, tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    assert (
        call(
            "simulate", path, "--architecture", "cfc", "--scenario", "door-relay", "--runs", "1", "--workers", "1"
        ).code
        == 0
    )
    one_message(call("audit", path, "--architecture", "fsar"), 2, "found no runs of fsar")
