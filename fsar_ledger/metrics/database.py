"""Open databases over the rows of a ledger, whole or in slices, or over rows in memory.

A slice has whole runs, of some 500,000 events. Queries about each run by itself (their headers say `Partial`) are
answered slice by slice and the rows combined; queries that compare runs read those. So memory does not grow with the
ledger, and after an append only the slices that it changed are judged.
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
from .connection import Database as Database
from .connection import Value as Value
from .library import Query
from .slices import Slice, SliceQuery, slice_of, slice_query
from .sql_values import NULLABLE, with_all_columns
from .sql_values import plain_rows as plain_rows
from .verified import is_verified, is_verified_for_runs

_Name = TypeVar("_Name")
SLICE_EVENTS = 8 << 16
"""Events judged at once: few enough for half a gigabyte; each slice costs some tenths of a second."""
LEAST_BYTES = 4
"""The fewest bytes of an event in a segment; those of a fleet take 10 to 17."""
FEW_ROWS = 20_000
"""Up to this many rows, copying costs less than planning over an Arrow table does."""
SMALL = 1 << 16
"""The most events of a small ledger or run."""


def connect(
    ledger: Path, threads: int | None = None, demanded: str | None = None, file: Path | None = None
) -> Database:
    """Open a database over the committed segments of one head of this ledger, each checked against its hash.

    Args:
        ledger: Its folder.
        threads: DuckDB threads; None: one per core, or a single one for few events.
        demanded: The newest record that `ensure_verified` has just checked, if no other head will do.
        file: A new DuckDB file for the relations, for other programs; None: they are in memory.

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
    earlier_runs(view)  # checks that the parts that `relation` joins follow one another
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
    own_folders = {ledger.path / SEGMENTS for ledger in views_of(view)}
    passing = [] if file is None else [path for path in segments if path.parent not in own_folders]
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
    in_order = view.segments_of(parts)
    segments = [view.segment(number) for number in in_order]
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
    _fill(database, segments, [releases[number] for number in in_order], chosen)
    return database


def _fill(
    database: Database,
    segments: Sequence[Path],
    releases: Sequence[str],
    chosen: relation.RowFilter | None = None,
    passing: Sequence[Path] = (),
) -> None:
    """Hold the rows of these segments, or close the database if that fails. Raises: As `hold_segments`."""
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
    """Open a database over these rows; columns that a row lacks are NULL. For tests and small queries.

    Raises: as `table_of`.
    """
    return from_table(table_of(rows), threads)


def table_of(rows: Sequence[Mapping[str, Value]]) -> pa.Table:
    """Return these rows with all columns of events; columns that a row lacks are NULL.

    Raises:
        ValueError: A row has a column that events do not have.
    """
    names = SCHEMA.names
    if unknown := sorted({name for row in rows for name in row} - set(names)):
        raise ValueError(f"rows: found columns {', '.join(unknown)}, expected those of the ledger's schema")
    return pa.Table.from_pylist([{name: row.get(name) for name in names} for row in rows], schema=NULLABLE)


# See docs/decisions/what-is-known-of-runs-is-cached.md.
class Slices:
    """Databases over successive runs of a ledger, so that memory does not grow with the ledger.

    Each has whole runs, of about `most` events, at least one run; it is closed when the next is opened. A ledger with
    fewer events has none. A run is in the slice in which it ends, so that an append changes only the slices of the runs
    that continue, and the last one. The slices of a federation are those of its shards, so that answers cached for a
    shard serve here, too.

    Raises: As `database.connect_view`, on iteration.
    """

    def __init__(self, view: View, demanded: str | None = None, most: int | None = None) -> None:
        self._head = view.head
        most = most or SLICE_EVENTS
        self._slices: list[Slice] = []
        self._rows_verified: bool | None = None
        # A decompression bomb has many rows in few bytes, and nothing to judge: judging it in parts would take longer.
        stored = sum(segment_bytes(ledger.path) for ledger in views_of(view)) if view.head.events > most else 0
        if stored > LEAST_BYTES * view.head.events:
            self._rows_verified = is_verified_for_runs(view, demanded)
            self._slices = [*_slices(view, most)]

    def __len__(self) -> int:
        return len(self._slices)

    def __iter__(self) -> Iterator[Database]:
        for slice_ in self._slices:
            with slices.connect(slice_, self._head, self._rows_verified) as database:
                slices.fill(database, slice_)
                yield database

    def tables(self, queries: Mapping[_Name, SliceQuery], progress: Progress | None = None) -> Iterator[pa.Table]:
        """Yield the answer of all slices together to each of these queries, in order, from the cache where possible.

        Raises: As `Database.table`.
        """
        return (slices.decoded(slices.joined(stored)) for stored in self._stored(queries, progress).values())

    def _stored(
        self, queries: Mapping[_Name, SliceQuery], progress: Progress | None = None
    ) -> dict[_Name, list[bytes]]:
        """Return the answers of each slice to each of these queries in the cache's form, which takes little memory."""
        stored: dict[_Name, list[bytes]] = {name: [] for name in queries}
        cached = [
            slices.remembered(slice_.digest, {query.text for query in queries.values()}) for slice_ in self._slices
        ]
        lacking = [
            {query.text: query for query in queries.values() if query.text not in answers_held}
            for answers_held in cached
        ]
        with pool_of(1) as pool:
            answers = [
                pool.submit(slice_answers, str(slice_.view.path.absolute()), slice_.runs, slice_.digest, missing)
                if pool is not None and missing and slice_.digest is not None
                else None
                for slice_, missing in zip(self._slices, lacking, strict=True)
            ]
            of_slices = zip(self._slices, cached, lacking, answers, strict=True)
            for done, (slice_, answers_held, missing, remote) in enumerate(of_slices, start=1):
                if missing:
                    answer_here = partial(cuts.answers, slice_, self._head, self._rows_verified, missing)
                    tables = answer_here() if remote is None else remote.result()
                    computed = {text: slices.table_bytes(table) for text, table in tables.items()}
                    slices.remember(slice_.digest, computed)
                    answers_held |= computed
                for name, query in queries.items():
                    stored[name].append(answers_held[query.text])
                if progress is not None:
                    progress(done * len(queries), len(self._slices) * len(queries))
        return stored

    def rows_of(self, queries: Sequence[Query]) -> Iterator[tuple[str, pa.Table]]:
        """Yield the relation name and the rows, texts coded, of each of these queries about single runs."""
        selects = {query.relation: slice_query(f"SELECT * FROM {query.relation}") for query in queries}
        for name, stored in self._stored(selects).items():
            yield name, slices.joined(stored)


def keep_known(before: View, after: View) -> None:
    """Keep the cached answers of a ledger's slices for the same events in other segments."""
    with suppress(sqlite3.Error), slices.opened_cache() as cache:
        if not cache.execute("SELECT EXISTS (SELECT 1 FROM answers)").fetchone()[0]:
            return
        old, new = (
            {runs: digest for slice_ in Slices(view)._slices for runs, digest in cuts.digests(slice_).items()}
            for view in (before, after)
        )
        cache.create_function("of_entry", 3, slices.of_entry)
        cache.executemany(
            "UPDATE OR REPLACE answers SET slice = ?1, sha256 = of_entry(?1, asked, data) "
            "WHERE slice = ?2 AND sha256 = of_entry(?2, asked, data)",
            [(new[runs], digest) for runs, digest in old.items() if runs in new],
        )


def slice_answers(
    ledger: str, runs: Sequence[Extent], digest: str, queries: Mapping[str, SliceQuery]
) -> dict[str, pa.Table]:
    """Return the answers of the slice of these runs to these queries, by their texts, in another process.

    Raises: As `Database.table`; SequenceConflict if the ledger there has no slice of this digest.
    """
    view = open_for_answers(Path(ledger))
    slice_ = slice_of(view, runs, view.extents(), SLICE_EVENTS)
    if slice_.digest != digest:
        raise SequenceConflict(
            f"{ledger}: found other events than another process that read part of it, expected the same; check that "
            "it is the same folder there, and run it again if it was compacted meanwhile"
        )
    return cuts.answers(slice_, view.head, None, queries, threads=1)  # a worker of a cluster has one core


def _slices(view: View, most: int) -> Iterator[Slice]:
    """Yield the slices of each ledger, and those of runs that continue each other from one ledger to another."""
    earlier, homes = earlier_runs(view), dict[str, int]()
    ledgers = [(ledger, ledger.extents()) for ledger in views_of(view)]
    for at, (_, extents) in enumerate(ledgers if earlier else ()):
        homes.update((extent.run, at) for extent in extents)
    beside = view.extents() if len(ledgers) > 1 and earlier else []
    crossing = [group for group in _continuing(beside, earlier) if len({homes[extent.run] for extent in group}) > 1]
    names = {extent.run for group in crossing for extent in group}
    for ledger, extents in ledgers:
        groups = _continuing([extent for extent in extents if extent.run not in names], earlier)
        yield from (slice_of(ledger, runs, extents, most) for runs in _windows(groups, most))
    yield from (Slice(tuple(runs), None, view, beside, most) for runs in _windows(crossing, most))


def _windows(groups: Iterable[Sequence[Extent]], most: int) -> Iterator[list[Extent]]:
    """Yield the runs that end within the same `most` events, split further where they are many more."""
    windows: dict[int, list[Sequence[Extent]]] = {}
    for group in groups:
        windows.setdefault((max(extent.end for extent in group) - 1) // most, []).append(group)
    for _, runs in sorted(windows.items()):
        for part in parts_of(runs, lambda group: sum(extent.rows for extent in group), 2 * most):
            yield list(chain.from_iterable(part))


def _continuing(extents: Iterable[Extent], continues: Mapping[str, str]) -> list[list[Extent]]:
    """Group the extents of runs that continue each other, in the order in which the first of each begin."""
    groups: dict[str, list[Extent]] = {}
    first: dict[str, str] = {}
    for extent in extents:
        name = first[extent.run] = first.get(continues.get(extent.run, ""), extent.run)
        groups.setdefault(name, []).append(extent)
    return list(groups.values())
