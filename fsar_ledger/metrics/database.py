"""Open databases over the rows of a ledger, or over rows in memory."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.rows.schema import SCHEMA
from fsar_ledger.ledger.store.places import segments_of
from fsar_ledger.ledger.store.view import View

from . import relation
from .connection import (
    FAULTS_OF_SQL,
    NULLABLE,
    OUT_OF_MEMORY,
    SHOWN,
    Database,
    Value,
    first_damage,
    plain_rows,
    with_all_columns,
)
from .verified import is_verified

__all__ = [
    "FAULTS_OF_SQL",
    "FEW_ROWS",
    "OUT_OF_MEMORY",
    "SHOWN",
    "Database",
    "Value",
    "connect",
    "connect_run",
    "first_damage",
    "from_rows",
    "from_table",
    "plain_rows",
    "table_of",
]

_NUMBERS = pa.schema([("run_id", pa.string()), ("number", pa.int64())])
FEW_ROWS = 20_000
"""Up to this many rows, copying costs less than planning over an Arrow table does."""


def connect(
    ledger: Path, threads: int | None = None, demanded: str | None = None, file: Path | None = None
) -> Database:
    """Open a database over the committed segments of one head of this ledger, each checked against its hash.

    Args:
        ledger: Its folder.
        threads: Of DuckDB; None is one per core.
        demanded: The newest record that `required_look` has just checked, if no other head will do.
        file: A new file of DuckDB in which the relations stay, for other programs; None: they are in memory.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `open_for_answers`; also LedgerCorrupted for a segment
            that is not as committed.
        SequenceConflict: As `is_verified`.
    """
    view = open_for_answers(ledger)
    rows_verified = is_verified(view, demanded)
    segments = view.segments()
    database = Database(view.head, segments, threads, rows_verified=rows_verified, file=file)
    _fill(database, segments, view.releases)
    return database


def connect_run(view: View, run: str, demanded: str | None = None) -> Database:
    """Open a database over the events of this run; only the segments that hold it are read.

    `run_numbers` has every run.

    Raises:
        LedgerCorrupted: A segment is not as committed.
        SequenceConflict: As `is_verified`.
    """
    rows_verified = is_verified(view, demanded)
    held = segments_of(view, view.parts(run))
    segments = [view.segment(number) for number in held]
    names = view.run_names.runs
    numbers = pa.table({"run_id": names, "number": np.arange(1, len(names) + 1)}, schema=_NUMBERS)
    database = Database(view.head, segments, rows_verified=rows_verified)
    _fill(database, segments, [view.releases[number] for number in held], relation.OneRun(run, numbers))
    return database


def _fill(
    database: Database, segments: Sequence[Path], releases: Sequence[str], only: relation.OneRun | None = None
) -> None:
    """Hold the rows of these segments as `hold_segments`, or close the database if that fails. Raises: As that."""
    try:
        relation.hold_segments(database, segments, releases, only)
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
