"""Preparation for a Writer: creating, locking and repairing a ledger, sealing journals and merging segments.

The segment of a journal is made in a thread, which writes nothing, while its writer continues with another journal.
Segments are discarded if another writer committed first.
"""

import fcntl
import os
import stat
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import pyarrow as pa

from fsar_ledger.base.errors import LedgerCorrupted, NotALedger, UsageError, option
from fsar_ledger.base.printable import value
from fsar_ledger.ledger.log import pack
from fsar_ledger.ledger.log.hashing import HASH_BYTES, sha256_hex
from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.log.note import VerifierKey, doubt, is_name, signers_of
from fsar_ledger.ledger.rows import canonical, segment
from fsar_ledger.ledger.rows.blocks import Block, blocks_of
from fsar_ledger.ledger.rows.bounds import MAX_NAME_BYTES
from fsar_ledger.ledger.store import disk, growing
from fsar_ledger.ledger.store.derived import append_derived, derived_sizes
from fsar_ledger.ledger.store.journal import FIRST, Frame, leaves_in, lines_of
from fsar_ledger.ledger.store.manifest import FORMAT, VERSION, Manifest, parse_manifest, read_manifest
from fsar_ledger.ledger.store.paths import (
    CHAIN,
    CHECKPOINT,
    INDEX,
    JOURNAL,
    MANIFEST,
    NODES,
    SEALING,
    SEGMENTS,
    STAGING,
    is_unfinished,
    require_outside,
)
from fsar_ledger.ledger.store.read import View, open_chain
from fsar_ledger.ledger.store.record import Placement, segment_of
from fsar_ledger.ledger.store.snapshot import behind
from fsar_ledger.ledger.store.staging import Staged, UnstagedSegment, made_of, stage_made, table_of


def lock(ledger: Path) -> tuple[int, bool]:
    """Open the ledger's folder and try to lock it; return the handle, and whether it holds the only lock.

    False if another writer has the ledger open or the file system has no locks.
    """
    with disk.refusals(ledger, "locking"):
        handle = os.open(ledger, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return handle, False
    return handle, True


def require_name(origin: str, key: VerifierKey | None) -> None:
    """Require that this is a valid origin, and the name of the key.

    Raises: UsageError if it is not the key's name, ValueError if it is not valid.
    """
    if key is not None and key.name != origin:
        raise UsageError(
            f"found a key named {key.name}, expected {origin}, the ledger's origin; make one with "
            f"fsar-ledger key new FILE --name {origin}"
        )
    if len(origin.encode(errors="replace")) > MAX_NAME_BYTES:
        raise ValueError(f"found an origin of {len(origin)} characters, expected at most {MAX_NAME_BYTES} bytes")
    if not is_name(origin):
        raise ValueError(f"found origin {origin!r}, expected a printable name without spaces and plus signs")


def create(ledger: Path, origin: str) -> None:
    """Create an empty ledger, or finish an interrupted creation; leave anything else at the path alone.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted: The path is something else, or a ledger of another format.
        WriteFailed: The disk refused.
    """
    if os.path.lexists(ledger / MANIFEST):
        parse_manifest(ledger / MANIFEST, read_manifest(ledger))
        return
    if os.path.lexists(ledger) and not os.path.isdir(ledger):
        raise NotALedger(f"{ledger}: found a file, expected a ledger or a free path; give another path")
    require_outside(ledger.parent, str(ledger))
    manifest = Manifest(FORMAT, origin, VERSION)
    folders = [ledger, ledger / SEGMENTS, ledger / STAGING]
    temporary = disk.temporary_name(ledger / STAGING / MANIFEST)
    with disk.refusals(ledger, "creating a ledger"):
        if os.path.isdir(ledger) and not is_unfinished(ledger):
            if os.path.lexists(ledger / MANIFEST):  # another writer created it first
                return
            if os.path.lexists(ledger / CHAIN):
                read_manifest(ledger)  # raises: only the manifest is missing
            raise NotALedger(
                f"{ledger}: found a folder that is not a ledger and not empty, expected a ledger or a free path; give "
                "another path"
            )
        for folder in folders:
            disk.make_folder(folder)
        disk.write_temporary(temporary, canonical.document(manifest))
        with suppress(FileExistsError):  # another writer created it first
            disk.link_new(temporary, ledger / MANIFEST)
        disk.sync_folder(ledger)


def require_own(view: View, key: VerifierKey | None) -> None:
    """Require that the key signed the newest commit, if any, because its next signature covers all earlier ones.

    Without a key, that commit must be unsigned: the next one would be.

    Raises: UsageError if that is not so.
    """
    note = view.note()
    if note is None:
        return
    if key is None:
        if (signers := signers_of(note)) is not None:
            raise UsageError(
                f"{value(str(view.path))}: found a newest commit signed by {value(signers)}, expected the same key for "
                f"the next: give it with {option('key')}, or continue in a new ledger"
            )
    elif (flaw := doubt(note, key)) is not None:
        raise UsageError(
            f"{view.path}: found a newest checkpoint with {flaw}, expected one of {key.key}; its next signature "
            f"would vouch for everything there: verify the ledger, and give {option('adopt')} to sign from here on, "
            "if the command has it; with `record`, `import`, `federate` and `serve`, continue in a new ledger"
        )


def repair(view: View, *, is_alone: bool, settles: bool = True) -> View:
    """Finish what an interrupted writer left, durably, and return the resulting view.

    The caller holds the turn lock. Staged segments that are not placed are removed only if the writer `is_alone`:
    others may be staging. Unless it `settles`, a checkpoint that lags behind only the journal stays.

    Raises:
        LedgerCorrupted: A segment is missing, or the checkpoint is not one that a crash leaves.
        WriteFailed: The disk refused.
    """
    path = view.path
    covered = behind(view)
    is_hidden = bool(view.followed.is_hidden or view.journal.hidden)
    is_changed = bool(view.followed.torn or view.journal.torn or view.journal.sealed or is_hidden)
    with disk.refusals(path, "opening it for writing"):
        disk.sync_folder(path)
        growing.write_again(path / CHAIN, view.followed.last, view.followed.end, cuts=view.followed.torn > 0)
        if view.followed.is_hidden:
            growing.show(path / CHAIN, [view.followed.end - 1], b"\n")
        if view.journal.end:
            # What follows is torn, or preallocated room that may not be on disk.
            cuts = view.journal.torn > 0 or (settles and growing.size_of(path / JOURNAL) > view.journal.end)
            growing.write_again(path / JOURNAL, view.journal.unsure, view.journal.end, cuts=cuts)
            if view.journal.hidden:
                growing.show(path / JOURNAL, view.journal.hidden, FIRST)
        _roll_forward(view)
        _clean(view, is_alone=is_alone)
        is_covered = not covered or view.commits[-covered].tree_size > view.chain.placed_size
        _derive(view, is_settled=is_covered and not view.journal.sealed)
        if covered and (settles or not is_covered):
            disk.replace_durably(path / CHECKPOINT, str(view.note()).encode(), path / STAGING)
        for name, is_empty in ((SEALING, not view.journal.sealing), (JOURNAL, not view.journal.end)):
            if is_empty and os.path.lexists(path / name):  # it was sealed, or its first frame is torn
                os.unlink(path / name)
                disk.sync_folder(path)
    return open_chain(path, read_manifest(path), has_turn=True) if is_changed else view


def _roll_forward(view: View) -> None:
    """Move every placed segment into place. Raises: LedgerCorrupted if one is missing."""
    files = {
        entry.name: entry.stat(follow_symlinks=False)
        for entry in os.scandir(view.path / SEGMENTS)  # three times as fast as a stat of each path
    }
    for placement in view.chain.placed:
        name = segment_of(placement)
        status = files.get(name.removeprefix(f"{SEGMENTS}/"))
        if status is not None and stat.S_ISREG(status.st_mode) and status.st_size == placement.segment_bytes:
            continue
        target = view.path / name
        file = view.located(placement)
        if file != target:
            disk.move(file, target)


def _clean(view: View, *, is_alone: bool) -> None:
    """Remove superseded segments and, for a writer that is alone, everything from staging."""
    if len(view.chain.placed) < len(view.chain.placements):
        superseded = set(map(segment_of, view.chain.placements)) - set(map(segment_of, view.chain.placed))
        for name in superseded:
            if os.path.lexists(view.path / name):
                os.unlink(view.path / name)
    disk.make_folder(view.path / STAGING)
    if not is_alone:
        return
    for entry in list(os.scandir(view.path / STAGING)):
        if entry.is_file(follow_symlinks=False):  # another creator of this ledger may have removed its temporary file
            disk.remove(Path(entry.path))


def _derive(view: View, *, is_settled: bool) -> None:
    """Bring pack and index up to date with the events in segments.

    What the last append added is rewritten if not settled.

    Raises: LedgerCorrupted if a segment is not as placed.
    """
    good = view.chain.placed_size if is_settled else view.chain.settled
    sizes = {name: growing.size_of(view.path / name) for name in (NODES, INDEX)}
    if sizes == derived_sizes(view.chain) and is_settled:
        return
    _derive_nodes(view, good, sizes[NODES])
    _derive_index(view, good, sizes[INDEX])


def _derive_index(view: View, good: int, have: int) -> None:
    """Write the lines of the index beyond the first `good` events or `have` bytes. Raises: As `_derive`."""
    chain, offset = view.chain, 0
    for number, placement in enumerate(chain.placed):
        added = chain.placed_in(number)
        size = sum(placement.index_bytes for placement in added)
        if placement.end > good or offset + size > have:
            lines = view.index_lines(number)
            if [sha256_hex(line) for line in lines] != [placement.index_sha256 for placement in added]:
                raise LedgerCorrupted(
                    f"{view.segment(number)}: found rows with other lines of the index than those placed; run "
                    "fsar-ledger verify"
                )
            append_derived(view.path, INDEX, b"".join(lines), offset)
        offset += size


def _derive_nodes(view: View, good: int, have: int) -> None:
    """Write the hashes of the pack beyond the first `good` events or `have` bytes. Raises: As `_derive`."""
    placed = view.chain.placed
    begin = 0
    while begin < len(placed) and placed[begin].end <= good and pack.count(placed[begin].end) * HASH_BYTES <= have:
        begin += 1
    tree = placed[begin - 1].tree() if begin else Frontier()
    for number in range(begin, len(placed)):
        first = tree.size
        tree, nodes = pack.grow(tree, canonical.leaves(view.table(number)))
        if tree != placed[number].tree():
            raise LedgerCorrupted(
                f"{view.segment(number)}: found rows that lead to root {tree.root().hex()}, expected "
                f"{placed[number].tree().root().hex()} as placed; run fsar-ledger verify"
            )
        append_derived(view.path, NODES, nodes, pack.count(first) * HASH_BYTES)


class Sealed(NamedTuple):
    """The segment of some journal frames, its blocks, the tree after them, and the nodes added to the pack."""

    made: UnstagedSegment
    blocks: tuple[Block, ...]
    tree: Frontier
    nodes: bytes


def sealed(path: Path, frames: Sequence[Frame], before: Frontier) -> Sealed:
    """Make the segment of these journal frames of a ledger whose tree before them is `before`.

    Raises: LedgerCorrupted if their rows are not events.
    """
    table = table_of(path / JOURNAL, lines_of(frames))
    leaves = leaves_in(frames)
    return Sealed(made_of(table, leaves), tuple(blocks_of(table)), *pack.grow(before, leaves))


class Sealing:
    """A background thread that makes the segment of some journal frames, identified by the last one."""

    def __init__(self) -> None:
        self._threads: ThreadPoolExecutor | None = None
        self._found: Future[Sealed] | None = None
        self._last: Frame | None = None

    def begin(self, path: Path, frames: Sequence[Frame], before: Frontier) -> None:
        """Start making the segment of these frames."""
        if self._threads is None:
            self._threads = ThreadPoolExecutor(1, "fsar-ledger-sealing")
        self._found, self._last = self._threads.submit(sealed, path, frames, before), frames[-1]

    @property
    def is_begun(self) -> bool:
        """Return whether a segment was started and not yet taken."""
        return self._found is not None

    @property
    def is_done(self) -> bool:
        """Return whether that segment is finished."""
        return self._found is not None and self._found.done()

    def take_segment(self, path: Path, frames: Sequence[Frame], before: Frontier) -> Sealed:
        """Return the segment of these frames, making it now if it was not started. Raises: As `sealed`."""
        ready, last = self._found, self._last
        self._found = self._last = None
        if ready is None or last is None or last.commit != frames[-1].commit or last.line != frames[-1].line:
            return sealed(path, frames, before)
        return ready.result()

    def close(self) -> None:
        """End the thread, after its current segment."""
        if self._threads is not None:
            self._threads.shutdown()
            self._threads = None


# See docs/decisions/segments-hold-65536-events.md.
MERGED_ROWS = 1 << 16
"""The most events of a merged segment."""
MERGED_BYTES = 1 << 22
"""The most bytes of the segments merged into one; a small part of a segment's limit."""


def mergeable(placed: Sequence[Placement]) -> Iterator[Sequence[Placement]]:
    """Yield groups of at least two neighbouring segments that fit into one, greedily from the first on."""
    group: list[Placement] = []
    rows = size = 0
    for placement in placed:
        rows, size = rows + placement.rows, size + placement.segment_bytes
        if rows > MERGED_ROWS or size > MERGED_BYTES:
            if len(group) > 1:
                yield group
            group, rows, size = [], placement.rows, placement.segment_bytes
        group.append(placement)
    if len(group) > 1:
        yield group


def merged_segment(view: View, old: Sequence[Placement]) -> Staged:
    """Write the rows of these neighbouring segments into one, in the staging folder.

    Raises: LedgerCorrupted if their rows do not lead from the tree before them to the tree after.
    """
    tables: list[pa.Table] = [segment.read_table(view.placed_segment(placement)) for placement in old]
    table = pa.concat_tables(tables).combine_chunks()
    leaves = canonical.leaves(table)
    tree_before = view.chain.tree_at(old[0].first)
    tree_after = tree_before.extend(leaves)
    if tree_after != old[-1].tree():
        raise LedgerCorrupted(
            f"{view.path}: events {old[0].first} to {old[-1].end - 1}: found rows that lead to root "
            f"{tree_after.root().hex()}, expected {old[-1].tree().root().hex()} as placed; run fsar-ledger verify"
        )
    unstaged = made_of(table, leaves)
    stage_made(view.path, unstaged)
    return unstaged.staged
