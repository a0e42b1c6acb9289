"""Put the segments of a ledger together."""

from pathlib import Path

import msgspec

from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.view import Head


class Compacted(msgspec.Struct, frozen=True):
    """What `compact` did: the head, and the number of segments before and after; a journal counts as one before."""

    head: Head
    before: int
    after: int


def compact(ledger: Path) -> Compacted:
    """Put small neighbouring segments together; first, what is in the journal becomes one.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted, WriteFailed: As `Writer`.
    """
    view = open_ledger(ledger)
    with Writer(ledger, view.manifest.origin) as writer:
        before = len(view.releases)
        writer.compact()
        return Compacted(writer.head, before, len(open_ledger(ledger).releases))
