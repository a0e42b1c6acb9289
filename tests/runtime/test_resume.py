"""Stop anywhere, fold the stored events, derive what is pending, go on: the rest is the same.

Architectures and handlers keep nothing of their own, so state and pending commands follow from the events.
"""

import io
from collections.abc import Iterator
from itertools import count

import pyarrow.parquet as pq
import pytest

from fsar_ledger.designs.constants import Constants, Outages
from fsar_ledger.events import Event
from fsar_ledger.events.configuration import CONFIGURATIONS, PAPER_ARCHITECTURES, Configuration
from fsar_ledger.events.envelope import Architecture, Robot, Scenario
from fsar_ledger.events.world import LinkCameUp, LinkWentDown, RobotCameBack, RobotWentOff
from fsar_ledger.ledger.rows.codec import LedgerRun, decode, encode
from fsar_ledger.projections.fold import State, fold
from fsar_ledger.runtime.architectures import HandlerTable
from fsar_ledger.runtime.architectures.fsar.execution import decide_routine
from fsar_ledger.runtime.handlers.commands import DecideRoutine
from fsar_ledger.runtime.simulation import SCENARIOS, RunSpec, handler_table_of, kernel, simulate_run
from tests.quick import few

CONSTANTS = Constants()
OUTAGES = Constants(outages=Outages(0.02, 8.0, 0.03, 6.0, 0.002))


def stored(record: LedgerRun) -> LedgerRun:
    """The run as it comes back from Parquet."""
    sink = io.BytesIO()
    pq.write_table(encode([record]), sink)
    [back] = decode(pq.read_table(io.BytesIO(sink.getvalue())))
    return back


def resumed(
    spec: RunSpec, record: LedgerRun, position: int, constants: Constants
) -> tuple[list[int], list[int | None], list[object]]:
    one = kernel(spec, constants)
    one.restore(record.times_us[:position], record.caused_by[:position], record.events[:position])
    one.run()
    return one.times_us, one.caused_by, list(one.events)


def positions(length: int, founding: int, places: int) -> Iterator[int]:
    """Positions spread over the run by a step that meets all kinds of places."""
    step = max(1, (length - founding) // places)
    yield from range(founding + 1, length, step)
    yield length


def assert_resumes(spec: RunSpec, places: int, constants: Constants = CONSTANTS) -> None:
    record = stored(simulate_run(spec, constants))
    founding = sum(time == 0 for time in record.times_us)
    for position in positions(len(record.events), founding, places):
        times, causes, events = resumed(spec, record, position, constants)
        assert (times, causes, events) == (list(record.times_us), list(record.caused_by), list(record.events)), (
            f"stopped at {position}"
        )


@pytest.mark.parametrize("architecture", PAPER_ARCHITECTURES)
@pytest.mark.parametrize("scenario", few(SCENARIOS, ["door-relay", "fleet-contention"]))
def test_a_run_resumes_anywhere(scenario: Scenario, architecture: Architecture) -> None:
    for run in range(2):
        assert_resumes(RunSpec(5, architecture, "full", scenario, 4, run), 25)


@pytest.mark.parametrize("configuration", CONFIGURATIONS[1:])
def test_an_ablated_run_resumes_anywhere(configuration: Configuration) -> None:
    for scenario in SCENARIOS:
        assert_resumes(RunSpec(5, "fsar", configuration, scenario, 4, 0), 8)


@pytest.mark.parametrize("architecture", few(PAPER_ARCHITECTURES, ["fsar"]))
def test_a_run_resumes_at_every_single_position(architecture: Architecture) -> None:
    assert_resumes(RunSpec(6, architecture, "full", "failure-recovery-chain", 4, 3), 10_000)


@pytest.mark.parametrize("architecture", PAPER_ARCHITECTURES)
@pytest.mark.parametrize("run", few(range(2), [0]))
def test_a_run_with_outages_resumes_anywhere(architecture: Architecture, run: int) -> None:
    """What is kept for a robot that is off, or for a link that is down, follows from the events as well."""
    spec = RunSpec(5, architecture, "full", "fleet-contention", 4, run)
    types = {type(event) for event in simulate_run(spec, OUTAGES).events}
    assert types >= {RobotWentOff, RobotCameBack, LinkWentDown, LinkCameUp}
    assert_resumes(spec, 60, OUTAGES)


def test_a_larger_fleet_resumes_anywhere() -> None:
    for architecture in PAPER_ARCHITECTURES:
        assert_resumes(RunSpec(5, architecture, "full", "fleet-contention", 8, 0), 6)


def test_the_live_state_is_the_fold_of_the_stored_events() -> None:
    for architecture in PAPER_ARCHITECTURES:
        spec = RunSpec(7, architecture, "full", "fleet-contention", 4, 0)
        one = kernel(spec, CONSTANTS)
        one.run()
        back = stored(simulate_run(spec, CONSTANTS))
        assert fold(back.events) == one.state


def with_memory() -> HandlerTable:
    """Broken on purpose: a handler that counts its calls and every other time does nothing."""
    whole, calls = handler_table_of("fsar"), count()

    def decide(state: State, command: DecideRoutine) -> tuple[Event, ...]:
        return decide_routine(state, command) if next(calls) % 2 else ()

    return HandlerTable({**whole.decides, DecideRoutine: decide}, whole.reacts)


def test_an_architecture_with_a_memory_of_its_own_does_not_resume() -> None:
    spec = RunSpec(5, "fsar", "full", "door-relay", 4, 0)
    record = simulate_run(spec, CONSTANTS, with_memory())
    half = next(
        seq
        for seq in range(len(record.events) // 2, len(record.events))
        if type(record.events[seq]).__name__ == "RoutineDue"
    )

    def rest(structure: HandlerTable) -> list[Event]:
        one = kernel(spec, CONSTANTS, structure)
        one.restore(record.times_us[:half], record.caused_by[:half], record.events[:half])
        one.run()
        return one.events

    assert any(rest(structure) != list(record.events) for structure in (with_memory(), _shifted()))


def _shifted() -> HandlerTable:
    """The same memory, one call further on: at one of two phases the rest must differ."""
    structure = with_memory()
    structure.decides[DecideRoutine](fold(()), DecideRoutine(Robot("robot/A1"), "sensing"))
    return structure
