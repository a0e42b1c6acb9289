"""Why an event happened: its trigger, what the decision read and which events wrote that, and the answers at ports.

The run is made again under observation. Handlers are functions of the state and a command or an event: the requested
decisions, and the reactions that scheduled them, get a state that notes what they read (`reads.py`).
"""

from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any, Literal, NamedTuple

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError
from fsar_ledger.events import Event
from fsar_ledger.events.command import CommandGiven
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.rows.runs import LedgerRun, parts_at, start_of
from fsar_ledger.projections.fold import State
from fsar_ledger.runtime.changeable import Question, name_of
from fsar_ledger.runtime.changes import NOW, RULES
from fsar_ledger.runtime.forks import command, edited_environment, record_of, run_to_end
from fsar_ledger.runtime.handlers.commands import Command, Decide, React, Scheduled
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.ports import Ask, Environment, LiveEnvironment
from fsar_ledger.runtime.recipes import CannotReplay, Recipe, recipe_of, started_of
from fsar_ledger.runtime.run_replay import function_name
from fsar_ledger.runtime.simulation import founding_of, handler_table_of

from .reads import LastWrite, Path, Read, Reads, ReadValues, described, last_writes


class Reaction(NamedTuple):
    """What scheduled a decision: the function, what it read, and its questions at ports with their answers."""

    handler: str
    reads: ReadValues
    answers: tuple[tuple[Ask, int], ...]


class Decision(NamedTuple):
    """How a batch of events was made: the function, its command, and what it read.

    `reaction` is None for a command that came from outside. `waited_for` are the seqs of the facts that brought back a
    robot or a link that the command had been held back for.
    """

    handler: str
    command: Command
    reads: ReadValues
    reaction: Reaction | None
    waited_for: tuple[int, ...] = ()


def first_of(record: LedgerRun, seq: int) -> int:
    """Return the seq of the first event of the batch that this one belongs to."""
    cause = record.caused_by[seq]
    return seq if cause is None or record.times_us[cause] != record.times_us[seq] else cause


def decisions(record: LedgerRun, seqs: Collection[int]) -> dict[int, Decision]:
    """Return the decisions behind the batches that begin at these seqs; those of the world and the founding have none.

    Raises:
        UsageError: This version cannot make the run again, or makes one that differs from the record.
    """
    run, started = printable.value(record.run_id), start_of(record)
    try:
        recipe = recipe_of(record, started)
    except CannotReplay as reason:
        raise UsageError(f"run {run}: {reason}; only a run that can be replayed shows what was read") from reason
    differs: list[int] = []
    for rules in RULES if started.changes else (NOW,):  # a fork's changes mean what they meant when it was made
        recipe = msgspec.structs.replace(recipe, rules=rules)
        try:
            kernel = _ObservedKernel(record, started, recipe, seqs)
            run_to_end(kernel, kernel.edited, recipe)
        except (LookupError, ValueError, RuntimeError, TypeError) as error:
            raise UsageError(
                f"run {run}: it cannot be replayed ({error!s:.300}); run `fsar-ledger verify --replay`"
            ) from error
        at = 0 if kernel.events[0] != started else parts_at(record, record_of(kernel))
        if at is None:
            return kernel.made
        differs.append(at)
    raise UsageError(
        f"run {run}, event {differs[0]}: the record is not what its world and its handlers make, so nothing shows why; "
        "run `fsar-ledger verify --replay`, which says what differs"
    )


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
        """Replace the environment that answers questions, and note its answers."""

        def answer(ask: Ask) -> int | None:
            value = environment.answer(ask)
            self._answers[id(ask)] = ask, value
            return value

        self._answer = answer

    def _release(self, now_us: int) -> None:
        held = [scheduled.command for *_, scheduled in self._held_back]
        super()._release(now_us)
        still_held = {id(scheduled.command) for *_, scheduled in self._held_back}
        for held_command in held:
            if id(held_command) not in still_held:
                self._released.setdefault(id(held_command), (held_command, []))[1].append(len(self.events) - 1)

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
            reactions = react(reads.state(state), event, now_us)
            for scheduled in reactions:
                self._scheduled[id(scheduled.command)] = scheduled, function_name(react), reads.values
            return reactions

        return reacted

    def _reaction(self, command: Command) -> Reaction | None:
        if id(command) not in self._scheduled:
            return None
        scheduled, handler, reads = self._scheduled[id(command)]
        asks = scheduled.waits if scheduled.ask is None else (*scheduled.waits, scheduled.ask)
        answers = (self._answers[id(ask)] for ask in asks)
        return Reaction(handler, reads, tuple((ask, answer) for ask, answer in answers if answer is not None))


DEPTH = 2
"""The default depth: the event, and the events that it rests on."""
Origin = Literal["founding", "world", "command", "decision"]


class PortAnswer(msgspec.Struct, frozen=True):
    """A question that was asked at a port, and the answer, both as `whatif --change 'answer ...'` takes them."""

    port: str
    question: str
    answer: str


class DecisionTrace(msgspec.Struct, frozen=True, kw_only=True):
    """How a batch of events, made by one command at one time, came about.

    Attributes:
        seq: The first of the batch.
        count: How many events the batch has.
        origin: `founding`: the run begins with it; `world`: a fact of the world; `command`: requested or given from
            outside; `decision`: triggered by an event.
        handler: The function that decided; None for the founding, the world and the giving of a command.
        command: The command that it decided on; None as for `handler`.
        triggered_by: The seq of the event that triggered it; None if none did.
        scheduled_by: The function that scheduled it after that event; None if none did.
        answers: The questions asked at ports on the way, with their answers.
        waited_for: The seqs of the facts that brought back a robot or a link that the command had been held back for.
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
        """Return the seqs of its trigger, of what it waited for, and of the writers of what was read; in order."""
        reads = (*self.scheduled_reads, *self.reads)
        seqs = {
            self.triggered_by,
            *self.waited_for,
            *(seq for read in reads for seq in (read.written_by, *read.elements)),
        }
        return tuple(sorted(seq for seq in seqs if seq is not None))


class Reasons(msgspec.Struct, frozen=True):
    """Why an event of a run happened.

    Attributes:
        run: The run.
        seq: The event.
        triggers: The chain of triggers: the event's, the trigger of that one, and so on to a fact of the world, a
            command from outside or event 0.
        made: How the event came about, then the events that it rests on, then those that these rest on, to the
            requested depth; each batch once.
    """

    run: str
    seq: int
    triggers: tuple[int, ...]
    made: tuple[DecisionTrace, ...]

    @property
    def seqs(self) -> list[int]:
        """Return the seqs of all events named, in order."""
        named = {self.seq, *self.triggers}
        for trace in self.made:
            named.update((trace.seq, *trace.rests_on))
        return sorted(named)


def reasons(record: LedgerRun, seq: int, depth: int | None = DEPTH) -> Reasons:
    """Return why the event with this seq happened.

    Args:
        record: The run.
        seq: An event of it.
        depth: 1: how it came about; 2: also how what it rests on came about; and so on; None: no limit.

    Raises:
        UsageError: The run cannot be made again, or not as recorded.
    """
    batches: dict[int, DecisionTrace] = {}
    pending = [first_of(record, seq)]
    while pending and (depth is None or depth > 0):
        for trace in _decision_traces(record, pending):
            batches[trace.seq] = trace
        rests_on = [first_of(record, below) for above in pending for below in batches[above].rests_on]
        pending = [below for below in dict.fromkeys(rests_on) if below not in batches]
        depth = None if depth is None else depth - 1
    return Reasons(record.run_id, seq, tuple(_triggers(record, seq)), tuple(batches.values()))


def _triggers(record: LedgerRun, seq: int) -> Iterator[int]:
    """Yield the trigger of the batch that has the event, the trigger of that, and so on; event 0 is none."""
    while (cause := record.caused_by[first_of(record, seq)]) is not None and cause > 0:
        yield cause
        seq = cause


def _decision_traces(record: LedgerRun, firsts: list[int]) -> Iterator[DecisionTrace]:
    """Yield how the batches that begin at these seqs came about."""
    decided = decisions(record, firsts)
    reads: list[tuple[Path, int]] = []
    for seq, decision in decided.items():
        reads += [(path, seq) for path in decision.reads]
        if decision.reaction is not None:
            reads += [(path, _trigger(record, seq) + 1) for path in decision.reaction.reads]
    writers = last_writes(record.events, reads)
    for seq in firsts:
        count = _count(record, seq)
        if seq in decided:
            yield _decided(record, seq, count, decided[seq], writers)
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
    reads = tuple(described(decision.reads, seq, writers))
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
        answers=tuple(_named_answers(decision.reaction.answers)),
        waited_for=decision.waited_for,
        scheduled_reads=tuple(described(decision.reaction.reads, cause + 1, writers)),
        reads=reads,
    )


def _count(record: LedgerRun, first: int) -> int:
    """Return the number of events of the batch that begins at this seq."""
    end = first + 1
    while end < len(record.events) and first_of(record, end) == first:
        end += 1
    return end - first


def _named_answers(answers: Iterable[tuple[Ask, int]]) -> Iterator[PortAnswer]:
    """Yield the questions that have a name, with their answers; the others take no time."""
    for ask, answer in answers:
        name = name_of(ask)
        if name is not None:
            yield PortAnswer(ask.port, name, Question(name, answer).text)
