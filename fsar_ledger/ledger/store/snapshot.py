"""Read what is committed in a ledger at one moment, while writers continue.

Readers read the chain, the checkpoint, and then the journal. If the chain grew meanwhile they follow it further, and
read the others again. A hidden commit is on its way to the disk, or was left by a crash; an inconsistency was written
meanwhile, or is damage. Whether a writer holds the turn lock shows which.
"""

import hashlib
import os
from copy import copy
from pathlib import Path
from time import monotonic, sleep
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from fsar_ledger.base.errors import FormatVersionMismatch, LedgerCorrupted
from fsar_ledger.ledger.store import disk, growing
from fsar_ledger.ledger.store.journal import FIRST, Journal, after_lines, read_frames
from fsar_ledger.ledger.store.links import Chain, Followed, follow
from fsar_ledger.ledger.store.paths import CHAIN, CHECKPOINT, JOURNAL, SEALING, SEGMENTS
from fsar_ledger.ledger.store.problem import LaterRelease, Problem
from fsar_ledger.ledger.store.record import Commit, Placement, line_at, parse_line

if TYPE_CHECKING:
    from fsar_ledger.ledger.store.read import View

MAX_CHAIN_BYTES = 1 << 32
PART_BYTES = 1 << 24
"""The bytes of a chain that are read at once."""
MAX_JOURNAL_BYTES = 1 << 30
_PAUSE_S, _PATIENCE_S = 0.0005, 10.0
"""How long a reader waits for a writer each time, and in total."""


class Snapshot(NamedTuple):
    """The chain and how far it could be followed, the journal, and the checkpoint or why it cannot be read."""

    chain: Chain
    followed: Followed
    journal: Journal
    checkpoint: str | Problem | None

    @property
    def problem(self) -> Problem | None:
        """Return the first inconsistency; None if there is none."""
        return self.followed.problem or self.journal.problem

    def require_whole(self, path: Path) -> None:
        """Require consistency. Raises: FormatVersionMismatch for a record of a later release, else LedgerCorrupted."""
        if isinstance(self.problem, LaterRelease):
            raise FormatVersionMismatch(f"{path}/{self.problem}")
        if self.problem is not None:
            raise LedgerCorrupted(f"{path}/{self.problem}; restore the file, or run fsar-ledger verify")


# See docs/decisions/commits-are-packed.md.
class Known(NamedTuple):
    """The state of a chain after its first bytes, up to where they were `followed`, and their SHA-256."""

    sha256: bytes
    followed: Followed
    chain: Chain


LEAST_KNOWN, MOST_KNOWN = 1 << 12, 8
"""The least number of commits of a chain cached in this process, and the most chains cached."""
known: dict[tuple[Path, str], Known] = {}
"""The cached chains by folder and hash of ledger.json; the newest last."""


def take_snapshot(path: Path, manifest_sha256: str, *, trusts_frontiers: bool, has_turn: bool) -> Snapshot:
    """Return what is committed now, once that is certain.

    Args:
        path: The folder of the ledger.
        manifest_sha256: The hash of its ledger.json.
        trusts_frontiers: As in `Chain`.
        has_turn: The caller holds the writers' turn lock.
    """
    reader = _Reader(path, manifest_sha256, trusts_frontiers=trusts_frontiers)
    if has_turn:  # a writer is long-lived, and drops commits
        return reader.look(counts_hidden=True)
    reader.begin_known()
    snapshot = _settled(reader)
    reader.keep()
    return snapshot


def _settled(reader: "_Reader") -> Snapshot:
    """Return what is committed, as soon as that is certain."""
    first: tuple[int, int] | None = None
    until = monotonic() + _PATIENCE_S
    while True:
        snapshot = reader.look()
        if not reader.is_steady:
            if monotonic() > until:
                with disk.shared_lock(reader.path / SEGMENTS):
                    return reader.look(counts_hidden=reader.is_synced())
            continue
        seen = snapshot.followed.end, snapshot.chain.count
        # Commits hidden at first may have been seen before, if a crash left them; those hidden later cannot.
        if snapshot.problem is None and (not reader.has_hidden or first not in (None, seen)):
            return snapshot
        with disk.lock_if_free(reader.path / SEGMENTS) as is_free:
            if is_free:
                return reader.look(counts_hidden=reader.is_synced())
        if monotonic() > until:
            return snapshot
        first = first or seen
        sleep(_PAUSE_S)


class _Reader:
    """A reader that polls a ledger, without rereading the part of the chain already followed."""

    def __init__(self, path: Path, manifest_sha256: str, *, trusts_frontiers: bool) -> None:
        self.path = path
        self.is_steady = True
        """Whether the chain had the same size before and after the last look."""
        self.has_hidden = False
        """Whether that found hidden commits."""
        self._sha256 = manifest_sha256
        self._trusts_frontiers = trusts_frontiers
        self._begin()

    def _begin(self) -> None:
        self._chain = Chain(self._sha256, trusts_frontiers=self._trusts_frontiers)
        self._followed, self._digest = Followed(0), hashlib.sha256()
        self._newest = self._chain.mark()  # without what the journal added

    def begin_known(self) -> None:
        """Start from the cached state of the chain, if the file still has the same bytes up to there.

        Reading and hashing them takes a tenth of the time of following them.
        """
        cached = known.get((self.path, self._sha256)) if self._trusts_frontiers else None
        if cached is None:
            return
        digest = hashlib.sha256()
        for offset in range(0, cached.followed.end, PART_BYTES):
            count = min(PART_BYTES, cached.followed.end - offset)
            digest.update(growing.read_whole(self.path / CHAIN, MAX_CHAIN_BYTES, offset, count))
        if digest.digest() == cached.sha256:
            self._chain, self._followed, self._digest = _copied(cached.chain), cached.followed, digest
            self._newest = self._chain.mark()

    def keep(self) -> None:
        """Cache the state of the chain for the next reader in this process."""
        if not self._trusts_frontiers or self._newest.commits < LEAST_KNOWN or self._followed.problem is not None:
            return
        key, sha256 = (self.path, self._sha256), self._digest.digest()
        entry = known.pop(key, None)
        if entry is None or entry.sha256 != sha256:
            chain = _copied(self._chain)
            chain.back(self._newest)
            entry = Known(sha256, Followed(self._followed.end, last=self._followed.last), chain)
        known[key] = entry
        for oldest in [*known][:-MOST_KNOWN]:
            known.pop(oldest, None)  # unless another thread has removed it

    def is_synced(self) -> bool:
        """Sync hidden commits to the disk, so that they stay; return whether that succeeded."""
        if self.has_hidden:
            try:
                growing.sync(self.path / CHAIN)
                growing.sync(self.path / JOURNAL)
            except OSError:
                return False
        return True

    def look(self, *, counts_hidden: bool = False) -> Snapshot:
        """Return a snapshot of the ledger, with or without whole commits that are hidden."""
        size = self._follow(counts_hidden=counts_hidden)
        has_sealing = os.access(self.path / SEALING, os.F_OK)  # one renamed after this is read under its new name too
        note = read_checkpoint(self.path)  # before the commits that it may cover
        newer, older = (growing.read_whole(self.path / name, MAX_JOURNAL_BYTES) for name in (JOURNAL, SEALING))
        with_hidden, offsets = _with_hidden(newer)
        newer = with_hidden if counts_hidden else newer[: offsets[0]] if offsets else newer
        journal = read_frames(older, newer, self._chain, has_sealing=has_sealing)
        journal.hidden = offsets if counts_hidden else ()
        self.has_hidden = self.has_hidden or bool(offsets)
        self.is_steady = growing.size_of(self.path / CHAIN) == size
        return Snapshot(self._chain, self._followed, journal, note)

    def _follow(self, *, counts_hidden: bool) -> int:
        """Follow the new bytes of the chain; return the size of the file."""
        self._chain.back(self._newest)
        if self._followed.problem or growing.size_of(self.path / CHAIN) < self._followed.end:
            self._begin()
        size = self._follow_parts(counts_hidden=counts_hidden)
        if not self._chain.has_right_tree():  # find the wrong line
            self._begin()
            self._chain = Chain(self._sha256)
            size = self._follow_parts(counts_hidden=False)
        self._newest = self._chain.mark()
        return size

    def _follow_parts(self, *, counts_hidden: bool) -> int:
        """Follow the rest of the file in parts; return its size.

        Within the file, the bytes after the last whole append of a part are read again with the next one.
        """
        count = PART_BYTES
        while True:
            start = self._followed.end
            data = growing.read_whole(self.path / CHAIN, MAX_CHAIN_BYTES, start, count)
            is_last = len(data) < count
            self.has_hidden = is_last and data.endswith(b"}\0") and _is_placement(_last_line(data))
            is_hidden = self.has_hidden and counts_hidden
            visible = data[:-1] + b"\n" if is_hidden else data
            followed = follow(visible, self._chain)
            self._digest.update(visible[: followed.end])
            size = start + len(data) if is_last else growing.size_of(self.path / CHAIN)
            self._followed = Followed(
                start + followed.end,
                followed.torn,
                followed.problem,
                start + followed.last if followed.end else self._followed.last,
                is_hidden=is_hidden and start + followed.end == size,
            )
            if is_last or followed.problem is not None:
                return size
            count = PART_BYTES if followed.end else 2 * count


def _copied(chain: Chain) -> Chain:
    """Return an independent copy of this chain."""
    other = copy(chain)
    other.commits = chain.commits.copy()
    other.placements, other.placed, other.added = [*chain.placements], [*chain.placed], [*chain.added]
    return other


def _with_hidden(text: bytes) -> tuple[bytes, tuple[int, ...]]:
    """Return the bytes of `journal.jsonl` with its whole hidden frames made visible, and their offsets.

    There are two if the power failed before the first byte of a frame, and a later frame, were on disk.
    """
    offsets: list[int] = []
    offset = text.find(b"\0")  # neither records nor rows contain NUL
    while offset >= 0 and (end := _end_of_hidden(text, offset)):
        text = text[:offset] + FIRST + text[offset + 1 :]
        offsets.append(offset)
        offset = end if text[end : end + 1] == b"\0" else -1
    return text, tuple(offsets)


def _end_of_hidden(text: bytes, offset: int) -> int:
    """Return the end of the hidden frame at this offset; 0 if there is none, or only part of it."""
    end = text.find(b"\n", offset) + 1
    if not end or text[offset + 1 : offset + 2] == b"\0":
        return 0
    try:
        record = parse_line(FIRST + line_at(text, offset + 1, end - 1))
    except ValueError:
        return 0
    return (isinstance(record, Commit) and after_lines(text, end, record.rows)) or 0


def _last_line(data: bytes) -> bytes:
    """Return the last line of these bytes, without their last byte."""
    return line_at(data, data.rfind(b"\n") + 1, len(data) - 1)


def _is_placement(line: bytes) -> bool:
    """Return whether this is the whole line of a placement."""
    try:
        return isinstance(parse_line(line), Placement)
    except ValueError:
        return False


def read_checkpoint(path: Path) -> str | Problem | None:
    """Return the content of the file `checkpoint`, None if it is missing, or why it cannot be read."""
    try:
        return disk.read_document(path / CHECKPOINT).decode()
    except FileNotFoundError:
        return None
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not text"
        return Problem(CHECKPOINT, f"an unreadable file ({reason})", "the note of a commit")


# The checkpoint is written after each append to the chain, and when a writer closes the ledger, not for each commit in
# the journal. So it may lag behind by the commits in the journal, and, after a crash, by the last append to the chain.


def behind(view: "View") -> int:
    """Return how many of the newest commits the checkpoint does not cover.

    Raises: LedgerCorrupted if it is not the note of any of them, or not one that a crash leaves.
    """
    lag = covered(view)
    if isinstance(lag, Problem):
        raise LedgerCorrupted(
            f"{view.path}/{lag}; run fsar-ledger verify, and fsar-ledger maintain recover if it says so"
        )
    return lag


def covered(view: "View") -> int | Problem:
    """Return how many of the newest commits the checkpoint does not cover, or why no crash leaves such a note."""
    if isinstance(checkpoint := view.checkpoint, Problem):
        return checkpoint
    commits, origin = view.commits, view.manifest.origin
    for lag in range(len(commits) + 1):
        number = len(commits) - lag
        note = str(commits[number - 1].note(origin)) if number else None
        if checkpoint == note:
            return lag
        if number and commits[number - 1].tree_size <= view.chain.settled:
            break
    return Problem(
        CHECKPOINT,
        "no file" if checkpoint is None else f"{checkpoint!r:.400}",
        "the note of the newest commit, or of one since which a crash leaves none",
    )


def check_chain_checkpoint(view: "View") -> list[Problem]:
    """Compare the checkpoint with the notes of the newest commits, and return the problems."""
    lag = covered(view)
    number = len(view.commits) - 1 if view.commits else None
    return [msgspec.structs.replace(lag, commit=number)] if isinstance(lag, Problem) else []
