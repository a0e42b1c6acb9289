"""The states of a run at any time of it, without folding all events before, and a walk through its events."""

import re
from bisect import bisect_right
from collections.abc import Callable

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError
from fsar_ledger.events import Event
from fsar_ledger.events.command import CommandRejected
from fsar_ledger.events.envelope import flat
from fsar_ledger.events.recovery import AssistanceDeclined
from fsar_ledger.events.request import RequestCountered, RequestDenied, RequestUnanswered
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.projections.fold import State, apply

EVERY = 256
"""Events between two states that are kept; they share all that did not change."""


class Timeline:
    """A run with its states. Building it folds all events once; then each moment takes at most `EVERY` of them."""

    def __init__(self, record: LedgerRun) -> None:
        self.record = record
        state = State()
        self._kept = [state.copy()]
        for seq, event in enumerate(record.events, start=1):
            apply(state, event)
            if seq % EVERY == 0:
                self._kept.append(state.copy())

    def seq_at(self, time_us: int) -> int:
        """Return the last event that has happened by then, which may be event 0."""
        return max(0, bisect_right(self.record.times_us, time_us) - 1)

    def after(self, seq: int) -> State:
        """Return the state after this event."""
        state = self._kept[(seq + 1) // EVERY].copy()
        for event in self.record.events[(seq + 1) // EVERY * EVERY : seq + 1]:
            apply(state, event)
        return state


REFUSALS = (RequestDenied, RequestCountered, RequestUnanswered, AssistanceDeclined, CommandRejected)
MOVES = {
    "next": "the next event",
    "previous": "the event before",
    "next-decision": "the next event that names who decided it",
    "previous-decision": "the decision before",
    "next-of": "the next event that names the robot: `next-of B1`",
    "next-refusal": "the next refusal",
    "cause": "the event that caused this one",
    "go": "a time or an event: `go 46.6s`, `go 289`",
    "find": "the next event whose words hold the text: `find door`",
    "first": "event 0",
    "last": "the last event",
}
"""By name, where each move of a walk leads."""
_SEQ = re.compile(r"[0-9]{1,16}")


class Walk:
    """A place in a run, at an event. A move that leads nowhere stays there and says so."""

    def __init__(self, record: LedgerRun, words: list[str], seq: int = 0) -> None:
        """Begin at an event; `words` are those of each event."""
        self.record = record
        self.words = words
        self.seq = seq

    def move(self, name: str, about: str = "", seq_at: Callable[[str], int] | None = None) -> str | None:
        """Make a move; return why it leads nowhere, or None.

        Args:
            name: One of `MOVES`.
            about: The robot, text, time or seq that it needs.
            seq_at: Reads a time, and finds the last event that has happened by then.

        Raises:
            UsageError: There is no such move, or it lacks what it needs.
        """
        if name not in MOVES:
            hint = printable.did_you_mean(name, MOVES) or ";"
            raise UsageError(
                f"move {printable.value(name)}: there is no such move{hint} expected one of {', '.join(MOVES)}"
            )
        if name in ("next-of", "go", "find") and not about:
            raise UsageError(f"move {name}: expected what to look for, {MOVES[name]}")
        found = self._found(name, about, seq_at)
        if found is None:
            return f"found none: {MOVES[name].partition(':')[0]}"
        self.seq = found
        return None

    def _found(self, name: str, about: str, seq_at: Callable[[str], int] | None) -> int | None:
        last = len(self.record.events) - 1
        match name:
            case "next" | "previous":
                seq = self.seq + (1 if name == "next" else -1)
                return seq if 0 <= seq <= last else None
            case "first" | "last":
                return 0 if name == "first" else last
            case "cause":
                return self.record.caused_by[self.seq]
            case "previous-decision":
                return self._first(_is_decision, range(self.seq - 1, -1, -1))
            case "go" if _SEQ.fullmatch(about):
                return int(about) if int(about) <= last else None
            case "go":
                return None if seq_at is None else seq_at(about)
            case "find":
                return next((seq for seq in self._later() if about.casefold() in self.words[seq].casefold()), None)
        kinds: dict[str, Callable[[Event], bool]] = {
            "next-decision": _is_decision,
            "next-refusal": lambda event: isinstance(event, REFUSALS),
            "next-of": lambda event: _names(event, about if "/" in about else f"robot/{about}"),
        }
        return self._first(kinds[name], self._later())

    def _later(self) -> range:
        return range(self.seq + 1, len(self.record.events))

    def _first(self, is_it: Callable[[Event], bool], seqs: range) -> int | None:
        return next((seq for seq in seqs if is_it(self.record.events[seq])), None)


def _is_decision(event: Event) -> bool:
    """Tell whether the record names who decided it."""
    return flat(event).get("decided_by") is not None


def _names(event: Event, robot: str) -> bool:
    """Tell whether a field of the event, or an item of one, is this robot."""
    return any(robot == one or (isinstance(one, tuple) and robot in one) for one in flat(event).values())
