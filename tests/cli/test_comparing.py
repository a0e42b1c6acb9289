"""`statistics` says whose worlds differ before any number, and why it compares nothing; `--pool` is asked for by
name."""

import csv
import io
import json
from pathlib import Path

import msgspec
import pytest

from fsar_ledger.designs.constants import Constants
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.runtime.experiment import ORIGIN, Experiment
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.simulation import RunSpec, founding_of, handler_table_of, run_id, run_started, simulate_run
from fsar_ledger.runtime.world import Draws, SimulatedEnvironment, run_key
from fsar_ledger.runtime.world.schedule import schedule
from tests.cli.conftest import Call, one_message

CONSTANTS = Constants()
EXPERIMENT = Experiment(("fsar", "cfc"), ("door-relay",), runs=2, seed=7)


@pytest.fixture(scope="module")
def unlike(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ledger in which the first run of FSAR met a world without one of its facts."""
    path = tmp_path_factory.mktemp("unlike") / "ledger"
    records = [simulate_run(spec, CONSTANTS) for spec in EXPERIMENT.specs()]
    spec: RunSpec = next(EXPERIMENT.specs())
    facts = schedule(CONSTANTS, spec.seed, spec.scenario, spec.run, spec.fleet_size)
    one = Kernel(
        handler_table_of(spec.architecture),
        SimulatedEnvironment(facts[:-1], Draws(run_key(spec.seed, spec.scenario, spec.run), CONSTANTS.world)),
        *founding_of(spec, CONSTANTS),
    )
    one.run()
    records[0] = msgspec.structs.replace(records[0], times_us=one.times_us, caused_by=one.caused_by, events=one.events)
    assert records[0].run_id == run_id(run_started(spec, CONSTANTS))
    with Writer(path, ORIGIN) as writer:
        writer.append(stage(path, records))
    return path


@pytest.mark.slow
def test_statistics_name_differing_worlds_before_any_number_and_fail(call: Call, unlike: Path) -> None:
    table = call("statistics", unlike)
    lines = table.out.splitlines()
    assert table.code == 1
    assert lines[0].startswith(
        "fsar-cfc: 1 pair of runs is left out: they did not meet the same facts of the world; first under seed "
        "7, door-relay, 4 robots, run 0"
    )
    assert " 1 " in next(line for line in lines[1:] if "coordination_success" in line)
    answer = json.loads(call("statistics", unlike, "--json").out)
    assert [one["differs"] for one in answer["differing_worlds"]] == ["facts"]
    assert {row["n"] for row in answer["rows"]} == {1}
    # The runs without a failure are in the pair that is left out.
    assert not any("(basis published)" in line for line in answer["remarks"]), answer["remarks"]
    as_csv = call("statistics", unlike, "--csv")
    assert (as_csv.code, "1 pair of runs is left out" in as_csv.err) == (1, True)
    assert {row["n"] for row in csv.DictReader(io.StringIO(as_csv.out))} == {"1"}


@pytest.mark.slow
def test_statistics_with_nothing_to_compare_say_why(call: Call, tmp_path: Path) -> None:
    alone = tmp_path / "alone"
    call("simulate", alone, "--architecture", "fsar", "--scenario", "door-relay", "--runs", "1", "--workers", "1")
    why = "fsar-cfc: found 1 run of fsar (full) and none of cfc (full)"
    table = call("statistics", alone).good()
    assert table.out.startswith("nothing to compare; ")
    assert why in table.out
    answer = json.loads(call("statistics", alone, "--json").out)
    assert answer["rows"] == []
    assert answer["not_compared"][0].startswith(why)
    as_csv = call("statistics", alone, "--csv")
    assert why in as_csv.err
    assert as_csv.out.startswith("family,configuration")


@pytest.mark.parametrize("command", ["metrics", "statistics"])
def test_only_seeds_are_pooled(call: Call, unlike: Path, command: str) -> None:
    one_message(call(command, unlike, "--pool", "constants"), 2, "--pool constants: expected --pool seeds")


@pytest.mark.slow
def test_forks_are_not_counted_as_runs(call: Call, ledger: Path, tmp_path: Path) -> None:
    place = tmp_path / "forks"
    for runs in (("--all-runs", "--architecture", "fsar"), ("--run", "2")):
        call("whatif", ledger, *runs, "--change", "drop window:*", "--out", place).good()
    answer = json.loads(call("statistics", place, "--json").out)
    assert [line.partition(" (full)")[0] for line in answer["not_compared"]] == [
        "fsar-dhma: found 4 runs and 4 forks of fsar",
        "cfc-dhma: found 1 run and 1 fork of cfc",
    ]
    assert "fsar-cfc: 3 runs and 3 forks of fsar under seed 7 have no partner and are left out" in answer["remarks"]
