"""A ledger that is opened for an answer: what `verify --quick` looks at holds.

The records, their chain and notes, and the file `checkpoint` are compared here; the bytes of a segment when it is handed out
(`LedgerView.segment`). Stray files are left to `verify`: no answer reads a file that no record names. So are the tiles, but for those that a proof is
made of, which lead to the root or to nothing.
"""

from pathlib import Path

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.derived import check_checkpoint
from fsar_ledger.ledger.store.read import LedgerView, open_ledger
from fsar_ledger.ledger.store.record import COMMITS


def open_for_answers(path: Path) -> LedgerView:
    """The ledger at this path, whose checkpoint is the note of its newest commit, or of the one before it, as a crash may leave it.

    Where a writer is at work and the two do not fit together, it waits while both are read once more.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `open_ledger`; LedgerCorrupted also for any other checkpoint, or none.
    """
    view = open_ledger(path)
    problems, _ = check_checkpoint(path, view.records)
    if problems:
        with disk.turn(path / COMMITS, is_shared=True):
            view = open_ledger(path)
            problems, _ = check_checkpoint(path, view.records)
    for problem in problems:
        raise LedgerCorrupted(
            f"{path}/{problem}: commits were removed, or the file was altered; run fsar-ledger verify, and fsar-ledger recover if it says so"
        )
    return view
