"""`compare` as users call it: a table, JSON and CSV, of one ledger or of two, and refusals that say what there is."""

import csv
import io
import json
from pathlib import Path

import pytest

from fsar_ledger import record
from fsar_ledger.designs.constants import Constants
from fsar_ledger.events.envelope import Architecture
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.metrics.definitions import metrics, published_metrics
from fsar_ledger.runtime.experiment import ORIGIN
from fsar_ledger.runtime.simulation import RunSpec, run_started
from tests.cli.conftest import Call, one_message

CALLED = ("--outcome", "human_intervention > 0")


def begun(name: str, architecture: Architecture, run: int) -> LedgerRun:
    """A run of which nothing but its beginning is on record."""
    started = run_started(RunSpec(1, architecture, "full", "door-relay", 4, run), Constants())
    return LedgerRun(name, (0,), (None,), (started,))


def appended(path: Path, *runs: LedgerRun) -> Path:
    with Writer(path, ORIGIN) as writer:
        writer.append(stage(path, runs))
    return path


@pytest.mark.slow
def test_compare_says_what_is_paired_before_the_numbers(call: Call, ledger: Path) -> None:
    table = call("compare", ledger, "--first", "fsar", "--second", "cfc")
    lines = table.out.splitlines()
    assert table.code == 0
    assert lines[:2] == [
        "first: fsar:full@A/4 (4 runs), simulated, model 3",
        "second: cfc:full@A/4 (4 runs), simulated, model 3",
    ]
    assert lines[2:4] == [
        "4 pairs by seed, scenario and number: 4 met the same facts of the world",
        "the constants are the same",
    ]
    assert len([line for line in lines if line.startswith(("coordination_", "governance_", "reassignment_"))]) == 3
    answer = json.loads(call("compare", ledger, "--first", "fsar", "--second", "cfc", "--by", "scenario", "--json").out)
    assert (answer["pairs"], answer["same_facts"], answer["first"]["name"]) == (4, 4, "fsar:full@A/4")
    assert answer["other"] is None
    assert {row["scenario"] for row in answer["rows"]} == {"door-relay", "failure-recovery-chain"}
    rows = list(csv.DictReader(io.StringIO(call("compare", ledger, "--first", "fsar", "--second", "cfc", "--csv").out)))
    assert [row["metric"] for row in rows] == [one.name for one in metrics()]
    assert [row["n"] for row in rows][: len(published_metrics())] == ["4"] * len(published_metrics())


@pytest.mark.slow
def test_two_ledgers_are_compared_each_with_its_head(call: Call, ledger: Path, tmp_path: Path) -> None:
    one_run = ("--architecture", "fsar", "--scenario", "door-relay", "--runs", "1", "--seed", "7")
    call("simulate", tmp_path / "more", *one_run, "--fleet-size", "8")
    answer = json.loads(call("compare", ledger, tmp_path / "more", "--first", "fsar", "--json").out)
    assert (answer["pairs"], answer["same_draws"], answer["first_alone"]) == (1, 1, 3)
    assert answer["second"]["fleet_size"] == 8
    assert answer["other"]["head"]["root"] != answer["head"]["root"]
    assert any("the fleets differ in size (4 and 8 robots)" in line for line in answer["remarks"])


@pytest.mark.slow
def test_recordings_are_in_no_pair_and_nobody_is_told_to_simulate_them(call: Call, tmp_path: Path) -> None:
    for name in ("hall", "yard"):
        with record(tmp_path / name, run=name, observes=["ExecutionStarted"]):
            pass
    told = call("compare", tmp_path / "hall", tmp_path / "yard")
    assert "runs of a real fleet have none and form no pairs: `fsar-ledger metrics` shows" in told.out
    assert "simulate" not in told.out
    assert told.out.splitlines()[0] == "first: recorder (1 run), foreign, recorder"
    assert told.out.splitlines()[-1] == "no constants are on record"
    one_message(call("compare", tmp_path / "hall"), 2, "found 1 side", "give a second ledger")
    bisected = call("bisect", tmp_path / "hall", tmp_path / "yard", *CALLED)
    one_message(bisected, 2, "number; runs of a real fleet have none; `fsar-ledger diff` compares any two runs")


def test_recordings_without_an_architecture_are_named_by_their_sources(call: Call, tmp_path: Path) -> None:
    for source in ("hall", "yard"):
        with record(tmp_path / "both", run=source, source=source, observes=["ExecutionStarted"]):
            pass
    one_message(call("compare", tmp_path / "both", "--first", "door"), 2, "it holds hall (1 run), yard (1 run)")
    lines = call("compare", tmp_path / "both", "--first", "yard").out.splitlines()
    assert lines[:2] == ["first: yard (1 run), foreign, yard", "second: hall (1 run), foreign, hall"]


def test_compare_refuses_what_it_cannot_tell(call: Call, ledger: Path) -> None:
    one_message(call("compare", ledger), 2, "found 3 sides, expected two", "dhma:full@A/4 (4 runs)")
    one_message(
        call("compare", ledger, "--first", "fsra", "--second", "cfc"),
        2,
        "--first fsra: found no such runs",
        "fsar:full@A/4",
    )
    one_message(call("compare", ledger, ledger, "--first", "fsar"), 2, "found the same events in both")
    one_message(call("compare", ledger, "--by", "robot"), 2, "--by robot: expected --by scenario")


@pytest.mark.slow
def test_bisect_and_compare_tell_alike_of_runs_without_a_partner(call: Call, tmp_path: Path) -> None:
    sides = ("--first", "fsar", "--second", "cfc")
    runs = (begun("one", "fsar", 0), begun("its pair", "cfc", 0), begun("two", "fsar", 1), begun("three", "fsar", 2))
    path = appended(tmp_path / "ledger", *runs, begun("elsewhere", "cfc", 7))
    for words in (("compare", path, *sides), ("bisect", path, *sides, *CALLED)):
        told = call(*words).good()
        assert "2 runs of the first side have no partner\n" in told.out
        assert "1 run of the second side has no partner\n" in told.out
        answer = json.loads(call(*words, "--json").out)
        assert (answer["first_alone"], answer["second_alone"]) == (2, 1)


@pytest.mark.slow
def test_of_several_runs_of_one_world_bisect_takes_none(call: Call, tmp_path: Path) -> None:
    twins = (begun("one", "fsar", 0), begun("other", "fsar", 0), begun("its pair", "cfc", 0))
    sides = ("--first", "fsar", "--second", "cfc")
    left_out = "cannot be told apart: one side has several runs of one seed, scenario and number"
    path = appended(tmp_path / "both", *twins, begun("next", "fsar", 1), begun("its pair, too", "cfc", 1))
    told = call("bisect", path, *sides, *CALLED).good()
    assert "1 pair: 0 have the outcome on both sides, 1 on neither" in told.out
    assert f"left out: 2 pairs that {left_out}" in told.out
    assert f"left out: 2 pairs that {left_out}" in call("compare", path, *sides).out
    assert json.loads(call("bisect", path, *sides, *CALLED, "--json").out)["repeated"] == 2
    alone = call("bisect", appended(tmp_path / "twins", *twins), *sides, *CALLED)
    one_message(alone, 2, "found 2 pairs in which one side has several runs of one seed, scenario and number")
