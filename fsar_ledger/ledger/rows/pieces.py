"""Cut a run into pieces, and put together those that a ledger holds of one."""

from collections.abc import Sequence
from itertools import chain

from fsar_ledger.ledger.rows.runs import LedgerRun


def joined(pieces: Sequence[LedgerRun]) -> LedgerRun:
    """Return the run of these pieces, each of which continues the one before."""
    if len(pieces) == 1:
        return pieces[0]
    return LedgerRun(
        pieces[0].run_id,
        list(chain.from_iterable(one.times_us for one in pieces)),
        list(chain.from_iterable(one.caused_by for one in pieces)),
        list(chain.from_iterable(one.events for one in pieces)),
        pieces[0].first,
        pieces[-1].goes_on,
    )


def piece(run: LedgerRun, at: int, end: int) -> LedgerRun:
    """Return the events of a run between these indexes; it goes on unless they are its last."""
    if (at, end) == (0, len(run.events)):
        return run
    return LedgerRun(
        run.run_id,
        run.times_us[at:end],
        run.caused_by[at:end],
        run.events[at:end],
        run.first + at,
        end < len(run.events) or run.goes_on,
    )
