"""What a fleet refuses of the changes of a fork: commands that it rejects, and what means nothing in the run."""

from collections.abc import Iterable
from typing import NamedTuple

from fsar_ledger.events import Event
from fsar_ledger.events.command import CommandGiven
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.runtime.change_texts import fact_of
from fsar_ledger.runtime.changes import Add, AnyChange, Budget, Changes, Density, Rule, Set, Trust, microseconds_of
from fsar_ledger.runtime.forks import Fork

from .fork_base import Rerun, rejected_in, rejection


class Refusal(NamedTuple):
    """Why a change of a fork is refused, and whether the fork does the same as its base but for what is refused."""

    why: str
    is_same: bool


def refusal(rerun: Rerun, changes: Changes, forked: Fork) -> Refusal | None:
    """Return what of the changes is refused in the fork, as an error of `fork_with_effect`; None: nothing is."""
    base, fork = rerun.base.record, forked.record
    refused = {change: why for change in changes if (why := rerun.refused(change, forked)) is not None}
    rejected = rejected_in(rerun.base, forked)
    if not refused and not rejected:
        return None
    whys = [*refused.values(), *(rejection(fork.events[seq]) for seq in rejected)]
    causes = [cause for seq in rejected if (cause := fork.caused_by[seq])]
    own = {*rejected, *(seq for seq in causes if isinstance(fork.events[seq], CommandGiven))}
    for seq, (time_us, cause, event) in enumerate(zip(fork.times_us, fork.caused_by, fork.events, strict=True)):
        if seq and not cause and any(_is_of(one, time_us, event, base.times_us[-1]) for one in refused):
            own.add(seq)
    return Refusal(whys[0], forked.end is None and _rest(fork, own) == _rest(base, ()))


def _is_of(change: AnyChange, time_us: int, event: Event, last_us: int) -> bool:
    """Return whether an event that nothing causes is that of the change, which is refused in a run that ends then."""
    match change:
        case Add():
            return event == fact_of(change.event)
        case Rule() | Trust() if change.task is not None and getattr(event, "context", None) == change.task:
            return True
        case Set() | Rule() | Trust() | Budget() | Density() if change.from_s is not None:
            return time_us >= microseconds_of(change.from_s) > last_us
        case _:
            return False


def _rest(record: LedgerRun, own: Iterable[int]) -> list[tuple[int, int | None, Event]]:
    """Return what happens after event 0, without these events and what they lead to."""
    found: list[tuple[int, int | None, Event]] = []
    out, places = {*own}, {0: 0}
    for seq, (time_us, cause, event) in enumerate(zip(record.times_us, record.caused_by, record.events, strict=True)):
        if seq in out or cause in out:
            out.add(seq)
        elif seq:
            found.append((time_us, None if cause is None else places[cause], event))
            places[seq] = len(found)
    return found
