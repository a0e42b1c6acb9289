"""Open a ledger to answer from it, after the checks of `verify --quick`.

The records, their chain and notes, and the file `checkpoint` are compared here; the bytes of a segment when it is
handed out (`LedgerView.segment`). Stray files are left to `verify`, because no answer reads a file that no record
names. So are the tiles, except those of a proof, which is checked against the root.
"""

from pathlib import Path

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.derived import check_checkpoint
from fsar_ledger.ledger.store.paths import COMMITS
from fsar_ledger.ledger.store.read import LedgerView, open_ledger


def open_for_answers(path: Path) -> LedgerView:
    """Open the ledger at this path, and compare its checkpoint with the note of its newest commit.

    The note of the commit before is accepted too: a crash may leave that one. If the two do not fit, both are read once
    more while any writer waits.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `open_ledger`; LedgerCorrupted also for any other
            checkpoint, or none.
    """
    view = open_ledger(path)
    problems, _ = check_checkpoint(path, view.records)
    if problems:
        with disk.turn(path / COMMITS, is_shared=True):
            view = open_ledger(path)
            problems, _ = check_checkpoint(path, view.records)
    for problem in problems:
        raise LedgerCorrupted(
            f"{path}/{problem}: commits were removed, or the file was altered; run fsar-ledger verify, and "
            "fsar-ledger recover if it says so"
        )
    return view
