"""Open databases over the rows of a ledger, or over rows in memory."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import pyarrow as pa

from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.rows.schema import SCHEMA
from fsar_ledger.ledger.store.locations import chain_of, earlier_runs, event_count
from fsar_ledger.ledger.store.paths import SEGMENTS
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.shards import views_of

from . import relation
from .connection import Database, Value
from .slices import SLICE_EVENTS, Slices, numbered
from .sql_values import NULLABLE, plain_rows, with_all_columns
from .verified import is_verified, is_verified_for_runs

__all__ = [
    "Database",
    "Value",
    "connect",
    "connect_run",
    "connect_view",
    "from_rows",
    "from_table",
    "plain_rows",
    "table_of",
]

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
    segments = view.segments(are_laid_out=rows_verified)
    slices = Slices(view, demanded) or None
    database = Database(
        view.head,
        segments,
        threads,
        rows_verified=rows_verified,
        file=file,
        slices=slices,
        may_spill=slices is not None,
    )
    stay = {one.path / SEGMENTS for one in views_of(view)}
    passing = [] if file is None else [path for path in segments if path.parent not in stay]
    numbers = slices and relation.RowFilter("TRUE", numbered(view.run_names.runs), frozenset(segments))
    _fill(database, segments, view.releases, numbers, passing)
    return database


def connect_run(view: View, run: str, demanded: str | None) -> Database:
    """Open a database over the events of this run, and of those that it continues; only their segments are read.

    `run_numbers` has this run alone.

    Raises:
        LedgerCorrupted: A segment is not as committed.
        SequenceConflict: As `is_verified`.
    """
    rows_verified = is_verified_for_runs(view, demanded)
    runs = chain_of(view, run)
    parts = [part for name in runs for part in view.parts(name)]
    held = view.segments_of(parts)
    segments = [view.segment(number) for number in held]
    is_long = event_count(parts) > SLICE_EVENTS
    database = Database(view.head, segments, rows_verified=rows_verified, may_spill=is_long)
    ordinal, releases = view.ordinal_of(run), view.releases
    numbers = numbered([run] if ordinal else [], ordinal)
    chosen = relation.RowFilter(relation.of_runs(runs), numbers)
    _fill(database, segments, [releases[number] for number in held], chosen)
    return database


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
