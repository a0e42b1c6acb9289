"""Read what is committed in a ledger at one moment, beside writers that go on.

Readers read the chain, the checkpoint, and then the journal. If the chain grew meanwhile they follow it further, and
read the others again. A commit that is hidden is on its way to the disk, or was left by a crash; what does not fit
together was written meanwhile, or is damaged. Which of these shows whether a writer has its turn.
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
"""How much of a chain is read at once."""
MAX_JOURNAL_BYTES = 1 << 30
_PAUSE_S, _PATIENCE_S = 0.0005, 10.0
"""How long a reader waits for a writer each time, and in all."""


class Snapshot(NamedTuple):
    """The chain and how far it could be followed, the journal, and the checkpoint or why it cannot be read."""

    chain: Chain
    followed: Followed
    journal: Journal
    checkpoint: str | Problem | None

    @property
    def problem(self) -> Problem | None:
        """Return what does not fit together; None if all does."""
        return self.followed.problem or self.journal.problem

    def require_whole(self, path: Path) -> None:
        """Raise what does not fit together. Raises: FormatVersionMismatch for a later release, else LedgerCorrupted."""
        if isinstance(self.problem, LaterRelease):
            raise FormatVersionMismatch(f"{path}/{self.problem}")
        if self.problem is not None:
            raise LedgerCorrupted(f"{path}/{self.problem}; restore the file, or run fsar-ledger verify")


# See docs/decisions/commits-are-packed.md.
class Known(NamedTuple):
    """What the first bytes of a chain say, up to where they were `followed`, and their SHA-256."""

    sha256: bytes
    followed: Followed
    chain: Chain


LEAST_KNOWN, MOST_KNOWN = 1 << 12, 8
"""How many commits a chain has at least that is known to this process from before, and how many chains are."""
known: dict[tuple[Path, str], Known] = {}
"""By the folder and the hash of its ledger.json; the newest last."""


def take_snapshot(path: Path, manifest_sha256: str, *, trusts_frontiers: bool, has_turn: bool) -> Snapshot:
    """Return what is committed now, once that is certain.

    Args:
        path: The folder of the ledger.
        manifest_sha256: The hash of its ledger.json.
        trusts_frontiers: As in `Chain`.
        has_turn: The caller has the turn of a writer.
    """
    reader = _Reader(path, manifest_sha256, trusts_frontiers=trusts_frontiers)
    if has_turn:  # a writer goes on for long, and lets go of commits
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
        # What was hidden at first may have been seen already, if a crash left it; what was hidden later may not.
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
    """Looks at a ledger again and again. The part of the chain that was followed is not read again."""

    def __init__(self, path: Path, manifest_sha256: str, *, trusts_frontiers: bool) -> None:
        self.path = path
        self.is_steady = True
        """Whether the chain was the same before and after the last look."""
        self.has_hidden = False
        """Whether that saw commits that are hidden."""
        self._sha256 = manifest_sha256
        self._trusts_frontiers = trusts_frontiers
        self._begin()

    def _begin(self) -> None:
        self._chain = Chain(self._sha256, trusts_frontiers=self._trusts_frontiers)
        self._followed, self._digest = Followed(0), hashlib.sha256()
        self._newest = self._chain.mark()  # without what the journal added

    def begin_known(self) -> None:
        """Begin where this process has followed the chain to before, if the file still has the same bytes up to there.

        To read and hash them takes a tenth of the time.
        """
        one = known.get((self.path, self._sha256)) if self._trusts_frontiers else None
        if one is None:
            return
        digest = hashlib.sha256()
        for at in range(0, one.followed.end, PART_BYTES):
            count = min(PART_BYTES, one.followed.end - at)
            digest.update(growing.read_whole(self.path / CHAIN, MAX_CHAIN_BYTES, at, count))
        if digest.digest() == one.sha256:
            self._chain, self._followed, self._digest = _copied(one.chain), one.followed, digest
            self._newest = self._chain.mark()

    def keep(self) -> None:
        """Keep how far the chain was followed for the next reader in this process."""
        if not self._trusts_frontiers or self._newest.commits < LEAST_KNOWN or self._followed.problem is not None:
            return
        place, sha256 = (self.path, self._sha256), self._digest.digest()
        one = known.pop(place, None)
        if one is None or one.sha256 != sha256:
            chain = _copied(self._chain)
            chain.back(self._newest)
            one = Known(sha256, Followed(self._followed.end, last=self._followed.last), chain)
        known[place] = one
        for oldest in [*known][:-MOST_KNOWN]:
            known.pop(oldest, None)  # unless another thread was first

    def is_synced(self) -> bool:
        """Sync what is hidden to the disk, so that it stays; return whether the disk took it."""
        if self.has_hidden:
            try:
                growing.sync(self.path / CHAIN)
                growing.sync(self.path / JOURNAL)
            except OSError:
                return False
        return True

    def look(self, *, counts_hidden: bool = False) -> Snapshot:
        """Return what the ledger holds now, with or without whole commits that are hidden."""
        size = self._follow(counts_hidden=counts_hidden)
        has_sealing = os.access(self.path / SEALING, os.F_OK)  # one renamed after this is read under its new name too
        note = read_checkpoint(self.path)  # before the commits that it may be about
        newer, older = (growing.read_whole(self.path / name, MAX_JOURNAL_BYTES) for name in (JOURNAL, SEALING))
        shown, places = _with_hidden(newer)
        newer = shown if counts_hidden else newer[: places[0]] if places else newer
        journal = read_frames(older, newer, self._chain, has_sealing=has_sealing)
        journal.hidden = places if counts_hidden else ()
        self.has_hidden = self.has_hidden or bool(places)
        self.is_steady = growing.size_of(self.path / CHAIN) == size
        return Snapshot(self._chain, self._followed, journal, note)

    def _follow(self, *, counts_hidden: bool) -> int:
        """Follow what the chain has beyond what was followed; return the size of the file."""
        self._chain.back(self._newest)
        if self._followed.problem or growing.size_of(self.path / CHAIN) < self._followed.end:
            self._begin()
        size = self._follow_parts(counts_hidden=counts_hidden)
        if not self._chain.has_right_tree():  # which line is wrong?
            self._begin()
            self._chain = Chain(self._sha256)
            size = self._follow_parts(counts_hidden=False)
        self._newest = self._chain.mark()
        return size

    def _follow_parts(self, *, counts_hidden: bool) -> int:
        """Follow the file from there on, some bytes at a time; return its size.

        Within the file, what follows the last whole append of a part is read again with the next one.
        """
        count = PART_BYTES
        while True:
            start = self._followed.end
            data = growing.read_whole(self.path / CHAIN, MAX_CHAIN_BYTES, start, count)
            is_last = len(data) < count
            self.has_hidden = is_last and data.endswith(b"}\0") and _is_placement(_last_line(data))
            is_hidden = self.has_hidden and counts_hidden
            shown = data[:-1] + b"\n" if is_hidden else data
            followed = follow(shown, self._chain)
            self._digest.update(shown[: followed.end])
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
    """Return a chain that says the same, and changes apart from this one."""
    other = copy(chain)
    other.commits = chain.commits.copy()
    other.placements, other.placed, other.added = [*chain.placements], [*chain.placed], [*chain.added]
    return other


def _with_hidden(text: bytes) -> tuple[bytes, tuple[int, ...]]:
    """Return the bytes of `journal.jsonl` with its whole hidden frames shown, and where each of these begins.

    There are two if the power failed before the first byte of a frame, and a later frame, were on disk.
    """
    places: list[int] = []
    at = text.find(b"\0")  # neither records nor rows have any
    while at >= 0 and (end := _end_of_hidden(text, at)):
        text = text[:at] + FIRST + text[at + 1 :]
        places.append(at)
        at = end if text[end : end + 1] == b"\0" else -1
    return text, tuple(places)


def _end_of_hidden(text: bytes, at: int) -> int:
    """Return where the hidden frame that begins there ends; 0 if there is none, or not all of it."""
    end = text.find(b"\n", at) + 1
    if not end or text[at + 1 : at + 2] == b"\0":
        return 0
    try:
        record = parse_line(FIRST + line_at(text, at + 1, end - 1))
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
    """Return what the file `checkpoint` holds, None if there is none, or why it cannot be read."""
    try:
        return disk.read_document(path / CHECKPOINT).decode()
    except FileNotFoundError:
        return None
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not text"
        return Problem(CHECKPOINT, f"an unreadable file ({reason})", "the note of a commit")


# The checkpoint is written after each append to the chain, and when a writer closes the ledger, not for each commit in
# the journal. So it may be behind by the commits that the journal holds, and, after a crash, by the last append to the
# chain.


def behind(view: "View") -> int:
    """Return how many of the newest commits the checkpoint does not cover.

    Raises: LedgerCorrupted if it is the note of none of them, or of none that a crash leaves.
    """
    back = covered(view)
    if isinstance(back, Problem):
        raise LedgerCorrupted(
            f"{view.path}/{back}; run fsar-ledger verify, and fsar-ledger maintain recover if it says so"
        )
    return back


def covered(view: "View") -> int | Problem:
    """Return how many of the newest commits the checkpoint does not cover, or why it is no note that a crash leaves."""
    if isinstance(kept := view.checkpoint, Problem):
        return kept
    commits, origin = view.commits, view.manifest.origin
    for back in range(len(commits) + 1):
        number = len(commits) - back
        note = str(commits[number - 1].note(origin)) if number else None
        if kept == note:
            return back
        if number and commits[number - 1].tree_size <= view.chain.settled:
            break
    return Problem(
        CHECKPOINT,
        "no file" if kept is None else f"{kept!r:.400}",
        "the note of the newest commit, or of one since which a crash leaves none",
    )


def check_chain_checkpoint(view: "View") -> list[Problem]:
    """Compare the file with the notes of the newest commits. Returns the problems."""
    back = covered(view)
    number = len(view.commits) - 1 if view.commits else None
    return [msgspec.structs.replace(back, commit=number)] if isinstance(back, Problem) else []
