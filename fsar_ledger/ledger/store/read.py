"""What is committed, as a reader sees it.

Readers never write, never see half a commit, and never get a segment other than the committed one.
"""

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import msgspec
import pyarrow as pa
import pyarrow.compute as pc

from fsar_ledger.errors import FormatVersionMismatch, LedgerCorrupted, NotALedger
from fsar_ledger.ledger.log import merkle
from fsar_ledger.ledger.log.note import Note
from fsar_ledger.ledger.log.tiles import node_of
from fsar_ledger.ledger.rows import canonical, codec, segment
from fsar_ledger.ledger.rows.arrow import whole
from fsar_ledger.ledger.rows.blocks import BLOCK_COLUMNS, blocks_of, by_run
from fsar_ledger.ledger.rows.check import standing_alone
from fsar_ledger.ledger.rows.layout import check_layout
from fsar_ledger.ledger.rows.releases import is_later
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.derived import read_checkpoint, tile_reader
from fsar_ledger.ledger.store.paths import COMMITS, MANIFEST, require_created
from fsar_ledger.ledger.store.record import CommitRecord, Manifest, parse_manifest, sha256_hex
from fsar_ledger.ledger.store.view import EMPTY_HEAD, Extent, Head, Part, RunNames
from fsar_ledger.ledger.store.walk import (
    Commit,
    check_folders,
    check_names,
    commit_names,
    find_segment,
    read_segment,
    walk,
)

_THREADS = 4
_WORTH_THREADS_BYTES = 1 << 25
"""Hashing this much takes some 20 ms; below that, threads gain nothing."""


class Checked(NamedTuple):
    """A segment that was found to be as committed: its path, and the attributes that change when the file does."""

    path: Path
    device: int
    inode: int
    size: int
    modified_ns: int
    changed_ns: int


class LedgerView(msgspec.Struct, frozen=True, dict=True):
    """A ledger as it was when it was opened; later commits do not show.

    `record_sha256` is the hash of the newest record (of ledger.json if there is none), which vouches for every byte of
    the ledger except the derived files.
    """

    path: Path
    manifest: Manifest
    manifest_sha256: str
    record_sha256: str
    records: tuple[CommitRecord, ...]
    checked: dict[int, Checked] = msgspec.field(default_factory=dict)

    @property
    def commits(self) -> Sequence[CommitRecord]:
        """Return what each commit says, in order."""
        return self.records

    @property
    def releases(self) -> list[str]:
        """Return for each segment the release that has its columns."""
        return [record.release for record in self.records]

    def first(self, number: int) -> int:
        """Return the index in the ledger of the first event of this segment."""
        return self.records[number - 1].tree_size if number else 0

    def end(self, number: int) -> int:
        """Return the index in the ledger after the last event of this segment."""
        return self.records[number].tree_size

    @property
    def head(self) -> Head:
        """Return how far the ledger goes."""
        if not self.records:
            return EMPTY_HEAD
        last = self.records[-1]
        return Head(len(self.records), last.tree_size, last.tree_root, last.last_run)

    def location(self, number: int) -> Path:
        """Find the segment of this commit, in place or in staging, without reading it.

        Raises:
            LedgerCorrupted: The segment is in neither place, is not a regular file, or does not have the committed
                size.
        """
        return self._found(number).path

    def segment(self, number: int) -> Path:
        """Return the segment of this commit, after checking that it is the committed one and within the bounds.

        Each file is read once per view, and again if it has changed since.

        Raises:
            LedgerCorrupted: As `location`; or its SHA-256 is another, or it exceeds the bounds.
        """
        found = self._found(number)
        if self.checked.get(number) != found:
            try:
                self._require_committed(number, found.path)
            except FileNotFoundError:  # a writer moved it into place meanwhile
                found = self._found(number)
                self._require_committed(number, found.path)
            self.checked[number] = found
        return found.path

    def segments(self) -> list[Path]:
        """Return the segments of all commits, in order, each checked.

        Raises: As `segment`, for the first that fails.
        """
        numbers = range(len(self.records))
        if sum(record.segment_bytes for record in self.records) < _WORTH_THREADS_BYTES:
            return [self.segment(number) for number in numbers]
        with ThreadPoolExecutor(_THREADS) as pool:  # hashing releases the interpreter lock
            return list(pool.map(self.segment, numbers))

    def _found(self, number: int) -> Checked:
        """Find the segment without reading it. Raises: As `location`."""
        found = find_segment(self.path, number, self.records[number])
        if found.problem is not None or found.status is None:
            raise LedgerCorrupted(f"{self.path}/{found.problem}; restore the file")
        status = found.status
        path = self.path / found.file
        return Checked(path, status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns)

    def _require_committed(self, number: int, path: Path) -> None:
        """Require that the file is the one that the record names, and within the bounds.

        Raises: LedgerCorrupted if it is not; FileNotFoundError if it is gone.
        """
        file = str(path.relative_to(self.path))
        data, problem = read_segment(self.path, file, number, self.records[number])
        if problem is not None:
            raise LedgerCorrupted(f"{self.path}/{problem}; restore the file")
        check_layout(path, data)

    def tables(self, columns: list[str] | None = None) -> Iterator[pa.Table]:
        """Yield the stored rows of each commit, in order, with these columns (None: all).

        Raises: LedgerCorrupted for a segment that cannot be read.
        """
        for number in range(len(self.records)):
            yield self.table(number, columns)

    def table(self, number: int, columns: list[str] | None = None) -> pa.Table:
        """Return the stored rows of this commit with these columns (None: all). Raises: As `segment`."""
        path = self.segment(number)
        try:
            return segment.read_table(path, columns)
        except LedgerCorrupted:
            if path.exists():
                raise
            return segment.read_table(self.segment(number), columns)  # a writer moved it into place meanwhile

    def tables_from(self, first: int, columns: list[str]) -> Iterator[pa.Table]:
        """Yield these columns of the events from this index on, a table for each commit. Raises: As `table`."""
        for number, record in enumerate(self.records):
            if record.tree_size > first:
                yield self.table(number, columns).slice(max(0, first - self.first(number)))

    def event(self, index: int) -> bytes:
        """Return the canonical bytes of the event at this index. Raises: As `row`."""
        number = bisect_right(self.records, index, key=lambda record: record.tree_size)
        return self.row(number, index - self.first(number))

    @cached_property
    def run_names(self) -> RunNames:
        """Return the names of the runs and plans, in order. Raises: As `table`."""
        found: tuple[list[str], list[str]] = ([], [])
        for table in self.tables(["run_id", "seq", "type"]):
            begins = table.filter(pc.equal(table.column("seq"), 0)).combine_chunks()
            is_plan = pa.array(standing_alone(whole(begins.column("type"))))
            for names, is_one in zip(found, (pc.invert(is_plan), is_plan), strict=True):
                names += begins.column("run_id").filter(is_one).to_pylist()
        return RunNames(*map(tuple, found))

    def has_run(self, run: str) -> bool:
        """Return whether a run or a plan has this name. Raises: As `table`."""
        return run in self.run_names.runs or run in self.run_names.plans

    def ordinal_of(self, run: str) -> int:
        """Return the number of this run among all, from 1; 0 if there is none. Raises: As `table`."""
        return self.run_names.runs.index(run) + 1 if run in self.run_names.runs else 0

    def extents(self) -> list[Extent]:
        """Return where each run and plan is, in order: in one commit. Raises: As `table`."""
        found: list[Extent] = []
        for number, table in enumerate(self.tables(["run_id"])):
            counts = table.column("run_id").combine_chunks().value_counts().to_pylist()
            found += [Extent(one["values"], one["counts"], self.first(number), self.end(number)) for one in counts]
        return found

    def parts(self, run: str) -> list[Part]:
        """Return where the run of this name is: in one commit. Raises: As `table`."""
        for number, table in enumerate(self.tables(BLOCK_COLUMNS)):
            own = table.filter(pc.equal(table.column("run_id"), run)).combine_chunks()
            if own.num_rows:
                return [Part(self.first(number), self.end(number), block) for block in by_run(blocks_of(own))]
        return []

    def groups(self) -> list[tuple[int, ...]]:
        """Return the segments in groups that share no run: each by itself."""
        return [(number,) for number in range(len(self.records))]

    def note(self) -> Note | None:
        """Return the note of the newest commit; None if there is none."""
        return self.records[-1].signed_note() if self.records else None

    def published(self, index: int = 0) -> Note | None:
        """Return the newest note whose tree has this event, and the tiles for proofs.

        While a writer is still at work, that is the one before the newest, if it has the event.

        Raises: LedgerCorrupted if the file `checkpoint` cannot be read.
        """
        *_, before, newest = (None, None, *self.records)
        is_behind = before is not None and index < before.tree_size and read_checkpoint(self.path) == before.note
        found = before if is_behind else newest
        return None if found is None else found.signed_note()

    def node(self, size: int) -> merkle.Node:
        """Return a function that gives the complete subtrees of the tree of this many events, from the tiles.

        It raises LedgerCorrupted if a tile is missing.
        """
        return node_of(tile_reader(self.path), size)

    def row(self, number: int, at: int) -> bytes:
        """Return the canonical bytes of one row of this commit.

        Raises: LedgerCorrupted for a segment that cannot be read or has no such row.
        """
        table = self.table(number)
        if not 0 <= at < table.num_rows:
            raise LedgerCorrupted(
                f"{self.segment(number)}: commit {number}: found {table.num_rows} rows, expected "
                f"{self.records[number].rows}; restore the file"
            )
        return canonical.from_table(table.take([at]))[0]

    def leaves(self, number: int) -> bytes:
        """Return the packed RFC 6962 leaf hashes of the rows of this commit.

        Raises: LedgerCorrupted for a segment that cannot be read.
        """
        return canonical.leaves(self.table(number))

    def runs(self) -> Iterator[codec.LedgerRun]:
        """Yield every run, in order, with its events in their newest versions.

        Raises: LedgerCorrupted or UnknownEventTag if a segment does not hold valid events.
        """
        for number in range(len(self.records)):
            table = self.table(number)
            try:
                runs = list(codec.decode(table))
            except LedgerCorrupted as error:
                raise type(error)(f"{self.segment(number)}: commit {number}: {error}") from error
            yield from runs


def open_ledger(path: Path) -> LedgerView:
    """Open the ledger at this path: check its commit records against each other, without reading any events.

    Raises:
        NotALedger: There is no ledger.
        FormatVersionMismatch: It was written in another format, or holds events of a later release.
        LedgerCorrupted: A record is missing, is not canonical, or contradicts the one before it; or a folder is a link.
    """
    data = read_manifest(path)
    manifest = parse_manifest(path / MANIFEST, data)
    for problem in check_folders(path):
        raise LedgerCorrupted(f"{path}/{problem}; restore it")
    records: list[CommitRecord] = []
    sha256 = manifest_sha256 = sha256_hex(data)
    for commit in walk(path, manifest.origin, manifest_sha256, _count(path)):
        if commit.problems:
            raise _refused(path, commit)
        assert commit.record is not None  # as of every commit without problems
        assert commit.sha256 is not None
        records.append(commit.record)
        sha256 = commit.sha256
    return LedgerView(path, manifest, manifest_sha256, sha256, tuple(records))


def _refused(path: Path, commit: Commit) -> LedgerCorrupted | FormatVersionMismatch:
    """Return the error that says why a reader rejects this commit, and all after it."""
    found = f"{path}/{commit.problems[0]}"
    if commit.record is not None and is_later(commit.record.release):
        return FormatVersionMismatch(found)
    return LedgerCorrupted(f"{found}; restore the file, or run fsar-ledger verify")


def read_manifest(path: Path) -> bytes:
    """Read ledger.json. Raises: NotALedger if there is none, or its creation was interrupted."""
    try:
        return disk.read_document(path / MANIFEST)
    except (FileNotFoundError, NotADirectoryError) as error:
        require_created(path)
        found = "no such path" if not path.exists() else "no ledger.json in it" if path.is_dir() else "a file"
        raise NotALedger(
            f"{path}: found {found}, expected the directory of a ledger; give the path that `fsar-ledger simulate` "
            "wrote to"
        ) from error
    except OSError as error:
        raise LedgerCorrupted(
            f"{path / MANIFEST}: it cannot be read ({error.strerror}); permit reading or restore it"
        ) from error


def _count(path: Path) -> int:
    """Count the commit records. Raises: LedgerCorrupted if they cannot be listed, or other files are among them."""
    try:
        names = commit_names(path)
    except OSError as error:
        raise LedgerCorrupted(
            f"{path / COMMITS}: the folder cannot be read ({error.strerror}), expected one record a commit; restore it"
        ) from error
    for problem in check_names(names):
        raise LedgerCorrupted(f"{path}/{problem}; restore the missing record or take the stray file away")
    return len(names)
