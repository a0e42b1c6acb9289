"""The record of one run, read from its ledger."""

from bisect import bisect_right
from collections.abc import Iterator

import pyarrow.compute as pc

from fsar_ledger import printable
from fsar_ledger.errors import UsageError
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.rows import codec, segment
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.rows.pieces import joined
from fsar_ledger.ledger.store.proof import blocks
from fsar_ledger.ledger.store.view import View


def record_of(view: View, run: str, size: int | None = None) -> LedgerRun:
    """Return the events of the run of this name; only the segments that hold it are decoded.

    With `size`, only those among the first so many events of the ledger; event 0 must be one of them.

    Raises:
        UsageError: The ledger has no such run.
        LedgerCorrupted: A segment cannot be read.
    """
    pieces: list[LedgerRun] = []
    for number, names in enumerate(view.tables(["run_id"])):
        is_its = pc.equal(names.column("run_id"), run)
        if pc.any(is_its).as_py():
            table = segment.read_table(view.segment(number))
            most = len(table) if size is None else max(0, size - view.first(number))
            pieces += codec.decode(table.slice(0, most).filter(is_its.slice(0, most)), is_whole=False)
    if not pieces:
        raise _missing(view, run)
    return joined(pieces)


def commits_of(view: View, run: str) -> list[tuple[int, int]]:
    """Return for each commit that holds events of the run the seq of the first of them and its number, from 0.

    Raises: as `record_of`.
    """
    found: list[tuple[int, int]] = []
    for block in blocks(view):
        if block.run != run:
            continue
        at, seq = block.first, block.seq
        while at < block.first + block.events:
            number = bisect_right(view.commits, at, key=lambda commit: commit.tree_size)
            found.append((seq, number))
            seq += view.commits[number].tree_size - at
            at = view.commits[number].tree_size
    if not found:
        raise _missing(view, run)
    return found


def starts_of(view: View) -> Iterator[tuple[str, RunStarted]]:
    """Yield the name and event 0 of each run, in order; plans are no runs. Raises: LedgerCorrupted as `record_of`."""
    for table in view.tables():
        for run in codec.decode(table.filter(pc.equal(table.column("seq"), 0))):
            if isinstance(run.events[0], RunStarted):
                yield run.run_id, run.events[0]


def _missing(view: View, run: str) -> UsageError:
    return UsageError(f"{view.path}: run {printable.value(run)}: there is no such run")
