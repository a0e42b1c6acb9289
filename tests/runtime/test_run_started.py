"""Event 0: what it says of runs that are simulated, live or foreign, and that groups of constants added later change
nothing."""

import pickle
from pathlib import Path

import msgspec
import pytest

from fsar_ledger.designs.constants import Constants, Load, Range, WorldConstants, read_constants, write_constants
from fsar_ledger.events import CONCERNS
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.events.retired import UPCASTS, RunStartedV1
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.rows.schema import LAYOUTS
from fsar_ledger.ledger.v1 import upgrade
from fsar_ledger.ledger.verify import verify
from fsar_ledger.metrics.database import connect
from fsar_ledger.projections import fleet
from fsar_ledger.runtime.simulation import RunSpec, run_id, run_started, simulate_run
from tests.ledger.keep_release import LEDGERS
from tests.ledger.samples import append_all

SPEC = RunSpec(42, "fsar", "full", "door-relay", 4, 0)


class Lift(msgspec.Struct, frozen=True):
    """A group of constants that does not exist yet."""

    capacity_count: int = 2


class LaterConstants(Constants, frozen=True):
    """The constants of a later release, with one group more."""

    lift: Lift | None = None


def test_a_group_of_constants_added_later_changes_neither_run_ids_nor_the_root(tmp_path: Path) -> None:
    roots, ids = [], []
    for constants in (Constants(), LaterConstants()):
        record = simulate_run(SPEC, constants)
        roots.append(append_all(tmp_path / type(constants).__name__, [[record]]).root)
        ids.append(record.run_id)
    assert len(set(ids)) == len(set(roots)) == 1


def test_a_group_that_is_there_makes_another_run_and_is_recorded() -> None:
    later = LaterConstants(lift=Lift())
    assert write_constants(later) == write_constants(Constants())[:-1] + ',"lift":{"capacity_count":2}}'
    assert run_id(run_started(SPEC, later)) != run_id(run_started(SPEC, Constants()))
    assert read_constants(write_constants(later)) == Constants()


def test_what_a_design_leaves_out_and_what_it_writes_out_is_so_in_every_process() -> None:
    """msgspec leaves a default out by its identity, and equal constants are one key of a cache."""
    tasks = '"tasks":[{"owner":"A","steps":["A navigate.indoor"]'
    left_out, written_out = (f"{tasks}{more}}}]" for more in ("", ',"offset_s":0.0'))
    for text in (left_out, written_out, left_out):
        own = read_constants(f'{write_constants(Constants())[:-1]},"scenario":{{"name":"night",{text}}}}}')
        sent: Constants = pickle.loads(pickle.dumps(own))  # as a worker gets it
        assert sent == own
        assert text in write_constants(sent) == run_started(SPEC, own).parameters


def test_equal_constants_are_one_text() -> None:
    ours = Constants()
    given = Constants(
        world=msgspec.structs.replace(WorldConstants(), horizon_s=240), load=Load(task_sets=2, interval_s=30)
    )
    assert ours.world == given.world
    assert write_constants(given) == write_constants(Constants(load=Load(task_sets=2, interval_s=30.0)))
    assert write_constants(given).startswith(write_constants(ours)[:-1])


def test_zero_is_one_text_whatever_its_sign() -> None:
    durations = (("-0.0", Range(-0.0, 1.0)),)
    one, other = (
        Constants(WorldConstants(obstruction_rate_per_s=zero, durations=(("-0.0", Range(zero, 1.0)),)))
        for zero in (0.0, -0.0)
    )
    assert one == other
    assert write_constants(one) == write_constants(other)
    assert read_constants(write_constants(other)).world.durations == durations


def test_a_simulated_run_observes_every_concern() -> None:
    assert run_started(SPEC, Constants()).observes == CONCERNS
    assert len(set(CONCERNS)) == len(CONCERNS)


@pytest.mark.parametrize("version", ["0.1.0", "0.2.0"])
def test_runs_of_earlier_releases_observe_all_that_there_was(version: str, tmp_path: Path) -> None:
    upgrade(LEDGERS / version / "ledger", tmp_path / "upgraded")
    started = [run.events[0] for run in open_ledger(tmp_path / "upgraded").runs()]
    assert [event.observes for event in started if isinstance(event, RunStarted)] == [CONCERNS] * 3


def test_a_retired_start_keeps_all_that_it_said() -> None:
    values = {
        "kind": "live",
        "seed": 7,
        "architecture": "cfc",
        "configuration": "full",
        "scenario": "live",
        "fleet_size": 8,
        "run": 3,
        "model_version": "1",
    }
    event = RunStartedV1(**values, parameters="{}")  # type: ignore[arg-type]
    [change] = UPCASTS[RunStartedV1]
    assert change(event) == RunStarted(**values, parameters="{}", observes=CONCERNS)  # type: ignore[arg-type]


def test_a_run_from_outside_is_stored_with_what_it_has(tmp_path: Path) -> None:
    started = RunStarted(
        kind="foreign",
        observes=("fleet", "execution"),
        architecture="open-rmf",
        scenario="Ward 3, night",
        source="traffic log of a hospital",
    )
    append_all(tmp_path / "ledger", [[LedgerRun("night", [0], [None], [started])]])
    assert verify(tmp_path / "ledger").ok
    [record] = open_ledger(tmp_path / "ledger").runs()
    assert record.events == [started]
    assert fleet.evolve(fleet.INITIAL, started) == fleet.INITIAL
    with connect(tmp_path / "ledger") as database:
        [row] = database.query("staging/runs").to_pylist()
    missing = {"seed", "configuration", "fleet_size", "run", "model_version", "parameters_sha256", "forked_from"}
    assert {name for name, value in row.items() if value is None} == missing
    assert (row["kind"], row["observes"]) == ("foreign", ["fleet", "execution"])
    assert row["source"] == "traffic log of a hospital"


def test_names_of_what_a_run_plays_are_open_text_and_its_kind_is_not() -> None:
    values = {field.name: field.values for field in LAYOUTS["RunStarted.v2"].fields}
    assert {name for name, found in values.items() if found is not None} == {"kind"}
    assert values["kind"] == frozenset({"simulated", "live", "foreign"})
