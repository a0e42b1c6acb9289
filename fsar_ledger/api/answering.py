"""The looks that an answer may demand before it is given."""

from pathlib import Path

from fsar_ledger.ledger.store.opening import open_for_answers
from fsar_ledger.metrics.verified import is_remembered, required_look

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
