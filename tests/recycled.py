"""Databases for our own questions: reused over a few rows, since starting DuckDB with all views takes longer than
asking about few events; over a ledger in this process, since another one takes half a second to start."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import pyarrow as pa

from fsar_ledger.metrics import database as fresh
from fsar_ledger.metrics.database import Database, Value

_idle: dict[int | None, list[Database]] = {}


def from_rows(rows: Sequence[Mapping[str, Value]], threads: int | None = None) -> AbstractContextManager[Database]:
    """Provide a database over these rows, possibly a reused one."""
    return from_table(fresh.table_of(rows), threads)


@contextmanager
def from_table(events: pa.Table, threads: int | None = None) -> Iterator[Database]:
    """Provide a database over this table, possibly a reused one; over many rows it is always new."""
    if len(events) > fresh.FEW_ROWS:
        with fresh.from_table(events, threads) as database:
            yield database
        return
    threads = threads or 1
    if idle := _idle.setdefault(threads, []):
        database = idle.pop()
        database.refill(events)
    else:
        database = fresh.from_table(events, threads)
    try:
        yield database
    except BaseException:
        database.close()
        raise
    idle.append(database)


def asked(ledger: Path, sql: str) -> list[dict[str, Any]]:
    """Return the rows of our own SELECT over a ledger; `Ledger.sql` trusts no SQL and asks in another process."""
    with fresh.connect(ledger, 1) as database:
        return database.rows(sql)
