"""Open a ledger to answer from it, after the checks of `verify --quick`.

The records, their chain and notes, and the file `checkpoint` are compared here; the bytes of a segment when it is
handed out (`View.segment`). Stray files are left to `verify`, because no answer reads a file that no record names.
So are the derived hashes, except those of a proof, which is checked against the root, and of the index, whose lines are
compared with their records.
"""

from pathlib import Path

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.store import turns
from fsar_ledger.ledger.store.checkpoint import check_chain_checkpoint
from fsar_ledger.ledger.store.manifest import read_manifest
from fsar_ledger.ledger.store.paths import SEGMENTS
from fsar_ledger.ledger.store.read import View, open_chain


def open_ledger(path: Path) -> View:
    """Open the ledger at this path: check its records against each other, without reading any events of segments.

    Raises:
        NotALedger: There is no ledger.
        FormatVersionMismatch: It was written in another format, or holds events of a later release.
        LedgerCorrupted: A record is missing, is not canonical, or contradicts the one before it.
    """
    return open_chain(path, read_manifest(path))


def open_for_answers(path: Path) -> View:
    """Open the ledger at this path, and compare its checkpoint with its newest commits.

    An older note is accepted where a crash may leave it: that of any commit since which the journal holds all. If they
    do not fit, both are read once more while any writer waits.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `open_ledger`; LedgerCorrupted also for any other
            checkpoint, or none.
    """
    view = open_ledger(path)
    problems = check_chain_checkpoint(view)
    if problems:
        with turns.turn(path / SEGMENTS, is_shared=True):
            view = open_ledger(path)
            problems = check_chain_checkpoint(view)
    for problem in problems:
        raise LedgerCorrupted(
            f"{path}/{problem}: commits were removed, or the file was altered; run fsar-ledger verify, and "
            "fsar-ledger maintain recover if it says so"
        )
    return view
