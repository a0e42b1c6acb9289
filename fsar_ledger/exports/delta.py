"""A ledger's rows as a Delta table (delta.io) whose files are the ledger's own segments, linked and not copied.

The log of a Delta table lies beside its files, and the folder of a ledger holds nothing but its own, so the table is a
folder of its own. Segments never change, and removing a link leaves the other, so neither harms the other.
"""

import os
import shutil
from pathlib import Path

from fsar_ledger.base.errors import UsageError, WriteFailed, option
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.paths import require_outside, segment_name
from fsar_ledger.ledger.store.read import View

from .shared import Written

DOING = "writing a Delta table"


def write(out: Path, view: View) -> Written:
    """Write a new folder with the segments of the ledger, one more of the rows of its journal, and `_delta_log`.

    Raises:
        UsageError: Something is at `out`, it lies inside a ledger, or the ledger has no events.
        LedgerCorrupted: A segment is not as committed.
        WriteFailed: The folder cannot be written; nothing is left there.
        ImportError: There is no library `deltalake`.
    """
    if os.path.lexists(out):
        raise UsageError(f"{option('out', out)}: found something there, expected a free path for a new folder")
    require_outside(out, option("out", out))
    if not view.head.size:
        raise UsageError(f"{view.path}: found no events, expected some: a Delta table has the columns of its files")
    work = disk.temporary_name(out)
    try:
        with disk.refusals(out, DOING):
            work.mkdir(parents=True)
        linked = sum(_place(view, number, work, out) for number in range(len(view.releases)))
        _make_log(work, out, view.head.root)
        with disk.refusals(out, DOING):
            os.rename(work, out)
    except BaseException:
        shutil.rmtree(work, ignore_errors=True)
        raise
    placed, journal = len(view.chain.placed), view.head.size - view.chain.placed_size
    told = f"{linked:,} segments are hard links into the ledger, {placed - linked:,} are copies"
    return Written(view.head.size, (told, f"{journal:,} events of the journal are in a file of their own"))


def _place(view: View, number: int, work: Path, out: Path) -> bool:
    """Put this segment into the folder; return whether it is a link into the ledger. Raises: As `write`."""
    segment = view.segment(number)
    file = work / Path(segment_name(view.first(number), view.end(number))).name
    with disk.refusals(out, DOING):
        try:
            os.link(segment, file)
        except OSError:  # another file system, or one without links
            shutil.copyfile(segment, file)
            return False
    return segment.is_relative_to(view.path)


def _make_log(work: Path, out: Path, root: str) -> None:
    """Make the log of the table of these files. Raises: WriteFailed, ImportError."""
    from deltalake import convert_to_deltalake
    from deltalake.exceptions import DeltaError

    try:
        convert_to_deltalake(work, name="events", description=f"The events of the ledger with the root {root}")
    except (DeltaError, OSError) as error:
        raise WriteFailed(
            f"{out}: cannot be written ({error}); nothing was left there: choose another place"
        ) from error
