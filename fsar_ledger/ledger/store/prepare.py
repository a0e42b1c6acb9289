"""What a Writer does before it appends: create the ledger, lock it, and finish what an interrupted writer left."""

import fcntl
import os
from contextlib import suppress
from pathlib import Path

from fsar_ledger.errors import NotALedger, UsageError
from fsar_ledger.ledger.log.note import VerifierKey, is_name
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.rows.bounds import MAX_NAME_BYTES
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.manifest import FORMAT, VERSION, Manifest, parse_manifest, read_manifest
from fsar_ledger.ledger.store.paths import (
    MANIFEST,
    SEGMENTS,
    STAGING,
    is_unfinished,
    require_outside,
)


def lock(ledger: Path) -> tuple[int, bool]:
    """Open the ledger's folder and try to lock it; return the handle, and whether it holds the only lock.

    False where another writer is at work or the file system has no locks.
    """
    with disk.refusals(ledger, "locking"):
        handle = os.open(ledger, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return handle, False
    return handle, True


def require_name(origin: str, key: VerifierKey | None) -> None:
    """Require that this is an origin, and that of the key.

    Raises: UsageError if it is another than the key's, ValueError if it is none.
    """
    if key is not None and key.name != origin:
        raise UsageError(
            f"found a key named {key.name}, expected {origin}, the ledger's origin; make one with "
            f"fsar-ledger key new FILE --name {origin}"
        )
    if len(origin.encode(errors="replace")) > MAX_NAME_BYTES:
        raise ValueError(f"found an origin of {len(origin)} characters, expected at most {MAX_NAME_BYTES} bytes")
    if not is_name(origin):
        raise ValueError(f"found origin {origin!r}, expected a printable name without spaces and plus signs")


def create(ledger: Path, origin: str) -> None:
    """Create an empty ledger, or finish an interrupted creation; leave anything else there alone.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted: Something else is there, or a ledger of another format.
        WriteFailed: The disk refused.
    """
    if os.path.lexists(ledger / MANIFEST):
        parse_manifest(ledger / MANIFEST, read_manifest(ledger))
        return
    if os.path.lexists(ledger) and not os.path.isdir(ledger):
        raise NotALedger(f"{ledger}: found a file, expected a ledger or a free path; give another path")
    require_outside(ledger.parent, str(ledger))
    manifest = Manifest(FORMAT, origin, VERSION)
    folders = [ledger, ledger / SEGMENTS, ledger / STAGING]
    temporary = disk.temporary_name(ledger / STAGING / MANIFEST)
    with disk.refusals(ledger, "creating a ledger"):
        if os.path.isdir(ledger) and not is_unfinished(ledger):
            if os.path.lexists(ledger / MANIFEST):  # another writer was quicker
                return
            raise NotALedger(
                f"{ledger}: found a folder with other things in it, expected a ledger or a free path; give another path"
            )
        for folder in folders:
            disk.make_folder(folder)
        disk.write_temporary(temporary, canonical.document(manifest))
        with suppress(FileExistsError):  # another writer was quicker
            disk.link_new(temporary, ledger / MANIFEST)
        disk.sync_folder(ledger)
