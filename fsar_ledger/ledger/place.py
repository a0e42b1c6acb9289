"""Where a ledger is: what tells a folder that holds one, and what nobody else may write there."""

import os
from pathlib import Path

from fsar_ledger.errors import UsageError
from fsar_ledger.ledger.record import COMMITS, MANIFEST, SEGMENTS


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
