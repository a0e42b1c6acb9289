"""The kernel: pops the next command or fact in the total order (time, priority, serial) and records its events.

Facts of the world come before commands of the same instant. A command never runs at the instant at which it was
scheduled, and two commands with the same cause never share an instant. So (caused_by, time_us) of the first event of a
batch identifies the command that made it, and a run can be resumed from its events alone. The first event of a batch
causes the others.

Commands of a robot that is off, and messages over a link that is down, are held back until a fact brings the robot or
the link back. A robot then continues for the time it had left. A message departs when its sender can send, travels
whatever happens to the sender or the receiver meanwhile, and waits at the receiver until it can be received. So the
world constrains every architecture alike; which robot carries out a command is data of the handler table.

The run's environment answers what a reaction asks at a port, and holds the scheduled facts. The clock is the kernel's:
a command without a wait is due at a fixed time. A command that waits for an answer that never comes is dropped: a real
robot or human reports instead, and the report is a command from outside, recorded as `CommandGiven`.
"""

import sys
from array import array
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Sequence
from functools import lru_cache
from heapq import heappop, heappush
from operator import itemgetter
from typing import Any

from fsar_ledger.events import EVENT_TYPES, Event
from fsar_ledger.events.fleet import RunContinued, RunStarted
from fsar_ledger.events.world import LinkCameUp, RobotCameBack, RobotWentOff
from fsar_ledger.ledger.rows.runs import LedgerRun, is_same_batch
from fsar_ledger.projections.fleet import NEVER_US
from fsar_ledger.projections.fold import ENDS, ROUTES, State, apply, forget
from fsar_ledger.projections.world import is_linked

from .agenda import Agenda, Pending
from .architectures import HandlerTable
from .handlers.commands import Command, React, Scheduled, is_idle
from .ports import Ask, Environment

_Plan = dict[type[Event], tuple[tuple[tuple[str, Callable[[Any, Any], Any]], ...], tuple[React, ...]]]
_TURNS = frozenset({RobotWentOff, RobotCameBack, LinkCameUp})
"""Facts that stop commands, or release those that were held back."""
MOMENT_US = 60_000_000
"""A run that is overdue, with less than this between its commands, does not end."""


@lru_cache(maxsize=32)
def _plan(table: HandlerTable) -> _Plan:
    """Return, for each event type, the projections that handle it and the reactions to it."""
    return {kind: (ROUTES.get(kind, ()), table.reacts.get(kind, ())) for kind in EVENT_TYPES}


class Kernel:
    """One run in progress: the events recorded so far, their state, and the pending commands.

    `first` is the seq of the first of `events`: 0, unless earlier events were taken out.
    """

    def __init__(
        self,
        table: HandlerTable,
        environment: Environment,
        founding: Sequence[Event],
        founded: State | None = None,
    ) -> None:
        """Begin the run with `founding`.

        `founded` is the state after all founding events but the first, if already known.
        """
        self.times_us: list[int] = []
        self.caused_by: list[int | None] = []
        self.events: list[Event] = []
        self.first = 0
        self.state = State()
        self._decides = table.decides
        self._actors = table.actors
        self._plan = _plan(table)
        self._facts = environment.facts
        self._next_fact = 0
        self._answer = environment.answer
        self._latest_us = NEVER_US if environment.latest_us is None else environment.latest_us
        begun = founding[0]
        self._pending = Agenda((isinstance(begun, RunStarted) and begun.fleet_size) or 1)
        self._held_back: list[Pending] = []
        self._serial = 0
        self._turn_us = 0  # time of the last command, even one without events: nothing is recorded before it
        self._submitted_us: list[int] = []  # a heap: when commands from outside are due
        self._taken: deque[tuple[int, array[int]]] = deque()  # first seq and times of events recently taken out
        self._cut = 0  # the seq at which the run was last cut
        if founded is None:
            self._batch(founding, 0, None)
        else:
            self._begin(founding, founded)

    def _begin(self, founding: Sequence[Event], founded: State) -> None:
        """Record the founding events. They leave nothing pending: handlers react only to what a fleet does."""
        self.times_us += [0] * len(founding)
        self.caused_by += [None, *[0] * (len(founding) - 1)]
        self.events += founding
        self.state = founded.copy()
        apply(self.state, founding[0])

    def decides(self, command: type[Command]) -> bool:
        """Return whether the run's architecture decides such commands."""
        return command in self._decides

    def set_environment(self, environment: Environment) -> None:
        """Replace the environment that answers questions; scheduled facts are unchanged."""
        self._answer = environment.answer

    def submit(self, time_us: int, command: Command) -> int:
        """Schedule a command from outside; return its due time: the time given, or the next instant that is free.

        Raises:
            ValueError: The time is not after what has happened.
        """
        if time_us <= self.last_us:
            raise ValueError(f"found a command at {time_us} microseconds, expected it after {self.last_us}")
        while self._submitted_us and self._submitted_us[0] <= self.last_us:
            heappop(self._submitted_us)
        while self._is_taken(time_us):
            time_us += 1
        heappush(self._submitted_us, time_us)
        self._serial += 1
        self._pending.put((time_us, self._serial, 0, Scheduled(command)))
        return time_us

    def happen(self, time_us: int, fact: Event) -> int:
        """Record a fact at this time, or at the next free instant, after everything due before it; return its seq."""
        self._apply_fact(fact, self.clear(time_us))
        return self.first + len(self.events) - 1

    def clear(self, time_us: int) -> int:
        """Run everything due by this time; return it, or the next instant at which nothing is due or recorded."""
        self.run(time_us)
        while self.last_us >= time_us:
            self.run(time_us := self.last_us + 1)
        return time_us

    def _is_taken(self, time_us: int) -> bool:
        """Return whether a fact or another command from outside is due at this time."""
        index = bisect_left(self._facts, time_us, self._next_fact, key=itemgetter(0))
        has_fact = index < len(self._facts) and self._facts[index][0] == time_us
        return has_fact or time_us in self._submitted_us

    @property
    def last_us(self) -> int:
        """The time of the last event, or of the last command if that made none."""
        return max(self._turn_us, self.times_us[-1] if self.times_us else self._taken[-1][1][-1])

    def take(self) -> LedgerRun:
        """Remove and return the events recorded so far; the run does not need them to go on."""
        if self.times_us:
            self._taken.append((self.first, array("q", self.times_us)))
            while self._taken[0][1][-1] < self.times_us[-1] - MOMENT_US:
                self._taken.popleft()
        if self._next_fact == len(self._facts):
            self._facts, self._next_fact = (), 0  # the facts of a run that is rebuilt are all its past commands
        taken = LedgerRun("", self.times_us, self.caused_by, self.events, self.first)
        self.first += len(self.events)
        self.times_us, self.caused_by, self.events = [], [], []
        return taken

    def saved_state(self) -> tuple[Any, ...]:
        """Return the state of a run whose events were taken out, for `recall`; it must not be modified."""
        pending = self._pending, self._held_back, self._serial, self._turn_us, self._submitted_us
        return self.first, self.state, pending, self._taken, self._cut

    def recall(self, known: tuple[Any, ...]) -> None:
        """Continue from what `saved_state` returned for a run of the same architecture."""
        self.times_us, self.caused_by, self.events = [], [], []
        self.first, self.state, pending, self._taken, self._cut = known
        self._pending, self._held_back, self._serial, self._turn_us, self._submitted_us = pending

    def stands(self, time_us: int) -> tuple[Any, ...]:
        """Return what determines the run after this time: its state and pending commands, without their numbers."""
        later = sorted((item for item in self._pending if item[0] > time_us), key=lambda item: item[:2])
        return self.state, [(item[0], item[3]) for item in later], [(item[0], item[3]) for item in self._held_back]

    def _time_of(self, seq: int) -> int:
        """Return the time of the event; 0 for one that was taken out and is older than `MOMENT_US`."""
        if seq >= self.first:
            return self.times_us[seq - self.first]
        return next((times_us[seq - first] for first, times_us in reversed(self._taken) if seq >= first), 0)

    @property
    def has_ended(self) -> bool:
        """Return whether no command is pending and no fact is left."""
        return not self._pending and self._next_fact == len(self._facts)

    def run(self, until_us: int = NEVER_US, most: int = sys.maxsize) -> None:
        """Run until nothing is left, everything due by `until_us` has happened, or `most` events are held."""
        facts, count, decides, state = self._facts, len(self._facts), self._decides, self.state
        position, events_held, pending, turn = self._next_fact, self.events, self._pending.soon, self._pending.advance
        while len(events_held) < most:
            if not pending:
                turn(facts[position][0] if position < count else NEVER_US)
            if position < count and (not pending or facts[position][0] <= pending[0][0]):
                time_us, fact = facts[position]
                if time_us > until_us:
                    break
                position += 1
                self._apply_fact(fact, time_us)
            elif pending:
                time_us, _, cause, scheduled = pending[0]
                if time_us > until_us:
                    break
                if time_us > self._latest_us:
                    self._require_end(time_us, cause, scheduled)
                    self._pending.replace(())
                    continue
                item, world, self._turn_us = heappop(pending), state.world, time_us
                if (world.off or world.unlinked) and self._hold_back(item):
                    continue
                command, ask = scheduled.command, scheduled.ask
                command.now_us = time_us
                if ask is not None:
                    answer = self._answer(ask)
                    if answer is None and (answer := self._unanswered(scheduled, ask, time_us)) is None:
                        continue
                    command.answer = answer
                events = decides[type(command)](state, command)
                if events:
                    self._batch(events, time_us, cause)
            else:
                break
        self._next_fact = position

    def _require_end(self, time_us: int, cause: int, scheduled: Scheduled) -> None:
        """Check that a command due so late was scheduled long before. Raises: RuntimeError if it was not."""
        if time_us - self._time_of(cause) < MOMENT_US:
            raise RuntimeError(
                f"the run does not end: {scheduled.command} is due at {time_us} microseconds, caused by event {cause}"
            )

    def restore(self, times_us: Sequence[int], caused_by: Sequence[int | None], events: Sequence[Event]) -> None:
        """Restore the run to just before the last batch of these events; `run` repeats that batch and continues.

        The events must begin with the founding batch with which this kernel was made.
        """
        end = len(events) - 1
        while end > 0 and is_same_batch(times_us, caused_by, end):
            end -= 1
        for seq in range(len(self.events), end):
            cause = caused_by[seq]
            if not is_same_batch(times_us, caused_by, seq):
                self._discard_until(times_us[seq], cause)
            if cause == 0 and times_us[seq] > 0:
                self._apply_fact(events[seq], times_us[seq])
            else:
                self._record(events[seq], times_us[seq], cause)
        if end < len(events):
            self._discard_before(times_us[end], caused_by[end])

    def _discard_until(self, time_us: int, cause: int | None) -> None:
        """Pop the command that made the recorded batch, and earlier ones that made no event."""
        if cause == 0:
            self._next_fact += 1
            while (item := self._pending.pop_before(time_us)) is not None:
                self._hold_back(item)
            return
        self._discard_before(time_us, cause)
        heappop(self._pending.soon)

    def _discard_before(self, time_us: int, cause: int | None) -> None:
        soon = self._pending.soon
        while self._pending.advance(time_us) and (
            soon[0][0] < time_us or (cause != 0 and soon[0][0] == time_us and soon[0][2] != cause)
        ):
            self._hold_back(heappop(soon))

    def _batch(self, events: Sequence[Event], time_us: int, cause: int | None) -> None:
        first = self.first + len(self.events)
        if cause and cause < self._cut:
            cause = self._cut
        for event in events:
            self._record(event, time_us, cause)
            if type(event) in _TURNS:  # reported by a robot
                self._turn(event, time_us)
            cause = first

    def _record(self, event: Event, time_us: int, cause: int | None) -> None:
        self.times_us.append(time_us)
        self.caused_by.append(cause)
        self.events.append(event)
        state = self.state
        routes, reacts = self._plan[type(event)]
        for slot, evolve in routes:
            setattr(state, slot, evolve(getattr(state, slot), event))
        if type(event) in ENDS and forget(state, event):
            self._pending.replace(item for item in self._pending if not is_idle(state, item[3].command))
        if reacts:
            self._react(reacts, event, time_us, self.first + len(self.events) - 1)

    def _react(self, reacts: Sequence[React], event: Event, time_us: int, seq: int) -> None:
        """Schedule the commands of these reactions to the event, no two of them at the same instant."""
        state, answer, world, pending = self.state, self._answer, self.state.world, self._pending
        is_whole = not world.off and not world.unlinked  # nothing can be held back
        taken: set[int] = set()  # an event may schedule thousands
        for react in reacts:
            for scheduled in react(state, event, time_us):
                due_us = time_us + scheduled.after_us
                for ask in scheduled.waits:
                    length_us = answer(ask)
                    if length_us is None and (length_us := self._unanswered(scheduled, ask, time_us)) is None:
                        break
                    due_us += length_us
                else:
                    length_us = 0
                if length_us is None:
                    continue
                if due_us <= time_us:
                    due_us = time_us + 1
                # See docs/decisions/cause-and-time-name-a-command.md.
                while due_us in taken:
                    due_us += 1
                taken.add(due_us)
                self._serial += 1
                item = (due_us, self._serial, seq, scheduled)
                if not is_whole and self._hold_back(item, due_us - time_us):  # a message departs
                    continue
                if due_us < pending.until_us:
                    heappush(pending.soon, item)
                else:
                    pending.put(item)

    def _unanswered(self, _scheduled: Scheduled, _ask: Ask, _time_us: int) -> int | None:
        """Return an answer where the environment has none now; None: it comes as a command, if at all."""
        return None

    # See docs/decisions/outages-live-in-the-kernel.md.
    def _hold_back(self, item: Pending, after_us: int = 0) -> bool:
        """Hold back a command that cannot run because a robot is off or a link is down; return whether it was.

        Once they are back, it is due after the time it had left. For a message that departs (it has time to go) only
        the sender matters; for one that has arrived, only its receiver and its relay.
        """
        world, scheduled = self.state.world, item[3]
        if not world.off and not world.unlinked:
            return False
        actor = self._actor(scheduled)
        senders = [ask.sender for ask in scheduled.waits if ask.sender is not None]
        if _is_message(scheduled) and after_us:
            ends, actor = senders[:1], None
        else:
            others = senders[1:] if _is_message(scheduled) else senders
            ends = [*others, actor] if senders and actor is not None else others
        if actor in world.off or not all(is_linked(world, end) for end in ends):
            self._held_back.append((after_us, *item[1:]))
            return True
        return False

    def _actor(self, scheduled: Scheduled) -> str | None:
        actor = self._actors.get(type(scheduled.command))
        return None if actor is None else actor(self.state, scheduled.command)

    def _apply_fact(self, fact: Event, time_us: int) -> None:
        """Apply a fact of the world."""
        self._record(fact, time_us, 0)
        if type(fact) in _TURNS:
            self._turn(fact, time_us)
        elif type(fact) is RunContinued:
            self._cut = self.first + len(self.events) - 1

    def _turn(self, fact: Event, time_us: int) -> None:
        """Hold back the commands that the fact stops, or release those that it brings back."""
        if isinstance(fact, RobotWentOff):
            stopped = [
                item for item in self._pending if self._actor(item[3]) == fact.robot and not _is_message(item[3])
            ]
            self._held_back += [
                (due_us - time_us, serial, cause, scheduled)
                for due_us, serial, cause, scheduled in sorted(stopped, key=lambda item: item[:2])
            ]
            self._pending.replace([item for item in self._pending if item not in stopped])
        else:
            self._release(time_us)

    def _release(self, now_us: int) -> None:
        """Schedule all commands held back that can run again; the others stay.

        No two become due at the same instant, nor at that of another command with the same cause.
        """
        held_back, self._held_back = self._held_back, []
        taken = {(due_us, cause) for due_us, _, cause, _ in self._pending}
        instants: set[int] = set()
        for after_us, serial, cause, scheduled in held_back:
            if self._hold_back((0, serial, cause, scheduled), after_us):
                continue
            due_us = now_us + max(1, after_us)
            while due_us in instants or (due_us, cause) in taken:
                due_us += 1
            instants.add(due_us)
            self._pending.put((due_us, serial, cause, scheduled))


def _is_message(scheduled: Scheduled) -> bool:
    """Return whether this is a message alone, which travels while its receiver is off, and waits for it."""
    return scheduled.after_us <= 1 and bool(scheduled.waits) and all(ask.sender is not None for ask in scheduled.waits)
