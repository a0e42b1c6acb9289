"""Append commits to a ledger. Each is added whole or not at all, and is on disk when the call returns.

A large commit gets its own segment, and each step is durable before the next:
1. `stage` (any number of workers) writes the segment to `staging/`, under its SHA-256.
2. `append` (one parent) writes two lines to the chain, the commit and where its rows are: this is the commit.
3. The segment moves to `segments/`. Until then readers look in `staging/`.
4. The pack of the tree and the checkpoint follow.

A small commit goes into the journal (`add`), in one sync. A full journal is renamed and sealed: a thread makes a
segment of its rows while further commits go into a new journal, then steps 1 to 4 follow for all of its commits at once
and it is removed. `seal` does so immediately.

Writers take turns, under an exclusive lock on `segments/`. Each turn begins by reading what others have added, so no
work is repeated: leaves and segments do not depend on their position in the ledger.
"""

import base64
import fcntl
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from fsar_ledger.base.errors import CommitTooLarge, NotALedger, WriteFailed, option
from fsar_ledger.ledger.log import pack
from fsar_ledger.ledger.log.hashing import HASH_BYTES, sha256_hex
from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.log.note import Checkpoint, Signer
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.rows.blocks import Block
from fsar_ledger.ledger.rows.runs import LedgerRun, refusal
from fsar_ledger.ledger.rows.schema import RELEASE
from fsar_ledger.ledger.store import disk, growing, paths
from fsar_ledger.ledger.store.derived import append_derived, index_line
from fsar_ledger.ledger.store.journal import Frame, JournalFile
from fsar_ledger.ledger.store.locations import ExistingRuns, RunsAndPlans, continued
from fsar_ledger.ledger.store.manifest import read_manifest
from fsar_ledger.ledger.store.paths import CHECKPOINT, SEGMENTS, STAGING, staged_path
from fsar_ledger.ledger.store.prepare import (
    Sealing,
    create,
    lock,
    mergeable,
    merged_segment,
    repair,
    require_name,
    require_own,
)
from fsar_ledger.ledger.store.read import View, open_chain
from fsar_ledger.ledger.store.record import Commit, Head, Placement, segment_of
from fsar_ledger.ledger.store.staging import Staged, require_staged, rows_of, stage, stage_made

# See docs/decisions/segments-hold-65536-events.md.
SEAL_ROWS, SEAL_BYTES = 1 << 14, 1 << 23
"""A journal is sealed before it holds more events or bytes; this many always fit into a segment."""


class Writer:
    """A writer that appends to a ledger, which it creates if missing. Use it as a context manager.

    Args:
        signer: The key that signs the notes of new commits; its name must be the origin. Without one they are
            unsigned.
        adopts: Allow signing on top of commits that this key did not sign; without a signer, allow unsigned commits
            in a signed ledger.

    Raises:
        NotALedger: The path is a file, a folder with other things in it, or a ledger of another origin; it is left as
            it was.
        LedgerCorrupted: Its records contradict each other, or a segment is missing.
        UsageError: The key has another origin, or did not sign the newest commit and does not adopt it; or a key signed
            that and none is given; or the path is in another ledger.
        WriteFailed: The disk refused.
    """

    def __init__(self, ledger: Path, origin: str, signer: Signer | None = None, *, adopts: bool = False):
        require_name(origin, signer.verifier if signer is not None else None)
        create(ledger, origin)
        self._path, self._origin, self._signer, self._adopts = ledger, origin, signer, adopts
        self._segments = ledger / SEGMENTS
        self._turn = disk.FolderLock(self._segments)
        self._is_broken = False
        self._chain = growing.OpenFile(ledger / paths.CHAIN)
        self._journal = JournalFile(ledger / paths.JOURNAL)
        self._sealing = Sealing()
        self._lock = -1
        try:
            self._lock, is_alone = lock(ledger)
            with self._turn:
                self._view = self._opened(is_alone=is_alone)
            with suppress(OSError):  # the file system has no locks
                fcntl.flock(self._lock, fcntl.LOCK_SH)
        except BaseException:
            self.close()
            raise
        self._held: ExistingRuns | None = None  # read when the first batch is appended

    def _opened(self, *, is_alone: bool = False, settles: bool = True) -> View:
        """Open the ledger, finish what an interrupted writer left, and check its signer."""
        view = open_chain(self._path, read_manifest(self._path), has_turn=True)
        if view.manifest.origin != self._origin:
            raise NotALedger(
                f"{self._path}: found a ledger of origin {view.manifest.origin!r}, expected {self._origin!r}; give "
                f"another path, or that origin with {option('origin')}"
            )
        if not self._adopts:
            require_own(view, self._signer.verifier if self._signer is not None else None)
        view = repair(view, is_alone=is_alone, settles=settles)
        view.chain.let_go()
        return view

    @property
    def head(self) -> Head:
        """Return the head of the ledger."""
        return self._view.head

    def __enter__(self) -> "Writer":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the lock, once the checkpoint covers the journal. Appended commits stay."""
        if self._lock < 0:
            self._turn.close()
            self._chain.close()
            return
        try:
            if (self._journal.is_open or self._sealing.is_begun) and not self._is_broken:
                with self._turn:
                    if self._view.is_current():
                        self._settle()
        except OSError as error:
            raise WriteFailed(
                f"{self._path}: every commit is safe, but the disk refused the checkpoint ({error.strerror}); the next "
                "writer writes it"
            ) from error
        finally:
            self._sealing.close()
            self._journal.close()
            self._chain.close()
            self._turn.close()
            disk.close(self._lock)
            self._lock = -1

    def _settle(self) -> None:
        """Finish any sealing in progress, and write the checkpoint of all commits. Raises: OSError, WriteFailed."""
        self._seal(self._view.journal.sealing)
        if self._journal.is_open:
            self._journal.trim(self._view.journal.end)
            self._write_checkpoint()

    def existing_runs(self) -> RunsAndPlans:
        """Return the runs and plans that the ledger holds. Raises: As `append`; LedgerCorrupted for damaged rows."""
        with self._its_turn():
            return self._runs().runs_and_plans()

    def unfinished_runs(self) -> dict[str, int]:
        """Return the runs that later commits may extend, each with its number of events in the ledger."""
        return {run: self._runs().events(run) for run in sorted(self._view.chain.going_on)}

    def _runs(self) -> ExistingRuns:
        if self._held is None:
            self._held = ExistingRuns(self._view)
        return self._held

    # See docs/decisions/append-is-one-sync.md.
    def append(self, staged: Staged, signature: str = "") -> Head:
        """Commit the staged segment, durably. Appending a segment that the ledger already holds changes nothing.

        `signature` is an existing one of the resulting tree, as in a record; the writer's signer replaces it.

        Raises:
            InvalidRun: Its events do not continue the ledger's events of a run, or repeat some. The staged file is
                removed; the ledger is unchanged.
            LedgerCorrupted: Another writer made the ledger contradict itself.
            WriteFailed: The disk refused. The ledger is unchanged, unless the message says otherwise.
        """
        with self._its_turn():
            if any(placement.segment_sha256 == staged.segment_sha256 for placement in self._view.chain.placements):
                disk.remove(staged_path(self._path, staged.segment_sha256))
                return self._view.head
            require_staged(self._path, staged)
            continues, release = self._continued(staged), staged.release
            self._seal_all()
            tree, nodes = pack.grow(self._view.tree(), staged.leaves)
            commit = self._record(staged.rows, tree.size, tree.root(), continues, staged.goes_on, release, signature)
            self._write_placement(staged, [canonical.document(commit)], tree, nodes, staged.blocks)
            self._runs().add(staged.blocks)
        return self._view.head

    def commit(self, runs: Sequence[LedgerRun]) -> Head:
        """Commit these runs, or parts of runs, durably: to the journal, or as a segment if too large for it.

        Raises: As `add` and `append`; CommitTooLarge if they do not fit into a segment either.
        """
        try:
            return self.add(runs)
        except CommitTooLarge:
            return self.append(stage(self._path, runs))

    def add(self, runs: Sequence[LedgerRun]) -> Head:
        """Commit these runs, or parts of runs, to the journal, durably: for small commits.

        Raises:
            InvalidRun: As `stage`, or as `append`. The ledger is unchanged.
            CommitTooLarge: They exceed the limit of a journal, 16,384 events or 8 MiB. The ledger is unchanged.
            LedgerCorrupted: Another writer made the ledger contradict itself.
            WriteFailed: The disk refused. The ledger is unchanged, unless the message says otherwise.
        """
        rows, blocks = rows_of(runs)
        count = sum([block.rows for block in blocks])
        if count > SEAL_ROWS or len(rows) > SEAL_BYTES:
            raise CommitTooLarge(
                f"found {count} events of {len(rows)} bytes, expected at most {SEAL_ROWS} events and {SEAL_BYTES} "
                "bytes in one commit of a journal; stage them and append them as a segment"
            )
        goes_on = tuple([run.run_id for run in runs if run.goes_on])
        if len(runs) > 1:
            goes_on = tuple(sorted(goes_on))
        with self._its_turn():
            if (flaw := self._runs().refused(blocks, self._view)) is not None:
                raise refusal(flaw)
            if self._sealing.is_done:
                self._seal(self._view.journal.sealing)
            if self._view.journal.end and (
                self._view.journal.rows + count > SEAL_ROWS or self._view.journal.end + len(rows) > SEAL_BYTES
            ):
                self._hand_over()
            journal = self._view.journal
            leaves, tree, root = journal.tree.add(rows)
            commit = self._record(count, tree.size, root, continued(blocks), goes_on)
            line = canonical.document(commit)
            self._is_broken = True  # unless everything below succeeds
            try:
                self._journal.write(b"".join((line, b"\n", rows)), journal.end)
            except OSError as error:
                raise disk.refusal(self._journal.path, "writing to the journal", error) from error
            self._view.chain.add(commit, sha256_hex(line))
            journal.add(Frame(line, commit, rows, leaves), tree)
            self._runs().add(blocks)
            self._is_broken = False
        return self._view.head

    def newest_rows(self) -> bytes:
        """Return the hashed bytes of the newest commit's rows, one line each. Raises: LedgerCorrupted."""
        newest = self._view.commits[-1]
        if self._view.journal.frames:
            return self._view.journal.frames[-1].rows
        return b"".join(row + b"\n" for row in self._view.rows(newest.tree_size - newest.rows, newest.tree_size))

    def compact(self) -> int:
        """Merge small neighbouring segments, durably; return how many were merged into others.

        No leaf, root, commit or proof changes. Old segments are removed once the new one is recorded and in place.

        Raises: LedgerCorrupted if a segment is not as placed; otherwise as `append`.
        """
        merged = 0
        with self._its_turn():
            self._seal_all()
            for old in list(mergeable(self._view.chain.placed)):
                self._merge(old)
                merged += len(old)
        return merged

    def _merge(self, old: Sequence[Placement]) -> None:
        """Merge these neighbouring segments into one, and remove them."""
        staged, chain = merged_segment(self._view, old), self._view.chain
        placement = chain.placement(staged, old[0].first, old[-1].tree(), chain.sha256)
        self._is_broken = True  # unless everything below succeeds
        self._grow_chain([canonical.document(placement)], 0, self._view.tree())
        with disk.refusals(self._segments, "moving a compacted segment into place"):
            growing.sync(self._path / paths.CHAIN)
            disk.move(staged_path(self._path, staged.segment_sha256), self._path / segment_of(placement))
        for replaced in old:
            disk.remove(self._path / segment_of(replaced))
        self._is_broken = False

    def settle(self) -> None:
        """Finish sealing the last full journal. Raises: As `append`."""
        with self._its_turn():
            self._seal(self._view.journal.sealing)

    def seal(self) -> Head:
        """Move the journal's rows into a segment. Raises: As `append`."""
        with self._its_turn():
            self._seal_all()
        return self._view.head

    # See docs/decisions/journals-are-sealed-in-the-background.md.
    def _hand_over(self) -> None:
        """Begin to seal the journal; the next commit goes into a new one. The caller holds the turn lock."""
        self._seal(self._view.journal.sealing)
        self._is_broken = True  # unless everything below succeeds
        with disk.refusals(self._journal.path, "renaming the full journal"):
            self._journal.hand_over(self._view.journal.end)
        self._view.journal.hand_over()
        self._is_broken = False
        self._sealing.begin(self._path, list(self._view.journal.frames), self._view.chain.tree())

    def _seal_all(self) -> None:
        """Move the journal's rows into segments, and remove it. The caller holds the turn lock."""
        self._seal(self._view.journal.sealing)
        self._seal(len(self._view.journal.frames))

    def _seal(self, count: int) -> None:
        """Move the first `count` frames of the journal into a segment: all, those being sealed, or none."""
        journal, chain = self._view.journal, self._view.chain
        if not count:
            return
        sealed = self._sealing.take_segment(self._path, journal.frames[:count], chain.tree())
        stage_made(self._path, sealed.made)
        lines = [frame.line for frame in journal.frames[journal.chained :]]
        self._write_placement(sealed.made.staged, lines, sealed.tree, sealed.nodes, sealed.blocks, count)
        self._journal.remove(is_all=count == len(journal.frames))

    # See docs/decisions/writers-take-turns.md.
    @contextmanager
    def _its_turn(self) -> Iterator[None]:
        """Hold the turn lock, after reading what other writers added. Raises: WriteFailed if broken or closed."""
        if self._is_broken or self._lock < 0:
            raise WriteFailed(
                f"{self._path}: this writer is {'broken' if self._is_broken else 'closed'}; open the ledger again and "
                "append what it lacks"
            )
        with self._turn:
            if not self._view.is_current(self._chain, self._journal.handle):
                size = self._view.head.size
                self._journal.close()
                self._view = self._opened(settles=False)
                if self._held is not None:
                    self._held.add_from(self._view, size)
            yield

    def _continued(self, staged: Staged) -> tuple[tuple[str, int], ...]:
        """Return the runs that the segment continues. Raises: InvalidRun if the ledger cannot hold its events."""
        if (flaw := self._runs().refused(staged.blocks, self._view)) is not None:
            disk.remove(staged_path(self._path, staged.segment_sha256))
            raise refusal(flaw)
        return continued(staged.blocks)

    def _record(
        self,
        rows: int,
        size: int,
        root: bytes,
        continues: tuple[tuple[str, int], ...],
        goes_on: tuple[str, ...],
        release: str = RELEASE,
        signature: str = "",
    ) -> Commit:
        chain = self._view.chain
        if self._signer is not None:
            signed = self._signer.sign(Checkpoint(self._origin, size, root))
            signature = base64.b64encode(signed.key_id + signed.data).decode()
        return Commit(chain.count, chain.sha256, release, rows, size, root.hex(), continues, goes_on, signature)

    def _write_placement(
        self,
        staged: Staged,
        lines: Sequence[bytes],
        tree: Frontier,
        nodes: bytes,
        blocks: Sequence[Block],
        frames: int = 0,
    ) -> None:
        """Append these commit lines and the placement of rows up to this tree, then update the derived files.

        The rows are those of the journal's first `frames` frames, or of the one commit.
        """
        chain = self._view.chain
        line = index_line(chain.placed_size, blocks)
        previous = sha256_hex(lines[-1]) if lines else chain.sha256
        placement = chain.placement(staged, chain.placed_size, tree, previous, line)
        self._is_broken = True  # unless everything below succeeds
        self._grow_chain([*lines, canonical.document(placement)], frames, self._view.tree() if frames else tree)
        try:
            growing.sync(self._path / paths.CHAIN)
            disk.move(staged_path(self._path, staged.segment_sha256), self._path / segment_of(placement))
            append_derived(self._path, paths.NODES, nodes, pack.count(placement.first) * HASH_BYTES)
            append_derived(self._path, paths.INDEX, line, chain.index_bytes - len(line))
            self._write_checkpoint()
        except OSError as error:
            raise WriteFailed(
                f"{self._path}: commit {chain.count - 1} was made, but the disk refused before it was safe "
                f"({error.strerror}); the next writer finishes it or finds it gone: run the same command again"
            ) from error
        chain.let_go()
        self._is_broken = False

    def _grow_chain(self, lines: Sequence[bytes], frames: int, tree: Frontier) -> None:
        """Append these lines to the chain, durably; they place `frames` frames, and `tree` is that of all events."""
        with disk.refusals(self._path / paths.CHAIN, "writing to the chain"):
            growing.append_durably(self._path / paths.CHAIN, b"\n".join((*lines, b"")), self._view.followed.end)
        self._view = self._view.grown(lines, frames, tree)

    def _write_checkpoint(self) -> None:
        """Write the note of the newest commit, durably. Raises: OSError."""
        disk.replace_durably(self._path / CHECKPOINT, str(self._view.note()).encode(), self._path / STAGING)
