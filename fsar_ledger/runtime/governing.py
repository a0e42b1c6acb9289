"""That one process at a time governs a live run: a lock beside its ledger, which the system releases with the process.

It is one of a process (`lockf`), so that a federation that was dropped without being closed holds up no later one of
the same process. Where a disk has no locks, or no place for the file, a second process is found when it commits.
"""

import fcntl
import os
from contextlib import suppress
from pathlib import Path

from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import counted, value
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.store.locations import event_count

from . import snapshot


class Hold:
    """Holds a run for this process, until it is released. Raises: UsageError if another process holds it."""

    def __init__(self, ledger: Path, run: str) -> None:
        self._handle: int | None = None
        place = snapshot.place(ledger, run).with_suffix(".lock")
        with suppress(OSError):
            place.parent.mkdir(exist_ok=True)
            self._handle = os.open(place, os.O_RDWR | os.O_CREAT, 0o666)
        if self._handle is None:
            return
        try:
            fcntl.lockf(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError) as error:
            self.release()
            raise UsageError(
                f"{ledger}: run {value(run)}: found that another process governs it, expected none; stop that one "
                "first, or give this run another name"
            ) from error
        except OSError:
            return  # no locks here

    def release(self) -> None:
        """Let another process govern the run."""
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None


def overtaken(ledger: Path, run: str, known: int) -> str:
    """Say that the run has other events than the known ones, so that another process wrote it; nothing if it has not.

    Raises: As `open_ledger`.
    """
    view = open_ledger(ledger)
    size = event_count(view, run)
    if size == known:
        return ""
    return (
        f"run {value(run)}: found {counted(size, 'event')} on record, expected the {known:,} that this process knows; "
        "another process has written this run meanwhile: stop one of them, and start this one again"
    )
