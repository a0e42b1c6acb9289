"""Whether the rows of a query are told apart by the columns that its header calls its key."""

from collections.abc import Iterator

from fsar_ledger.metrics.database import Database
from fsar_ledger.metrics.library import Query


def required(query: Query) -> dict[str, str]:
    """Return a value, the seq of the first event, for each parameter of the query that has no default."""
    return {one.sql_name: "0" for one in query.parameters.values() if one.default is None}


def broken_keys(database: Database, queries: Iterator[Query]) -> list[str]:
    """Return what is wrong with the keys of these queries over the rows of this database, with their defaults."""
    return [f"{query.name}: {fault}" for query in queries for fault in _faults(database, query)]


def _faults(database: Database, query: Query) -> Iterator[str]:
    if (key := query.key) is None:
        return
    rows = database.query(query.name, required(query))
    if unknown := sorted(key.keys() - set(rows.column_names)):
        yield f"key names {', '.join(unknown)}, which is no column"
    elif not key:
        if rows.num_rows > 1:
            yield f"{rows.num_rows} rows, at most one expected"
    else:
        seen = rows.select(list(key))
        yield from (
            f"{column} is NULL" for column, is_nullable in key.items() if not is_nullable and seen[column].null_count
        )
        if several := rows.num_rows - seen.group_by(list(key)).aggregate([]).num_rows:
            yield f"{several} of {rows.num_rows} rows have the key of another"
