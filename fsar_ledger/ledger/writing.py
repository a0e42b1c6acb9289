"""Append to a ledger of any format."""

import os
from pathlib import Path

from fsar_ledger.errors import UsageError
from fsar_ledger.ledger.chain.append import ChainWriter
from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.ledger.opening import version_of
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.paths import MANIFEST
from fsar_ledger.ledger.store.record import CHAINED, VERSION

VERSIONS = (VERSION, CHAINED)


def open_writer(
    ledger: Path, origin: str, signer: Signer | None = None, *, adopts: bool = False, version: int | None = None
) -> Writer | ChainWriter:
    """Open a ledger to append to it. If there is none, it is made in this format version, by default the newest.

    Raises:
        UsageError: As `version_for`, and as the writer of its version.
        NotALedger, FormatVersionMismatch, LedgerCorrupted, WriteFailed: As the writer of its version.
    """
    if version_for(ledger, version) == CHAINED:
        return ChainWriter(ledger, origin, signer, adopts=adopts)
    return Writer(ledger, origin, signer, adopts=adopts)


def version_for(ledger: Path, version: int | None = None) -> int:
    """Return the format version in which the ledger at this path is written, if this one is asked for.

    Raises:
        UsageError: It has another one.
        NotALedger, FormatVersionMismatch, LedgerCorrupted: What is there is no ledger that this version writes.
    """
    found = version_of(ledger) if os.path.lexists(ledger / MANIFEST) else version or CHAINED
    if version is not None and found != version:
        raise UsageError(
            f"{ledger}: found a ledger of format {found}, expected {version}; a ledger is continued in its own format, "
            "and fsar-ledger upgrade writes it in the newest one"
        )
    return found
