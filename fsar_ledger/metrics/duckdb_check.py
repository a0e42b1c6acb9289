"""Compare the rows of a segment as DuckDB's own Parquet reader finds them with those that pyarrow decoded.

A whole look trusts neither alone: answers come from the one, proofs and replay from the other. `layout` leaves no known
way in which a file could say two things to them; this finds unknown ones. For a file that is byte for byte what its
rows are written as, a digest of each column suffices (the number of its values, and its integers combined). In any
other file every value is compared, since whoever can choose the content of a file can make it fit a digest.
"""

import os
from collections.abc import Iterable, Mapping, Sequence
from functools import cache

import numpy as np
import pyarrow as pa

from fsar_ledger.base.errors import QueryFailed
from fsar_ledger.ledger.rows.arrow import numbers, validity, whole
from fsar_ledger.ledger.rows.schema import COLUMNS
from fsar_ledger.ledger.verify.segment import Digest

from .connection import Database
from .paths import literal, parquet

_DECODED = "decoded_rows"
_EXPECTED = "the same as by pyarrow: rows that both of our readers read alike"


# See docs/decisions/verify-rereads-every-byte.md.
class ReadAgain:
    """What serves as `VerifyOptions.second_reader`; it keeps one connection per process."""

    def by_value(self, path: str, decoded: pa.Table) -> tuple[str, str] | None:
        """Return what DuckDB finds in this segment and what was expected, value by value; None if it is the same."""
        try:
            return _by_value(_database(), path, decoded)
        except QueryFailed as error:
            return _unreadable(error)

    def digest(self, decoded: pa.Table) -> Digest:
        """Return the number of rows, of the values in each column, and the XOR of the integers of each."""
        columns = {name: whole(decoded.column(name)) for name in decoded.column_names}
        counts = [len(column) - column.null_count for column in columns.values()]
        sums = [
            int(np.bitwise_xor.reduce(numbers(columns[name])[validity(columns[name])], initial=0))
            for name in _integers(columns)
        ]
        return Digest(tuple(columns), (len(decoded), *counts, *sums))

    def by_digest(self, digests: Mapping[str, Digest]) -> Mapping[str, tuple[str, str]]:
        """Return what DuckDB finds in these segments and what was expected, by path; nothing where it is the same."""
        found: dict[str, tuple[str, str]] = {}
        alike: dict[tuple[str, ...], list[str]] = {}
        for path, digest in digests.items():
            alike.setdefault(digest.columns, []).append(path)
        for columns, paths in alike.items():
            try:
                numbers_of = _digests(_database(), columns, paths)
            except QueryFailed as error:
                if len(paths) == 1:
                    found[paths[0]] = _unreadable(error)
                for path in paths if len(paths) > 1 else ():
                    found |= self.by_digest({path: digests[path]})
                continue
            for path in paths:
                if (other := _other(digests[path], numbers_of.get(literal(path), ()))) is not None:
                    found[path] = other
        return found


def _unreadable(error: QueryFailed) -> tuple[str, str]:
    return f"a segment that DuckDB cannot read ({error})", _EXPECTED


def _integers(columns: Iterable[str]) -> list[str]:
    return [name for name in columns if COLUMNS[name] == "integer"]


def _digests(database: Database, columns: Sequence[str], paths: Sequence[str]) -> dict[str, tuple[int, ...]]:
    """Return the numbers of `ReadAgain.digest` for each `literal` path, by DuckDB. Raises: QueryFailed."""
    counts = [f'count("{name}")' for name in columns] + [f'bit_xor("{name}")' for name in _integers(columns)]
    rows = database.direct(
        f"SELECT filename, count(*), {', '.join(counts)} FROM {parquet(paths, 'filename = true')} GROUP BY filename"
    )
    return {path: tuple(number or 0 for number in found) for path, *found in rows}  # NULL where all values are


def _other(expected: Digest, found: Sequence[int]) -> tuple[str, str] | None:
    """Return the first number that differs, as found and expected; None if none does."""
    if not found:
        return "no rows by DuckDB", _EXPECTED
    names = ("run_id", *expected.columns, *_integers(expected.columns))
    for name, by_pyarrow, by_duckdb in zip(names, expected.numbers, found, strict=True):
        if by_duckdb != by_pyarrow:
            return f"{by_duckdb} as the digest of column {name} by DuckDB, {by_pyarrow} by pyarrow", _EXPECTED
    return None


def _by_value(database: Database, path: str, decoded: pa.Table) -> tuple[str, str] | None:
    """Compare as `read_again` does, value by value."""
    source = f"FROM {parquet([path])} AS a POSITIONAL JOIN {_DECODED} AS b"
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


def _database() -> Database:
    """Return the connection of this process: one opened before a fork cannot be used after it."""
    return _database_of(os.getpid())


@cache
def _database_of(_process: int) -> Database:
    return Database(None, (), threads=1, caches_files=False)
