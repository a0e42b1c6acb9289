"""A slice of a ledger: some of its runs, a database over their events, and the cache of its answers.

The cache lies beside the user's other caches, never in a ledger, and belongs to this user on this machine, who could as
well change the program. Entries are keyed by the hashes of the segments that their slice was read from, the runs and
their positions in these, the texts of the queries, and this program's own text. A reader has just compared the
segments with their hashes, so an entry is about exactly the bytes that lie there. Damaged entries are recomputed.
Losing the cache costs one more pass over the events.
"""

import hashlib
import json
import sqlite3
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from functools import cache, partial
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import msgspec
import pyarrow as pa

from fsar_ledger import __version__
from fsar_ledger.ledger.store.derived import Extent
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.record import Head

from . import relation
from .connection import Database
from .library import library
from .verified import cache_folder, is_own_file

CACHE_BYTES = 1 << 30
"""Maximum size of the cache; the oldest entries are dropped."""


class SliceQuery(NamedTuple):
    """A query of each slice: `of` answers it, and `text` identifies all that the answer depends on but the events.

    `of` can be sent to another process. `reads` are the relations that it reads, None if these are not known.
    """

    text: str
    of: Callable[[Database], pa.Table]
    reads: frozenset[str] | None = None


class Slice(NamedTuple):
    """Some runs of a ledger, and the `digest` of the bytes that hold them; None where these have no hash yet.

    `view` is the ledger, and `beside` are all of its runs. About `most` events are judged at once.
    """

    runs: tuple[Extent, ...]
    digest: str | None
    view: View
    beside: Sequence[Extent]
    most: int


def slice_query(sql: str) -> SliceQuery:
    """Return the query of this SELECT, whose answer depends on the texts of all queries that it reads."""
    reads = frozenset(library().mentioned(sql))
    needs = library().needs(reads)
    return SliceQuery(digest_of([sql, *(query.sha256 for query in needs)]), partial(Database.table, sql=sql), reads)


def slice_of(view: View, runs: Sequence[Extent], beside: Sequence[Extent], most: int) -> Slice:
    """Return the slice of a ledger that has these runs."""
    numbers, placed = view.segments_of(runs), view.chain.placed
    if numbers[-1] >= len(placed):
        return Slice(tuple(runs), None, view, beside, most)  # a journal has no hash
    hashes = [(placed[number].first, placed[number].segment_sha256) for number in numbers]
    digest = digest_of([repr(hashes), repr([msgspec.structs.astuple(extent) for extent in runs])])
    return Slice(tuple(runs), digest, view, beside, most)


def connect(one: Slice, head: Head, rows_verified: bool | None, threads: int | None = None) -> Database:
    """Return a database for the events of a slice, still empty."""
    return Database(head, segments(one), threads, rows_verified=rows_verified, may_spill=True)


def segments(one: Slice) -> list[Path]:
    """Return the segments that hold the runs of a slice, and perhaps other runs."""
    return [one.view.segment(number) for number in one.view.segments_of(one.runs)]


def fill(database: Database, one: Slice, parts: relation.Parts | None = None) -> None:
    """Make the events of a slice, or of these parts of its run, the events of a database.

    Raises: As `database.connect_view`.
    """
    runs, view, releases = one.runs, one.view, one.view.releases
    numbers = view.segments_of(runs)
    paths = {number: view.segment(number) for number in numbers}
    names = {run.run for run in runs}
    others = [run for run in one.beside if run.run not in names and _meets(view, run, numbers)]
    mixed = {number for run in others for number in view.segments_between(run.first, run.end)}
    unshared = frozenset(path for number, path in paths.items() if number not in mixed)
    # See docs/decisions/slices-make-no-tables.md.
    condition, numbered_runs = relation.OF_NUMBERED, [run.run for run in runs]
    if parts is not None:
        condition, numbered_runs = relation.of_runs(sorted(names)), [parts.run]
    chosen = relation.RowFilter(condition, relation.numbered(numbered_runs), unshared)
    relation.hold_segments(database, [*paths.values()], [releases[number] for number in paths], chosen, (), parts)


def _meets(view: View, extent: Extent, numbers: Sequence[int]) -> bool:
    return extent.first < view.end(numbers[-1]) and extent.end > view.first(numbers[0])


def digest_of(texts: Iterable[str]) -> str:
    """Return the SHA-256 of these texts in this order, in hex."""
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()


@cache
def _program() -> str:
    """Return a digest of the code that reads events and answers: this package's text, DuckDB and Arrow."""
    folders = ("metrics", "events", "ledger/rows")
    texts = [
        file.read_text("utf-8")
        for folder in folders
        for file in sorted(files("fsar_ledger").joinpath(folder).iterdir(), key=lambda file: file.name)
        if file.name.endswith(".py")
    ]
    return digest_of([__version__, *(f"{name} {version(name)}" for name in ("duckdb", "pyarrow")), *texts])


_MADE = """
    CREATE TABLE IF NOT EXISTS answers (
        number INTEGER PRIMARY KEY, slice TEXT, asked TEXT, bytes INTEGER, sha256 TEXT, data BLOB, UNIQUE (slice, asked)
    )
"""
_TOO_MANY = """
    DELETE FROM answers WHERE number <= (
        SELECT max(number) FROM (SELECT number, sum(bytes) OVER (ORDER BY number DESC) AS kept FROM answers)
        WHERE kept > ?
    )
"""


@contextmanager
def opened_cache() -> Iterator[sqlite3.Connection]:
    """Yield the cache, and commit its changes. Raises: sqlite3.Error if there is none, or it is damaged."""
    folder = cache_folder()
    file = folder and folder / "slices.sqlite"
    if file is None or (file.exists() and not is_own_file(file)):
        raise sqlite3.OperationalError("no place for a cache")
    with closing(sqlite3.connect(file)) as cache:
        try:
            with cache:
                cache.execute("PRAGMA synchronous = OFF")
                cache.execute(_MADE)
                yield cache
        except sqlite3.OperationalError:  # another process uses it, or the disk is full
            raise
        except sqlite3.DatabaseError:
            file.unlink(missing_ok=True)
            raise


def remembered(of: str | None, texts: Collection[str]) -> dict[str, bytes]:
    """Return the cached answers of a slice, by the texts of their queries, in the form of `table_bytes`."""
    if of is None:
        return {}
    with suppress(sqlite3.Error), opened_cache() as cache:
        by_key = {_key(text): text for text in texts}
        rows = cache.execute(
            "SELECT asked, sha256, data FROM answers WHERE slice = ? AND asked IN (SELECT value FROM json_each(?))",
            [of, json.dumps([*by_key])],
        )
        return {by_key[key]: data for key, sha256, data in rows if sha256 == of_entry(of, key, data)}
    return {}


def remember(of: str | None, made: Mapping[str, bytes]) -> None:
    """Cache the answers of a slice if possible; otherwise the next query takes longer."""
    if of is None:
        return
    rows = [(of, _key(text), data, of_entry(of, _key(text), data)) for text, data in made.items()]
    with suppress(sqlite3.Error), opened_cache() as cache:
        cache.executemany(
            "INSERT OR REPLACE INTO answers (slice, asked, data, sha256, bytes) VALUES (?1, ?2, ?3, ?4, length(?3))",
            rows,
        )
        cache.execute(_TOO_MANY, [CACHE_BYTES])


def coded(table: pa.Table) -> pa.Table:
    """Return the rows with texts dictionary-encoded: runs of an experiment share their constants, of 2,000 bytes."""
    columns = [column.dictionary_encode() if column.type == pa.string() else column for column in table.columns]
    return pa.table(columns, table.column_names)


def table_bytes(table: pa.Table) -> bytes:
    """Return the rows as bytes."""
    table = coded(table)
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema, options=pa.ipc.IpcWriteOptions(compression="zstd")) as stream:
        stream.write_table(table)
    data: bytes = sink.getvalue().to_pybytes()
    return data


def joined(stored: Iterable[bytes]) -> pa.Table:
    """Return the rows of several results of `table_bytes` as one table."""
    return pa.concat_tables(pa.ipc.open_stream(data).read_all() for data in stored)


def decoded(table: pa.Table) -> pa.Table:
    """Return the rows with plain columns."""
    types = [kind.value_type if pa.types.is_dictionary(kind) else kind for kind in table.schema.types]
    return table.cast(pa.schema([*zip(table.column_names, types, strict=True)]))


def _key(text: str) -> str:
    return digest_of([_program(), text])


def of_entry(of: str, asked: str, data: bytes) -> str:
    """Return the digest of a cache entry, over its key and its data, in hex."""
    return hashlib.sha256(f"{of}{asked}".encode() + data).hexdigest()
