"""One run, from its parameters to its events; and batches of runs, simulated and staged here or by workers."""

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from functools import lru_cache
from hashlib import sha256
from importlib import import_module
from itertools import groupby
from pathlib import Path
from typing import TypeAlias

import msgspec

from fsar_ledger.base.errors import CommitTooLarge
from fsar_ledger.base.memory import without_collection
from fsar_ledger.base.workers import Cluster, WorkerPool, pool_of
from fsar_ledger.designs import Fleet
from fsar_ledger.designs.constants import Constants, Range, WorldConstants, write_constants
from fsar_ledger.designs.registered import PAPER_SCENARIOS
from fsar_ledger.events import CONCERNS, Event
from fsar_ledger.events.configuration import FULL, MECHANISMS, Configuration, removed_mechanisms
from fsar_ledger.events.fleet import ExperimentPlanned, RunStarted
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.rows.runs import joined, piece
from fsar_ledger.ledger.store.staging import Staged, stage
from fsar_ledger.projections.fold import State, fold

from .architectures import HandlerTable
from .kernel import Kernel
from .world import Draws, SimulatedEnvironment, founding, run_key
from .world.schedule import schedule

MODEL_VERSION = "3"

SCENARIOS = PAPER_SCENARIOS


class RunSpec(msgspec.Struct, frozen=True):
    """What identifies a run; changing any value gives another run."""

    seed: int
    architecture: str
    configuration: Configuration
    scenario: str
    fleet_size: int
    run: int


def run_started(spec: RunSpec, constants: Constants) -> RunStarted:
    """Return event 0 of the run."""
    return RunStarted(
        kind="simulated",
        observes=CONCERNS,
        architecture=spec.architecture,
        configuration=spec.configuration,
        scenario=spec.scenario,
        seed=spec.seed,
        fleet_size=spec.fleet_size,
        run=spec.run,
        model_version=MODEL_VERSION,
        parameters=write_constants(constants),
    )


def run_id(started: RunStarted) -> str:
    """Return a readable name with a digest of all parameters, so that other parameters give another name."""
    digest = sha256(msgspec.json.encode(started, order="sorted")).hexdigest()[:12]
    if started.kind == "live":
        return f"{started.forked_from_run or 'live'}-{digest}"
    cell = f"{started.architecture}.{started.configuration}.{started.scenario}"
    return f"{cell}.n{started.fleet_size}.s{started.seed}.r{started.run:04d}-{digest}"


def kernel(spec: RunSpec, constants: Constants, table: HandlerTable | None = None) -> Kernel:
    """Return the run at its founding, before any fact of the world.

    `table` replaces the architecture's own handler table.
    """
    table = table or handler_table_of(spec.architecture, spec.configuration)
    return Kernel(table, environment_of(spec, constants), *founding_of(spec, constants))


def environment_of(spec: RunSpec, constants: Constants) -> SimulatedEnvironment:
    """Return the world of the run."""
    facts = schedule(constants, spec.seed, spec.scenario, spec.run, spec.fleet_size)
    return SimulatedEnvironment(facts, draws_of(spec, constants))


def draws_of(spec: RunSpec, constants: Constants) -> Draws:
    """Return the draws of the run's world; the durations of an own fleet's capabilities are among them."""
    return Draws(run_key(spec.seed, spec.scenario, spec.run), _world(constants.world, constants.fleet))


@lru_cache(maxsize=8)
def _world(world: WorldConstants, fleet: Fleet | None) -> WorldConstants:
    own = tuple((each.name, Range(*each.lasts_s)) for each in fleet.capabilities if each.lasts_s) if fleet else ()
    return msgspec.structs.replace(world, durations=world.durations + own)


def founding_of(spec: RunSpec, constants: Constants, alone: tuple[Event, ...] = ()) -> tuple[tuple[Event, ...], State]:
    """Return the events with which the run begins, and the state after all of them but the first."""
    events, founded = fleet_founding(spec.fleet_size, constants, alone)
    return (run_started(spec, constants), *events), founded


def fleet_founding(
    fleet_size: int, constants: Constants, alone: tuple[Event, ...] = ()
) -> tuple[tuple[Event, ...], State]:
    """Return the events after event 0 with which a fleet of this size is founded, and the state after them.

    `alone`: the founding events of a robot alone, instead (`handlers.isolation`).
    """
    if alone:
        return alone, fold(alone)
    fleet = (fleet_size, constants.world.floor_teams, constants.fleet)
    return _founding(*fleet), _founded(*fleet)


_founding = lru_cache(maxsize=4)(founding)


@lru_cache(maxsize=4)
def _founded(fleet_size: int, floor_teams: int, fleet: Fleet | None) -> State:
    """Return the state after the founding of a fleet, before its run is known."""
    return fold(_founding(fleet_size, floor_teams, fleet))


def simulate_run(spec: RunSpec, constants: Constants, table: HandlerTable | None = None) -> LedgerRun:
    """Simulate the whole run."""
    run = kernel(spec, constants, table)
    run.run()
    return LedgerRun(run_id(run_started(spec, constants)), run.times_us, run.caused_by, run.events)


def simulate_slices(spec: RunSpec, constants: Constants, most: int) -> Iterator[LedgerRun]:
    """Simulate the run, and yield its events in parts of about `most` events.

    Only one part of the run is held in memory.
    """
    run = kernel(spec, constants)
    name = run_id(run_started(spec, constants))
    while True:
        run.run(most=most)
        part = run.take()
        yield msgspec.structs.replace(part, run_id=name, goes_on=not run.has_ended)
        if run.has_ended:
            return


def handler_table_of(architecture: str, configuration: Configuration = FULL) -> HandlerTable:
    """Return the architecture's handlers and reactions, without the mechanisms that the configuration lacks.

    The handlers themselves check for the mechanisms of the paper's ablation, so those do not change the table.
    """
    module = import_module(f".architectures.{architecture}", __package__)
    table: HandlerTable = getattr(module, architecture.upper())
    return table if removed_mechanisms(configuration) <= set(MECHANISMS) else _knocked_out(architecture, configuration)


@lru_cache(maxsize=32)
def _knocked_out(architecture: str, configuration: Configuration) -> HandlerTable:
    """Return the table from a cache, so that the kernel plans it once for all runs."""
    from .knockouts import knock_out

    return knock_out(handler_table_of(architecture), architecture, configuration)


def plan_id(planned: ExperimentPlanned) -> str:
    """Return a readable name with a digest of the whole plan, as for runs; no two plans share a name."""
    digest = sha256(msgspec.json.encode(planned, order="sorted")).hexdigest()[:12]
    return f"plan.n{planned.fleet_size}.s{planned.seed}.x{planned.run_count:04d}-{digest}"


def plan_record(planned: ExperimentPlanned) -> LedgerRun:
    """Return the record of a plan: a run with its name and one event, at time 0."""
    return LedgerRun(plan_id(planned), (0,), (None,), (planned,))


def plan_mismatch(record: LedgerRun) -> tuple[str, str, str] | None:
    """Return the first field in which the record of a plan is wrong, with what was found and expected, or None."""
    planned = record.events[0]
    assert isinstance(planned, ExperimentPlanned)
    expected = plan_record(planned)
    pairs = (("run_id", record.run_id, expected.run_id), ("time_us", record.times_us[0], expected.times_us[0]))
    return next(((field, f"{found!r:.300}", repr(right)) for field, found, right in pairs if found != right), None)


IN_FLIGHT = 2
"""Batches in progress per worker at most, so that memory stays flat."""
# See docs/decisions/segments-hold-65536-events.md.
COMMIT_EVENTS = 1 << 16
"""Events of a commit; independent of the number of workers."""

Batch: TypeAlias = tuple[RunSpec, ...]


class Staging(msgspec.Struct, frozen=True):
    """Simulates batches of runs and stages them for the ledger `out`.

    `held` is the number of events that the ledger has of each unfinished run. A batch is staged as segments of at most
    `COMMIT_EVENTS` events.
    """

    out: Path
    constants: Constants
    held: Mapping[str, int]

    def of_all(self, batches: Sequence[Batch], workers: int | WorkerPool) -> Iterator[Iterable[Staged]]:
        """Yield the staged segments of each batch, in order, from this process, new worker processes, or a pool.

        In this process a batch is simulated while its segments are consumed.
        """
        with pool_of(workers, len(batches)) as pool:
            yield from map(self._stream, batches) if pool is None else self._of_pool(batches, pool)

    def _of_pool(self, batches: Sequence[Batch], pool: Cluster | WorkerPool) -> Iterator[Iterable[Staged]]:
        queue: deque[Future[Sequence[Staged]]] = deque()
        for batch in batches:
            queue.append(pool.submit(self.of, batch))
            if len(queue) >= IN_FLIGHT * pool.workers:
                yield queue.popleft().result()
        while queue:
            yield queue.popleft().result()

    def of(self, batch: Batch) -> Sequence[Staged]:
        """Simulate and stage the batch."""
        return list(self._stream(batch))

    def _stream(self, batch: Batch) -> Iterator[Staged]:
        """Yield the batch's segments one at a time, with the collector off: a run creates no cycles."""
        with without_collection():
            for part in self._parts(batch):
                yield from self._fitted(part)

    def _parts(self, batch: Batch) -> Iterator[list[LedgerRun]]:
        """Yield the runs of the batch in parts of `COMMIT_EVENTS` events; the last part has the rest."""
        part: list[LedgerRun] = []
        room = COMMIT_EVENTS
        for spec in batch:
            for run in simulate_slices(spec, self.constants, COMMIT_EVENTS):
                start, end = max(0, self.held.get(run.run_id, 0) - run.first), len(run.events)
                while start < end:
                    stop = min(end, start + room)
                    part.append(piece(run, start, stop))
                    room -= stop - start
                    start = stop
                    if not room:
                        yield joined_parts(part)
                        part, room = [], COMMIT_EVENTS
        if part:
            yield joined_parts(part)

    def _fitted(self, part: list[LedgerRun]) -> Iterator[Staged]:
        """Stage the part, in halves if it does not fit into a segment."""
        try:
            yield stage(self.out, part)
        except CommitTooLarge:
            events = sum(len(run.events) for run in part)
            if events < 2:
                raise
            for half in _halves(part, events // 2):
                yield from self._fitted(half)


def joined_parts(part: Sequence[LedgerRun]) -> list[LedgerRun]:
    """Return the runs of a part, each in one piece."""
    return [joined(list(pieces)) for _, pieces in groupby(part, key=lambda run: run.run_id)]


def _halves(part: Sequence[LedgerRun], events: int) -> tuple[list[LedgerRun], list[LedgerRun]]:
    """Divide these runs after this many events."""
    first: list[LedgerRun] = []
    second: list[LedgerRun] = []
    for run in part:
        size = len(run.events)
        if events > 0:
            first.append(piece(run, 0, min(size, events)))
        if size > events:
            second.append(piece(run, max(0, events), size))
        events -= size
    return first, second
