"""What is committed, as a reader sees it. Readers never write, never see half a commit, and never get a segment that is not the one committed."""

import os
import stat
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import msgspec
import pyarrow as pa

from fsar_ledger.errors import FormatVersionMismatch, LedgerCorrupted, NotALedger
from fsar_ledger.ledger.log import merkle
from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.log.tiles import TILE
from fsar_ledger.ledger.rows import canonical, codec, segment
from fsar_ledger.ledger.rows.layout import check_layout
from fsar_ledger.ledger.rows.releases import is_later
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.paths import require_created
from fsar_ledger.ledger.store.record import (
    COMMITS,
    MANIFEST,
    SEGMENTS,
    STAGING,
    CommitRecord,
    Manifest,
    commit_name,
    commit_path,
    contradictions,
    parse_manifest,
    parse_record,
    segment_path,
    sha256_hex,
    staged_path,
)

_THREADS = 4
_WORTH_THREADS_BYTES = 1 << 25
"""Hashing so much takes some 20 ms; below that, starting threads gains nothing."""


class Head(msgspec.Struct, frozen=True):
    """How far a ledger goes: commits, events, the Merkle root over them in hex, and the last run."""

    commits: int
    size: int
    root: str
    last_run: str | None = None


EMPTY_HEAD = Head(0, 0, merkle.EMPTY_ROOT.hex())


class Checked(NamedTuple):
    """A segment that is as committed: where it is, and what of its file changes when somebody writes to it or puts another in its place."""

    path: Path
    device: int
    inode: int
    size: int
    modified_ns: int
    changed_ns: int


class LedgerView(msgspec.Struct, frozen=True):
    """A ledger as it was when it was opened; later commits do not show.

    `record_sha256` is the hash of the newest record, of ledger.json where there is none: it vouches for every byte of the ledger but what is derived.
    """

    path: Path
    manifest: Manifest
    manifest_sha256: str
    record_sha256: str
    records: tuple[CommitRecord, ...]
    checked: dict[int, Checked] = msgspec.field(default_factory=dict)

    @property
    def head(self) -> Head:
        """How far the ledger goes."""
        if not self.records:
            return EMPTY_HEAD
        last = self.records[-1]
        return Head(len(self.records), last.tree_size, last.tree_root, last.last_run)

    def place(self, number: int) -> Path:
        """Where the rows of this commit are: in place, or in staging where the writer was interrupted. The bytes are not looked at: for who only moves them.

        Raises:
            LedgerCorrupted: The segment is in neither place, is no regular file, or has another size than committed.
        """
        return self._found(number).path

    def segment(self, number: int) -> Path:
        """The file with the rows of this commit: exactly the bytes that the record names, and no more to unpack than a batch of runs.

        They are read once for each view; a file that changed since is read again.

        Raises:
            LedgerCorrupted: As `place`; or its SHA-256 is another, or it asks for more than the bounds.
        """
        found = self._found(number)
        if self.checked.get(number) != found:
            try:
                self._require_committed(number, found.path)
            except FileNotFoundError:  # a writer moved it into place in between
                found = self._found(number)
                self._require_committed(number, found.path)
            self.checked[number] = found
        return found.path

    def segments(self) -> list[Path]:
        """The files with the rows of all commits, in order, each as committed. Raises: as `segment`, of the first that is not."""
        numbers = range(len(self.records))
        if sum(record.segment_bytes for record in self.records) < _WORTH_THREADS_BYTES:
            return [self.segment(number) for number in numbers]
        with ThreadPoolExecutor(_THREADS) as pool:  # hashing lets other threads run
            return list(pool.map(self.segment, numbers))

    def _found(self, number: int) -> Checked:
        """The segment where it is, not yet checked. Raises: as `place`."""
        record = self.records[number]
        for path in (
            segment_path(self.path, number),
            staged_path(self.path, record.segment_sha256),
            segment_path(self.path, number),
        ):
            try:
                status = path.lstat()
            except FileNotFoundError:
                continue
            except OSError as error:
                raise _unreadable(path, number, error) from error
            if not stat.S_ISREG(status.st_mode):
                raise LedgerCorrupted(
                    f"{path}: commit {number}: found a link or something else than a file, expected a segment; restore the file"
                )
            if status.st_size != record.segment_bytes:
                raise LedgerCorrupted(
                    f"{path}: commit {number}: found {status.st_size} bytes, expected {record.segment_bytes}; restore the file"
                )
            return Checked(path, status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns)
        raise LedgerCorrupted(
            f"{segment_path(self.path, number)}: commit {number}: found no segment, expected {record.rows} events; restore the file"
        )

    def _require_committed(self, number: int, path: Path) -> None:
        """Raises: LedgerCorrupted if the file is not the one that the record names, or goes beyond the bounds; FileNotFoundError if it is gone."""
        expected = self.records[number].segment_sha256
        try:
            with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as opened:
                if not stat.S_ISREG(os.fstat(opened.fileno()).st_mode):
                    raise OSError(0, "it is not a regular file")
                data = opened.read(self.records[number].segment_bytes + 1)
            if (found := sha256_hex(data)) != expected:
                raise LedgerCorrupted(
                    f"{path}: commit {number}: found SHA-256 {found}, expected {expected} as committed; restore the file"
                )
            check_layout(path, data)
        except FileNotFoundError:
            raise
        except OSError as error:
            raise _unreadable(path, number, error) from error

    def tables(self, columns: list[str] | None = None) -> Iterator[pa.Table]:
        """The rows of each commit as they are stored, in order, with these columns (all: None). Raises: LedgerCorrupted for a segment that cannot be read."""
        for number in range(len(self.records)):
            yield self._table(number, columns)

    def _table(self, number: int, columns: list[str] | None = None) -> pa.Table:
        path = self.segment(number)
        try:
            return segment.read_table(path, columns)
        except LedgerCorrupted:
            if path.exists():
                raise
            return segment.read_table(self.segment(number), columns)  # a writer moved it into place in between

    def row(self, number: int, at: int) -> bytes:
        """The canonical bytes of one row of this commit. Raises: LedgerCorrupted for a segment that cannot be read or has no such row."""
        table = self._table(number)
        if not 0 <= at < table.num_rows:
            raise LedgerCorrupted(
                f"{self.segment(number)}: commit {number}: found {table.num_rows} rows, expected {self.records[number].rows}; restore the file"
            )
        return canonical.from_table(table.take([at]))[0].removeprefix(b"\x00")

    def leaves(self, number: int) -> bytes:
        """The packed RFC 6962 leaf hashes of the rows of this commit. Raises: LedgerCorrupted for a segment that cannot be read."""
        return canonical.leaves(self._table(number))

    def runs(self) -> Iterator[codec.RunRecord]:
        """Every run, in order, its events as their newest versions. Raises: LedgerCorrupted or UnknownEventTag where a segment does not hold valid events."""
        for number in range(len(self.records)):
            table = self._table(number)
            try:
                runs = list(codec.decode(table))
            except LedgerCorrupted as error:
                raise type(error)(f"{self.segment(number)}: commit {number}: {error}") from error
            yield from runs


def open_ledger(path: Path) -> LedgerView:
    """The ledger at this path, with its commit records checked against each other, without reading any events.

    Raises:
        NotALedger: There is no ledger.
        FormatVersionMismatch: It was written in another format, or holds events of a later release.
        LedgerCorrupted: A record is missing, is not canonical, or contradicts the one before it; a folder is a link to elsewhere.
    """
    data = read_manifest(path)
    manifest = parse_manifest(path / MANIFEST, data)
    _require_folders(path)
    records: list[CommitRecord] = []
    previous = manifest_sha256 = sha256_hex(data)
    tree = Frontier()
    for number in range(_count(path)):
        file = commit_path(path, number)
        data = _read(file)
        record = parse_record(file, data)
        for name, found, expected in contradictions(record, number, previous, manifest.origin, tree):
            if is_later(record.release):
                raise FormatVersionMismatch(f"{file}: field {name}: found {found!s:.80}, expected {expected!s:.300}")
            raise LedgerCorrupted(
                f"{file}: field {name}: found {found!r:.300}, expected {expected!r:.300}; restore the file, or run fsar-ledger verify"
            )
        tree = record.tree()
        previous = sha256_hex(data)
        records.append(record)
    return LedgerView(path, manifest, manifest_sha256, previous, tuple(records))


def read_manifest(path: Path) -> bytes:
    """The bytes of ledger.json. Raises: NotALedger if there is none, or its creation was interrupted."""
    try:
        return disk.read_document(path / MANIFEST)
    except (FileNotFoundError, NotADirectoryError) as error:
        require_created(path)
        found = "no such path" if not path.exists() else "no ledger.json in it" if path.is_dir() else "a file"
        raise NotALedger(
            f"{path}: found {found}, expected the directory of a ledger; give the path that `fsar-ledger simulate` wrote to"
        ) from error
    except OSError as error:
        raise LedgerCorrupted(
            f"{path / MANIFEST}: it cannot be read ({error.strerror}); permit reading or restore it"
        ) from error


def _require_folders(path: Path) -> None:
    """Raises: LedgerCorrupted if a folder of the ledger is a link: what it leads to is not the ledger's, to be read or cleaned up."""
    for folder in (path / COMMITS, path / SEGMENTS, path / STAGING, path / TILE):
        if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
            raise LedgerCorrupted(
                f"{folder}: found a link or something else than a folder, expected a folder of the ledger; restore it"
            )


def _unreadable(path: Path, number: int, error: OSError) -> LedgerCorrupted:
    return LedgerCorrupted(
        f"{path}: commit {number}: the segment cannot be read ({error.strerror}); permit reading or restore it"
    )


def _read(file: Path) -> bytes:
    try:
        return disk.read_document(file)
    except OSError as error:
        raise LedgerCorrupted(f"{file}: the commit record cannot be read ({error.strerror}); restore it") from error


def _count(path: Path) -> int:
    """How many commits there are. Raises: LedgerCorrupted if their numbers have gaps or other files are among them."""
    try:
        names = commit_names(path)
    except OSError as error:
        raise LedgerCorrupted(
            f"{path / COMMITS}: the folder cannot be read ({error.strerror}), expected one record a commit; restore it"
        ) from error
    for number, name in enumerate(names):
        if name != commit_name(number):
            raise LedgerCorrupted(
                f"{path / COMMITS}: found {name!r:.80}, expected {commit_name(number)}; restore the missing record or take the stray file away"
            )
    return len(names)


def commit_names(path: Path) -> list[str]:
    """What is in the folder of the commit records, sorted. Raises: OSError if it cannot be listed.

    A listing may lack a commit that is made meanwhile, and yet hold a later one: then the folder is listed again.
    """
    while True:
        names = [entry.name for entry in disk.entries(path / COMMITS)]
        lacking = set(map(commit_name, range(len(names)))).difference(names)
        if not any(os.path.lexists(path / COMMITS / name) for name in lacking):
            return names
