"""Cut a run into pieces, and put together those that a ledger holds of one."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain

from fsar_ledger.base import printable
from fsar_ledger.base.errors import LedgerCorrupted
from fsar_ledger.ledger.rows.runs import LedgerRun


def joined(pieces: Sequence[LedgerRun]) -> LedgerRun:
    """Return the run of these pieces, each of which continues the one before."""
    if len(pieces) == 1:
        return pieces[0]
    return LedgerRun(
        pieces[0].run_id,
        list(chain.from_iterable(part.times_us for part in pieces)),
        list(chain.from_iterable(part.caused_by for part in pieces)),
        list(chain.from_iterable(part.events for part in pieces)),
        pieces[0].first,
        pieces[-1].goes_on,
    )


def whole(pieces: Sequence[LedgerRun]) -> LedgerRun:
    """Return the run of all its pieces that a ledger holds. Raises: LedgerCorrupted if one of them is missing."""
    next_seq = 0
    for part in pieces:
        if part.first != next_seq:
            raise LedgerCorrupted(
                f"run {printable.value(part.run_id)}: found event {part.first} where event {next_seq} is expected; run "
                "fsar-ledger verify"
            )
        next_seq += len(part.events)
    return joined(pieces)


def gathered(parts: Iterable[tuple[int, Sequence[LedgerRun]]], last: Mapping[str, int]) -> Iterator[LedgerRun]:
    """Yield each run that these parts of a ledger hold in pieces, once all were there.

    Args:
        parts: Where each part ends in the ledger, and its pieces.
        last: Where the last piece of a run begins, of those that may be in several parts.

    Raises: As `whole`.
    """
    held: dict[str, list[LedgerRun]] = {}
    for end, pieces in parts:
        for part in pieces:
            held.setdefault(part.run_id, []).append(part)
        for run in [run for run in held if last.get(run, 0) < end]:
            yield whole(held.pop(run))


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
