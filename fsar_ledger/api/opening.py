"""Opening a ledger, and the comparison with its root that an answer may demand."""

from pathlib import Path

from fsar_ledger.ledger.store.opening import open_for_answers
from fsar_ledger.metrics.verified import is_remembered, required_look

from .ledger import Ledger
from .names import Place
from .workload import Progress, readers_of


def demanded_head(ledger: Path, *, verified: bool, progress: Progress | None = None) -> str | None:
    """Return the newest record once its rows were compared with its root; None if `verified` is not demanded.

    An earlier comparison that is remembered will do.

    Raises:
        LedgerCorrupted: The look doubts something.
        NotALedger, FormatVersionMismatch: As `open_for_answers`.
    """
    if not verified:
        return None
    newest = open_for_answers(ledger).record_sha256
    return newest if is_remembered(newest) else required_look(ledger, readers_of(None, ledger), progress)


def open_ledger(path: Place, *, verified: bool = False, progress: Progress | None = None) -> Ledger:
    """Open the ledger in this folder.

    Args:
        path: The folder.
        verified: Compare all rows with the root first, as `verify` does, unless that is remembered of this head;
            answers about later commits are then refused.
        progress: Called with segments compared and in all.

    Raises:
        NotALedger, FormatVersionMismatch: There is none that this version reads.
        LedgerCorrupted: It contradicts itself.
    """
    if not verified:
        open_for_answers(Path(path))
    return Ledger(path, demanded=demanded_head(Path(path), verified=verified, progress=progress))
