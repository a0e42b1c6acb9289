"""Open a ledger, and compare its rows with its root where answers demand that."""

from pathlib import Path

from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.metrics.verified import ensure_verified, is_remembered

from .ledger import Ledger
from .names import Place
from .workload import Progress, readers_of


def demanded_head(ledger: Path, *, verified: bool, progress: Progress | None = None) -> str | None:
    """Compare the rows with the root and return the newest record's SHA-256; None if `verified` is not demanded.

    A remembered comparison is not repeated.

    Raises:
        LedgerCorrupted: The comparison found something.
        NotALedger, FormatVersionMismatch: As `open_for_answers`.
    """
    if not verified:
        return None
    newest = open_for_answers(ledger).record_sha256
    return newest if is_remembered(newest) else ensure_verified(ledger, readers_of(None, ledger), progress)


def open_ledger(path: Place, *, verified: bool = False, progress: Progress | None = None) -> Ledger:
    """Open the ledger in this folder.

    Args:
        path: The folder.
        verified: Compare all rows with the root first, as `verify` does, unless an earlier comparison of this head is
            remembered; then only compare the files with their hashes. Answers about later commits are then refused.
        progress: Called with the segments compared and their total.

    Raises:
        NotALedger, FormatVersionMismatch: The folder holds no ledger that this version reads.
        LedgerCorrupted: It contradicts itself.
    """
    demanded = demanded_head(Path(path), verified=verified, progress=progress)
    view = open_for_answers(Path(path))
    if verified:
        view.segments()  # what is remembered was perhaps compared in another place, and this is an altered copy
    return Ledger(path, demanded=demanded)
