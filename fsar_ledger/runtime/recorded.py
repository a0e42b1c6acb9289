"""The recorded environment: what happened by itself, and what was answered at the ports, taken from a run's events.

No event says how long a message took or what came of an attempt. But two commands with the same cause never share an
instant, and the first event of a batch names its cause: so the batch belongs to one of the commands that this event
scheduled, namely one that decides exactly these events under the state before them. Its time is the answer to what the
command waited for, and what it had to be told, to decide so, is the answer to what it asked.

No draw, seed or constant of the world is read. Whoever plays the run in this environment checks every decision, given
what the record says was met.
"""

from collections import defaultdict, deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import NamedTuple, get_args

from fsar_ledger.events import Event
from fsar_ledger.events.command import CommandGiven
from fsar_ledger.events.envelope import flat
from fsar_ledger.events.world import WorldEvent
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.rows.runs import is_same_batch

from .agenda import Pending
from .architectures import HandlerTable
from .handlers.commands import Scheduled
from .kernel import Kernel
from .ports import AS_USUAL, DISAPPROVES, PREFERS_OTHER, Ask, Fact
from .world import FOREVER_US

FACTS = frozenset({*get_args(WorldEvent), CommandGiven})
"""The types of events that come from outside the run: what the world does by itself, and commands."""
_SPAN_US = 1 << 42
"""Longer than any run: what is due after some spans is due at a time to be found."""
_MOST_WAITS = 20
"""More than what is asked in reaction to one event."""
_POSSIBLE_ANSWERS = {
    "verdict": (AS_USUAL, DISAPPROVES, PREFERS_OTHER),
    "admission": (AS_USUAL,),
    "help": (AS_USUAL,),
    "reliability": (1, 0),
}
"""What can be answered, in words, to what a command asks when it is due, the usual first; all else are lengths."""


Batch = tuple[Event, ...]
Compare = Callable[[Batch, Batch], bool]


class RecordedEnvironment:
    """The environment of a record: its facts happen, and each question gets the answers that were found, in order.

    Where a command waited for several, the first has the length of all. A question of which nothing came, as far as
    the record shows, is never answered.

    What was kept during an outage is done after it, each at an instant of its own, in an order that the record does not
    tell. `later_us` has, by serial, when a command was due that waited, or that came later because others were first.
    """

    def __init__(
        self, facts: Sequence[Fact], answers: dict[Ask, list[int]], later_us: dict[int, int], last_us: int
    ) -> None:
        self.facts = facts
        self.later_us = later_us
        self.latest_us: int | None = last_us + FOREVER_US // 2
        self._answers = {ask: deque(found) for ask, found in answers.items()}

    def answer(self, ask: Ask) -> int:
        """Return the recorded answer. Units: microseconds for lengths."""
        left = self._answers.get(ask)
        if not left:
            return FOREVER_US
        return left.popleft() if len(left) > 1 else left[0]


def recorded_environment(record: LedgerRun, table: HandlerTable) -> RecordedEnvironment:
    """Return the environment in which a run was recorded.

    From a batch that no command makes, at most its time is learned, and nothing from what follows where the handlers
    cannot go on: the run played in this environment differs from the record there.
    """
    facts = tuple(
        (record.times_us[seq], event)
        for seq, event in enumerate(record.events)
        if type(event) in FACTS and record.caused_by[seq] == 0
    )
    end = next((seq for seq, time_us in enumerate(record.times_us) if time_us > 0), len(record.events))
    found = _AnswerSearch(table, record.events[:end])
    with suppress(LookupError, TypeError, ValueError, AttributeError, AssertionError):
        found.follow(record, end)
    return RecordedEnvironment(facts, found.answers, found.later_us, record.times_us[-1])


class RecordedKernel(Kernel):
    """A run that, in a recorded environment, does what was kept during an outage when it was done."""

    later_us: dict[int, int]

    def _release(self, now_us: int) -> None:
        super()._release(now_us)
        if any(one[1] in self.later_us for one in self._pending):
            self._pending.replace([(self.later_us.get(one[1], one[0]), *one[1:]) for one in self._pending])


class _UnknownEnvironment:
    """An environment in which nothing is answered yet: each wait takes a number of spans of its own."""

    facts: tuple[Fact, ...] = ()
    latest_us: int | None = None

    def __init__(self) -> None:
        self.given: list[int] = []
        self._count = 0

    def answer(self, ask: Ask) -> int:
        self._count += 1
        number = (self._count << _MOST_WAITS) + (1 << len(self.given))  # so that no two sums are the same
        self.given.append(_SPAN_US * number if ask.key else 0)
        return self.given[-1]


class _AnswerSearch(Kernel):
    """A run that is led by its record, and notes which command made each batch, and what it had been answered."""

    def __init__(self, table: HandlerTable, founding: Sequence[Event]) -> None:
        self._unknown = _UnknownEnvironment()
        self._waits: dict[int, _Wait] = {}  # by serial
        self._released: set[int] = set()  # serials
        self._under_way = 0  # messages that may have come first
        self._passed: list[Pending] = []  # that were due after an outage, and made nothing then
        self.answers: dict[Ask, list[int]] = defaultdict(list)
        self.later_us: dict[int, int] = {}
        super().__init__(table, self._unknown, founding)

    def follow(self, record: LedgerRun, begin: int) -> None:
        """Go through the record, batch by batch."""
        seq, count = begin, len(record.events)
        while seq < count:
            time_us, cause = record.times_us[seq], record.caused_by[seq]
            end = seq + 1
            while end < count and is_same_batch(record.times_us, record.caused_by, end):
                end += 1
            batch = tuple(record.events[seq:end])
            while (one := self._pending.pop_before(time_us)) is not None:
                self._pass(one)
            if cause == 0 and type(batch[0]) in FACTS:
                self._apply_fact(batch[0], time_us)
            else:
                self._find(batch, time_us, cause)
                self._batch(batch, time_us, cause)
            seq = end

    def _pass(self, one: Pending) -> None:
        """Let a command have its turn, which made nothing, unless what it was due after is later than it seems."""
        if self._hold_back(one):
            return
        if one[3].ask is not None:
            self.answers[one[3].ask].append(0)
        if one[1] in self._released:
            self._passed.append(one)

    def _find(self, batch: Batch, time_us: int, cause: int | None) -> None:
        """Take the pending command that makes the batch, or one of its kind, and note what it had been answered."""
        able = [
            one
            for one in sorted(self._pending, key=lambda one: one[1])
            if one[2] == cause and (one[0] == time_us or one[1] in self._waits)
        ]
        for is_made in (_is_same, _is_same_kind):
            for one in able:
                told = self._told(batch, time_us, one[3], is_made)
                if told is not None:
                    self._take(one, time_us, told)
                    return
        for one in self._passed:
            if one[2] != cause or time_us - one[0] > self._under_way:
                continue
            told = self._told(batch, time_us, one[3], _is_same)
            if told is not None:
                self.later_us[one[1]] = time_us
                if one[3].ask is not None:
                    self.answers[one[3].ask][-1] = told
                self._passed.remove(one)
                return

    def _told(self, batch: Batch, time_us: int, scheduled: Scheduled, is_made: Compare) -> int | None:
        """Return what makes the command decide this batch, 0 where it asks nothing; None if nothing does."""
        command, ask = scheduled.command, scheduled.ask
        command.now_us = time_us
        for answer in (0,) if ask is None else _POSSIBLE_ANSWERS.get(ask.what) or (*_lengths(batch, time_us), 0):
            command.answer = answer
            if is_made(tuple(self._decides[type(command)](self.state, command)), batch):
                return answer
        return None

    def _release(self, now_us: int) -> None:
        kept = {one[1] for one in self._held_back}
        super()._release(now_us)
        self._passed.clear()
        self._released = kept - {one[1] for one in self._held_back}
        self._under_way = sum(one[1] in self._waits for one in self._pending)

    def _take(self, one: Pending, time_us: int, told: int) -> None:
        due_us, serial, _, scheduled = one
        if scheduled.ask is not None:
            self.answers[scheduled.ask].append(told)
        if serial in self._waits:
            ask, place, spans_us = self._waits[serial]
            self.answers[ask][place] = time_us - (due_us - spans_us)
            self.later_us[serial] = time_us
        self._pending.replace([other for other in self._pending if other is not one])

    def _record(self, event: Event, time_us: int, cause: int | None) -> None:
        before, asked = self._serial, 0
        self._unknown.given.clear()
        super()._record(event, time_us, cause)
        if self._serial == before:
            return
        new = sorted((one for one in (*self._pending, *self._held_back) if one[1] > before), key=lambda one: one[1])
        for _, serial, _, scheduled in new:
            given = self._unknown.given[asked : asked + len(scheduled.waits)]
            asked += len(given)
            for ask, span_us in zip(scheduled.waits, given, strict=True):
                is_first = span_us > 0 and serial not in self._waits
                if is_first:
                    self._waits[serial] = _Wait(ask, len(self.answers[ask]), sum(given))
                self.answers[ask].append(FOREVER_US if is_first else 0)


class _Wait(NamedTuple):
    """What a command waits for: the question that has the length of all, its place among the answers, and the spans."""

    ask: Ask
    place: int
    spans_us: int


def _is_same(made: Batch, batch: Batch) -> bool:
    return made == batch


def _is_same_kind(made: Batch, batch: Batch) -> bool:
    return [type(event) for event in made[:1]] == [type(batch[0])]


def _lengths(batch: Batch, time_us: int) -> list[int]:
    """Return the lengths from now on that a batch names, each once."""
    values = [value for event in batch for name, value in flat(event).items() if name.endswith("_us")]
    return list(dict.fromkeys(value - time_us for value in values if isinstance(value, int) and value > time_us))
