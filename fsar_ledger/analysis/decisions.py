"""Decisions: how the events of a run were made, found by making the run again under observation.

Handlers are functions of the state and a command, or an event. Here they get a state that notes what they read
(`reads.py`), in the decisions that are asked for and in the reactions that scheduled them. The kernel and all other
decisions are those of every run.
"""

from collections.abc import Callable, Collection
from typing import Any, NamedTuple

from fsar_ledger import printable
from fsar_ledger.errors import UsageError
from fsar_ledger.events import Event
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.projections.fold import State
from fsar_ledger.runtime.forks import command, edited_environment, parts_at, play, record_of
from fsar_ledger.runtime.handler_tables import handler_table_of
from fsar_ledger.runtime.handlers.commands import Command, Decide, React, Scheduled
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.ports import Ask, Environment
from fsar_ledger.runtime.recipes import Recipe, Unmade, recorded_recipe, started_of
from fsar_ledger.runtime.simulation import founding_of

from .reads import Path, Reads

Values = dict[Path, object]
"""What was read: each path, in order, with the value found there."""


class Reaction(NamedTuple):
    """What scheduled a decision: the function, what it read, and the questions that it asked at ports, answered."""

    handler: str
    reads: Values
    answers: tuple[tuple[Ask, int], ...]


class Decision(NamedTuple):
    """How a batch of events was made: the function, its command, and what it read.

    `reaction` is None for a command that came from outside. `waited_for` are the seqs of the facts that brought back a
    robot or a link for which the command had been kept.
    """

    handler: str
    command: Command
    reads: Values
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
    run = printable.value(record.run_id)
    started = record.events[0]
    if not isinstance(started, RunStarted):
        raise UsageError(f"{run}: found a plan, expected a run; nothing happens in a plan")
    try:
        recipe = recorded_recipe(started, len(record.events))
    except Unmade as found:
        raise UsageError(f"run {run}: {found}; only a run that can be made again shows what was read") from found
    try:
        watched = _Watched(record, started, recipe, seqs)
        play(watched, watched.edited, recipe)
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


class _Watched(Kernel):
    """A run in progress in which some decisions, and the reactions that schedule them, are observed."""

    def __init__(self, record: LedgerRun, started: RunStarted, recipe: Recipe, seqs: Collection[int]) -> None:
        self.made: dict[int, Decision] = {}
        self.edited = edited_environment(recipe)
        self._seqs = frozenset(seqs)
        self._causes = frozenset(record.caused_by[seq] for seq in seqs)
        self._scheduled: dict[int, tuple[Scheduled, str, Values]] = {}
        self._answers: dict[int, tuple[Ask, int]] = {}
        self._released: dict[int, tuple[Command, list[int]]] = {}
        events, founded = founding_of(recipe.spec, recipe.constants)
        founding = (started_of(recipe, started), *events[1:])
        super().__init__(
            handler_table_of(recipe.spec.architecture, recipe.spec.configuration), self.edited, founding, founded
        )
        command(self, recipe)
        self.answered_by(self.edited)
        self._decides = {kind: self._decided(decide) for kind, decide in self._decides.items()}
        self._plan = {
            kind: (routes, tuple(map(self._reacted, reacts))) for kind, (routes, reacts) in self._plan.items()
        }

    def answered_by(self, environment: Environment) -> None:
        """From now on, let this environment answer, and note its answers."""

        def answer(ask: Ask) -> int:
            found = environment.answer(ask)
            self._answers[id(ask)] = ask, found
            return found

        self._answer = answer

    def _release(self, now_us: int) -> None:
        kept = [scheduled.command for *_, scheduled in self._kept]
        super()._release(now_us)
        still = {id(scheduled.command) for *_, scheduled in self._kept}
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
                self.made[seq] = Decision(_name(decide), command, reads.values, reaction, tuple(waited_for))
            return events

        return decided

    def _reacted(self, react: React) -> React:
        def reacted(state: State, event: Any, now_us: int) -> tuple[Scheduled, ...]:
            if len(self.events) - 1 not in self._causes:
                return react(state, event, now_us)
            reads = Reads()
            found = react(reads.state(state), event, now_us)
            for scheduled in found:
                self._scheduled[id(scheduled.command)] = scheduled, _name(react), reads.values
            return found

        return reacted

    def _reaction(self, command: Command) -> Reaction | None:
        if id(command) not in self._scheduled:
            return None
        scheduled, handler, reads = self._scheduled[id(command)]
        asked = scheduled.waits if scheduled.ask is None else (*scheduled.waits, scheduled.ask)
        return Reaction(handler, reads, tuple(self._answers[id(ask)] for ask in asked))


def _name(function: Callable[..., object]) -> str:
    """Return the function by module and name, without what all handlers share."""
    return f"{function.__module__}.{function.__qualname__}".removeprefix("fsar_ledger.runtime.")
