"""What a Writer does before it appends: create the ledger, lock it, and finish what an interrupted writer left."""

import fcntl
import os
from contextlib import suppress
from pathlib import Path

from fsar_ledger.errors import NotALedger, UsageError, option
from fsar_ledger.ledger.log.note import VerifierKey, doubt, is_name
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.rows.bounds import MAX_NAME_BYTES
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.paths import (
    COMMITS,
    MANIFEST,
    SEGMENTS,
    STAGING,
    commit_path,
    is_unfinished,
    require_outside,
    segment_path,
)
from fsar_ledger.ledger.store.read import LedgerView
from fsar_ledger.ledger.store.record import FORMAT, VERSION, Manifest


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


def require_own(view: LedgerView, key: VerifierKey) -> None:
    """Require that the key signed the newest commit, if there is one, because its next signature covers all before.

    Raises: UsageError if it did not.
    """
    if view.records and (found := doubt(view.records[-1].signed_note(), key)) is not None:
        raise UsageError(
            f"{commit_path(view.path, view.records[-1].number)}: found a newest checkpoint with {found}, expected one "
            f"of {key.key}; "
            f"its next signature would vouch for all that is there: verify the ledger, and say {option('adopt')} to "
            "sign on from "
            "here"
        )


def confirm(view: LedgerView) -> None:
    """Sync every commit that the view shows: its writer may have been killed before doing so."""
    for folder in (view.path, view.path / COMMITS):
        with disk.refusals(folder, "syncing a folder"):
            disk.sync_folder(folder)


def clean(view: LedgerView) -> None:
    """Remove everything from staging except committed segments that are not yet in place.

    Only for a writer that is alone: others may be staging.
    """
    places = [view.location(number) for number in range(len(view.records))]
    kept = {path.name for path in places if path.parent.name == STAGING}
    with disk.refusals(view.path / STAGING, "cleaning up"):
        disk.make_folder(view.path / STAGING)
        leftovers = [
            entry.path
            for entry in list(os.scandir(view.path / STAGING))
            if entry.name not in kept and entry.is_file(follow_symlinks=False)
        ]
    for leftover in leftovers:
        disk.remove(Path(leftover))


def roll_forward(view: LedgerView) -> None:
    """Move every committed segment into place.

    Raises: LedgerCorrupted if one is missing, WriteFailed if the disk refuses.
    """
    for number in range(len(view.records)):
        path, target = view.location(number), segment_path(view.path, number)
        if path != target:
            with disk.refusals(target, "moving a committed segment into place"):
                disk.move(path, target)


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


def create(ledger: Path, origin: str, version: int = VERSION) -> None:
    """Create an empty ledger of this format, or finish an interrupted creation; leave anything else there alone."""
    if os.path.lexists(ledger / MANIFEST):
        return
    if os.path.lexists(ledger) and not os.path.isdir(ledger):
        raise NotALedger(f"{ledger}: found a file, expected a ledger or a free path; give another path")
    require_outside(ledger.parent, str(ledger))
    manifest = Manifest(FORMAT, origin, version)
    folders = [ledger, *([ledger / COMMITS] if version == VERSION else []), ledger / SEGMENTS, ledger / STAGING]
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
