"""Compare the rows of a segment as DuckDB's own Parquet reader finds them with those that pyarrow decoded.

A whole look trusts neither alone: answers come from the one, proofs and replay from the other. `layout` leaves no known
way in which a file could say two things to them; this finds unknown ones. For a file that is byte for byte what its
rows are written as, a digest of each column suffices (the number of its values, and its integers combined). In any
other file every value is compared, since whoever can choose the content of a file can make it fit a digest.
"""

import os
from functools import cache

import numpy as np
import pyarrow as pa

from fsar_ledger.errors import QueryFailed
from fsar_ledger.ledger.rows.arrow import numbers, validity, whole

from .connection import Database

_DECODED = "decoded_rows"
_EXPECTED = "the same as by pyarrow: rows that both of our readers read alike"


def read_again(path: str, decoded: pa.Table, is_as_written: bool) -> tuple[str, str] | None:
    """Return what DuckDB finds in this segment and what was expected; None if it finds the decoded rows.

    It serves as `verify.Asked.second_reader`: it can be pickled, and keeps one connection per process.
    """
    database = _databases().setdefault(os.getpid(), None) or _opened()
    try:
        return _by_digest(database, path, decoded) if is_as_written else _by_value(database, path, decoded)
    except QueryFailed as error:
        return f"a segment that DuckDB cannot read ({error})", _EXPECTED


def _by_digest(database: Database, path: str, decoded: pa.Table) -> tuple[str, str] | None:
    """Compare as `read_again` does, by the number of values in each column and the XOR of its integers."""
    columns = {name: whole(decoded.column(name)) for name in decoded.column_names}
    integers = [name for name, column in columns.items() if pa.types.is_int64(column.type)]
    counts = [f'count("{name}")' for name in columns] + [f'bit_xor("{name}")' for name in integers]
    expected = [
        ("run_id", len(decoded)),
        *((name, len(column) - column.null_count) for name, column in columns.items()),
    ]
    for name in integers:
        values = numbers(columns[name])[validity(columns[name])]
        expected.append((name, int(np.bitwise_xor.reduce(values, initial=0))))
    [found] = database.direct(f"SELECT count(*), {', '.join(counts)} FROM {_source(path)}")
    for (name, by_pyarrow), by_duckdb in zip(expected, found, strict=True):
        if (by_duckdb or 0) != by_pyarrow:  # the XOR is NULL where all values are
            return f"{by_duckdb} as the digest of column {name} by DuckDB, {by_pyarrow} by pyarrow", _EXPECTED
    return None


def _by_value(database: Database, path: str, decoded: pa.Table) -> tuple[str, str] | None:
    """Compare as `read_again` does, value by value."""
    source = f"FROM {_source(path)} AS a POSITIONAL JOIN {_DECODED} AS b"
    differences = {name: f'a."{name}" IS DISTINCT FROM b."{name}"' for name in decoded.column_names}
    database.hold(_DECODED, decoded)
    try:
        if database.direct(f"SELECT count(*) {source} WHERE {' OR '.join(differences.values())}") == [(0,)]:
            return None
        [found] = database.direct(
            f"SELECT {', '.join(f'count(*) FILTER ({difference})' for difference in differences.values())} {source}"
        )
    finally:
        database.drop(_DECODED)
    name, count = next(((name, count) for name, count in zip(differences, found, strict=True) if count), ("run_id", 0))
    return f"{count} values of column {name} that DuckDB reads otherwise", _EXPECTED


def _source(path: str) -> str:
    return "read_parquet('{}', hive_partitioning = false)".format(path.replace("'", "''"))


@cache
def _databases() -> dict[int, Database | None]:
    """Return the connection of this process: one opened before a fork cannot be used after it."""
    return {}


def _opened() -> Database:
    database = _databases()[os.getpid()] = Database(None, (), threads=1, caches_files=False)
    return database
