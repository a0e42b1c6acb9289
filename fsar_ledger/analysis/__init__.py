"""Replay analysis: any moment of a run, the differences between two, what would have been, and why.

Everything works on the record of a run, read from its ledger; events are worded as in `log`.
"""

from collections.abc import Iterable, Iterator, Sequence
from operator import itemgetter

import msgspec
import numpy as np
import pyarrow.compute as pc

from fsar_ledger.base import printable
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.rows import codec
from fsar_ledger.ledger.rows.codec import LedgerRun, encode_coded
from fsar_ledger.ledger.store.locations import chain_of, event_count
from fsar_ledger.ledger.store.read import View
from fsar_ledger.metrics.database import Database, from_table
from fsar_ledger.metrics.results import typed


def commits_of(view: View, run: str) -> list[tuple[int, int]]:
    """Return (first seq, commit number) for each commit that holds events of the run; commits count from 0.

    Commits of the runs that it continues come first, and seqs run on. Raises: as `record_of`.
    """
    first_seqs: dict[int, int] = {}
    sizes = np.array(view.commits.sizes)
    shift = 0
    for name in chain_of(view, run):
        parts = view.parts(name)
        for number in view.segments_of(parts):
            table = view.table(number, ["run_id", "seq"])
            positions = np.flatnonzero(pc.equal(table.column("run_id"), name).to_numpy())
            commits, firsts = np.unique(
                np.searchsorted(sizes, positions + view.first(number), "right"), return_index=True
            )
            seqs = np.maximum(table.column("seq").to_numpy()[positions[firsts]], 1 if shift else 0) + shift
            first_seqs.update(zip(commits.tolist(), seqs.tolist(), strict=True))
        shift += event_count(parts) - 1
    return [(seq, commit) for commit, seq in first_seqs.items()]


def starts_of(view: View) -> Iterator[tuple[str, RunStarted]]:
    """Yield the name and event 0 of each run, in order; plans are no runs. Raises: LedgerCorrupted as `record_of`."""
    for table in view.tables():
        for run in codec.decode(table.filter(pc.equal(table.column("seq"), 0))):
            if isinstance(run.events[0], RunStarted):
                yield run.run_id, run.events[0]


MAX_WORDS = 1_000
"""Maximum length, in characters, of an event's text on display."""
LINES = """
    SELECT run_id, seq, time_s, action_id, sender, receiver, message, note
    FROM log_lines
    WHERE run_id || ' ' || seq IN (SELECT unnest($places)) AND seq BETWEEN $first AND $last
"""


class Line(msgspec.Struct, frozen=True):
    """An event in words, as a row of `log`: sender, receiver, message. Units: `time_s` seconds of run time.

    None: not on record.
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
        """Return the names, the message and the note in one line, unescaped."""
        names = self.sender or "?"
        if self.receiver != self.sender or self.sender is None:
            names = f"{names} -> {self.receiver or '?'}"
        return f"{names}: {self.message}" + (f" ({self.note})" if self.note else "")

    @property
    def words(self) -> str:
        """Return the action and the text, escaped for display."""
        action = "" if self.action_id is None else f"{printable.value(self.action_id)}  "
        return action + printable.value(self.text, MAX_WORDS)


def lines_of(records: Sequence[LedgerRun], seqs: Iterable[tuple[str, int]]) -> dict[tuple[str, int], Line]:
    """Return the lines of these events of the records, by run and seq. Raises: as `Database.rows`."""
    with from_table(encode_coded(records)) as database:
        return lines_from(database, seqs)


def lines_from(database: Database, seqs: Iterable[tuple[str, int]]) -> dict[tuple[str, int], Line]:
    """Return the lines of these events, by run and seq. Raises: as `Database.rows`."""
    keys = sorted(seqs, key=itemgetter(1))
    if not keys:
        return {}
    names = [f"{run} {seq}" for run, seq in keys]
    lines = typed(database.rows(LINES, {"places": names, "first": keys[0][1], "last": keys[-1][1]}), Line)
    return {(line.run_id, line.seq): line for line in lines}
