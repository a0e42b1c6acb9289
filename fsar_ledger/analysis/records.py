"""The record of one run, read from its ledger."""

from collections.abc import Iterator
from pathlib import Path

import pyarrow.compute as pc

from fsar_ledger import printable
from fsar_ledger.errors import UsageError
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.rows import codec, segment
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.read import LedgerView


def record_of(view: LedgerView, run: str) -> LedgerRun:
    """Return all events of the run of this name; only the segment that holds it is decoded.

    Raises:
        UsageError: The ledger has no such run.
        LedgerCorrupted: A segment cannot be read.
    """
    for number, names in enumerate(view.tables(["run_id"])):
        is_its = pc.equal(names.column("run_id"), run)
        if pc.any(is_its).as_py():
            (found,) = codec.decode(segment.read_table(Path(view.segment(number))).filter(is_its))
            return found
    raise _missing(view, run)


def commit_of(view: LedgerView, run: str) -> int:
    """Return the number of the commit, from 0, that recorded the run of this name. Raises: as `record_of`."""
    for number, names in enumerate(view.tables(["run_id"])):
        if pc.any(pc.equal(names.column("run_id"), run)).as_py():
            return number
    raise _missing(view, run)


def starts_of(view: LedgerView) -> Iterator[tuple[str, RunStarted]]:
    """Yield the name and event 0 of each run, in order; plans are no runs. Raises: LedgerCorrupted as `record_of`."""
    for table in view.tables():
        for run in codec.decode(table.filter(pc.equal(table.column("seq"), 0))):
            if isinstance(run.events[0], RunStarted):
                yield run.run_id, run.events[0]


def _missing(view: LedgerView, run: str) -> UsageError:
    return UsageError(f"{view.path}: run {printable.value(run)}: there is no such run")
