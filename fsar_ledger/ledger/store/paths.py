"""Where a ledger is: what tells a folder that holds one, and what nobody else may write there."""

import os
from contextlib import suppress
from pathlib import Path

from fsar_ledger.errors import NotALedger, UsageError
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.record import COMMITS, MANIFEST, SEGMENTS, STAGING


def require_created(ledger: Path) -> None:
    """The folder is not what an interrupted creation left: that is no damage, and the command that creates the ledger finishes it.

    Raises:
        NotALedger: It is: it holds some of a ledger's folders, in them nothing but a ledger.json on its way, and nothing else.
    """
    with suppress(OSError):
        if os.listdir(ledger) and is_unfinished(ledger):
            raise NotALedger(
                f"{ledger}: found a ledger whose creation was interrupted before anything was in it, expected one with {MANIFEST}; "
                "run the command that creates it again"
            )


def is_unfinished(ledger: Path) -> bool:
    """Whether this folder holds nothing but what an interrupted creation leaves behind, or nothing at all. Raises: OSError if it cannot be read."""
    for entry in list(os.scandir(ledger)):
        if entry.name not in (COMMITS, SEGMENTS, STAGING) or not entry.is_dir(follow_symlinks=False):
            return False
        leftovers = os.listdir(entry.path)
        if any(
            entry.name != STAGING or not (name.startswith(MANIFEST) and name.endswith(disk.TEMPORARY))
            for name in leftovers
        ):
            return False
    return True


def require_outside(out: Path, what: str) -> None:
    """The file `out` would not lie inside any ledger, whether or not the command reads that ledger; a message calls it `what`, as the user did.

    A folder counts as a ledger if two of its three parts are there: a damaged one is evidence, too.

    Raises:
        UsageError: It would, or where it leads to if it is a link.
    """
    named, led_to = Path(os.path.realpath(out.parent)) / out.name, Path(os.path.realpath(out))
    for place in (named, led_to):
        for folder in (place, *place.parents):
            if sum(os.path.lexists(folder / part) for part in (MANIFEST, COMMITS, SEGMENTS)) > 1:
                raise UsageError(
                    f"{what}: found a place inside the ledger {folder}, which holds nothing but its own files; choose one outside"
                )
