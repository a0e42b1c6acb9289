"""The journal: commits whose rows are not in a segment yet.

`journal.jsonl` holds frames, one for each commit: its record, as in the chain, and then its rows, each the canonical
bytes of an event. It continues the chain. Room for more frames is preallocated as NUL bytes. A frame is hidden by a NUL
in place of its first byte until the rest has been synced, once, so readers see only what is on disk. After a crash the
last frames may be torn, or whole and still hidden; the roots in their records show which. Whole ones count.

A full journal becomes `sealing.jsonl`, and further commits go into a new one, while its rows are put into a segment.
The placement comes after the commits of the new one so far, whose records are in the chain before their rows are in a
segment.
"""

import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import msgspec

from fsar_ledger.ledger.log.hashing import leaves, sha256_hex
from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.rows.schema import is_later
from fsar_ledger.ledger.store import disk, growing
from fsar_ledger.ledger.store.links import Chain, Doubt
from fsar_ledger.ledger.store.paths import CHAIN, JOURNAL, SEALING
from fsar_ledger.ledger.store.problem import LaterRelease, Problem
from fsar_ledger.ledger.store.record import Commit, has_later_commit, line_at, parse_line

FIRST = b"{"
"""The first byte of every frame."""

# See docs/decisions/small-commits-write-into-room.md.
ALLOTTED = 1 << 20
"""Bytes by which the file grows: overwriting existing bytes, a disk syncs only the data."""
_LARGE = 1 << 17
"""Frames of this many bytes preallocate no room: writing that many zeros takes longer than syncing the file's size."""


class Frame(msgspec.Struct, frozen=True):
    """One commit in the journal: the line of its record, the record, and its rows.

    `rows` are the canonical bytes of each, followed by a line feed; `leaves` are their packed leaf hashes.
    """

    line: bytes
    commit: Commit
    rows: bytes
    leaves: bytes


class Journal(msgspec.Struct):
    """The content of a journal: its frames, and the tree after them.

    The first `sealing` frames are in `sealing.jsonl`, if it exists (`has_sealing`); `rows` and `end` (in bytes) are
    those of the others, in `journal.jsonl`. The chain has the records of the first `chained` frames.

    `problem` is a contradiction with the chain or within the journal, unless only its last frame is torn. Files that
    were `sealed` count as empty; while they exist, their sealing may not be finished. `hidden` are the offsets in
    `journal.jsonl` of frames that count and are still hidden.
    """

    frames: list[Frame]
    tree: Frontier
    sealing: int = 0
    rows: int = 0
    end: int = 0
    chained: int = 0
    has_sealing: bool = False
    torn: int = 0
    problem: Problem | None = None
    sealed: tuple[str, ...] = ()
    hidden: tuple[int, ...] = ()

    @property
    def last(self) -> int:
        """Return the offset of the last frame in `journal.jsonl`."""
        return self.end - (size_of(self.frames[-1]) if self.end else 0)

    @property
    def unsure(self) -> int:
        """Return the offset in `journal.jsonl` of the first frame that may not be on disk.

        It is the last frame; or, if one is hidden, the frame before that, whose first byte is synced with the hidden
        one.
        """
        if not self.hidden:
            return self.last
        offset = before = 0
        for frame in self.frames[self.sealing :]:
            if offset >= self.hidden[0]:
                break
            before, offset = offset, offset + size_of(frame)
        return min(before, self.last)

    def add(self, frame: Frame, tree: Frontier) -> None:
        """Add a frame that was written at the end."""
        self.frames.append(frame)
        self.tree = tree
        self.rows += frame.commit.rows
        self.end += size_of(frame)

    def hand_over(self) -> None:
        """Record that `journal.jsonl`, with all frames, became `sealing.jsonl`."""
        self.sealing, self.has_sealing = len(self.frames), True
        self.rows = self.end = 0


def size_of(frame: Frame) -> int:
    """Return the size of a frame in bytes."""
    return len(frame.line) + 1 + len(frame.rows)


def lines_of(frames: Sequence[Frame]) -> bytes:
    """Return the rows of these frames, the canonical bytes of each followed by a line feed."""
    return b"".join([frame.rows for frame in frames])


def leaves_in(frames: Sequence[Frame]) -> bytes:
    """Return the packed leaf hashes of the rows of these frames."""
    return b"".join([frame.leaves for frame in frames])


def read_frames(sealing: bytes, journal: bytes, chain: Chain, *, has_sealing: bool) -> Journal:
    """Read the frames in these bytes of the two files, and add missing commits to the chain.

    A file whose first commit is in a segment has been sealed, and counts as empty. Only the roots of the last two
    frames are compared with the rows; `verify` compares all. `has_sealing` is whether `sealing.jsonl` existed before
    either was read.
    """
    texts = {SEALING: sealing.rstrip(b"\0"), JOURNAL: journal.rstrip(b"\0")}
    sealed = tuple(name for name, text in texts.items() if _is_sealed(text, chain))
    texts |= dict.fromkeys(sealed, b"")
    if texts[SEALING] and not has_sealing:
        texts[JOURNAL] = b""  # a writer renamed it between the two reads: both may be the same file
    reading = _Reading(chain)
    reading.add(SEALING, texts[SEALING])
    if reading.is_whole():
        reading.add(JOURNAL, texts[JOURNAL])
    reading.finish()
    unsealed = reading.frames[reading.sealing :]
    return Journal(
        reading.frames,
        chain.tree().extend(leaves_in(reading.frames)),
        reading.sealing,
        sum(frame.commit.rows for frame in unsealed),
        sum(map(size_of, unsealed)),
        min(len(reading.known), len(reading.frames)),
        has_sealing,
        reading.rest,
        reading.problem if reading.is_damage else None,
        sealed,
    )


class _Reading:
    """The frames read so far, of which the first `sealing` are those of `sealing.jsonl`.

    `known` are the commits of the chain whose rows are in no segment. `rest` is the number of unreadable bytes at the
    end of the last file; `problem` is why, and `is_damage` is whether no crash could leave it.
    """

    def __init__(self, chain: Chain) -> None:
        self.known = chain.commits[chain.commits.up_to(chain.placed_size) :]
        self.frames: list[Frame] = []
        self.sealing = self.rest = 0
        self.problem: Problem | None = None
        self.is_damage = False
        self._chain, self._name = chain, SEALING
        self._text = b""  # of the last file
        self._marks = [chain.mark()]  # and one after each commit that the chain lacked

    def add(self, name: str, text: bytes) -> None:
        """Read the frames of this file."""
        self._name, self._text = name, text
        offset = 0
        while (end := text.find(b"\n", offset)) >= 0:
            line = line_at(text, offset, end)
            commit = self._commit(line)
            if commit is None or (frame_end := after_lines(text, end + 1, commit.rows)) is None:
                break
            rows = text[end + 1 : frame_end]
            self.frames.append(Frame(line, commit, rows, leaves(rows)))
            if len(self.frames) > len(self.known):
                self._chain.add(commit, sha256_hex(line))
                self._marks.append(self._chain.mark())
            offset = frame_end
        self.rest = len(text) - offset
        if name == SEALING:
            self.sealing = len(self.frames)

    def _commit(self, line: bytes) -> Commit | None:
        """Return the commit of this line; None if it is not a commit, or contradicts what precedes it."""
        chained, number = self._expected(), self._number()
        try:
            record = parse_line(line)
        except ValueError as error:
            self.problem = Problem(self._name, f"no record ({error})", "one as it is written", commit=number)
            return None
        if not isinstance(record, Commit):
            self.problem = Problem(self._name, "a placement", "commits and their rows", number, field="kind")
        elif (doubt := self._chain.doubt(record) if chained is None else _other(record, chained)) is None:
            return record
        else:
            name, found, expected = doubt
            expectation = f"{expected}, as {CHAIN} and the frames before say"
            kind = LaterRelease if name == "release" and is_later(record.release) else Problem
            self.problem = kind(self._name, f"{found!r}", expectation, number, field=name)
        self.is_damage = True  # a readable wrong record, which no crash leaves
        return None

    def _expected(self) -> Commit | None:
        """Return the next commit if the chain has it."""
        return self.known[len(self.frames)] if len(self.frames) < len(self.known) else None

    def _number(self) -> int:
        """Return the number of the next commit."""
        chained = self._expected()
        return self._chain.count if chained is None else chained.number

    def is_whole(self) -> bool:
        """Return whether all of `sealing.jsonl`, which was on disk before it got its name, could be read."""
        if self.rest:
            self.is_damage = True
            torn = Problem(self._name, "a torn frame", "whole ones, as they were", commit=self._number())
            self.problem = self.problem or torn
        return not self.rest

    def finish(self) -> None:
        """Drop the last frame if it is torn, and detect what no crash leaves."""
        if self._has_wrong_root():
            if len(self.frames) <= max(len(self.known), self.sealing):
                return self._tell_first_wrong()  # it was on disk before what followed
            last = self.frames.pop()
            self._marks.pop()
            self._chain.back(self._marks[-1])
            if self._has_wrong_root():
                return self._tell_first_wrong()
            self.problem = _wrong_rows(JOURNAL, last.commit)
            self.rest += size_of(last)
        if len(self.frames) < len(self.known) and not self.is_damage:
            commit, self.is_damage = self.known[len(self.frames)], True
            self.problem = Problem(JOURNAL, "no rows of it", "those of each commit that no segment has", commit.number)
        start = len(self._text) - self.rest
        if self.problem is not None and has_later_commit(self._text, start, self._chain.count):
            self.is_damage = True
        return None

    def _has_wrong_root(self) -> bool:
        """Return whether the rows lead to another root than that in the last frame."""
        if not self.frames:
            return False
        return self._chain.tree().extend(leaves_in(self.frames)).root().hex() != self.frames[-1].commit.tree_root

    def _tell_first_wrong(self) -> None:
        """Report the first frame with a wrong root, given that the last has one, and drop it and all later ones."""
        tree, wrong = self._chain.tree(), 0
        while tree.extend(self.frames[wrong].leaves).root().hex() == self.frames[wrong].commit.tree_root:
            tree = tree.extend(self.frames[wrong].leaves)
            wrong += 1
        self.problem = _wrong_rows(SEALING if wrong < self.sealing else JOURNAL, self.frames[wrong].commit)
        self.is_damage = True
        del self.frames[wrong:]
        self.sealing = min(self.sealing, wrong)


def after_lines(text: bytes, at: int, count: int) -> int | None:
    """Return the offset after `count` lines from `at` on; None if there are fewer."""
    for _ in range(count):
        at = text.find(b"\n", at) + 1
        if not at:
            return None
    return at


def _is_sealed(text: bytes, chain: Chain) -> bool:
    """Return whether the first commit of this journal is already in a segment."""
    try:
        first = parse_line(line_at(text, 0, text.find(b"\n")))
    except ValueError:
        return False
    if not isinstance(first, Commit) or first not in chain.commits[first.number : first.number + 1]:
        return False
    return first.tree_size <= chain.placed_size


def _other(commit: Commit, recorded: Commit) -> Doubt | None:
    """Return the first field in which this commit differs from the one in the chain."""
    fields = ((name, getattr(commit, name), getattr(recorded, name)) for name in commit.__struct_fields__)
    return next((doubt for doubt in fields if doubt[1] != doubt[2]), None)


def _wrong_rows(name: str, commit: Commit) -> Problem:
    return Problem(
        name, "rows that lead to another root", f"{commit.tree_root} as committed", commit.number, field="tree_root"
    )


class JournalFile:
    """A journal's file, for its writer; opened on the first write. `handle` is -1 until then."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.handle = -1
        self._room = 0  # the size of the file, including preallocated bytes

    @property
    def is_open(self) -> bool:
        """Return whether the file is open, as it is after a write."""
        return self.handle >= 0

    def write(self, data: bytes, end: int) -> None:
        """Write this frame at offset `end`, where the last one ends, sync it, once, and make it visible.

        If the disk refuses, the file is truncated there. Raises: OSError; Uncertain if it refuses that, too.
        """
        if self.handle < 0:
            self._open(end)
        frame_end = end + len(data)
        try:
            if frame_end > self._room and len(data) < _LARGE:
                room = frame_end // ALLOTTED * ALLOTTED + ALLOTTED
                growing.write_zeros(self.handle, self._room, room)
                self._room = room
            growing.write_at(self.handle, memoryview(data)[1:], end + 1)
            os.fdatasync(self.handle)
            growing.write_at(self.handle, FIRST, end)
        except BaseException as error:
            growing.take_back(self.handle, end, end, error)
            raise
        self._room = max(self._room, frame_end)

    def _open(self, end: int) -> None:
        """Open the file, or create it durably. Raises: OSError."""
        is_new = not os.path.lexists(self.path)
        # Remains of a sealed journal that could not be removed are truncated first.
        flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | (0 if end else os.O_TRUNC)
        self.handle = os.open(self.path, flags, 0o666)
        self._room = os.fstat(self.handle).st_size
        if is_new:
            disk.sync_folder(self.path.parent)

    def hand_over(self, end: int) -> None:
        """Rename it durably to the file being sealed; the next frame goes into a new one. Raises: OSError.

        It is trimmed first, which shows other writers that have it open that this happened.
        """
        if self.handle < 0:
            self._open(end)
        os.ftruncate(self.handle, end)
        os.fdatasync(self.handle)  # the byte that shows the last frame
        self.close()
        os.rename(self.path, self.path.with_name(SEALING))
        disk.sync_folder(self.path.parent)

    def trim(self, end: int) -> None:
        """Release the preallocated bytes beyond the last frame. Raises: OSError."""
        os.ftruncate(self.handle, end)
        os.fsync(self.handle)

    def remove(self, *, is_all: bool) -> None:
        """Remove the sealed files, including this one if `is_all`; if the disk refuses, the next writer does it."""
        with suppress(OSError):
            if is_all:
                self.close()
            for path in (self.path.with_name(SEALING), *([self.path] if is_all else [])):
                with suppress(FileNotFoundError):
                    os.unlink(path)
            disk.sync_folder(self.path.parent)

    def close(self) -> None:
        """Close the file."""
        if self.handle >= 0:
            disk.close(self.handle)
            self.handle = -1
