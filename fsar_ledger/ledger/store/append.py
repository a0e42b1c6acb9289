"""Append batches of runs. Each is committed whole or not at all, and is on disk when `append` returns.

The steps, each durable before the next. A reader, or a crash between any two, sees a whole ledger:
1. `stage` (any number of workers) writes the segment to `staging/`, under its SHA-256.
2. `append` (one parent) writes the record in `staging/` and links it to its number in `commits/`: the commit.
3. The segment moves to `segments/`. After a crash, the next Writer moves it; until then readers look in `staging/`.
4. The tiles and the checkpoint follow (see `derived.py`); after a crash, the next Writer writes them.

Writers take turns: 2 to 4 happen under an exclusive lock on `commits/`. Each begins its turn with what others have
committed meanwhile, so no work is done again: a segment does not depend on its number. A Writer also holds a shared
lock on the ledger's folder. Leftovers in `staging/` that no record names are harmless; a Writer that is alone when it
opens removes them.
"""

import fcntl
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType

import msgspec
import pyarrow as pa

from fsar_ledger.errors import InvalidRun, NotALedger, SequenceConflict, WriteFailed, option
from fsar_ledger.ledger.log.hashing import HASH_BYTES
from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.log.note import Note, Signer, checkpoint_of
from fsar_ledger.ledger.log.tiles import Tile
from fsar_ledger.ledger.rows import canonical, segment
from fsar_ledger.ledger.rows.blocks import Block, blocks_of
from fsar_ledger.ledger.rows.bounds import (
    MAX_ROWS,
    MAX_SEGMENT_BYTES,
    MAX_TEXT_BYTES,
    has_more_text_than,
    text_bytes,
)
from fsar_ledger.ledger.rows.check import disordered, unprintable
from fsar_ledger.ledger.rows.codec import LedgerRun, encode_hashed
from fsar_ledger.ledger.rows.layout import read_file, read_layout
from fsar_ledger.ledger.rows.releases import RELEASE
from fsar_ledger.ledger.rows.runs import Flaw, overlong, refusal, unreadable
from fsar_ledger.ledger.rows.schema import FINGERPRINT
from fsar_ledger.ledger.store import disk, turns
from fsar_ledger.ledger.store.derived import catch_up, check_folders, write_derived
from fsar_ledger.ledger.store.held import Held, HeldRuns, runs_of
from fsar_ledger.ledger.store.paths import (
    COMMITS,
    MANIFEST,
    STAGING,
    commit_path,
    segment_path,
    staged_path,
)
from fsar_ledger.ledger.store.prepare import clean, confirm, create, lock, require_name, require_own, roll_forward
from fsar_ledger.ledger.store.read import open_ledger, read_manifest
from fsar_ledger.ledger.store.record import CommitRecord, parse_manifest, sha256_hex
from fsar_ledger.ledger.store.view import Head
from fsar_ledger.ledger.store.walk import commit_names

_TRIES = 100
"""How often a writer goes on from the commit of another, where the file system has no locks."""


class Staged(msgspec.Struct, frozen=True):
    """What the parent must know of a segment that waits to be committed.

    Units: `segment_bytes` bytes, `rows` events. `leaves` are the packed RFC 6962 leaf hashes, 32 bytes per row.
    `blocks` are those of the rows; `goes_on` are the runs of which later commits may hold more.
    `release` is the one whose events and columns these are.
    """

    segment_sha256: str
    segment_bytes: int
    rows: int
    first_run: str
    last_run: str
    leaves: bytes
    blocks: tuple[Block, ...] = ()
    goes_on: tuple[str, ...] = ()
    release: str = RELEASE
    schema_sha256: str = FINGERPRINT


def stage(ledger: Path, runs: Sequence[LedgerRun]) -> Staged:
    """Encode these runs and write them to the staging folder, durably; they are not yet part of the ledger.

    Needs no lock and no order. Workers may stage at the same time, but while a Writer is open: one that is alone when
    it opens removes what is staged and not committed. The same runs give the same file.

    Raises:
        InvalidRun: There are no runs, or more than one commit may hold (see `bounds`); or one cannot be encoded (see
            `codec.encode`), has unprintable text (see `check.unprintable`), events in a wrong order (see
            `check.disordered`) or unreadable parameters (see `runs.unreadable`). Nothing was written.
        WriteFailed: The disk refused; nothing is left behind.
    """
    if not runs:
        raise InvalidRun("found no runs to stage, expected at least 1")
    table, leaves = encode_hashed(runs)
    if flaw := unprintable(table):
        raise InvalidRun(f"{flaw}; give it another name")
    if flaw := disordered(table) or unreadable(runs):
        raise refusal(flaw)
    return stage_rows(ledger, runs, table, leaves)


def stage_rows(ledger: Path, runs: Sequence[LedgerRun], table: pa.Table, leaves: bytes) -> Staged:
    """Stage encoded runs without a check of their names and order, as 0.1.0 did. Raises: As `stage`."""
    data = segment.to_parquet(table)
    sizes = [(table.num_rows, MAX_ROWS, "events"), (data.size, MAX_SEGMENT_BYTES, "bytes")]
    if has_more_text_than(table, MAX_TEXT_BYTES):
        sizes.append((text_bytes(table), MAX_TEXT_BYTES, "bytes of text"))
    for found, most, what in sizes:
        if found > most:
            raise InvalidRun(
                f"found {found} {what} in {len(runs)} runs, expected at most {most} in one commit; commit fewer runs "
                "at once"
            )
    if flaw := overlong(runs):
        raise refusal(flaw)
    try:
        read_layout(data.to_pybytes())
    except ValueError as error:
        raise InvalidRun(
            f"found {error} in a segment of {len(runs)} runs, so no reader would take it; commit fewer runs at once"
        ) from error
    staged = Staged(
        sha256_hex(data),
        data.size,
        table.num_rows,
        runs[0].run_id,
        runs[-1].run_id,
        leaves,
        tuple(blocks_of(table)),
        tuple(sorted(run.run_id for run in runs if run.goes_on)),
    )
    path = staged_path(ledger, staged.segment_sha256)
    with disk.refusals(path, "writing a segment"):
        disk.write_durably(path, memoryview(data))
    return staged


class Writer:
    """Appends to one ledger, which it creates if there is none. Use it as a context manager.

    Args:
        signer: The key that signs the notes of new commits, and whose name must be the origin. Without one they are
            unsigned.
        adopts: The signer vouches for a ledger whose newest commit is unsigned or signed by another key.

    Raises:
        NotALedger: The path is a file, a folder with other things in it, or a ledger of another origin; it is left as
            it was.
        FormatVersionMismatch: The ledger was written in another format.
        LedgerCorrupted: Its records contradict each other, or a segment is missing.
        UsageError: The key has another origin, or did not sign the newest commit and does not adopt it; or the path is
            in another ledger.
        WriteFailed: The disk refused.
    """

    def __init__(self, ledger: Path, origin: str, signer: Signer | None = None, *, adopts: bool = False):
        require_name(origin, signer.verifier if signer is not None else None)
        create(ledger, origin)
        manifest = parse_manifest(ledger / MANIFEST, read_manifest(ledger))
        if manifest.origin != origin:
            raise NotALedger(
                f"{ledger / MANIFEST}: found a ledger of origin {manifest.origin!r}, expected {origin!r}; give "
                f"another path, or that origin with {option('origin')}"
            )
        self._path, self._origin, self._signer, self._adopts = ledger, origin, signer, adopts
        self._held: HeldRuns | None = None  # read when the first batch is appended
        self._is_broken = False
        self._lock, is_alone = lock(ledger)
        try:
            if is_alone:
                clean(open_ledger(ledger))
            with suppress(OSError):  # the file system has no locks
                fcntl.flock(self._lock, fcntl.LOCK_SH)
            with turns.turn(ledger / COMMITS):
                self._open()
        except BaseException:
            self.close()
            raise

    def _open(self) -> None:
        """Open the ledger, finish what an interrupted writer left, and go on from the newest commit."""
        view = open_ledger(self._path)
        if self._signer is not None and not self._adopts:
            require_own(view, self._signer.verifier)
        confirm(view)
        roll_forward(view)
        self._edge = catch_up(view)
        self._opened, self._head = view, view.head
        self._previous = view.record_sha256
        self._segments = {record.segment_sha256 for record in view.records}

    def _catch_up(self) -> None:
        """Take over what other writers have committed since the last turn."""
        known = self._head.commits
        if not os.path.lexists(commit_path(self._path, known)):
            return
        self._open()
        if self._held is not None:
            for record in self._opened.records[known:]:
                self._held.add(record.number, segment_path(self._path, record.number), record.rows)

    @property
    def head(self) -> Head:
        """Return how far the ledger goes."""
        return self._head

    def __enter__(self) -> "Writer":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Release the lock. What was appended stays."""
        if self._lock >= 0:
            disk.close(self._lock)
            self._lock = -1

    def held(self) -> Held:
        """Read from the rows which runs and plans the ledger holds; only once, and before the first append.

        Raises: LedgerCorrupted if they cannot be read.
        """
        assert self._held is None, "the writer has appended, or was asked before"
        self._held = HeldRuns(self._opened, by_row=True)
        return self._held.told()

    def append(self, staged: Staged) -> Head:
        """Commit the staged segment, durably. Appending a segment that is there already changes nothing.

        Raises:
            InvalidRun: The ledger already holds one of the runs. The staged file is removed; the ledger is unchanged.
            SequenceConflict: The file system has no locks, and others took the number again and again; open the ledger
                again and append what it lacks.
            LedgerCorrupted: A folder of the tiles is a link; or another writer made the ledger contradict itself.
            WriteFailed: The disk refused. The ledger is unchanged, unless the message says otherwise.
        """
        if self._is_broken or self._lock < 0:
            raise WriteFailed(
                f"{self._path}: this writer is {'broken' if self._is_broken else 'closed'}; open the ledger again and "
                "append what it lacks"
            )
        runs = self._runs_of(staged)
        tries = 0
        while True:
            with turns.turn(self._path / COMMITS):
                self._catch_up()
                if staged.segment_sha256 in self._segments:
                    disk.remove(staged_path(self._path, staged.segment_sha256))
                    return self._head
                try:
                    return self._append(staged, runs)
                except SequenceConflict:  # without locks another writer may be quicker: go on from its commit
                    self._is_broken, tries = False, tries + 1
                    if tries == _TRIES:
                        raise

    def _append(self, staged: Staged, runs: list[str] | None) -> Head:
        """Commit the staged segment with these runs next; the writer has its turn. Raises: As `append`."""
        number = self._head.commits
        if number >= disk.MAX_NAMES:
            raise WriteFailed(
                f"{self._path}: found {number} commits, expected at most {disk.MAX_NAMES}; begin another ledger"
            )
        if self._held is None:
            self._held = HeldRuns(self._opened)
        if (again := self._held.first_of(runs or [])) is not None:
            disk.remove(staged_path(self._path, staged.segment_sha256))
            run, holder = again
            raise refusal(Flaw(-1, run, 0, "run_id", f"a run that commit {holder} holds", "each run in one commit"))
        edge, tiles = self._edge.extend(staged.leaves)
        check_folders(self._path, tiles)
        record = self._record(staged, number, edge.frontier())
        data = canonical.document(record)
        self._is_broken = True  # unless everything below succeeds
        self._publish(staged, number, data)
        self._settle(staged, number)
        self._derive(record, tiles)
        self._is_broken = False
        self._edge, self._previous = edge, sha256_hex(data)
        self._head = Head(number + 1, edge.size, record.tree_root, record.last_run)
        self._segments.add(staged.segment_sha256)
        self._held.add(number, segment_path(self._path, number), staged.rows, runs)
        return self._head

    def _runs_of(self, staged: Staged) -> list[str] | None:
        """Return the runs that were staged; None if another writer has committed the same. Raises: As `append`."""
        path = staged_path(self._path, staged.segment_sha256)
        with disk.refusals(path, "reading what was staged"):
            try:
                data = read_file(path)
            except FileNotFoundError:
                return None
        if (
            sha256_hex(data) != staged.segment_sha256
            or len(data) != staged.segment_bytes
            or staged.rows * HASH_BYTES != len(staged.leaves)
        ):
            raise WriteFailed(
                f"{path}: found another file than was staged, expected {staged.segment_bytes} bytes of that SHA-256; "
                "stage it again"
            )
        return runs_of(path, staged.rows, data)

    def _record(self, staged: Staged, number: int, tree: Frontier) -> CommitRecord:
        checkpoint = checkpoint_of(self._origin, tree)
        return CommitRecord(
            number=number,
            previous_sha256=self._previous,
            release=RELEASE,
            schema_sha256=FINGERPRINT,
            segment_sha256=staged.segment_sha256,
            segment_bytes=staged.segment_bytes,
            rows=staged.rows,
            first_run=staged.first_run,
            last_run=staged.last_run,
            tree_size=tree.size,
            tree_root=checkpoint.root.hex(),
            frontier=tuple(subtree.hex() for subtree in tree.subtrees),
            note=str(Note(checkpoint, (self._signer.sign(checkpoint),) if self._signer else ())),
        )

    def _publish(self, staged: Staged, number: int, data: bytes) -> None:
        """Give the record its number, which must be the newest.

        Raises: SequenceConflict if another record has the number, or others continue from the same record.
        """
        path = commit_path(self._path, number)
        source = staged_path(self._path, staged.segment_sha256)
        temporary = disk.temporary_name(self._path / STAGING / path.name)
        with disk.refusals(path, "writing a commit record"):
            if not path.exists():
                if source.stat().st_size != staged.segment_bytes or staged.rows * HASH_BYTES != len(staged.leaves):
                    raise WriteFailed(
                        f"{source}: found another file than was staged, expected {staged.segment_bytes} bytes; stage "
                        "it again"
                    )
                disk.write_temporary(temporary, data)
                with suppress(FileExistsError):
                    disk.link_new(temporary, path)
                    return
            if disk.read_document(path) != data:
                raise SequenceConflict(
                    f"{path}: found a commit of another writer, expected number {number} to be free; open the ledger "
                    "again and append what it lacks"
                )
            newest = len(commit_names(self._path)) - 1
        if newest > number:  # derived files of a later commit are there already
            raise SequenceConflict(
                f"{self._path}: found commits up to {newest} of another writer, expected {number} to be the newest; "
                "open the ledger again and append what it lacks, or run the same command again"
            )

    def _settle(self, staged: Staged, number: int) -> None:
        """Sync the record and move its segment into place.

        Raises: WriteFailed if the disk refuses; the commit may stand.
        """
        with _unfinished(self._path, number):
            disk.sync_folder(self._path / COMMITS)
            disk.move(staged_path(self._path, staged.segment_sha256), segment_path(self._path, number))

    def _derive(self, record: CommitRecord, tiles: Mapping[Tile, bytes]) -> None:
        """Write the tiles and the checkpoint of the commit, durably. Raises: As `_settle`."""
        with _unfinished(self._path, record.number):
            write_derived(self._path, self._edge, tiles, record)


@contextmanager
def _unfinished(ledger: Path, number: int) -> Iterator[None]:
    """Turn an OSError inside, which comes after the commit, into WriteFailed."""
    try:
        yield
    except OSError as error:
        raise WriteFailed(
            f"{ledger}: commit {number} was made, but the disk refused before it was safe ({error.strerror}); "
            "the next writer finishes it or finds it gone: run the same command again"
        ) from error
