"""A recorded run is played again: given the recorded facts of the world, the handlers must decide what the record says, event by event.

| what | where replay has it from |
|---|---|
| what was played: seed, architecture, scenario, constants | `RunStarted`, as recorded |
| what the world did by itself (`events/world.py`), and when | the record |
| who founds the fleet, with which capabilities and trust | made again for the recorded fleet size, and compared |
| every decision: what, by whom, when, caused by which event | made again by the handlers, and compared |
| how long messages, ways, attempts, answers and executions take; whether a degraded actuator holds | drawn again under the recorded seed |

The last row is why only simulated runs can be replayed. The length of an execution stands in the record, too, as `ends_us`; it is
drawn again all the same, for to take it from there would be to believe the decision that is in question.

A ledger in which every hash agrees but a decision was forged before it was committed is found. A fact of the world that was
forged together with everything that follows from it is not: the world is taken as recorded here.
"""

import gc
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import lru_cache
from itertools import repeat
from pathlib import Path
from typing import get_args

import msgspec

from fsar_ledger.constants import Constants
from fsar_ledger.errors import InvalidExperiment
from fsar_ledger.events import Event
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.events.world import WorldEvent
from fsar_ledger.ledger import segment
from fsar_ledger.ledger.codec import RunRecord, decode
from fsar_ledger.ledger.read import open_ledger
from fsar_ledger.ledger.verify import MAX_PROBLEMS
from fsar_ledger.projections.fold import State
from fsar_ledger.workers import WorkerPool

from .experiment import Experiment
from .handlers.commands import Command, Decide
from .kernel import Kernel
from .simulation import MODEL_VERSION, RunSpec, founding_of, run_id, run_started, wiring
from .world.draws import Draws, run_key
from .world.scenarios import founding

_FACTS = frozenset(get_args(WorldEvent))
_END = "the end of the run"


class Difference(msgspec.Struct, frozen=True):
    """The first place where a record is not what was decided, or the reason why that could not be checked (`expected` and `actual` say it).

    `handler` is the function that makes what is expected, or that had its turn there and made nothing; None where there is none.
    `commit` and `segment` are where the run is stored, None while that is not known.
    """

    run: str | None
    seq: int | None
    field: str | None
    handler: str | None
    expected: str
    actual: str
    commit: int | None = None
    segment: str | None = None

    def __str__(self) -> str:
        parts = (("commit", self.commit), ("run", self.run), ("seq", self.seq), ("field", self.field))
        place = ", ".join(f"{name} {value}" for name, value in parts if value is not None)
        source = "" if self.handler is None else f" from {self.handler}"
        return f"{': '.join(filter(None, (self.segment, place)))}: found {self.actual}, expected {self.expected}{source}"


class ReplayReport(msgspec.Struct, frozen=True):
    """What `replay` found. Units: `commits`, `runs` and `events` are counts of what is as decided, to the last event."""

    ok: bool
    differences: tuple[Difference, ...] = ()
    commits: int = 0
    runs: int = 0
    events: int = 0


NOT_REPLAYED = ReplayReport(False)
"""The report on a ledger that does not verify: what its rows say is not known to be what was recorded."""


def replay(path: Path, workers: int = 1, progress: Callable[[int, int], None] | None = None, commits: int | None = None) -> ReplayReport:
    """Every run was played again, and of each that differs the first difference is in the report; so is each run that could not be checked.

    Args:
        path: The directory of the ledger, which is taken to verify.
        workers: Processes that play; the report does not depend on it.
        progress: Called with (segments done, segments in all).
        commits: Only the first so many; None is all of them.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted: as `open_ledger`, and where a segment is missing.
    """
    view = open_ledger(path)
    numbers = range(len(view.records))[:commits]
    files = [str(view.segment(number).relative_to(path)) for number in numbers]
    found: list[Difference] = []
    whole = runs = events = 0
    for done, result in enumerate(_replayed(str(path), files, max(1, workers)), start=1):
        found += result.differences
        whole, runs, events = whole + result.ok, runs + result.runs, events + result.events
        if progress is not None:
            progress(done, len(files))
    return ReplayReport(not found, tuple(found[:MAX_PROBLEMS]), whole, runs, events)


def _replayed(path: str, files: list[str], workers: int) -> Iterator[ReplayReport]:
    """The report of each commit, in order."""
    with ExitStack() as stack:
        if workers > 1 and len(files) > 1:
            pool = stack.enter_context(WorkerPool(min(workers, len(files))))
            yield from pool.map(replay_commit, repeat(path), range(len(files)), files)
        else:
            yield from map(replay_commit, repeat(path), range(len(files)), files)


def replay_commit(path: str, number: int, file: str) -> ReplayReport:
    """The report on the runs of one commit, in `file` of the ledger. Never raises."""
    found: list[Difference] = []
    runs = events = 0
    gc.disable()  # a run makes no cyclic garbage
    try:
        for record in decode(segment.read_table(Path(path) / file)):
            difference = replay_run(record)
            if difference is None:
                runs, events = runs + 1, events + len(record.events)
            else:
                found.append(msgspec.structs.replace(difference, commit=number, segment=file))
    except Exception as error:  # a check that fails in a way nobody thought of is still a finding
        found.append(Difference(None, None, None, None, "runs that can be replayed", _told(error), number, file))
    finally:
        gc.enable()
    return ReplayReport(not found, tuple(found), int(not found), runs, events)


def replay_run(record: RunRecord) -> Difference | None:
    """The first difference of the record from what the handlers decide, None if there is none. Never raises."""
    one: _Replay | None = None
    try:
        one = _begun(record)
        one.run()
        one.require_end()
    except _Differs as stopped:
        return stopped.difference
    except Exception as error:
        seq, handler = (0, None) if one is None else (len(one.events), one.handler())
        return Difference(record.run_id, seq, None, handler, "something that can be decided", _told(error))
    return None


def _told(error: Exception) -> str:
    if isinstance(error, MemoryError):
        raise error  # no fault of the ledger's
    return f"{type(error).__name__}: {error!s:.300}"


class _Differs(Exception):
    """The replay stops here."""

    def __init__(self, run: str, seq: int, field: str | None, handler: str | None, expected: str, actual: str) -> None:
        self.difference = Difference(run, seq, field, handler, expected, actual)


class _Replay(Kernel):
    """A run in progress that stops at the first event that is not as recorded."""

    def __init__(self, record: RunRecord, spec: RunSpec, constants: Constants) -> None:
        """The run stands after its founding. Raises: _Differs if the record has another one."""
        events, founded = founding_of(spec, constants)
        self._stored, self._count = record, len(record.events)
        self._deciding: Callable[..., tuple[Event, ...]] | None = founding
        self._silent: list[tuple[int, Decide]] = []  # when, and who had a turn since the last event and made nothing
        self._fact_us = 0
        for seq, event in enumerate(events):
            self._require(seq, event, 0, None if seq == 0 else 0)
        facts = [(time_us, event) for time_us, event in zip(record.times_us, record.events, strict=True) if type(event) in _FACTS]
        super().__init__(wiring(spec.architecture), facts, Draws(run_key(spec.seed, spec.scenario, spec.run), constants.world), events, founded)
        self._decides = {command: self._noted(decide) for command, decide in self._decides.items()}

    def handler(self) -> str | None:
        """The function that makes the next event, by module and name; None for the world."""
        return None if self._deciding is None else _name(self._deciding)

    def require_end(self) -> None:
        """Nothing is recorded that was not decided. Raises: _Differs."""
        seq = len(self.events)
        if seq < self._count:
            raise self._unasked(seq) or _Differs(self._stored.run_id, seq, "type", None, _END, self._actual(seq))

    def _noted(self, decide: Decide) -> Decide:
        """The same decision; that it is being taken is noted."""

        def noted(state: State, command: Command) -> tuple[Event, ...]:
            self._deciding = decide
            events = decide(state, command)
            if not events:
                self._silent.append((command.now_us, decide))
            return events

        return noted

    def _record(self, event: Event, time_us: int, cause: int | None) -> None:
        if cause == 0:
            self._deciding = None
        self._require(len(self.events), event, time_us, cause)
        if cause == 0:
            if time_us <= self._fact_us:
                expected = f"more than {self._fact_us}, the time of the fact of the world before it"
                raise _Differs(self._stored.run_id, len(self.events), "time_us", None, expected, str(time_us))
            self._fact_us = time_us
        self._silent.clear()
        super()._record(event, time_us, cause)

    def _require(self, seq: int, event: Event, time_us: int, cause: int | None) -> None:
        """The event of that seq is recorded as this one. Raises: _Differs."""
        stored = self._stored
        if seq >= self._count:
            raise _Differs(stored.run_id, seq, "type", self.handler(), _at(event, time_us), _END)
        if stored.events[seq] != event or stored.times_us[seq] != time_us or stored.caused_by[seq] != cause:
            raise self._unasked(seq) or _Differs(stored.run_id, seq, *self._first_field(seq, event, time_us, cause))

    def _first_field(self, seq: int, event: Event, time_us: int, cause: int | None) -> tuple[str, str | None, str, str]:
        """The first field in which the recorded event is another one: its name, the handler, expected, actual."""
        stored, actual_us = self._stored.events[seq], self._stored.times_us[seq]
        if type(stored) is not type(event):
            because = ", the next fact of the world in the record; nothing is decided before it" if type(event) in _FACTS else ""
            return "type", self.handler(), _at(event, time_us) + because, self._actual(seq)
        pairs: list[tuple[str, object, object]] = [("time_us", time_us, actual_us), ("caused_by", cause, self._stored.caused_by[seq])]
        pairs += [(name, getattr(event, name), getattr(stored, name)) for name in event.__struct_fields__]
        return next((name, self.handler(), f"{expected!r:.300}", f"{actual!r:.300}") for name, expected, actual in pairs if expected != actual)

    def _actual(self, seq: int) -> str:
        return _at(self._stored.events[seq], self._stored.times_us[seq])

    def _unasked(self, seq: int) -> _Differs | None:
        """The difference, if the recorded event stands where a handler had its turn and made nothing."""
        decide = dict(self._silent).get(self._stored.times_us[seq])
        return None if decide is None else _Differs(self._stored.run_id, seq, "type", _name(decide), "nothing", self._actual(seq))


def _name(function: Callable[..., object]) -> str:
    return f"{function.__module__}.{function.__qualname__}".removeprefix("fsar_ledger.runtime.")


def _at(event: Event, time_us: int) -> str:
    return f"{event.__struct_config__.tag} at {time_us} microseconds"


def _begun(record: RunRecord) -> _Replay:
    """The run at its founding. Raises: _Differs if it cannot be replayed, or its founding or name is another one."""
    started = record.events[0]
    if not isinstance(started, RunStarted):
        raise _Differs(record.run_id, 0, "type", None, "RunStarted.v1", _at(started, record.times_us[0]))
    spec, constants = _parameters(record.run_id, started)
    if run_id(started) != record.run_id:
        raise _Differs(record.run_id, 0, "run_id", None, repr(run_id(started)), repr(record.run_id))
    return _Replay(record, spec, constants)


def _parameters(run: str, started: RunStarted) -> tuple[RunSpec, Constants]:
    """What the run was made from. Raises: _Differs if this program cannot make such a run."""

    def refused(field: str | None, expected: str, actual: str) -> _Differs:
        return _Differs(run, 0, field, None, expected, f"{actual}, so the run cannot be replayed")

    if started.kind != "simulated" or started.scenario == "live":
        raise refused("kind", "a simulated run", f"a {started.kind} run, whose commands are not stored")
    if started.model_version != MODEL_VERSION:
        raise refused("model_version", f"{MODEL_VERSION!r}; replay it with the version that wrote it", repr(started.model_version))
    spec = RunSpec(started.seed, started.architecture, started.configuration, started.scenario, started.fleet_size, started.run)
    try:
        Experiment((spec.architecture,), (spec.scenario,), spec.run + 1, spec.seed, spec.fleet_size, (spec.configuration,))
    except InvalidExperiment as error:
        raise refused(None, "a run that can be simulated", str(error)) from error
    try:
        constants = _constants(started.parameters)
    except msgspec.MsgspecError as error:
        raise refused("parameters", "the constants of the model", str(error)) from error
    if run_started(spec, constants) != started:
        raise refused("parameters", "all constants of the model, in the form in which it writes them", f"{started.parameters!r:.300}")
    return spec, constants


@lru_cache(maxsize=8)
def _constants(parameters: str) -> Constants:
    return msgspec.json.decode(parameters, type=Constants)
