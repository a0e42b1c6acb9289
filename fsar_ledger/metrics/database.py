"""Open databases over the rows of a ledger, or over rows in memory."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import TypeVar

import numpy as np
import pyarrow as pa

from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.rows.schema import SCHEMA
from fsar_ledger.ledger.store.derived import Extent
from fsar_ledger.ledger.store.locations import chain_of, earlier_runs
from fsar_ledger.ledger.store.paths import SEGMENTS, segment_bytes
from fsar_ledger.ledger.store.read import View

from . import relation
from .connection import NULLABLE, Database, Value, plain_rows, with_all_columns
from .verified import is_verified, is_verified_for_runs

__all__ = [
    "Database",
    "Slices",
    "Value",
    "connect",
    "connect_run",
    "connect_view",
    "from_rows",
    "from_table",
    "plain_rows",
    "table_of",
]

_One = TypeVar("_One")
_NUMBERS = pa.schema([("run_id", pa.string()), ("number", pa.int64())])
SLICE_EVENTS = 1 << 19
"""Events that are judged at once: few enough to be judged in half a gigabyte."""
LEAST_BYTES = 4
"""Of an event in a segment; those of a fleet take 10 to 17."""
FEW_ROWS = 20_000
"""Up to this many rows, copying costs less than planning over an Arrow table does."""


def connect(
    ledger: Path, threads: int | None = None, demanded: str | None = None, file: Path | None = None
) -> Database:
    """Open a database over the committed segments of one head of this ledger, each checked against its hash.

    Args:
        ledger: Its folder.
        threads: Of DuckDB; None is one per core.
        demanded: The newest record that `ensure_verified` has just checked, if no other head will do.
        file: A new file of DuckDB in which the relations stay, for other programs; None: they are in memory.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `open_for_answers`; also LedgerCorrupted for a segment
            that is not as committed.
        SequenceConflict: As `is_verified`.
    """
    return connect_view(open_for_answers(ledger), threads, demanded, file)


def connect_view(
    view: View, threads: int | None = None, demanded: str | None = None, file: Path | None = None
) -> Database:
    """Open a database over this head, as `connect`. Raises: LedgerCorrupted, SequenceConflict."""
    rows_verified = is_verified(view, demanded)
    earlier_runs(view)  # what `relation` puts together follows one another
    segments = view.segments()
    database = Database(view.head, segments, threads, rows_verified=rows_verified, file=file)
    stay = view.path / SEGMENTS
    passing = [] if file is None else [path for path in segments if path.parent != stay]
    _fill(database, segments, view.releases, passing=passing)
    return database


def connect_run(view: View, run: str, demanded: str | None = None) -> Database:
    """Open a database over the events of this run, and of those that it continues; only their segments are read.

    `run_numbers` has this run alone.

    Raises:
        LedgerCorrupted: A segment is not as committed.
        SequenceConflict: As `is_verified`.
    """
    rows_verified = is_verified_for_runs(view, demanded)
    runs = chain_of(view, run)
    held = view.segments_of([part for name in runs for part in view.parts(name)])
    segments = [view.segment(number) for number in held]
    database = Database(view.head, segments, rows_verified=rows_verified)
    ordinal, releases = view.ordinal_of(run), view.releases
    numbers = _numbers([run] if ordinal else [], ordinal)
    chosen = relation.RowFilter(relation.of_runs(runs), numbers)
    _fill(database, segments, [releases[number] for number in held], chosen)
    return database


class Slices:
    """Databases over some runs of a ledger after the other, so that memory does not grow with the ledger.

    Each has whole runs, of about `most` events, one run at least; it is closed when the next is asked for. Of a ledger
    of fewer events there is one, over all of it.

    Raises: As `connect_view`, when they are asked for.
    """

    def __init__(self, view: View, demanded: str | None = None, most: int = SLICE_EVENTS) -> None:
        self._view = view
        self._demanded = demanded
        self._rows_verified = is_verified_for_runs(view, demanded)
        self._most = most
        # A bomb has many rows in few bytes, and nothing to be judged: to judge it in parts would take longer.
        is_long = view.head.size > most and segment_bytes(view.path) > LEAST_BYTES * view.head.size
        self._extents = view.extents() if is_long else []
        wholes = _continuing(self._extents, earlier_runs(view) if is_long else {})
        parts = parts_of(wholes, lambda whole: sum(one.rows for one in whole), most)
        self._slices = [list(chain.from_iterable(part)) for part in parts]

    def __len__(self) -> int:
        return max(1, len(self._slices))

    def __iter__(self) -> Iterator[Database]:
        if not self._slices:
            with connect_view(self._view, demanded=self._demanded) as database:
                yield database
        for runs in self._slices:
            with self._connect(runs) as database:
                yield database

    def _connect(self, runs: Sequence[Extent]) -> Database:
        view, releases = self._view, self._view.releases
        first, end = min(one.first for one in runs), max(one.end for one in runs)
        held = {number: view.segment(number) for number in view.segments_between(first, end)}
        names = [one.run for one in runs]
        others = [one for one in self._extents if one.first < end and one.end > first and one.run not in set(names)]
        cut = {number for one in others for number in view.segments_between(one.first, one.end)}
        whole = frozenset(path for number, path in held.items() if number not in cut)
        database = Database(view.head, [*held.values()], rows_verified=self._rows_verified)
        # See docs/decisions/slices-have-a-table-for-each-concern.md.
        # One run of more events is not worth tables: they would take memory with its length.
        database.keeps_events = sum(one.rows for one in runs) <= self._most
        chosen = relation.RowFilter(relation.OF_NUMBERED, _numbers(names), whole)
        _fill(database, [*held.values()], [releases[number] for number in held], chosen)
        return database


def _continuing(extents: Iterable[Extent], continues: Mapping[str, str]) -> list[list[Extent]]:
    """Return where runs are, those together that continue each other, in the order in which the first of them begin."""
    found: dict[str, list[Extent]] = {}
    first: dict[str, str] = {}
    for one in extents:
        whole = first[one.run] = first.get(continues.get(one.run, ""), one.run)
        found.setdefault(whole, []).append(one)
    return list(found.values())


def parts_of(every: Iterable[_One], size_of: Callable[[_One], int], most: int) -> Iterator[list[_One]]:
    """Yield these in order, in parts of at most this size all together, or of one that is larger."""
    part: list[_One] = []
    whole = 0
    for one in every:
        size = size_of(one)
        if part and whole + size > most:
            yield part
            part, whole = [], 0
        part.append(one)
        whole += size
    if part:
        yield part


def _numbers(runs: Sequence[str], first: int = 1) -> pa.Table:
    """Return the relation `run_numbers` of these runs, numbered from `first` on."""
    numbers = np.arange(first, first + len(runs))
    return pa.table({"run_id": pa.array(runs, pa.string()), "number": numbers}, schema=_NUMBERS)


def _fill(
    database: Database,
    segments: Sequence[Path],
    releases: Sequence[str],
    chosen: relation.RowFilter | None = None,
    passing: Sequence[Path] = (),
) -> None:
    """Hold the rows of these segments as `hold_segments`, or close the database if that fails. Raises: As that."""
    try:
        relation.hold_segments(database, segments, releases, chosen, passing)
    except BaseException:
        database.close()
        raise


def from_table(events: pa.Table, threads: int | None = None) -> Database:
    """Open a database over rows in memory; columns that the table lacks are NULL."""
    database = Database(None, (), threads)
    if len(events) <= FEW_ROWS:
        database.refill(events)
    else:
        database.hold("events", with_all_columns(events))
    return database


def from_rows(rows: Sequence[Mapping[str, Value]], threads: int | None = None) -> Database:
    """Open a database over these rows; columns that a row lacks are NULL. For tests and small questions.

    Raises: as `table_of`.
    """
    return from_table(table_of(rows), threads)


def table_of(rows: Sequence[Mapping[str, Value]]) -> pa.Table:
    """Return these rows with all columns of events; those that a row lacks are NULL.

    Raises:
        ValueError: A row has a column that events do not have.
    """
    names = SCHEMA.names
    if unknown := sorted({name for row in rows for name in row} - set(names)):
        raise ValueError(f"rows: found columns {', '.join(unknown)}, expected those of the ledger's schema")
    return pa.Table.from_pylist([{name: row.get(name) for name in names} for row in rows], schema=NULLABLE)
