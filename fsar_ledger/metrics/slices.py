"""Judge a large ledger in slices: some of its runs at a time, what was found kept in a cache.

A slice has whole runs, of some 500,000 events. What a query says of each run by itself (its header says
`Partial`) is asked of one slice after the other and put together; what compares runs is asked of that. So memory does
not grow with the ledger, and after an append only the slices that it changed are judged.

The cache lies beside the user's other caches, never in a ledger, and belongs to this user on this machine, who could as
well change the program. An entry is found by the hashes of the segments that its slice was read from, by the runs and
where in these they are, by the texts of the queries, and by this program's own text. A reader has just compared the
segments with their hashes, so an entry is of the very bytes that lie there. What is damaged is made again. Losing the
cache costs one more look at the events.
"""

import hashlib
import json
import sqlite3
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from functools import cache, partial
from importlib.metadata import version
from importlib.resources import files
from itertools import chain
from pathlib import Path
from typing import NamedTuple, TypeVar

import msgspec
import pyarrow as pa

from fsar_ledger import __version__
from fsar_ledger.base.errors import SequenceConflict
from fsar_ledger.base.progress import Progress
from fsar_ledger.base.workers import pool_of
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.store.derived import Extent
from fsar_ledger.ledger.store.locations import earlier_runs
from fsar_ledger.ledger.store.paths import segment_bytes
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.record import Head
from fsar_ledger.ledger.store.shards import views_of

from . import relation
from .connection import Database
from .library import Query, library
from .verified import cache_folder, is_own_file, is_verified_for_runs

_One = TypeVar("_One")
_Name = TypeVar("_Name")
_NUMBERS = pa.schema([("run_id", pa.string()), ("number", pa.int64())])
SLICE_EVENTS = 8 << 16
"""Events that are judged at once: few enough for half a gigabyte, and each slice costs some tenths of a second."""
LEAST_BYTES = 4
"""Of an event in a segment; those of a fleet take 10 to 17."""
CACHE_BYTES = 1 << 30
"""The most that the cache holds; what was made first is left out."""


class Asked(NamedTuple):
    """What is asked of each slice: `of` answers it, and `text` names all that the answer depends on but the events.

    `of` can be sent to another process.
    """

    text: str
    of: Callable[[Database], pa.Table]


class Slice(NamedTuple):
    """Some runs of a ledger, and by `digest` the bytes that hold them; None where these have no hash yet.

    `view` is the ledger, and `beside` are all of its runs.
    """

    runs: tuple[Extent, ...]
    digest: str | None
    view: View
    beside: Sequence[Extent]


# See docs/decisions/what-is-known-of-runs-is-cached.md.
class Slices:
    """Databases over some runs of a ledger after the other, so that memory does not grow with the ledger.

    Each has whole runs, of about `most` events, one run at least; it is closed when the next is asked for. Of a ledger
    of fewer events there is none. A run is in the slice in which it ends, so that an append changes the slices of the
    runs that go on, and the last one. The slices of a federation are those of its shards, so that what is known of a
    shard is known of it here, too.

    Raises: As `database.connect_view`, when they are asked for.
    """

    def __init__(self, view: View, demanded: str | None = None, most: int | None = None) -> None:
        self._head = view.head
        most = most or SLICE_EVENTS
        self._slices: list[Slice] = []
        self._rows_verified: bool | None = None
        # A bomb has many rows in few bytes, and nothing to be judged: to judge it in parts would take longer.
        stored = sum(segment_bytes(ledger.path) for ledger in views_of(view)) if view.head.events > most else 0
        if stored > LEAST_BYTES * view.head.events:
            self._rows_verified = is_verified_for_runs(view, demanded)
            self._slices = [*_slices(view, most)]

    def __len__(self) -> int:
        return len(self._slices)

    def __iter__(self) -> Iterator[Database]:
        for one in self._slices:
            with self._connect(one) as database:
                yield database

    def tables(self, asked: Mapping[_Name, Asked], progress: Progress | None = None) -> Iterator[pa.Table]:
        """Yield what all slices answer together to each of these, in order, from the cache where it is known.

        Raises: As `Database.table`.
        """
        return (_decoded(_joined(stored)) for stored in self._stored(asked, progress).values())

    def _stored(self, asked: Mapping[_Name, Asked], progress: Progress | None = None) -> dict[_Name, list[bytes]]:
        """Return what each slice answers to each of these as the cache has it, which takes little memory."""
        found: dict[_Name, list[bytes]] = {name: [] for name in asked}
        known = [_remembered(one.digest, {each.text for each in asked.values()}) for one in self._slices]
        lacking = [{each.text: each for each in asked.values() if each.text not in held} for held in known]
        with pool_of(1) as pool:
            answers = [
                pool.submit(answered, str(one.view.path.absolute()), one.runs, one.digest, each)
                if pool is not None and each and one.digest is not None
                else None
                for one, each in zip(self._slices, lacking, strict=True)
            ]
            of_slices = zip(self._slices, known, lacking, answers, strict=True)
            for done, (one, held, each, far) in enumerate(of_slices, start=1):
                if each:
                    tables = _answers(self._connect(one), each) if far is None else far.result()
                    made = {text: _written(table) for text, table in tables.items()}
                    _remember(one.digest, made)
                    held |= made
                for name, sought in asked.items():
                    found[name].append(held[sought.text])
                if progress is not None:
                    progress(done * len(asked), len(self._slices) * len(asked))
        return found

    def _connect(self, one: Slice) -> Database:
        return connect_slice(one, self._head, self._rows_verified)

    def rows_of(self, queries: Sequence[Query]) -> Iterator[tuple[str, pa.Table]]:
        """Yield the names of the relations of these queries, which are of one run each, and their rows, texts coded."""
        asked = {query.relation: asked_of(f"SELECT * FROM {query.relation}") for query in queries}
        for name, stored in self._stored(asked).items():
            yield name, _joined(stored)


def connect_slice(one: Slice, head: Head, rows_verified: bool | None = None, threads: int | None = None) -> Database:
    """Open a database over the events of a slice of the ledger with this head.

    Raises: As `database.connect_view`.
    """
    runs, view, releases = one.runs, one.view, one.view.releases
    numbers = view.segments_of(runs)
    held = {number: view.segment(number) for number in numbers}
    names = {run.run for run in runs}
    others = [run for run in one.beside if run.run not in names and _meets(view, run, numbers)]
    cut = {number for run in others for number in view.segments_between(run.first, run.end)}
    whole = frozenset(path for number, path in held.items() if number not in cut)
    database = Database(head, [*held.values()], threads, rows_verified=rows_verified, may_spill=True)
    # See docs/decisions/slices-make-no-tables.md.
    chosen = relation.RowFilter(relation.OF_NUMBERED, numbered([run.run for run in runs]), whole)
    try:
        relation.hold_segments(database, [*held.values()], [releases[number] for number in held], chosen)
    except BaseException:
        database.close()
        raise
    return database


def keep_known(before: View, after: View) -> None:
    """Let what is known of a ledger's slices be known of the same events in other segments."""
    with suppress(sqlite3.Error), _cache() as cache:
        if not cache.execute("SELECT EXISTS (SELECT 1 FROM answers)").fetchone()[0]:
            return
        digests = {one.runs: one.digest for one in Slices(after)._slices}
        pairs = [(new, one.digest) for one in Slices(before)._slices if (new := digests.get(one.runs)) and one.digest]
        cache.create_function("of_entry", 3, _of_entry)
        cache.executemany(
            "UPDATE OR REPLACE answers SET slice = ?1, sha256 = of_entry(?1, asked, data) "
            "WHERE slice = ?2 AND sha256 = of_entry(?2, asked, data)",
            pairs,
        )


def answered(ledger: str, runs: Sequence[Extent], digest: str, asked: Mapping[str, Asked]) -> dict[str, pa.Table]:
    """Return what the slice of these runs of a ledger answers to these, by their texts, in another process.

    Raises: As `Database.table`; SequenceConflict if the ledger there has no slice of this digest.
    """
    view = open_for_answers(Path(ledger))
    one = _slice(view, runs, view.extents())
    if one.digest != digest:
        raise SequenceConflict(
            f"{ledger}: found other events where another process read some of it, expected the same; is it the same "
            "folder there, and was it compacted meanwhile? run it again"
        )
    return _answers(connect_slice(one, view.head, threads=1), asked)  # a worker of a cluster has one core


def _answers(database: Database, asked: Mapping[str, Asked]) -> dict[str, pa.Table]:
    """Return what this database answers to these, by their texts, and close it. Raises: As `Database.table`."""
    with database:
        return {text: each.of(database) for text, each in asked.items()}


def asked_of(sql: str) -> Asked:
    """Return that this SELECT is asked, which depends on the texts of all queries that it reads."""
    needs = library().needs(library().mentioned(sql))
    return Asked(_digest([sql, *(query.sha256 for query in needs)]), partial(Database.table, sql=sql))


def numbered(runs: Sequence[str], first: int = 1) -> pa.Table:
    """Return the relation `run_numbers` of these runs, numbered from `first` on."""
    return pa.table([[*runs], [*range(first, first + len(runs))]], schema=_NUMBERS)


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


def _slices(view: View, most: int) -> Iterator[Slice]:
    """Yield the slices of each ledger, and those of runs that continue each other from one ledger to another."""
    earlier, homes = earlier_runs(view), dict[str, int]()
    ledgers = [(ledger, ledger.extents()) for ledger in views_of(view)]
    for at, (_, extents) in enumerate(ledgers if earlier else ()):
        homes.update((one.run, at) for one in extents)
    beside = view.extents() if len(ledgers) > 1 and earlier else []
    apart = [whole for whole in _continuing(beside, earlier) if len({homes[one.run] for one in whole}) > 1]
    names = {one.run for whole in apart for one in whole}
    for ledger, extents in ledgers:
        wholes = _continuing([one for one in extents if one.run not in names], earlier)
        yield from (_slice(ledger, runs, extents) for runs in _windows(wholes, most))
    yield from (Slice(tuple(runs), None, view, beside) for runs in _windows(apart, most))


def _windows(wholes: Iterable[Sequence[Extent]], most: int) -> Iterator[list[Extent]]:
    """Yield the runs that end within the same so many events, in more parts where these are many more."""
    windows: dict[int, list[Sequence[Extent]]] = {}
    for whole in wholes:
        windows.setdefault((max(one.end for one in whole) - 1) // most, []).append(whole)
    for _, runs in sorted(windows.items()):
        for part in parts_of(runs, lambda whole: sum(one.rows for one in whole), 2 * most):
            yield list(chain.from_iterable(part))


def _continuing(extents: Iterable[Extent], continues: Mapping[str, str]) -> list[list[Extent]]:
    """Return where runs are, those together that continue each other, in the order in which the first of them begin."""
    found: dict[str, list[Extent]] = {}
    first: dict[str, str] = {}
    for one in extents:
        whole = first[one.run] = first.get(continues.get(one.run, ""), one.run)
        found.setdefault(whole, []).append(one)
    return list(found.values())


def _meets(view: View, extent: Extent, numbers: Sequence[int]) -> bool:
    return extent.first < view.end(numbers[-1]) and extent.end > view.first(numbers[0])


def _slice(view: View, runs: Sequence[Extent], beside: Sequence[Extent]) -> Slice:
    numbers, placed = view.segments_of(runs), view.chain.placed
    if numbers[-1] >= len(placed):
        return Slice(tuple(runs), None, view, beside)  # a journal has no hash
    held = [(placed[number].first, placed[number].segment_sha256) for number in numbers]
    digest = _digest([repr(held), repr([msgspec.structs.astuple(one) for one in runs])])
    return Slice(tuple(runs), digest, view, beside)


def _digest(texts: Iterable[str]) -> str:
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()


@cache
def _program() -> str:
    """Return a digest of what reads events and answers: this package's text, DuckDB and Arrow."""
    rooms = ("metrics", "events", "ledger/rows")
    texts = [
        file.read_text("utf-8")
        for room in rooms
        for file in sorted(files("fsar_ledger").joinpath(room).iterdir(), key=lambda file: file.name)
        if file.name.endswith(".py")
    ]
    return _digest([__version__, *(f"{name} {version(name)}" for name in ("duckdb", "pyarrow")), *texts])


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
def _cache() -> Iterator[sqlite3.Connection]:
    """Yield the cache, and keep what was changed in it. Raises: sqlite3.Error if there is none, or it is damaged."""
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
        except sqlite3.OperationalError:  # another process is at it, or the disk is full
            raise
        except sqlite3.DatabaseError:
            file.unlink(missing_ok=True)
            raise


def _remembered(of: str | None, texts: Collection[str]) -> dict[str, bytes]:
    """Return what is known of a slice, by the texts that were asked, as `_written` has it."""
    if of is None:
        return {}
    with suppress(sqlite3.Error), _cache() as cache:
        by_key = {_key(text): text for text in texts}
        rows = cache.execute(
            "SELECT asked, sha256, data FROM answers WHERE slice = ? AND asked IN (SELECT value FROM json_each(?))",
            [of, json.dumps([*by_key])],
        )
        return {by_key[asked]: data for asked, sha256, data in rows if sha256 == _of_entry(of, asked, data)}
    return {}


def _remember(of: str | None, made: Mapping[str, bytes]) -> None:
    """Remember what a slice answered if possible; otherwise the next look takes longer."""
    if of is None:
        return
    rows = [(of, _key(text), data, _of_entry(of, _key(text), data)) for text, data in made.items()]
    with suppress(sqlite3.Error), _cache() as cache:
        cache.executemany(
            "INSERT OR REPLACE INTO answers (slice, asked, data, sha256, bytes) VALUES (?1, ?2, ?3, ?4, length(?3))",
            rows,
        )
        cache.execute(_TOO_MANY, [CACHE_BYTES])


def _written(table: pa.Table) -> bytes:
    """Return the rows, each text of a column once: runs of an experiment have the same constants, of 2,000 bytes."""
    columns = [column.dictionary_encode() if column.type == pa.string() else column for column in table.columns]
    table = pa.table(columns, table.column_names)
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema, options=pa.ipc.IpcWriteOptions(compression="zstd")) as stream:
        stream.write_table(table)
    data: bytes = sink.getvalue().to_pybytes()
    return data


def _joined(stored: Iterable[bytes]) -> pa.Table:
    """Return the rows that `_written` has made of tables, together."""
    return pa.concat_tables(pa.ipc.open_stream(data).read_all() for data in stored)


def _decoded(table: pa.Table) -> pa.Table:
    types = [one.value_type if pa.types.is_dictionary(one) else one for one in table.schema.types]
    return table.cast(pa.schema([*zip(table.column_names, types, strict=True)]))


def _key(text: str) -> str:
    return _digest([_program(), text])


def _of_entry(of: str, asked: str, data: bytes) -> str:
    return hashlib.sha256(f"{of}{asked}".encode() + data).hexdigest()
