"""Why an event happened: what triggered it, what the decision read, who wrote that, and what was answered at ports.

The run is made again under observation. Handlers are functions of the state and a command, or an event: the decisions
that are asked for, and the reactions that scheduled them, get a state that notes what they read (`reads.py`).
"""

from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any, Literal, NamedTuple

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError
from fsar_ledger.events import Event
from fsar_ledger.events.command import CommandGiven
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.rows.runs import LedgerRun, start_of
from fsar_ledger.projections.fold import State
from fsar_ledger.runtime.changeable import Question, name_of
from fsar_ledger.runtime.forks import command, edited_environment, parts_at, record_of, run_to_end
from fsar_ledger.runtime.handlers.commands import Command, Decide, React, Scheduled
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.ports import Ask, Environment, LiveEnvironment
from fsar_ledger.runtime.recipes import CannotReplay, Recipe, recipe_of, started_of
from fsar_ledger.runtime.run_replay import function_name
from fsar_ledger.runtime.simulation import founding_of, handler_table_of

from .reads import ABSENT, LastWrite, Path, Reads, last_writes

ReadValues = dict[Path, object]
"""What was read: each path, in order, with the value found there."""


class Reaction(NamedTuple):
    """What scheduled a decision: the function, what it read, and the questions that it asked at ports, answered."""

    handler: str
    reads: ReadValues
    answers: tuple[tuple[Ask, int], ...]


class Decision(NamedTuple):
    """How a batch of events was made: the function, its command, and what it read.

    `reaction` is None for a command that came from outside. `waited_for` are the seqs of the facts that brought back a
    robot or a link for which the command had been kept.
    """

    handler: str
    command: Command
    reads: ReadValues
    reaction: Reaction | None
    waited_for: tuple[int, ...] = ()


def first_of(record: LedgerRun, seq: int) -> int:
    """Return the seq of the first event that was made together with this one."""
    cause = record.caused_by[seq]
    return seq if cause is None or record.times_us[cause] != record.times_us[seq] else cause


def decisions(record: LedgerRun, seqs: Collection[int]) -> dict[int, Decision]:
    """Return how the batches that begin at these seqs were made; those of the world and the founding by nobody.

    Raises:
        UsageError: This version cannot make the run again, or makes another one than is recorded.
    """
    run, started = printable.value(record.run_id), start_of(record)
    try:
        recipe = recipe_of(record, started)
    except CannotReplay as found:
        raise UsageError(f"run {run}: {found}; only a run that can be made again shows what was read") from found
    try:
        watched = _ObservedKernel(record, started, recipe, seqs)
        run_to_end(watched, watched.edited, recipe)
    except (LookupError, ValueError, RuntimeError, TypeError) as error:
        raise UsageError(
            f"run {run}: it cannot be made again ({error!s:.300}); run `fsar-ledger verify --replay`"
        ) from error
    at = 0 if watched.events[0] != started else parts_at(record, record_of(watched))
    if at is not None:
        raise UsageError(
            f"run {run}, event {at}: the record is not what its world and its handlers make, so nothing shows why; run "
            "`fsar-ledger verify --replay`, which says what differs"
        )
    return watched.made


class _ObservedKernel(Kernel):
    """A run in progress in which some decisions, and the reactions that schedule them, are observed."""

    def __init__(self, record: LedgerRun, started: RunStarted, recipe: Recipe, seqs: Collection[int]) -> None:
        self.made: dict[int, Decision] = {}
        self.edited = edited_environment(recipe)
        self._seqs = frozenset(seqs)
        self._causes = frozenset(record.caused_by[seq] for seq in seqs)
        self._scheduled: dict[int, tuple[Scheduled, str, ReadValues]] = {}
        self._answers: dict[int, tuple[Ask, int | None]] = {}
        self._released: dict[int, tuple[Command, list[int]]] = {}
        environment: Environment = self.edited if recipe.live is None else LiveEnvironment(recipe.live.commands)
        events, founded = founding_of(recipe.spec, recipe.constants, recipe.live.alone if recipe.live else ())
        table = handler_table_of(recipe.spec.architecture, recipe.spec.configuration)
        super().__init__(table, environment, (started_of(recipe, started), *events[1:]), founded)
        command(self, recipe)
        self.set_environment(environment)
        self._decides = {kind: self._decided(decide) for kind, decide in self._decides.items()}
        self._plan = {
            kind: (routes, tuple(map(self._reacted, reacts))) for kind, (routes, reacts) in self._plan.items()
        }

    def set_environment(self, environment: Environment) -> None:
        """From now on, let this environment answer, and note its answers."""

        def answer(ask: Ask) -> int | None:
            found = environment.answer(ask)
            self._answers[id(ask)] = ask, found
            return found

        self._answer = answer

    def _release(self, now_us: int) -> None:
        kept = [scheduled.command for *_, scheduled in self._held_back]
        super()._release(now_us)
        still = {id(scheduled.command) for *_, scheduled in self._held_back}
        for one in kept:
            if id(one) not in still:
                self._released.setdefault(id(one), (one, []))[1].append(len(self.events) - 1)

    def _decided(self, decide: Decide) -> Decide:
        def decided(state: State, command: Command) -> tuple[Event, ...]:
            seq = len(self.events)
            if seq not in self._seqs:
                return decide(state, command)
            reads = Reads()
            events = decide(reads.state(state), command)
            if events:
                reaction, (_, waited_for) = self._reaction(command), self._released.get(id(command), (command, []))
                self.made[seq] = Decision(function_name(decide), command, reads.values, reaction, tuple(waited_for))
            return events

        return decided

    def _reacted(self, react: React) -> React:
        def reacted(state: State, event: Any, now_us: int) -> tuple[Scheduled, ...]:
            if len(self.events) - 1 not in self._causes:
                return react(state, event, now_us)
            reads = Reads()
            found = react(reads.state(state), event, now_us)
            for scheduled in found:
                self._scheduled[id(scheduled.command)] = scheduled, function_name(react), reads.values
            return found

        return reacted

    def _reaction(self, command: Command) -> Reaction | None:
        if id(command) not in self._scheduled:
            return None
        scheduled, handler, reads = self._scheduled[id(command)]
        asked = scheduled.waits if scheduled.ask is None else (*scheduled.waits, scheduled.ask)
        answers = (self._answers[id(ask)] for ask in asked)
        return Reaction(handler, reads, tuple((ask, answer) for ask, answer in answers if answer is not None))


DEPTH = 2
"""How far a person looks unless told otherwise: the event, and the events that it rests on."""
Origin = Literal["founding", "world", "command", "decision"]


class Read(msgspec.Struct, frozen=True):
    """What a decision read at one place of the state, and which event wrote it.

    Attributes:
        place: Where: a slot of the state, and the fields and keys that lead on, as `world.local` or
            `request[A1-1/2.1]`.
        name: What of it: a field, the value under a `[key]`, `has KEY` (or member), `any`, all `keys` (or members), or
            the `size`; for a key of several parts, `*` stands for all.
        value: What was found there, as JSON has it; None if `is_absent`.
        is_absent: Whether nothing was found.
        written_by: The seq of the event since which it is so; None if it is so since before the first event.
        elements: Of a list, a set or keys, the seqs of the events since which each element is there.
    """

    place: str
    name: str
    value: Any
    is_absent: bool
    written_by: int | None
    elements: tuple[int, ...]


class PortAnswer(msgspec.Struct, frozen=True):
    """A question that was asked at a port, and the answer, both as `whatif --change 'answer ...'` takes them."""

    port: str
    question: str
    answer: str


class DecisionTrace(msgspec.Struct, frozen=True, kw_only=True):
    """How a batch of events came about, which one command made at one time.

    Attributes:
        seq: The first of the batch.
        count: How many events the batch has.
        origin: `founding`: the run begins with it; `world`: a fact of the world; `command`: somebody outside asked for
            it, or gave it; `decision`: an event triggered it.
        handler: The function that decided; None for the founding, the world and the giving of a command.
        command: What it was asked to decide; None as for `handler`.
        triggered_by: The seq of the event that triggered it; None if none did.
        scheduled_by: The function that scheduled it after that event; None if none did.
        answers: What was asked at ports on the way, and answered.
        waited_for: The seqs of the facts that brought back a robot or a link for which the command had been kept.
        scheduled_reads: What the scheduling function read.
        reads: What the decision read.
    """

    seq: int
    count: int
    origin: Origin
    handler: str | None = None
    command: str | None = None
    triggered_by: int | None = None
    scheduled_by: str | None = None
    answers: tuple[PortAnswer, ...] = ()
    waited_for: tuple[int, ...] = ()
    scheduled_reads: tuple[Read, ...] = ()
    reads: tuple[Read, ...] = ()

    @property
    def rests_on(self) -> tuple[int, ...]:
        """Return the seqs of its trigger, of what it waited for, and of what wrote what was read; in order."""
        reads = (*self.scheduled_reads, *self.reads)
        found = {
            self.triggered_by,
            *self.waited_for,
            *(seq for read in reads for seq in (read.written_by, *read.elements)),
        }
        return tuple(sorted(seq for seq in found if seq is not None))


class Reasons(msgspec.Struct, frozen=True):
    """Why an event of a run happened.

    Attributes:
        run: The run.
        seq: The event.
        triggers: The chain of triggers: the event's, the trigger of that one, and so on to a fact of the world, a
            command from outside or event 0.
        made: How the event came about, then the events that it rests on, then those that these rest on, as deep as was
            asked for; each batch once.
    """

    run: str
    seq: int
    triggers: tuple[int, ...]
    made: tuple[DecisionTrace, ...]

    @property
    def seqs(self) -> list[int]:
        """Return all events that are named, in order."""
        named = {self.seq, *self.triggers}
        for one in self.made:
            named.update((one.seq, *one.rests_on))
        return sorted(named)


def reasons(record: LedgerRun, seq: int, depth: int | None = DEPTH) -> Reasons:
    """Return why the event with this seq happened.

    Args:
        record: The run.
        seq: An event of it.
        depth: 1: how it came about; 2: and how what it rests on came about; and so on; None: all there is.

    Raises:
        UsageError: The run cannot be made again, or not as recorded.
    """
    made: dict[int, DecisionTrace] = {}
    next_ones = [first_of(record, seq)]
    while next_ones and (depth is None or depth > 0):
        for one in _made(record, next_ones):
            made[one.seq] = one
        rests_on = [first_of(record, below) for above in next_ones for below in made[above].rests_on]
        next_ones = [below for below in dict.fromkeys(rests_on) if below not in made]
        depth = None if depth is None else depth - 1
    return Reasons(record.run_id, seq, tuple(_triggers(record, seq)), tuple(made.values()))


def _triggers(record: LedgerRun, seq: int) -> Iterator[int]:
    """Yield the trigger of the batch that has the event, and so on; event 0 only of the founding."""
    while (cause := record.caused_by[first_of(record, seq)]) is not None and cause > 0:
        yield cause
        seq = cause


def _made(record: LedgerRun, firsts: list[int]) -> Iterator[DecisionTrace]:
    """Yield how the batches that begin at these seqs came about."""
    found = decisions(record, firsts)
    asked: list[tuple[Path, int]] = []
    for seq, decision in found.items():
        asked += [(path, seq) for path in decision.reads]
        if decision.reaction is not None:
            asked += [(path, _trigger(record, seq) + 1) for path in decision.reaction.reads]
    writers = last_writes(record.events, asked)
    for seq in firsts:
        count = _count(record, seq)
        if seq in found:
            yield _decided(record, seq, count, found[seq], writers)
        else:
            itself: Origin = "command" if isinstance(record.events[seq], CommandGiven) else "world"
            yield DecisionTrace(seq=seq, count=count, origin="founding" if record.times_us[seq] == 0 else itself)


def _trigger(record: LedgerRun, first: int) -> int:
    """Return the trigger of a batch that has one."""
    cause = record.caused_by[first]
    assert cause is not None
    return cause


def _decided(
    record: LedgerRun, seq: int, count: int, decision: Decision, writers: Mapping[tuple[Path, int], LastWrite]
) -> DecisionTrace:
    reads = tuple(_reads(decision.reads, seq, writers))
    command = type(decision.command).__name__
    if decision.reaction is None:
        return DecisionTrace(
            seq=seq, count=count, origin="command", handler=decision.handler, command=command, reads=reads
        )
    cause = _trigger(record, seq)
    return DecisionTrace(
        seq=seq,
        count=count,
        origin="decision",
        handler=decision.handler,
        command=command,
        triggered_by=cause,
        scheduled_by=decision.reaction.handler,
        answers=tuple(_answered(decision.reaction.answers)),
        waited_for=decision.waited_for,
        scheduled_reads=tuple(_reads(decision.reaction.reads, cause + 1, writers)),
        reads=reads,
    )


def _count(record: LedgerRun, first: int) -> int:
    """Return how many events the batch has that begins with this one."""
    end = first + 1
    while end < len(record.events) and first_of(record, end) == first:
        end += 1
    return end - first


def _answered(answers: Iterable[tuple[Ask, int]]) -> Iterator[PortAnswer]:
    """Yield the questions that have a name; the others take no time."""
    for ask, answer in answers:
        name = name_of(ask)
        if name is not None:
            yield PortAnswer(ask.port, name, Question(name, answer).text)


def _reads(values: ReadValues, before: int, writers: Mapping[tuple[Path, int], LastWrite]) -> Iterator[Read]:
    """Yield what was read just before the event with this seq."""
    for path, value in values.items():
        place, name = _words(path)
        by = writers[path, before]
        found = None if value is ABSENT else msgspec.to_builtins(value, str_keys=True, enc_hook=str)
        yield Read(place, name, found, value is ABSENT, by.by, by.elements)


def _words(path: Path) -> tuple[str, str]:
    """Return the place that the path leads to, and what is read of it."""
    place = path[0].name
    for step in path[1:-1]:
        place += f".{step.name}" if step.kind == "field" else f"[{_key(step.name)}]"
    if len(path) == 1:
        return place, "whole"
    kind, name = path[-1]
    match kind:
        case "field":
            return place, name
        case "key":
            return place, f"[{_key(name)}]"
        case "has":
            return place, f"has {_key(name)}"
        case _:
            return place, kind


def _key(key: object) -> str:
    """Return the key as text; a key of several parts has `*` for None, which stands for all."""
    parts = key if isinstance(key, tuple) else (key,)
    return ", ".join("*" if part is None else str(part) or '""' for part in parts)
