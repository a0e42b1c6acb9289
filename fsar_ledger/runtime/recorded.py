"""The recorded environment: the facts of the world and the answers at the ports, inferred from a run's events.

No event records how long a message took or how an attempt ended. But two commands with the same cause never share an
instant, and the first event of a batch names its cause: so the batch belongs to one of the commands that this event
scheduled, namely one that decides exactly these events in the state before them. Its time is the answer to the
command's waits, and the answer to its question is the one with which it decides these events.

No draw, seed or constant of the world is read. Replaying the run in this environment checks every decision, given the
facts and answers of the record.
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
"""The types of events that come from outside the run: facts of the world, and commands."""
_SPAN_US = 1 << 42
"""Longer than any run: a command that is due after some spans is due at an unknown time."""
_MOST_WAITS = 20
"""More than the number of questions in reaction to one event."""
_POSSIBLE_ANSWERS = {
    "verdict": (AS_USUAL, DISAPPROVES, PREFERS_OTHER),
    "admission": (AS_USUAL,),
    "help": (AS_USUAL,),
    "reliability": (1, 0),
}
"""Possible answers to a question of a command when it is due, by `what`, the usual first; all others are lengths."""


Batch = tuple[Event, ...]
Compare = Callable[[Batch, Batch], bool]


class RecordedEnvironment:
    """The environment of a record: its facts, and for each question the inferred answers, in order.

    If a command waits for several answers, the first has the length of all. A question without an effect on record is
    never answered.

    Commands held back during an outage run after it, each at its own instant, in an order that the record does not
    show. `later_us` has, by serial, the time of each command that waited, or that ran later because of others.
    """

    def __init__(
        self, facts: Sequence[Fact], answers: dict[Ask, list[int]], later_us: dict[int, int], last_us: int
    ) -> None:
        self.facts = facts
        self.later_us = later_us
        self.latest_us: int | None = last_us + FOREVER_US // 2
        self._answers = {ask: deque(queue) for ask, queue in answers.items()}

    def answer(self, ask: Ask) -> int:
        """Return the recorded answer. Units: microseconds for lengths."""
        left = self._answers.get(ask)
        if not left:
            return FOREVER_US
        return left.popleft() if len(left) > 1 else left[0]


def recorded_environment(record: LedgerRun, table: HandlerTable) -> RecordedEnvironment:
    """Return the environment in which a run was recorded.

    A batch that no command produces gives at most its time, and the search ends where the handlers cannot continue: the
    replay in this environment differs from the record there.
    """
    facts = tuple(
        (record.times_us[seq], event)
        for seq, event in enumerate(record.events)
        if type(event) in FACTS and record.caused_by[seq] == 0
    )
    end = next((seq for seq, time_us in enumerate(record.times_us) if time_us > 0), len(record.events))
    search = _AnswerSearch(table, record.events[:end])
    with suppress(LookupError, TypeError, ValueError, AttributeError, AssertionError):
        search.follow(record, end)
    return RecordedEnvironment(facts, search.answers, search.later_us, record.times_us[-1])


class RecordedKernel(Kernel):
    """A run in a recorded environment, with commands held back in an outage run at their recorded times."""

    later_us: dict[int, int]

    def _release(self, now_us: int) -> None:
        super()._release(now_us)
        if any(item[1] in self.later_us for item in self._pending):
            self._pending.replace([(self.later_us.get(item[1], item[0]), *item[1:]) for item in self._pending])


class _UnknownEnvironment:
    """An environment without known answers: each wait takes its own number of spans."""

    facts: tuple[Fact, ...] = ()
    latest_us: int | None = None

    def __init__(self) -> None:
        self.given: list[int] = []
        self._count = 0

    def answer(self, ask: Ask) -> int:
        self._count += 1
        number = (self._count << _MOST_WAITS) + (1 << len(self.given))  # so that all sums differ
        self.given.append(_SPAN_US * number if ask.key else 0)
        return self.given[-1]


class _AnswerSearch(Kernel):
    """A run that follows its record, and finds the command behind each batch, and the answers to that command."""

    def __init__(self, table: HandlerTable, founding: Sequence[Event]) -> None:
        self._unknown = _UnknownEnvironment()
        self._waits: dict[int, _Wait] = {}  # by serial
        self._released: set[int] = set()  # serials
        self._under_way = 0  # messages that may have arrived first
        self._passed: list[Pending] = []  # commands due after an outage, so far without an event
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
            while (item := self._pending.pop_before(time_us)) is not None:
                self._pass(item)
            if cause == 0 and type(batch[0]) in FACTS:
                self._apply_fact(batch[0], time_us)
            else:
                self._find(batch, time_us, cause)
                self._batch(batch, time_us, cause)
            seq = end

    def _pass(self, item: Pending) -> None:
        """Skip a command that made no event when it was due; one that was held back before may still run later."""
        if self._hold_back(item):
            return
        if item[3].ask is not None:
            self.answers[item[3].ask].append(0)
        if item[1] in self._released:
            self._passed.append(item)

    def _find(self, batch: Batch, time_us: int, cause: int | None) -> None:
        """Take the pending command that produces the batch, or one of its kind, and note the answers to it."""
        candidates = [
            item
            for item in sorted(self._pending, key=lambda item: item[1])
            if item[2] == cause and (item[0] == time_us or item[1] in self._waits)
        ]
        for is_made in (_is_same, _is_same_kind):
            for item in candidates:
                answer = self._matching_answer(batch, time_us, item[3], is_made)
                if answer is not None:
                    self._take(item, time_us, answer)
                    return
        for item in self._passed:
            if item[2] != cause or time_us - item[0] > self._under_way:
                continue
            answer = self._matching_answer(batch, time_us, item[3], _is_same)
            if answer is not None:
                self.later_us[item[1]] = time_us
                if item[3].ask is not None:
                    self.answers[item[3].ask][-1] = answer
                self._passed.remove(item)
                return

    def _matching_answer(self, batch: Batch, time_us: int, scheduled: Scheduled, is_made: Compare) -> int | None:
        """Return the answer with which the command decides this batch, 0 if it asks nothing; None if there is none."""
        command, ask = scheduled.command, scheduled.ask
        command.now_us = time_us
        for answer in (0,) if ask is None else _POSSIBLE_ANSWERS.get(ask.what) or (*_lengths(batch, time_us), 0):
            command.answer = answer
            if is_made(tuple(self._decides[type(command)](self.state, command)), batch):
                return answer
        return None

    def _release(self, now_us: int) -> None:
        held_back = {item[1] for item in self._held_back}
        super()._release(now_us)
        self._passed.clear()
        self._released = held_back - {item[1] for item in self._held_back}
        self._under_way = sum(item[1] in self._waits for item in self._pending)

    def _take(self, item: Pending, time_us: int, answer: int) -> None:
        due_us, serial, _, scheduled = item
        if scheduled.ask is not None:
            self.answers[scheduled.ask].append(answer)
        if serial in self._waits:
            ask, place, spans_us = self._waits[serial]
            self.answers[ask][place] = time_us - (due_us - spans_us)
            self.later_us[serial] = time_us
        self._pending.replace([other for other in self._pending if other is not item])

    def _record(self, event: Event, time_us: int, cause: int | None) -> None:
        before, count = self._serial, 0
        self._unknown.given.clear()
        super()._record(event, time_us, cause)
        if self._serial == before:
            return
        new = sorted(
            (item for item in (*self._pending, *self._held_back) if item[1] > before), key=lambda item: item[1]
        )
        for _, serial, _, scheduled in new:
            spans_us = self._unknown.given[count : count + len(scheduled.waits)]
            count += len(spans_us)
            for ask, span_us in zip(scheduled.waits, spans_us, strict=True):
                is_first = span_us > 0 and serial not in self._waits
                if is_first:
                    self._waits[serial] = _Wait(ask, len(self.answers[ask]), sum(spans_us))
                self.answers[ask].append(FOREVER_US if is_first else 0)


class _Wait(NamedTuple):
    """The waits of a command: the question whose answer has their whole length, its place among answers, the spans."""

    ask: Ask
    place: int
    spans_us: int


def _is_same(made: Batch, batch: Batch) -> bool:
    return made == batch


def _is_same_kind(made: Batch, batch: Batch) -> bool:
    return [type(event) for event in made[:1]] == [type(batch[0])]


def _lengths(batch: Batch, time_us: int) -> list[int]:
    """Return the lengths of time from now to the times in a batch, each once."""
    values = [value for event in batch for name, value in flat(event).items() if name.endswith("_us")]
    return list(dict.fromkeys(value - time_us for value in values if isinstance(value, int) and value > time_us))
