"""Put the segments of a ledger of format 2 together."""

from pathlib import Path

import msgspec

from fsar_ledger.errors import UsageError
from fsar_ledger.ledger.chain.append import ChainWriter
from fsar_ledger.ledger.opening import open_ledger, version_of
from fsar_ledger.ledger.store.record import CHAINED
from fsar_ledger.ledger.store.view import Head


class Compacted(msgspec.Struct, frozen=True):
    """What `compact` did: the head, and the number of segments before and after; a journal counts as one before."""

    head: Head
    before: int
    after: int


def compact(ledger: Path) -> Compacted:
    """Put small neighbouring segments together; first, what is in the journal becomes one.

    Raises:
        UsageError: The ledger has another format.
        NotALedger, FormatVersionMismatch, LedgerCorrupted, WriteFailed: As `ChainWriter`.
    """
    if (found := version_of(ledger)) != CHAINED:
        raise UsageError(
            f"{ledger}: found a ledger of format {found}, whose segments stay as they are, expected one of format "
            f"{CHAINED}; fsar-ledger upgrade writes one"
        )
    view = open_ledger(ledger)
    with ChainWriter(ledger, view.manifest.origin) as writer:
        before = len(view.releases)
        writer.compact()
        return Compacted(writer.head, before, len(open_ledger(ledger).releases))
