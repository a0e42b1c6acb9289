"""Replay: the world and the handlers must make a run again from its parameters, exactly as recorded, event by event.

- What was simulated (seed, architecture, scenario, constants): taken from `RunStarted` as recorded. Constants other
  than this version's are a remark (`run_constants.py`).
- What the world did by itself (`events/world.py`), and when: made again (`world/schedule.py`) and compared, so that
  nothing is left out, added or changed.
- Who founds the fleet, with which capabilities and trust: made again for the recorded fleet size, and compared.
- Every decision (what, by whom, when, caused by which event): made again by the handlers, and compared.
- What was planned (`ExperimentPlanned`, which is no run): taken as recorded; its name is a digest of it.
- How long messages, ways, attempts, answers and executions take, and whether a degraded actuator holds: drawn again
  under the recorded seed.

So a simulated run has only one possible record, and nothing in it is taken on trust but its first event, whose digest
is in the run's name. The schedule is made to its horizon and a run ends when nothing is left to happen, so the whole
schedule is in the record. The facts of the paper's workflows follow from their scenario, and are also made again.

The first event of a fork says what is otherwise than in its base (`recipes.py`). The fork is made again with that, the
base without, and how far the one repeats the other is compared with what the first event says. Live and foreign runs
declare nothing from which they could be made: they are refused.

A replay can also be asked to take what the world did and answered from the record (`recorded.py`). It checks every
decision, and that none is missing, whatever world the run was in; that this world was the one of the seed, it does not.

The record also holds the length of an execution, as `ends_us`. It is drawn again all the same: taking it from the
record would be to believe the decision in question.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import repeat
from pathlib import Path

import msgspec

from fsar_ledger.base.memory import without_collection
from fsar_ledger.base.workers import WorkerPool
from fsar_ledger.events import ALONE, Event
from fsar_ledger.events.envelope import flat
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows import segment
from fsar_ledger.ledger.rows.codec import LedgerRun, decode
from fsar_ledger.ledger.rows.runs import joined
from fsar_ledger.ledger.verify.report import MAX_PROBLEMS
from fsar_ledger.projections.fold import State

from .forks import command, edited_environment, last_shared, run_to_end
from .handlers.commands import Command, Decide
from .recipes import CannotReplay, Recipe, WorldConstantsUsed, constants_used, recorded_recipe, remarks_on, started_of
from .recorded import FACTS, RecordedEnvironment, RecordedKernel, recorded_environment
from .simulation import founding_of, handler_table_of, plan_mismatch, run_id
from .world.founding import founding
from .world.schedule import schedule

_END = "the end of the run"

MAX_SILENT = 100_000
"""The most consecutive decisions that make no event; no run of the model needs a hundred."""


class Difference(msgspec.Struct, frozen=True):
    """The first place where a record differs from what was decided, or the reason why that could not be checked.

    `expected` and `actual` say which. `handler` is the function that makes what is expected, or that had its turn there
    and made nothing; None where there is none. `commit` and `segment` say where the run is stored, None where that is
    not known.
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
        return (
            f"{': '.join(filter(None, (self.segment, place)))}: found {self.actual}, expected {self.expected}{source}"
        )


class ReplayReport(msgspec.Struct, frozen=True):
    """The result of `replay`.

    Units: `commits`, `runs` and `events` (of runs) count what replay made exactly as recorded.

    `remarks` do not cast doubt on a run: they name constants that are not this version's.
    """

    ok: bool
    differences: tuple[Difference, ...] = ()
    commits: int = 0
    runs: int = 0
    events: int = 0
    remarks: tuple[str, ...] = ()


class CommitReport(msgspec.Struct, frozen=True):
    """The result of `replay_commit`: as `ReplayReport`, for one commit.

    `worlds` are those of the runs that replayed as recorded.
    """

    differences: tuple[Difference, ...]
    worlds: tuple[WorldConstantsUsed, ...]
    runs: int
    events: int

    @property
    def ok(self) -> bool:
        """Return whether nothing differs."""
        return not self.differences


NOT_REPLAYED = ReplayReport(False)
"""The report on a ledger that does not verify: its rows may not be what was recorded."""


def replay(
    path: Path,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
    commits: int | None = None,
    is_recorded: bool = False,
) -> ReplayReport:
    """Replay every run, and report the first difference of each run that differs or could not be checked.

    Args:
        path: The directory of the ledger, which is assumed to verify.
        workers: Number of processes; the report does not depend on it.
        progress: Called with (segments done, segments in all).
        commits: How many of the first commits to replay; None is all.
        is_recorded: Take what the world did and answered from the record.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted: as `open_ledger`, and where a segment is missing.
    """
    view = open_ledger(path)
    groups = view.groups()[:commits]
    files = [tuple(_within(path, view.segment(number)) for number in group) for group in groups]
    found: list[Difference] = []
    worlds: list[WorldConstantsUsed] = []
    whole = runs = events = 0
    for done, result in enumerate(_replayed(str(path), files, max(1, workers), is_recorded), start=1):
        found += result.differences
        worlds += result.worlds
        whole, runs, events = whole + result.ok, runs + result.runs, events + result.events
        if progress is not None:
            progress(done, len(files))
    return ReplayReport(not found, tuple(found[:MAX_PROBLEMS]), whole, runs, events, remarks_on(worlds))


def _within(path: Path, file: Path) -> str:
    """Return the name of a file within the ledger; of one outside, its path."""
    return str(file.relative_to(path) if file.is_relative_to(path) else file)


def _replayed(path: str, files: list[tuple[str, ...]], workers: int, is_recorded: bool) -> Iterator[CommitReport]:
    """Yield the report of each group of segments, in order."""
    asked = repeat(path), range(len(files)), files, repeat(is_recorded)
    with ExitStack() as stack:
        if workers > 1 and len(files) > 1:
            pool = stack.enter_context(WorkerPool(min(workers, len(files))))
            yield from pool.map(replay_commit, *asked)
        else:
            yield from map(replay_commit, *asked)


@without_collection()  # a run makes no cyclic garbage
def replay_commit(path: str, number: int, files: tuple[str, ...], is_recorded: bool = False) -> CommitReport:
    """Return the report on the runs of one commit, in these files of the ledger; other arguments as of `replay`.

    Files are those that share runs, and `number` counts such groups.

    Never raises.
    """
    found: list[Difference] = []
    starts: list[RunStarted] = []
    runs = events = 0
    try:
        for record in _runs_in(Path(path), files):
            difference = replay_run(record, is_recorded)
            if difference is None and type(record.events[0]) in ALONE:
                continue
            if difference is None:
                runs, events = runs + 1, events + len(record.events)
                starts += [event for event in record.events[:1] if isinstance(event, RunStarted)]
            else:
                found.append(msgspec.structs.replace(difference, commit=number, segment=files[0]))
    except Exception as error:  # a check that fails in an unforeseen way is still a finding
        found.append(
            Difference(None, None, None, None, "runs that can be replayed", _error_text(error), number, files[0])
        )
    return CommitReport(tuple(found), constants_used(starts), runs, events)


def _runs_in(path: Path, files: tuple[str, ...]) -> Iterator[LedgerRun]:
    """Yield the runs in these files of the ledger, which share them with no others."""
    if len(files) == 1:
        yield from decode(segment.read_table(path / files[0]))
        return
    pieces: dict[str, list[LedgerRun]] = {}
    for file in files:
        for piece in decode(segment.read_table(path / file), is_whole=False):
            pieces.setdefault(piece.run_id, []).append(piece)
    yield from map(joined, pieces.values())


def _replay_plan(record: LedgerRun) -> Difference | None:
    """Return the first field in which the record of a plan is wrong, or None.

    What was planned is taken as recorded; the plan's name is a digest of it.
    """
    found = plan_mismatch(record)
    return (
        None if found is None else Difference(record.run_id, 0, found[0], "simulation.plan_record", found[2], found[1])
    )


def replay_run(record: LedgerRun, is_recorded: bool = False) -> Difference | None:
    """Return the first difference between the record and what world and handlers make, or None. Never raises.

    With `is_recorded` the world is that of the record.
    """
    one: _Replay | None = None
    try:
        if type(record.events[0]) in ALONE:
            return _replay_plan(record)
        one = _start_replay(record, is_recorded)
        one.run_to_end()
        one.require_end()
    except _Mismatch as stopped:
        return stopped.difference
    except Exception as error:
        seq, handler = (0, None) if one is None else (len(one.events), one.handler())
        return Difference(record.run_id, seq, None, handler, "something that can be decided", _error_text(error))
    return None


def _error_text(error: Exception) -> str:
    if isinstance(error, MemoryError):
        raise error  # not the ledger's fault
    return f"{type(error).__name__}: {error!s:.300}"


class _Mismatch(Exception):
    """Raised to end a replay at a difference."""

    def __init__(self, run: str, seq: int, field: str | None, handler: str | None, expected: str, actual: str) -> None:
        self.difference = Difference(run, seq, field, handler, expected, actual)


class _Replay(RecordedKernel):
    """A run in progress that stops at the first event that differs from the record."""

    def __init__(self, record: LedgerRun, started: RunStarted, recipe: Recipe, is_recorded: bool) -> None:
        """Make the run up to its founding. Raises: _Differs if the record has another one."""
        spec, (founding_events, founded) = recipe.spec, founding_of(recipe.spec, recipe.constants)
        events = (started_of(recipe, started), *founding_events[1:])
        self._stored, self._count = record, len(record.events)
        self._deciding: Callable[..., object] = founding
        table = handler_table_of(spec.architecture, spec.configuration)
        self._recipe = recipe
        # See docs/decisions/replay-draws-again.md.
        self._environment = recorded_environment(record, table) if is_recorded else edited_environment(recipe)
        self._forked_from_seq = started.forked_from_seq
        self._facts = self._environment.facts
        self.later_us = self._environment.later_us if isinstance(self._environment, RecordedEnvironment) else {}
        self._silent: list[tuple[int, Decide]] = []  # decisions since the last event, which made none
        for seq, event in enumerate(events):
            self._require(seq, event, 0, None if seq == 0 else 0)
        super().__init__(table, self._environment, events, founded)
        command(self, recipe)
        self._decides = {command: self._noted(decide) for command, decide in self._decides.items()}

    def run_to_end(self) -> None:
        """Run to the end. Raises: _Differs."""
        if isinstance(self._environment, RecordedEnvironment):
            self.run()
        else:
            run_to_end(self, self._environment, self._recipe)

    def handler(self) -> str:
        """Return the function that makes the next event, by module and name."""
        return _name(self._deciding)

    def require_end(self) -> None:
        """Check that nothing is recorded that was not decided. Raises: _Differs."""
        seq = len(self.events)
        if seq < self._count:
            raise self._missed_decision(seq) or _Mismatch(
                self._stored.run_id, seq, "type", None, _END, self._actual(seq)
            )
        if self._forked_from_seq is not None:
            expected = last_shared(self._recipe, self._stored)
            if expected != self._forked_from_seq:
                pair = f"{expected}", f"{self._forked_from_seq}"
                raise _Mismatch(self._stored.run_id, 0, "forked_from_seq", "forks.last_shared", *pair)

    def _noted(self, decide: Decide) -> Decide:
        """Return the decision wrapped so that it is noted when it is taken."""

        def noted(state: State, command: Command) -> tuple[Event, ...]:
            self._deciding = decide
            events = decide(state, command)
            if not events:
                self._silent.append((command.now_us, decide))
                if len(self._silent) > MAX_SILENT:
                    raise RuntimeError(
                        f"more than {MAX_SILENT:,} decisions in a row made nothing, "
                        f"the last at {command.now_us} microseconds"
                    )
            return events

        return noted

    def _record(self, event: Event, time_us: int, cause: int | None) -> None:
        if cause == 0 and type(event) in FACTS:
            self._deciding = schedule
        self._require(len(self.events), event, time_us, cause)
        self._silent.clear()
        super()._record(event, time_us, cause)

    def _require(self, seq: int, event: Event, time_us: int, cause: int | None) -> None:
        """Check that the record has this event at that seq. Raises: _Differs."""
        stored = self._stored
        if seq >= self._count:
            raise _Mismatch(stored.run_id, seq, "type", self.handler(), _at(event, time_us), _END)
        if stored.events[seq] != event or stored.times_us[seq] != time_us or stored.caused_by[seq] != cause:
            raise self._missed_decision(seq) or _Mismatch(
                stored.run_id, seq, *self._first_field(seq, event, time_us, cause)
            )

    def _first_field(self, seq: int, event: Event, time_us: int, cause: int | None) -> tuple[str, str | None, str, str]:
        """Return the first field in which the recorded event differs: name, handler, expected, actual."""
        stored, actual_us = self._stored.events[seq], self._stored.times_us[seq]
        if type(stored) is not type(event):
            return "type", self.handler(), _at(event, time_us), self._actual(seq)
        pairs: list[tuple[str, object, object]] = [
            ("time_us", time_us, actual_us),
            ("caused_by", cause, self._stored.caused_by[seq]),
        ]
        expected_values, actual_values = flat(event), flat(stored)
        pairs += [(name, value, actual_values[name]) for name, value in expected_values.items()]
        name, expected, actual = next(pair for pair in pairs if pair[1] != pair[2])
        if type(event) in FACTS and name != "caused_by":
            return name, self.handler(), _at(event, time_us), self._actual(seq)
        return name, self.handler(), f"{expected!r:.300}", f"{actual!r:.300}"

    def _actual(self, seq: int) -> str:
        """Return what is recorded there; for a fact of the world, also say if the world does not have it."""
        event, time_us = self._stored.events[seq], self._stored.times_us[seq]
        invented = type(event) in FACTS and (time_us, event) not in self._facts
        return _at(event, time_us) + (", which the world of this run does not have" if invented else "")

    def _missed_decision(self, seq: int) -> _Mismatch | None:
        """Return the difference if the recorded event is where a handler had its turn and made nothing, else None."""
        decide = dict(self._silent).get(self._stored.times_us[seq])
        if decide is None:
            return None
        return _Mismatch(self._stored.run_id, seq, "type", _name(decide), "nothing", self._actual(seq))


def _name(function: Callable[..., object]) -> str:
    return f"{function.__module__}.{function.__qualname__}".removeprefix("fsar_ledger.runtime.")


def _at(event: Event, time_us: int) -> str:
    """Describe the event; for a fact of the world, with its fields."""
    about = ", ".join(f"{name} {value!r:.80}" for name, value in flat(event).items()) if type(event) in FACTS else ""
    return f"{event.__struct_config__.tag} at {time_us} microseconds{f' ({about})' if about else ''}"


def _start_replay(record: LedgerRun, is_recorded: bool) -> _Replay:
    """Return the run at its founding. Raises: _Differs if it cannot be replayed, or its founding or name differs."""
    started = record.events[0]
    if not isinstance(started, RunStarted):
        raise _Mismatch(record.run_id, 0, "type", None, "RunStarted.v2", _at(started, record.times_us[0]))
    try:
        recipe = recorded_recipe(started, len(record.events))
    except CannotReplay as found:
        actual = f"{found.actual}, so the run cannot be replayed"
        raise _Mismatch(record.run_id, 0, found.field, None, found.expected, actual) from found
    if run_id(started) != record.run_id:
        raise _Mismatch(record.run_id, 0, "run_id", None, repr(run_id(started)), repr(record.run_id))
    return _Replay(record, started, recipe, is_recorded)
