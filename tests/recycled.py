"""Databases over a few rows that are used again: DuckDB takes longer to make itself and all views than to answer a question about a short history.

What is held or locked in one of these would be there for the next test; for that there is `fsar_ledger.metrics.database.from_rows`.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager

import pyarrow as pa

from fsar_ledger.metrics import database as fresh
from fsar_ledger.metrics.database import Database, Value

_idle: dict[int | None, list[Database]] = {}


def from_rows(rows: Sequence[Mapping[str, Value]], threads: int | None = None) -> AbstractContextManager[Database]:
    """A database over these rows, perhaps one that had others before."""
    return from_table(fresh.table_of(rows), threads)


@contextmanager
def from_table(events: pa.Table, threads: int | None = None) -> Iterator[Database]:
    """A database over this table, perhaps one that had another before; over many rows it is a new one."""
    if len(events) > fresh.FEW_ROWS:
        with fresh.from_table(events, threads) as database:
            yield database
        return
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
