"""The replay of one run: it is simulated again, up to the first event that differs from the record.

What is repeated and what is taken as recorded: `replay.py`.
"""

from collections.abc import Callable, Sequence

import msgspec

from fsar_ledger.designs.constants import Constants
from fsar_ledger.events import ALONE, Event
from fsar_ledger.events.configuration import FULL, Configuration
from fsar_ledger.events.envelope import flat
from fsar_ledger.events.fleet import RunContinued, RunStarted
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.locations import continued_by
from fsar_ledger.projections.fold import State

from .changeable import EditedEnvironment
from .changes import NOW, RULES, Rules
from .forks import command, edited_environment, last_shared, run_to_end
from .handlers.commands import Command, Decide
from .handlers.isolation import founded_alone
from .live import ARCHITECTURE, SOURCE, commands_of, live_started, state_shape
from .ports import Environment, LiveEnvironment
from .recipes import CannotReplay, Recipe, recorded_constants, recorded_recipe, started_of
from .recorded import FACTS, RecordedEnvironment, RecordedKernel, recorded_environment
from .simulation import fleet_founding, founding_of, handler_table_of, plan_mismatch, run_id
from .snapshot import state_sha256
from .world import founding
from .world.schedule import schedule

_END = "the end of the run"

MAX_SILENT = 100_000
"""The most consecutive decisions without an event; no run of the model has a hundred."""


class Difference(msgspec.Struct, frozen=True):
    """The first place where a record differs from its replay, or the reason why it could not be checked.

    `handler` is the function that produces the expected event, or that ran there without an event; None if there is
    none. `commit` and `segment` are where the run is stored, None if unknown.
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


def _replay_plan(record: LedgerRun) -> Difference | None:
    """Return the first field in which the record of a plan is wrong, or None.

    A plan is taken as recorded; its name is a digest of it.
    """
    wrong = plan_mismatch(record)
    return (
        None if wrong is None else Difference(record.run_id, 0, wrong[0], "simulation.plan_record", wrong[2], wrong[1])
    )


class ForeignDigest(msgspec.Struct, frozen=True):
    """The recorded digest of a state in another shape than this version's, and whether it is the same here."""

    run: str
    seq: int
    shape: str
    is_same: bool


def replay_run(
    record: LedgerRun, is_recorded: bool = False, digests: list[ForeignDigest] | None = None
) -> Difference | None:
    """Return the first difference between the record and its replay, or None. Never raises.

    With `is_recorded` the world is taken from the record. Digests of states in another shape are added to `digests`.
    """
    difference, started = _replayed(record, is_recorded, digests), record.events[0]
    if difference is None or is_recorded:  # the changes are in the world of the record
        return difference
    earlier = RULES[1:] if isinstance(started, RunStarted) and started.changes else ()
    # Forks of earlier releases are valid: their changes mean what they meant there.
    return None if any(_replayed(record, is_recorded, digests, rules) is None for rules in earlier) else difference


def _replayed(
    record: LedgerRun, is_recorded: bool, digests: list[ForeignDigest] | None, rules: Rules = NOW
) -> Difference | None:
    replay: _Replay | None = None
    try:
        if type(record.events[0]) in ALONE:
            return _replay_plan(record)
        replay = _start_replay(record, is_recorded, rules)
        replay.run_to_end()
        replay.require_end()
        if digests is not None:
            digests += replay.digests
    except _Mismatch as mismatch:
        return mismatch.difference
    except Exception as error:
        seq, handler = (0, None) if replay is None else (len(replay.events), replay.handler())
        return Difference(record.run_id, seq, None, handler, "something that can be decided", error_text(error))
    return None


def error_text(error: Exception) -> str:
    """Return the error in words. Raises: MemoryError, which is not the ledger's fault."""
    if isinstance(error, MemoryError):
        raise error  # not the ledger's fault
    return f"{type(error).__name__}: {error!s:.300}"


class _Mismatch(Exception):
    """Raised to end a replay at a difference."""

    def __init__(self, run: str, seq: int, field: str | None, handler: str | None, expected: str, actual: str) -> None:
        self.difference = Difference(run, seq, field, handler, expected, actual)


class _Replay(RecordedKernel):
    """A run in progress that stops at the first event that differs from the record."""

    def __init__(
        self,
        record: LedgerRun,
        architecture: tuple[str, Configuration],
        environment: Environment,
        events: Sequence[Event],
        founded: State,
    ) -> None:
        """Begin the run with its founding. Raises: _Mismatch if the record has another founding."""
        self._stored, self._count = record, len(record.events)
        self._deciding: Callable[..., object] = founding
        self._environment, self._facts = environment, environment.facts
        self.later_us = environment.later_us if isinstance(environment, RecordedEnvironment) else {}
        self.digests: list[ForeignDigest] = []
        self._silent: list[tuple[int, Decide]] = []  # decisions since the last event, all without one
        for seq, event in enumerate(events):
            self._require(seq, event, 0, None if seq == 0 else 0)
        super().__init__(handler_table_of(*architecture), environment, events, founded)
        self._decides = {command: self._noted(decide) for command, decide in self._decides.items()}

    def run_to_end(self) -> None:
        """Run to the end. Raises: _Mismatch."""
        self.run()

    def handler(self) -> str:
        """Return the function that produces the next event, by module and name."""
        return function_name(self._deciding)

    def require_end(self) -> None:
        """Check that the record has no further events. Raises: _Mismatch."""
        seq = len(self.events)
        if seq < self._count:
            raise self._missed_decision(seq) or _Mismatch(
                self._stored.run_id, seq, "type", None, _END, self._actual(seq)
            )

    def _noted(self, decide: Decide) -> Decide:
        """Return the handler, wrapped so that its decisions are noted."""

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
        seq = len(self.events)
        self._require(seq, event, time_us, cause)
        self._silent.clear()
        super()._record(self._stored.events[seq], time_us, cause)  # the equal stored event: half of the memory

    def _require(self, seq: int, event: Event, time_us: int, cause: int | None) -> None:
        """Check that the record has this event at that seq. Raises: _Mismatch."""
        stored = self._stored
        if seq >= self._count:
            raise _Mismatch(stored.run_id, seq, "type", self.handler(), _describe_event(event, time_us), _END)
        if stored.events[seq] != event or stored.times_us[seq] != time_us or stored.caused_by[seq] != cause:
            raise self._missed_decision(seq) or _Mismatch(
                stored.run_id, seq, *self._first_field(seq, event, time_us, cause)
            )

    def _first_field(self, seq: int, event: Event, time_us: int, cause: int | None) -> tuple[str, str | None, str, str]:
        """Return the first field in which the recorded event differs: name, handler, expected, actual."""
        stored, actual_us = self._stored.events[seq], self._stored.times_us[seq]
        if type(stored) is not type(event):
            return "type", self.handler(), _describe_event(event, time_us), self._actual(seq)
        pairs: list[tuple[str, object, object]] = [
            ("time_us", time_us, actual_us),
            ("caused_by", cause, self._stored.caused_by[seq]),
        ]
        expected_values, actual_values = flat(event), flat(stored)
        pairs += [(name, value, actual_values[name]) for name, value in expected_values.items()]
        name, expected, actual = next(pair for pair in pairs if pair[1] != pair[2])
        if type(event) in FACTS and name != "caused_by":
            return name, self.handler(), _describe_event(event, time_us), self._actual(seq)
        return name, self.handler(), f"{expected!r:.300}", f"{actual!r:.300}"

    def _actual(self, seq: int) -> str:
        """Describe the recorded event; for a fact of the world, note if the world does not have it."""
        event, time_us = self._stored.events[seq], self._stored.times_us[seq]
        invented = type(event) in FACTS and (time_us, event) not in self._facts
        return _describe_event(event, time_us) + (", which the world of this run does not have" if invented else "")

    def _missed_decision(self, seq: int) -> _Mismatch | None:
        """Return the mismatch if a handler ran at the time of the recorded event without an event, else None."""
        decide = dict(self._silent).get(self._stored.times_us[seq])
        if decide is None:
            return None
        return _Mismatch(self._stored.run_id, seq, "type", function_name(decide), "nothing", self._actual(seq))


class _SimulatedReplay(_Replay):
    """The replay of a simulated run, in the world of its seed or (`is_recorded`) of its record."""

    def __init__(self, record: LedgerRun, started: RunStarted, recipe: Recipe, is_recorded: bool) -> None:
        spec, (events, founded) = recipe.spec, founding_of(recipe.spec, recipe.constants)
        architecture = spec.architecture, spec.configuration
        # See docs/decisions/replay-draws-again.md.
        environment = (
            recorded_environment(record, handler_table_of(*architecture)) if is_recorded else edited_environment(recipe)
        )
        super().__init__(record, architecture, environment, (started_of(recipe, started), *events[1:]), founded)
        self._recipe, self._forked_from_seq = recipe, started.forked_from_seq
        command(self, recipe)

    def run_to_end(self) -> None:
        if isinstance(self._environment, EditedEnvironment):
            run_to_end(self, self._environment, self._recipe)
        else:
            super().run_to_end()

    def require_end(self) -> None:
        super().require_end()
        if self._forked_from_seq is None:
            return
        expected = last_shared(self._recipe, self._stored)
        if expected != self._forked_from_seq:
            pair = f"{expected}", f"{self._forked_from_seq}"
            raise _Mismatch(self._stored.run_id, 0, "forked_from_seq", "forks.last_shared", *pair)


class _LiveReplay(_Replay):
    """The replay of a live run from its recorded commands, up to its last event."""

    def __init__(self, record: LedgerRun, started: RunStarted, constants: Constants) -> None:
        events, founded = fleet_founding(started.fleet_size or 0, constants, founded_alone(record.events))
        first = live_started(constants, started.fleet_size or 0, started.epoch)
        super().__init__(record, (ARCHITECTURE, FULL), LiveEnvironment(commands_of(record)), (first, *events), founded)

        self._before = 0  # how many events the runs before the last cut have

    def run_to_end(self) -> None:
        self.run(self._stored.times_us[-1])

    def _apply_fact(self, fact: Event, time_us: int) -> None:
        if isinstance(fact, RunContinued):
            seq = len(self.events)
            last, digest, shape = seq - 1 - self._before, state_sha256(self.stands(time_us)), fact.state_shape
            is_same, is_foreign = digest == fact.state_sha256, shape != state_shape()
            if is_foreign:  # the state was rebuilt event by event
                self.digests.append(ForeignDigest(self._stored.run_id, seq, shape, is_same))
            for name, recorded, expected, is_right in (
                ("continues_seq", fact.continues_seq, last, fact.continues_seq == last),
                ("state_sha256", fact.state_sha256, digest, is_same or is_foreign),
            ):
                if not is_right:
                    raise _Mismatch(
                        self._stored.run_id, seq, name, "live.LiveRun.cut", f"{expected!r}", f"{recorded!r}"
                    )
            self._before += last
        super()._apply_fact(fact, time_us)


def function_name(function: Callable[..., object]) -> str:
    """Return the function by module and name, without the prefix that all handlers share."""
    return f"{function.__module__}.{function.__qualname__}".removeprefix("fsar_ledger.runtime.")


def _describe_event(event: Event, time_us: int) -> str:
    """Describe the event; for a fact of the world, with its fields."""
    about = ", ".join(f"{name} {value!r:.80}" for name, value in flat(event).items()) if type(event) in FACTS else ""
    return f"{event.__struct_config__.tag} at {time_us} microseconds{f' ({about})' if about else ''}"


def _start_replay(record: LedgerRun, is_recorded: bool, rules: Rules) -> _Replay:
    """Return the run at its founding. Raises: _Mismatch if it cannot be replayed, or founding or name differ."""
    started = record.events[0]
    if not isinstance(started, RunStarted):
        raise _Mismatch(record.run_id, 0, "type", None, "RunStarted.v2", _describe_event(started, record.times_us[0]))
    if (before := continued_by(record)) is not None:
        expected = "a run that the ledger holds before this one, since this one continues from its state"
        raise _Mismatch(record.run_id, 1, "continues", None, expected, f"{before!r}")
    try:
        if started.kind == "live" and started.source == SOURCE:
            return _LiveReplay(record, started, recorded_constants(started, len(record.events)))
        recipe = msgspec.structs.replace(recorded_recipe(started, len(record.events)), rules=rules)
    except CannotReplay as error:
        actual = f"{error.actual}, so the run cannot be replayed"
        raise _Mismatch(record.run_id, 0, error.field, None, error.expected, actual) from error
    if run_id(started) != record.run_id:
        raise _Mismatch(record.run_id, 0, "run_id", None, repr(run_id(started)), repr(record.run_id))
    return _SimulatedReplay(record, started, recipe, is_recorded)
