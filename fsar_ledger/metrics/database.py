"""Open databases over the rows of a ledger, whole or in slices, or over rows in memory.

A slice has whole runs, of some 500,000 events. What a query says of each run by itself (its header says `Partial`) is
asked of one slice after the other and put together; what compares runs is asked of that. So memory does not grow with
the ledger, and after an append only the slices that it changed are judged.
"""

import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TypeVar

import pyarrow as pa

from fsar_ledger.base.errors import SequenceConflict
from fsar_ledger.base.progress import Progress, parts_of
from fsar_ledger.base.workers import pool_of
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.rows.schema import SCHEMA
from fsar_ledger.ledger.store.derived import Extent
from fsar_ledger.ledger.store.locations import chain_of, earlier_runs, event_count
from fsar_ledger.ledger.store.paths import SEGMENTS, segment_bytes
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.shards import views_of

from . import cuts, relation, slices
from .connection import Database, Value
from .library import Query
from .slices import Slice, SliceQuery, slice_of, slice_query
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

_Name = TypeVar("_Name")
SLICE_EVENTS = 8 << 16
"""Events that are judged at once: few enough for half a gigabyte, and each slice costs some tenths of a second."""
LEAST_BYTES = 4
"""Of an event in a segment; those of a fleet take 10 to 17."""
FEW_ROWS = 20_000
"""Up to this many rows, copying costs less than planning over an Arrow table does."""
SMALL = 1 << 16
"""A ledger, or a run, of up to this many events is small."""


def connect(
    ledger: Path, threads: int | None = None, demanded: str | None = None, file: Path | None = None
) -> Database:
    """Open a database over the committed segments of one head of this ledger, each checked against its hash.

    Args:
        ledger: Its folder.
        threads: Of DuckDB; None is one per core, and one for few events.
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
    sliced = Slices(view, demanded) or None
    database = Database(
        view.head,
        segments,
        threads,
        rows_verified=rows_verified,
        file=file,
        slices=sliced,
        may_spill=sliced is not None,
        is_small=sliced is None and view.head.size <= SMALL,
    )
    stay = {one.path / SEGMENTS for one in views_of(view)}
    passing = [] if file is None else [path for path in segments if path.parent not in stay]
    numbers = sliced and relation.RowFilter("TRUE", relation.numbered(view.run_names.runs), frozenset(segments))
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
    count = event_count(parts)
    database = Database(
        view.head,
        segments,
        rows_verified=rows_verified,
        may_spill=count > SLICE_EVENTS,
        is_small=count <= SMALL,
    )
    ordinal, releases = view.ordinal_of(run), view.releases
    numbers = relation.numbered([run] if ordinal else [], ordinal)
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
    database = Database(None, (), threads or (1 if len(events) <= SMALL else None))
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
            with slices.connect(one, self._head, self._rows_verified) as database:
                slices.fill(database, one)
                yield database

    def tables(self, queries: Mapping[_Name, SliceQuery], progress: Progress | None = None) -> Iterator[pa.Table]:
        """Yield what all slices answer together to each of these, in order, from the cache where it is known.

        Raises: As `Database.table`.
        """
        return (slices.decoded(slices.joined(stored)) for stored in self._stored(queries, progress).values())

    def _stored(
        self, queries: Mapping[_Name, SliceQuery], progress: Progress | None = None
    ) -> dict[_Name, list[bytes]]:
        """Return what each slice answers to each of these as the cache has it, which takes little memory."""
        found: dict[_Name, list[bytes]] = {name: [] for name in queries}
        known = [slices.remembered(one.digest, {each.text for each in queries.values()}) for one in self._slices]
        lacking = [{each.text: each for each in queries.values() if each.text not in held} for held in known]
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
                    here = partial(cuts.answers, one, self._head, self._rows_verified, each)
                    tables = here() if far is None else far.result()
                    made = {text: slices.written(table) for text, table in tables.items()}
                    slices.remember(one.digest, made)
                    held |= made
                for name, sought in queries.items():
                    found[name].append(held[sought.text])
                if progress is not None:
                    progress(done * len(queries), len(self._slices) * len(queries))
        return found

    def rows_of(self, queries: Sequence[Query]) -> Iterator[tuple[str, pa.Table]]:
        """Yield the names of the relations of these queries, which are of one run each, and their rows, texts coded."""
        selects = {query.relation: slice_query(f"SELECT * FROM {query.relation}") for query in queries}
        for name, stored in self._stored(selects).items():
            yield name, slices.joined(stored)


def keep_known(before: View, after: View) -> None:
    """Let what is known of a ledger's slices be known of the same events in other segments."""
    with suppress(sqlite3.Error), slices.opened_cache() as cache:
        if not cache.execute("SELECT EXISTS (SELECT 1 FROM answers)").fetchone()[0]:
            return
        old, new = (
            {runs: digest for one in Slices(view)._slices for runs, digest in cuts.digests(one).items()}
            for view in (before, after)
        )
        cache.create_function("of_entry", 3, slices.of_entry)
        cache.executemany(
            "UPDATE OR REPLACE answers SET slice = ?1, sha256 = of_entry(?1, asked, data) "
            "WHERE slice = ?2 AND sha256 = of_entry(?2, asked, data)",
            [(new[runs], digest) for runs, digest in old.items() if runs in new],
        )


def answered(
    ledger: str, runs: Sequence[Extent], digest: str, queries: Mapping[str, SliceQuery]
) -> dict[str, pa.Table]:
    """Return what the slice of these runs of a ledger answers to these, by their texts, in another process.

    Raises: As `Database.table`; SequenceConflict if the ledger there has no slice of this digest.
    """
    view = open_for_answers(Path(ledger))
    one = slice_of(view, runs, view.extents(), SLICE_EVENTS)
    if one.digest != digest:
        raise SequenceConflict(
            f"{ledger}: found other events where another process read some of it, expected the same; is it the same "
            "folder there, and was it compacted meanwhile? run it again"
        )
    return cuts.answers(one, view.head, None, queries, threads=1)  # a worker of a cluster has one core


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
        yield from (slice_of(ledger, runs, extents, most) for runs in _windows(wholes, most))
    yield from (Slice(tuple(runs), None, view, beside, most) for runs in _windows(apart, most))


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
