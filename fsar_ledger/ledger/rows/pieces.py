"""Put together a run of which a ledger holds several pieces."""

from collections.abc import Sequence
from itertools import chain

from fsar_ledger.ledger.rows.runs import LedgerRun


def joined(pieces: Sequence[LedgerRun]) -> LedgerRun:
    """Return the run of these pieces, each of which continues the one before."""
    if len(pieces) == 1:
        return pieces[0]
    return LedgerRun(
        pieces[0].run_id,
        list(chain.from_iterable(piece.times_us for piece in pieces)),
        list(chain.from_iterable(piece.caused_by for piece in pieces)),
        list(chain.from_iterable(piece.events for piece in pieces)),
        pieces[0].first,
        pieces[-1].goes_on,
    )
