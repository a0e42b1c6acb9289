"""`whatif` over all runs and `bisect --change`, as people call them: what is refused in some runs, or in all."""

import json
from pathlib import Path

import pytest

from fsar_ledger.cli import app
from tests.cli.conftest import Call, one_message
from tests.quick import few

VIOLATED = "policy_violations > 0"
OF_EIGHT = "rule fleet deny robot=B2"
"""A change that means something in a fleet of eight robots alone."""
UNKNOWN = "SetPolicyRule about robot/B2 is rejected: unknown robot robot/B2, expected a member of the fleet"


@pytest.fixture(scope="module")
def fleets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ledger with two runs of four robots and two of eight."""
    path = tmp_path_factory.mktemp("fleets") / "fleets"
    for size in ("4", "8"):
        words = ("--architecture", "fsar", "--scenario", "door-relay", "--runs", "2", "--seed", "3", "--workers", "1")
        assert app.run(["simulate", str(path), *words, "--fleet-size", size]) == 0
    return path


REFUSED = {
    "rule fleet deny robot=Z1": "SetPolicyRule about robot/Z1 is rejected: unknown robot robot/Z1",
    "rule fleet deny capability=no.such": "is rejected: unknown capability no.such",
    "density all -1": "SetSupervisionDensity about every robot is rejected: density -1",
    "density Z1 1": "SetSupervisionDensity about robot/Z1 is rejected",
    "trust A1 Z1 none": "SetTrust about robot/A1 is rejected: unknown robot robot/Z1",
    "budget Z1 local 5s 1": "SetRecoveryBudget about robot/Z1 is rejected",
    "rule fleet deny task=A1-9": "the run has no task A1-9",
    "add window:fleet/Z1 20s for 5s": "robot: found robot/Z1, expected one of the fleet",
    "add routine:Z1 20s motion": "robot: found robot/Z1, expected one of the fleet",
    'add 20s {"command": "LeaveFleet", "by": "robot/Z1", "robot": "robot/Z1"}': "LeaveFleet about robot/Z1 is",
    "rule fleet deny from 9000s": "the run has ended by then",
}


@pytest.mark.parametrize("change", few(REFUSED, [*REFUSED][:1]))
def test_what_is_refused_in_every_run_is_the_error_that_one_run_gives_and_names_that_run(
    call: Call, ledger: Path, tmp_path: Path, change: str
) -> None:
    of_fsar = ("--architecture", "fsar", "--change", change)
    one = call("whatif", ledger, "--run", "1", "--change", change)
    all_runs = call("whatif", ledger, "--all-runs", *of_fsar, "--out", tmp_path / "forks")
    one_message(all_runs, 2, REFUSED[change])
    bisected = call("bisect", ledger, *of_fsar, "--outcome", VIOLATED)
    one_message(bisected, 2, REFUSED[change])
    assert bisected.err == all_runs.err
    reason, _, named = all_runs.err.partition("; that is run ")
    assert f"{reason}\n" == one.err
    assert named.startswith("fsar.full.")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_what_is_refused_in_some_runs_is_counted_with_its_reason_and_parts_none_of_them(
    call: Call, fleets: Path
) -> None:
    out = call("whatif", fleets, "--all-runs", "--change", OF_EIGHT).good().out
    assert "fsar:full@A/4: 2 pairs, 0 of them diverge" in out
    assert out.count(f"\nin 2 of 2 a change has no effect: {UNKNOWN}\n") == 1
    told = json.loads(call("whatif", fleets, "--all-runs", "--change", OF_EIGHT, "--json").good().out)
    assert [(one["refused"], one["parts_at"] is None) for one in told["forks"]] == [
        *([(UNKNOWN, True)] * 2),
        *([(None, False)] * 2),
    ]
    assert [one["refused"] for one in told["effects"]] == [[{"reason": UNKNOWN, "pairs": 2}], []]
    bisected = ("bisect", fleets, "--change", OF_EIGHT, "--outcome", VIOLATED)
    assert f"\nin 2 of 4 a change has no effect: {UNKNOWN}\n" in call(*bisected).good().out
    assert json.loads(call(*bisected, "--json").good().out)["refused"] == [{"reason": UNKNOWN, "pairs": 2}]


@pytest.mark.slow
def test_a_fork_in_which_something_else_is_changed_parts_although_a_command_is_refused(
    call: Call, fleets: Path
) -> None:
    words = ("--change", OF_EIGHT, "--change", "drop window:*", "--json")
    forks = json.loads(call("whatif", fleets, "--all-runs", *words).good().out)["forks"]
    assert [one["refused"] is None for one in forks] == [False, False, True, True]
    assert None not in [one["parts_at"] for one in forks]


@pytest.mark.parametrize(
    "change",
    [
        "add window:fleet/B2 20s for 5s",
        "trust A1 B2 none",
        'add 20s {"command": "LeaveFleet", "by": "robot/B2", "robot": "robot/B2"}',
    ],
)
def test_what_a_refused_change_leaves_on_record_does_not_count(call: Call, fleets: Path, change: str) -> None:
    told = json.loads(call("whatif", fleets, "--all-runs", "--change", change, "--json").good().out)
    assert [one["diverging"] for one in told["effects"]] == [0, 2]


@pytest.mark.slow
def test_runs_of_several_constants_and_fleet_sizes_have_the_names_that_compare_has(
    call: Call, fleets: Path, tmp_path: Path
) -> None:
    place = tmp_path / "constants"
    made = ("--architecture", "fsar", "--scenario", "door-relay", "--runs", "1", "--workers", "1")
    for seed in ("3", "4"):
        call("simulate", place, *made, "--seed", seed).good()
    call("simulate", place, *made, "--set", "world.review_share=0.5").good()
    for ledger, names in ((place, ["fsar:full@A/4", "fsar:full@B/4"]), (fleets, ["fsar:full@A/4", "fsar:full@A/8"])):
        words = ("whatif", ledger, "--all-runs", "--change", "drop window:*")
        told = json.loads(call(*words, "--json").good().out)["effects"]
        assert [one["side"] for one in told] == names
        out = call(*words).good().out
        assert [line.partition(": ")[0] for line in out.splitlines() if " of them diverge" in line] == names
        for name in names:
            assert name in call("compare", ledger, "--first", "none").err


@pytest.mark.slow
def test_the_only_runs_of_an_architecture_are_named_by_it_alone(call: Call, ledger: Path) -> None:
    out = call("whatif", ledger, "--all-runs", "--change", "drop window:*").good().out
    assert [line.partition(": ")[0] for line in out.splitlines() if " of them diverge" in line] == [
        "fsar",
        "cfc",
        "dhma",
    ]


@pytest.mark.slow
def test_of_several_changes_of_which_one_is_refused_in_every_run_nobody_says_that_none_has_an_effect(
    call: Call, fleets: Path
) -> None:
    words = ("--change", "rule fleet deny robot=Z1", "--change", "drop window:*")
    told = call("whatif", fleets, "--all-runs", *words)
    one_message(told, 2, "unknown robot robot/Z1")
    assert "that is run fsar.full.door-relay.n4" in told.err
    assert "some change is refused in each of 4" in told.err


ENDS = "SELECT max(time_us) AS ended_us FROM events GROUP BY run_id HAVING max(time_us) > 0 ORDER BY run_id"


def fork_counts(call: Call, bases: Path, place: Path, *changes: str) -> list[bool]:
    """Whether each fork with these changes diverges; `whatif` and the query `forks` agree on that, and when it does."""
    words = [word for change in changes for word in ("--change", change)]
    told = json.loads(call("whatif", bases, "--all-runs", *words, "--out", place, "--json").good().out)["forks"]
    rows = json.loads(call("query", "forks", place, "--json").good().out)["rows"]
    parted = {row["run_id"]: (row["diverges"], row["parted_s"]) for row in rows}
    assert parted == {one["fork"]: (one["parts_at"] is not None, one["parted_s"]) for one in told}
    return [one["parts_at"] is not None for one in told]


@pytest.mark.slow
def test_the_query_forks_counts_no_fork_that_differs_only_in_a_command_that_it_rejects(
    call: Call, fleets: Path, tmp_path: Path
) -> None:
    given = 'add 20s {"command": "LeaveFleet", "by": "robot/B2", "robot": "robot/B2"}'
    of_four_and_eight = [False, False, True, True]
    assert fork_counts(call, fleets, tmp_path / "1", OF_EIGHT) == of_four_and_eight
    assert fork_counts(call, fleets, tmp_path / "2", given) == of_four_and_eight
    assert fork_counts(call, fleets, tmp_path / "3", OF_EIGHT, "drop window:*") == [True] * 4


@pytest.mark.slow
def test_the_query_forks_counts_no_fork_that_differs_only_in_what_its_fleet_does_not_know_or_is_too_late(
    call: Call, fleets: Path, tmp_path: Path
) -> None:
    of_four_and_eight = [False, False, True, True]
    for number, change in enumerate(
        ("add window:fleet/A2 20s for 30s", "add off:A2 20s for 30s", "rule fleet deny robot=B1 task=A2-1")
    ):
        assert fork_counts(call, fleets, tmp_path / f"{number}", change) == of_four_and_eight
    ends = [row["ended_us"] for row in json.loads(call("sql", fleets, ENDS, "--json").good().out)["rows"]]
    late_us = (min(ends) + max(ends)) / 2
    late = fork_counts(call, fleets, tmp_path / "late", f"rule fleet deny robot=B1 from {late_us / 1e6}s")
    assert late == [ended > late_us for ended in ends]


@pytest.mark.slow
def test_a_metric_that_no_pair_has_is_shown_with_the_number_of_its_pairs(call: Call, fleets: Path) -> None:
    words = ("whatif", fleets, "--all-runs", "--change", "drop task:A1-*")
    told = json.loads(call(*words, "--json").good().out)["effects"]
    four, eight = ({row["metric"]: row for row in one["rows"]} for one in told)
    assert list(four) == list(eight)
    assert (four["coordination_success"]["n"], four["coordination_success"]["difference"]) == (0, None)
    assert [four["policy_violations"]["n"], eight["coordination_success"]["n"]] == [2, 2]
    lines = call(*words).good().out.splitlines()
    assert [line.split()[1] for line in lines if line.startswith(("metric", "coordination_success"))] == [
        *("n", "0"),
        *("n", "2"),
    ]
