"""Where a ledger is: what tells a folder that holds one, and what nobody else may write there."""

import os
from pathlib import Path

from fsar_ledger.errors import NotALedger, UsageError
from fsar_ledger.ledger import disk
from fsar_ledger.ledger.record import COMMITS, MANIFEST, SEGMENTS, STAGING


def require_created(ledger: Path) -> None:
    """The folder is not what an interrupted creation left: that is no damage, and the command that creates the ledger finishes it.

    Raises:
        NotALedger: It is: it holds some of a ledger's folders, in them nothing but a ledger.json on its way, and nothing else.
    """
    if _is_unfinished(ledger):
        raise NotALedger(
            f"{ledger}: found a ledger whose creation was interrupted before anything was in it, expected one with {MANIFEST}; "
            "run the command that creates it again"
        )


def _is_unfinished(ledger: Path) -> bool:
    try:
        folders = list(os.scandir(ledger))
        if not folders or any(entry.name not in (COMMITS, SEGMENTS, STAGING) or not entry.is_dir(follow_symlinks=False) for entry in folders):
            return False
        leftovers = [(entry.name, name) for entry in folders for name in os.listdir(entry.path)]
    except OSError:
        return False
    return all(folder == STAGING and name.startswith(MANIFEST) and name.endswith(disk.TEMPORARY) for folder, name in leftovers)


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
                raise UsageError(f"{what}: found a place inside the ledger {folder}, which holds nothing but its own files; choose one outside")
