"""A ledger that is opened for an answer by the command line, and what is said of its rows: one line on stderr where they were not compared with the root."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from fsar_ledger.ledger.store.opening import open_for_answers
from fsar_ledger.metrics.verified import is_remembered, required_look

from .memory import readers_of
from .progress import Progress
from .terminal import say

if TYPE_CHECKING:
    from fsar_ledger.metrics.database import Database


@contextmanager
def answering(ledger: Path, *, verified: bool) -> Iterator["Database"]:
    """A database over the ledger; when the answer has been given, it is said if its rows were not compared with the root.

    Raises:
        FsarLedgerError: As `connect`; with `verified` as `demanded_head`, too.
    """
    from fsar_ledger.metrics.database import connect

    with connect(ledger, demanded=demanded_head(ledger, verified=verified)) as database:
        yield database
        warn(ledger, rows_verified=bool(database.rows_verified))


def warn_of_missing(ledger: Path, database: "Database") -> None:
    """One line on stderr if runs that were planned are missing: what was judged is not the experiment."""
    from fsar_ledger.metrics.plans import completeness

    if (found := completeness(database).warning()) is not None:
        say(f"{ledger}: {found}; `fsar-ledger info {ledger}` says how to go on")


def of_plans(database: "Database") -> dict[str, object]:
    """What JSON says of the runs that were planned."""
    from fsar_ledger.metrics.plans import completeness

    return completeness(database).answer()


def demanded_head(ledger: Path, *, verified: bool) -> str | None:
    """The newest record whose rows are compared with its root, remembered or by a whole look now, if that is demanded.

    Raises:
        LedgerCorrupted: The look doubts something.
        NotALedger, FormatVersionMismatch: As `open_for_answers`.
    """
    if not verified:
        return None
    newest = open_for_answers(ledger).record_sha256
    return newest if is_remembered(newest) else looked_head(ledger, readers_of(None, ledger))


def looked_head(ledger: Path, workers: int) -> str:
    """The newest record of the ledger, after a whole look. Raises: as `required_look`."""
    with Progress("verified", "segments") as progress:
        return required_look(ledger, workers, progress)


def not_observed(database: "Database", query: str, run: str | None = None) -> dict[str, object]:
    """What JSON says of concerns that the packaged query rests on and that not all runs (or this one) observe, if there are any; a line on stderr does too."""
    from fsar_ledger.metrics.observing import told, unobserved

    found = unobserved(database, database.library.find(query), run)
    if (line := told(found)) is None:
        return {}
    say(line)
    return {"not_observed": found}


def warn(ledger: Path, *, rows_verified: bool) -> None:
    """One line on stderr if the rows were not compared with the root."""
    if not rows_verified:
        say(
            f"the rows of {ledger} were not compared with its root; `fsar-ledger verify {ledger}` does that, and --verified demands it"
        )
