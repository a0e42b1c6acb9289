"""Which runs a ledger holds, for its writer: no run may be in two commits.

The runs are read once, before the first append: of each segment only the few hundred bytes at its beginning that hold
the dictionary of `run_id`. Ten thousand commits take a second. To continue an experiment, the writer needs to know
exactly which runs and plans are there; that takes the rows.
"""

from itertools import repeat
from pathlib import Path
from typing import NamedTuple

import pyarrow as pa

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.rows.arrow import whole
from fsar_ledger.ledger.rows.check import standing_alone
from fsar_ledger.ledger.rows.layout import dictionary_of_runs, read_file
from fsar_ledger.ledger.rows.segment import read_table
from fsar_ledger.ledger.store.read import LedgerView

_BEGINNING_BYTES = 1 << 14


class Held(NamedTuple):
    """The names of the runs that a ledger holds, and of its plans."""

    runs: frozenset[str]
    plans: frozenset[str]


class HeldRuns:
    """The runs of the commits of a ledger, as far as they are known.

    Raises:
        LedgerCorrupted: A segment is missing or its runs cannot be read.
    """

    def __init__(self, view: LedgerView, *, by_row: bool = False):
        self._commits: dict[str, tuple[int, Path]] = {}
        self._plans: set[str] = set()
        tables = view.tables(["run_id", "type"]) if by_row else repeat(None)
        for record, table in zip(view.records, tables, strict=False):
            path = view.location(record.number)
            if table is None:
                self.add(record.number, path, record.rows)
                continue
            runs = table.column("run_id")
            self.add(record.number, path, record.rows, runs.unique().to_pylist())
            self._plans.update(runs.filter(pa.array(standing_alone(whole(table.column("type"))))).to_pylist())

    def add(self, number: int, path: Path, rows: int, runs: list[str] | None = None) -> None:
        """Add the runs of this commit. If they are not given, read them from its segment, which has this many rows."""
        for run in _read(path, rows) if runs is None else runs:
            self._commits.setdefault(run, (number, path))

    def told(self) -> Held:
        """Return the names of these runs, and of the plans where they were read row by row."""
        return Held(frozenset(self._commits.keys() - self._plans), frozenset(self._plans))

    def first_of(self, runs: list[str]) -> tuple[str, int] | None:
        """Return the first of these runs that a commit holds, and the commit's number; None if there is none."""
        for run in runs:
            number, path = self._commits.get(run, (-1, None))
            if path is not None and run in _by_row(path):  # a dictionary may hold strings that no row has
                return run, number
        return None


def runs_of(path: Path, rows: int, data: bytes) -> list[str]:
    """Return the runs of a segment with these bytes and this many rows.

    If another library wrote the segment, names that no row has may be among them.

    Raises:
        LedgerCorrupted: They cannot be read.
    """
    found = dictionary_of_runs(data, rows)
    return _by_row(path) if found is None else found


def _read(path: Path, rows: int) -> list[str]:
    try:
        with path.open("rb") as file:
            found = dictionary_of_runs(file.read(_BEGINNING_BYTES), rows)
        return runs_of(path, rows, read_file(path)) if found is None else found
    except OSError as error:
        raise LedgerCorrupted(
            f"{path}: the segment cannot be read ({error.strerror}); permit reading or restore it"
        ) from error


def _by_row(path: Path) -> list[str]:
    runs: list[str] = read_table(path, ["run_id"]).column("run_id").unique().to_pylist()
    return runs
