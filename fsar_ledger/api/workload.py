"""The number of processes that a piece of work is worth."""

import os
from pathlib import Path

from fsar_ledger.base.errors import UsageError, option

WORTH_ROBOTS = 320
"""Robots, summed over all runs, whose simulation takes about as long as a process takes to start (0.4 s)."""

WORTH_BYTES = 400 << 10
"""Bytes of segments whose verification takes about as long as a process takes to start (0.4 s)."""


def workers_of(asked: int | None, worth: int | None = None) -> int:
    """Return the number of processes: as asked, else one per core, but no more than the work is worth.

    Raises:
        UsageError: Fewer than one was asked for.
    """
    if asked is None:
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        return cores if worth is None else max(1, min(cores, worth))
    if asked < 1:
        raise UsageError(f"{option('workers', asked)}: expected at least 1; leave it out for one per core")
    return asked


def readers_of(asked: int | None, *ledgers: Path | None) -> int:
    """Return the number of processes that read these ledgers: as asked, else one per core, if there is enough to do.

    Raises: As `workers_of`.
    """
    return workers_of(asked, stored(*ledgers) // WORTH_BYTES)


def stored(*ledgers: Path | None) -> int:
    """Return the bytes of the segments of these ledgers, including staged ones."""
    from fsar_ledger.ledger.store.paths import segment_bytes

    return sum(segment_bytes(ledger) for ledger in ledgers if ledger is not None)
