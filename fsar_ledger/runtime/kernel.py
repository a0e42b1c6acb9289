"""The clock: pops the next command or fact in the total order (time, priority, serial) and records what it makes.

Facts of the world come before commands of the same instant. A command never runs at the instant at which
it was scheduled, and two commands of one cause never share an instant; so (caused_by, time_us) of the first
event of a batch names the command that made it, and a run can be resumed from its events alone. The further
events of a batch are caused by its first.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from heapq import heappop, heappush
from typing import Any

from fsar_ledger.events import EVENT_TYPES, Event
from fsar_ledger.projections.fold import ROUTES, State, apply

from .architectures.wiring import Wiring
from .handlers.commands import Command, Draw, React
from .world.draws import Draws
from .world.schedule import Fact

_Plan = dict[type[Event], tuple[tuple[tuple[str, Callable[[Any, Any], Any]], ...], tuple[React, ...]]]

LATEST_US = 3_600_000_000  # no run of the model takes an hour of run time; one that does is a bug


@lru_cache(maxsize=32)
def _plan(wiring: Wiring) -> _Plan:
    """What happens to an event of each type: the projections that handle it, and the reactions that follow it."""
    return {kind: (ROUTES.get(kind, ()), wiring.reacts.get(kind, ())) for kind in EVENT_TYPES}


class Kernel:
    """One run in progress: what was recorded, the state it makes, and the commands that are pending."""

    def __init__(self, wiring: Wiring, facts: Sequence[Fact], draws: Draws, founding: Sequence[Event], founded: State | None = None) -> None:
        """The run begins with `founding`; `founded` is the state that all of it but its first event makes, where that is known already."""
        self.times_us: list[int] = []
        self.caused_by: list[int | None] = []
        self.events: list[Event] = []
        self.state = State()
        self._decides = wiring.decides
        self._plan = _plan(wiring)
        self._facts = facts
        self._next_fact = 0
        self._draws = draws
        self._pending: list[tuple[int, int, int, Command, Draw | None]] = []
        self._serial = 0
        if founded is None:
            self._batch(founding, 0, None)
        else:
            self._begin(founding, founded)

    def _begin(self, founding: Sequence[Event], founded: State) -> None:
        """The founding is recorded. Nothing is pending after it: reactions are to what a fleet does."""
        self.times_us += [0] * len(founding)
        self.caused_by += [None, *[0] * (len(founding) - 1)]
        self.events += founding
        for slot in State.__slots__:
            setattr(self.state, slot, getattr(founded, slot))
        apply(self.state, founding[0])

    def run(self) -> None:
        """Nothing is left to happen."""
        facts, count, pending, decides = self._facts, len(self._facts), self._pending, self._decides
        position = self._next_fact
        while True:
            if position < count and (not pending or facts[position][0] <= pending[0][0]):
                time_us, fact = facts[position]
                position += 1
                self._record(fact, time_us, 0)
            elif pending:
                time_us, _, cause, command, ask = heappop(pending)
                if time_us > LATEST_US:
                    raise RuntimeError(f"the run does not end: {command} is due at {time_us} microseconds, caused by event {cause}")
                command.now_us = time_us
                if ask is not None:
                    command.drawn = self._draws.value(ask.stream, ask.key)
                events = decides[type(command)](self.state, command)
                if events:
                    self._batch(events, time_us, cause)
            else:
                self._next_fact = position
                return

    def restore(self, times_us: Sequence[int], caused_by: Sequence[int | None], events: Sequence[Event]) -> None:
        """The run stands before the last batch of these recorded events; `run` makes that batch again and goes on.

        The first event must be the founding batch's that this kernel was made with.
        """
        end = len(events) - 1
        while end > 0 and _is_same_batch(times_us, caused_by, end):
            end -= 1
        for seq in range(len(self.events), end):
            cause = caused_by[seq]
            if not _is_same_batch(times_us, caused_by, seq):
                self._discard_until(times_us[seq], cause)
            self._record(events[seq], times_us[seq], cause)
        if end < len(events):
            self._discard_before(times_us[end], caused_by[end])

    def _discard_until(self, time_us: int, cause: int | None) -> None:
        """Pops the command that made the recorded batch, and those before it that made nothing."""
        if cause == 0:
            self._next_fact += 1
            while self._pending and self._pending[0][0] < time_us:
                heappop(self._pending)
            return
        self._discard_before(time_us, cause)
        heappop(self._pending)

    def _discard_before(self, time_us: int, cause: int | None) -> None:
        while self._pending and (self._pending[0][0] < time_us or (cause != 0 and self._pending[0][0] == time_us and self._pending[0][2] != cause)):
            heappop(self._pending)

    def _batch(self, events: Sequence[Event], time_us: int, cause: int | None) -> None:
        first = len(self.events)
        for event in events:
            self._record(event, time_us, cause)
            cause = first

    def _record(self, event: Event, time_us: int, cause: int | None) -> None:
        state = self.state
        seq = len(self.events)
        self.times_us.append(time_us)
        self.caused_by.append(cause)
        self.events.append(event)
        routes, reacts = self._plan[type(event)]
        for slot, evolve in routes:
            setattr(state, slot, evolve(getattr(state, slot), event))
        if not reacts:
            return
        taken: tuple[int, ...] = ()
        for react in reacts:
            for scheduled in react(state, event, time_us):
                due_us = time_us + scheduled.after_us
                for draw in scheduled.draws:
                    due_us += self._draws.value(draw.stream, draw.key, draw.share_ppm)
                if due_us <= time_us:
                    due_us = time_us + 1
                while due_us in taken:
                    due_us += 1
                taken = (*taken, due_us)
                self._serial += 1
                heappush(self._pending, (due_us, self._serial, seq, scheduled.command, scheduled.ask))


def _is_same_batch(times_us: Sequence[int], caused_by: Sequence[int | None], seq: int) -> bool:
    """True when the event belongs to the batch of the event before it."""
    cause = caused_by[seq]
    return cause is not None and times_us[cause] == times_us[seq]
