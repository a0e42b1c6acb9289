"""Moments: the state of a run at any time of it, without folding all events before."""

from bisect import bisect_right

from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.projections.fold import State, apply

EVERY = 256
"""Events between two states that are kept; they share all that did not change."""


class Timeline:
    """A run with its states. Building it folds all events once; then each moment takes at most `EVERY` of them."""

    def __init__(self, record: LedgerRun) -> None:
        self.record = record
        state = State()
        self._kept = [_copy(state)]
        for seq, event in enumerate(record.events, start=1):
            apply(state, event)
            if seq % EVERY == 0:
                self._kept.append(_copy(state))

    def seq_at(self, time_us: int) -> int:
        """Return the last event that has happened by then, which may be event 0."""
        return max(0, bisect_right(self.record.times_us, time_us) - 1)

    def after(self, seq: int) -> State:
        """Return the state after this event."""
        state = _copy(self._kept[(seq + 1) // EVERY])
        for event in self.record.events[(seq + 1) // EVERY * EVERY : seq + 1]:
            apply(state, event)
        return state


def _copy(state: State) -> State:
    """Return a state of its own with the same values, which never change."""
    copy = State.__new__(State)
    for slot in State.__slots__:
        setattr(copy, slot, getattr(state, slot))
    return copy
