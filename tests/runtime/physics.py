"""Whole runs of every scenario in a world of which something differs from ours, for statements of physics."""

from collections.abc import Iterator
from functools import cache
from typing import Any

import msgspec
import pytest

from fsar_ledger.designs.constants import DURATIONS, Constants, Outages, Range, WorldConstants
from fsar_ledger.events import Event
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.events.envelope import Architecture, flat
from fsar_ledger.events.execution import (
    ExecutionFailed,
    ExecutionFinished,
    ExecutionPaused,
    ExecutionResumed,
    ExecutionStarted,
    RoutinePerformed,
)
from fsar_ledger.events.recovery import AssistanceEnded
from fsar_ledger.ledger.rows.codec import LedgerRun, encode
from fsar_ledger.metrics.results import metric_rows
from fsar_ledger.projections.fold import State, apply
from fsar_ledger.runtime.simulation import SCENARIOS, RunSpec, simulate_run
from tests.recycled import from_table

EVERY = pytest.mark.parametrize("architecture", PAPER_ARCHITECTURES)
RUNS = 3
QUIET = {"obstruction_rate_per_s": 0.0, "degradation_probability": 0.0}
LAWLESS = {"context_window_share": 0.0, "fleet_rule_rate_per_s": 0.0}
LATE_HANDS = {"response": Range(900.0, 1000.0)}
BLOCKED = {"obstruction_rate_per_s": 0.5, "obstruction_mean_s": 1e5}
LASTING = {  # executions that take half a minute, and time enough for them
    "durations": tuple((capability, Range(30.0, 40.0)) for capability, _ in DURATIONS),
    "budget_base_s": 600.0,
}
ALWAYS, FOREVER = 1e9, 1e9  # per second, seconds
OURS = WorldConstants()
MIXED = Outages(0.02, 8.0, 0.03, 6.0, 0.002)


class Played(msgspec.Struct, frozen=True, eq=False):
    """The runs of all scenarios in one world under one architecture."""

    architecture: Architecture
    constants: Constants
    runs: int
    records: tuple[LedgerRun, ...]

    @property
    def events(self) -> tuple[tuple[Event, ...], ...]:
        """The events of each run."""
        return tuple(tuple(record.events) for record in self.records)

    @property
    def metrics(self) -> dict[str, float | None]:
        """The mean of each metric, as SQL judges it."""
        return _measured(self.constants, self.runs)[self.architecture]

    def told(self) -> Iterator[tuple[State, int, Event]]:
        """Each event of each run with its time and the state before it."""
        for record in self.records:
            state = State()
            for time_us, event in zip(record.times_us, record.events, strict=True):
                yield state, time_us, event
                apply(state, event)


@cache
def in_world(architecture: Architecture, constants: Constants, runs: int) -> Played:
    """So many runs of each scenario under these constants."""
    specs = [RunSpec(5, architecture, "full", scenario, 4, run) for scenario in SCENARIOS for run in range(runs)]
    return Played(architecture, constants, runs, tuple(simulate_run(spec, constants) for spec in specs))


@cache
def _measured(constants: Constants, runs: int) -> dict[str, dict[str, float | None]]:
    """Of every architecture, since opening a database costs more than judging three times as many runs."""
    found: dict[str, dict[str, float | None]] = {architecture: {} for architecture in PAPER_ARCHITECTURES}
    with from_table(
        encode([record for one in PAPER_ARCHITECTURES for record in in_world(one, constants, runs).records]), threads=1
    ) as database:
        for row in metric_rows(database):
            found[row.architecture or ""][row.metric] = row.mean
    return found


def played(architecture: Architecture, **changes: object) -> Played:
    """The runs in a world of which only this differs from ours."""
    return in_world(architecture, Constants(world=msgspec.structs.replace(OURS, **changes)), RUNS)


def failing(architecture: Architecture, outages: Outages, **changes: object) -> Played:
    """One run of each scenario in a world that has these outages, and of which only this differs from ours."""
    return in_world(architecture, Constants(world=msgspec.structs.replace(OURS, **changes), outages=outages), 1)


def of(events: tuple[tuple[Event, ...], ...], *types: type[Event]) -> list[Any]:
    """The events of these types, of all runs."""
    return [event for run in events for event in run if isinstance(event, types)]


def robot_of(principal: str | None) -> str | None:
    """The robot that the principal is, or whose agent it is."""
    return "robot/" + principal.split("/")[1] if principal is not None and principal.startswith("agent/") else principal


def deeds(runs: Played) -> Iterator[tuple[State, int, str, Event]]:
    """What a robot does or decides: its execution, its decisions, its answers; with the state before it and the
    time."""
    doing = (ExecutionStarted, ExecutionResumed, ExecutionFinished, ExecutionFailed, ExecutionPaused, RoutinePerformed)
    for state, time_us, event in runs.told():
        robot = event.robot if isinstance(event, doing) else robot_of(flat(event).get("decided_by"))
        if robot is not None and robot in state.fleet.robots:
            yield state, time_us, robot, event
        if isinstance(event, AssistanceEnded):
            yield state, time_us, event.helper, event
