"""The replay analyzer: any moment of a run, any difference between two, what would have been, and why.

All of it rests on the record of a run, read from its ledger, and tells events in the words of `log`.
"""

from collections.abc import Iterable, Iterator, Sequence
from operator import itemgetter

import msgspec
import numpy as np
import pyarrow.compute as pc

from fsar_ledger.base import printable
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.rows import codec, segment
from fsar_ledger.ledger.rows.codec import LedgerRun, encode_coded
from fsar_ledger.ledger.store.locations import chain_of, event_count
from fsar_ledger.ledger.store.read import View
from fsar_ledger.metrics.database import Database, from_table
from fsar_ledger.metrics.results import typed


def commits_of(view: View, run: str) -> list[tuple[int, int]]:
    """Return for each commit that holds events of the run the seq of the first of them and its number, from 0.

    Those of the runs that it continues come first, and seqs count on. Raises: as `record_of`.
    """
    found: dict[int, int] = {}
    sizes = np.array(view.commits.sizes)
    shift = 0
    for name in chain_of(view, run):
        parts = view.parts(name)
        for number in view.segments_of(parts):
            table = segment.read_table(view.segment(number), ["run_id", "seq"])
            places = np.flatnonzero(pc.equal(table.column("run_id"), name).to_numpy())
            commits, at = np.unique(np.searchsorted(sizes, places + view.first(number), "right"), return_index=True)
            seqs = np.maximum(table.column("seq").to_numpy()[places[at]], 1 if shift else 0) + shift
            found.update(zip(commits.tolist(), seqs.tolist(), strict=True))
        shift += event_count(parts) - 1
    return [(seq, commit) for commit, seq in found.items()]


def starts_of(view: View) -> Iterator[tuple[str, RunStarted]]:
    """Yield the name and event 0 of each run, in order; plans are no runs. Raises: LedgerCorrupted as `record_of`."""
    for table in view.tables():
        for run in codec.decode(table.filter(pc.equal(table.column("seq"), 0))):
            if isinstance(run.events[0], RunStarted):
                yield run.run_id, run.events[0]


MAX_WORDS = 1_000
"""Characters of an event in words that people are shown."""
LINES = """
    SELECT run_id, seq, time_s, action_id, sender, receiver, message, note
    FROM log_lines
    WHERE run_id || ' ' || seq IN (SELECT unnest($places)) AND seq BETWEEN $first AND $last
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
    places = sorted(seqs, key=itemgetter(1))
    if not places:
        return {}
    names = [f"{run} {seq}" for run, seq in places]
    found = typed(database.rows(LINES, {"places": names, "first": places[0][1], "last": places[-1][1]}), Line)
    return {(line.run_id, line.seq): line for line in found}
