"""The record of one run, read from its ledger, and its events in the words of `log`."""

from collections.abc import Iterable, Iterator, Sequence

import msgspec
import numpy as np
import pyarrow.compute as pc

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.rows import codec, segment
from fsar_ledger.ledger.rows.codec import LedgerRun, encode_coded
from fsar_ledger.ledger.rows.runs import whole
from fsar_ledger.ledger.store.read import View
from fsar_ledger.metrics.database import Database, from_table
from fsar_ledger.metrics.results import typed


def record_of(view: View, run: str, size: int | None = None) -> LedgerRun:
    """Return the events of the run of this name; only the segments that hold it are decoded.

    With `size`, only those among the first so many events of the ledger; event 0 must be one of them.

    Raises:
        UsageError: The ledger has no such run.
        LedgerCorrupted: A segment cannot be read.
    """
    pieces: list[LedgerRun] = []
    for number in view.segments_of(view.parts(run)):
        table = segment.read_table(view.segment(number))
        table = table.slice(0, len(table) if size is None else max(0, size - view.first(number)))
        pieces += codec.decode(table.filter(pc.equal(table.column("run_id"), run)), is_whole=False)
    if not pieces:
        raise _missing(view, run)
    return whole(pieces)


def commits_of(view: View, run: str) -> list[tuple[int, int]]:
    """Return for each commit that holds events of the run the seq of the first of them and its number, from 0.

    Raises: as `record_of`.
    """
    found: dict[int, int] = {}
    sizes = np.array([commit.tree_size for commit in view.commits])
    for number in view.segments_of(view.parts(run)):
        table = segment.read_table(view.segment(number), ["run_id", "seq"])
        places = np.flatnonzero(pc.equal(table.column("run_id"), run).to_numpy())
        commits, at = np.unique(np.searchsorted(sizes, view.first(number) + places, side="right"), return_index=True)
        found.update(zip(commits.tolist(), table.column("seq").to_numpy()[places[at]].tolist(), strict=True))
    if not found:
        raise _missing(view, run)
    return [(seq, commit) for commit, seq in found.items()]


def starts_of(view: View) -> Iterator[tuple[str, RunStarted]]:
    """Yield the name and event 0 of each run, in order; plans are no runs. Raises: LedgerCorrupted as `record_of`."""
    for table in view.tables():
        for run in codec.decode(table.filter(pc.equal(table.column("seq"), 0))):
            if isinstance(run.events[0], RunStarted):
                yield run.run_id, run.events[0]


def _missing(view: View, run: str) -> UsageError:
    return UsageError(f"{view.path}: run {printable.value(run)}: there is no such run")


MAX_WORDS = 1_000
"""Characters of an event in words that people are shown."""
LINES = """
    SELECT run_id, seq, time_s, action_id, sender, receiver, message, note
    FROM log_lines
    WHERE run_id || ' ' || seq IN (SELECT unnest($places))
"""


class Line(msgspec.Struct, frozen=True):
    """An event in words, as a row of `log`: who tells whom what, or does what. Units: `time_s` seconds of run time.

    None: what the record does not say.
    """

    run_id: str
    seq: int
    time_s: float
    action_id: str | None
    sender: str | None
    receiver: str | None
    message: str
    note: str | None

    @property
    def text(self) -> str:
        """Return who does or tells what, in one line, unescaped."""
        names = self.sender or "?"
        if self.receiver != self.sender or self.sender is None:
            names = f"{names} -> {self.receiver or '?'}"
        return f"{names}: {self.message}" + (f" ({self.note})" if self.note else "")

    @property
    def words(self) -> str:
        """Return the action and the text, as people see them."""
        action = "" if self.action_id is None else f"{printable.value(self.action_id)}  "
        return action + printable.value(self.text, MAX_WORDS)


def lines_of(records: Sequence[LedgerRun], seqs: Iterable[tuple[str, int]]) -> dict[tuple[str, int], Line]:
    """Return these events of the records in words, by run and seq. Raises: as `Database.rows`."""
    with from_table(encode_coded(records)) as database:
        return lines_from(database, seqs)


def lines_from(database: Database, seqs: Iterable[tuple[str, int]]) -> dict[tuple[str, int], Line]:
    """Return these events in words, by run and seq. Raises: as `Database.rows`."""
    found = typed(database.rows(LINES, {"places": [f"{run} {seq}" for run, seq in seqs]}), Line)
    return {(line.run_id, line.seq): line for line in found}
