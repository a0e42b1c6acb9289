"""The events of records in the words of `log`."""

from collections.abc import Iterable, Sequence

import msgspec

from fsar_ledger.ledger.rows.codec import LedgerRun, encode_coded
from fsar_ledger.metrics.database import Database, from_table
from fsar_ledger.metrics.results import typed

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


def lines_of(records: Sequence[LedgerRun], seqs: Iterable[tuple[str, int]]) -> dict[tuple[str, int], Line]:
    """Return these events of the records in words, by run and seq. Raises: as `Database.rows`."""
    with from_table(encode_coded(records)) as database:
        return lines_from(database, seqs)


def lines_from(database: Database, seqs: Iterable[tuple[str, int]]) -> dict[tuple[str, int], Line]:
    """Return these events in words, by run and seq. Raises: as `Database.rows`."""
    found = typed(database.rows(LINES, {"places": [f"{run} {seq}" for run, seq in seqs]}), Line)
    return {(line.run_id, line.seq): line for line in found}
