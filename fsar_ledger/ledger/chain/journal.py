"""The journal: commits whose rows are not in a segment yet.

`journal.jsonl` holds frames, one for each commit: its record, as in the chain, and then its rows, each the canonical
bytes of an event. It continues the chain. Room for more frames is allotted ahead, as NUL bytes. A frame is written at
once and synced once, so only the last one can be torn; the root in its record shows whether it is.
"""

import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import msgspec

from fsar_ledger.ledger.chain.links import Chain
from fsar_ledger.ledger.chain.paths import CHAIN, JOURNAL
from fsar_ledger.ledger.chain.record import Commit, parse_line
from fsar_ledger.ledger.log.hashing import HASH_BYTES, leaves_of
from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.store import disk, growing
from fsar_ledger.ledger.store.problem import Problem
from fsar_ledger.ledger.store.record import sha256_hex

ALLOTTED = 1 << 20
"""Bytes by which the file grows: writing over what is there, a disk syncs only the data."""
_LARGE = 1 << 17
"""Bytes from which a frame brings no room: to write as many bytes again takes longer than to sync the file's size."""


class Frame(msgspec.Struct, frozen=True):
    """One commit in the journal: the line of its record, what it says, and its rows (canonical bytes)."""

    line: bytes
    commit: Commit
    rows: Sequence[bytes]


class Journal(msgspec.Struct):
    """What a journal holds: its frames, the tree after them, and the bytes up to the end of the last one.

    `leaves` are the packed leaf hashes of all rows. `problem` says where it contradicts the chain or itself, if not
    merely its last frame is torn. One that `is_sealed` holds nothing any more; as long as it is there, its sealing may
    not be finished.
    """

    frames: list[Frame]
    tree: Frontier
    leaves: bytearray
    end: int = 0
    torn: int = 0
    problem: Problem | None = None
    is_sealed: bool = False

    @property
    def last(self) -> int:
        """Return where the last frame begins."""
        return self.end - (size_of(self.frames[-1]) if self.frames else 0)

    @property
    def rows(self) -> int:
        """Return the number of events in it."""
        return len(self.leaves) // HASH_BYTES

    def add(self, frame: Frame, tree: Frontier, leaves: bytes, size: int) -> None:
        """Add a frame of so many bytes that was written at the end."""
        self.frames.append(frame)
        self.tree = tree
        self.leaves += leaves
        self.end += size


def size_of(frame: Frame) -> int:
    """Return the bytes that a frame takes."""
    return len(frame.line) + 1 + sum(map(len, frame.rows)) + len(frame.rows)


def read_frames(data: bytes, chain: Chain) -> Journal:
    """Read the frames in these bytes of a journal and add their commits to the chain.

    A journal all of whose frames the chain holds has been sealed, and is empty. Only the roots of the last two frames
    are compared with the rows; `verify` compares all.
    """
    text = data.rstrip(b"\0")
    if _is_sealed(text, chain):
        return Journal([], chain.tree(), bytearray(), is_sealed=True)
    lines = text.split(b"\n")
    rest = lines.pop()  # empty, unless the last line is torn
    frames: list[Frame] = []
    at = end = 0
    before = chain.tree()
    problem: Problem | None = None
    shas = [chain.sha256]
    while at < len(lines):
        commit, problem = _commit(lines[at], chain)
        if commit is None or at + commit.rows >= len(lines):
            break
        frames.append(Frame(lines[at], commit, lines[at + 1 : at + 1 + commit.rows]))
        chain.add(commit, sha256_hex(lines[at]))
        shas.append(chain.sha256)
        at += 1 + commit.rows
    leaves = [leaves_of(frame.rows) for frame in frames]
    contradicts = problem is not None and problem.field is not None  # a record that can be read, which no crash leaves
    if frames and _tree(before, leaves).root().hex() != frames[-1].commit.tree_root:
        at -= 1 + frames[-1].commit.rows
        problem = _wrong_rows(frames.pop().commit)
        leaves.pop()
        shas.pop()
        chain.forget(len(chain.commits) - 1, shas[-1])
        if frames and _tree(before, leaves).root().hex() != frames[-1].commit.tree_root:
            return Journal([], before, bytearray(), problem=_first_wrong(before, frames))
    for frame in frames:
        end += size_of(frame)
    is_damage = contradicts or (problem is not None and _has_later_frame(lines[at:], len(chain.commits)))
    return Journal(
        frames,
        _tree(before, leaves),
        bytearray().join(leaves),
        end,
        sum(map(len, lines[at:])) + len(lines[at:]) + len(rest),
        problem if is_damage else None,
    )


def _tree(before: Frontier, leaves: Sequence[bytes]) -> Frontier:
    return before.extend(b"".join(leaves))


def _is_sealed(text: bytes, chain: Chain) -> bool:
    """Return whether the chain holds the commit with which this journal begins."""
    try:
        first = parse_line(text.partition(b"\n")[0])
    except ValueError:
        return False
    return isinstance(first, Commit) and first in chain.commits[first.number : first.number + 1]


def _commit(line: bytes, chain: Chain) -> tuple[Commit | None, Problem | None]:
    number = len(chain.commits)
    try:
        record = parse_line(line)
    except ValueError as error:
        return None, Problem(JOURNAL, f"no record ({error})", "one as it is written", commit=number)
    if not isinstance(record, Commit):
        return None, Problem(JOURNAL, "a placement", "commits and their rows", number, field="kind")
    doubt = chain.doubt(record)
    if doubt is None:
        return record, None
    name, found, expected = doubt
    return None, Problem(JOURNAL, f"{found!r}", f"{expected}, as {CHAIN} and the frames before say", number, field=name)


def _first_wrong(before: Frontier, frames: Sequence[Frame]) -> Problem:
    """Return which of these frames, of which the last has a wrong root, is the first with one."""
    for frame in frames:
        before = before.extend(leaves_of(frame.rows))
        if before.root().hex() != frame.commit.tree_root:
            break
    return _wrong_rows(frame.commit)


def _wrong_rows(commit: Commit) -> Problem:
    return Problem(
        JOURNAL, "rows that lead to another root", f"{commit.tree_root} as committed", commit.number, field="tree_root"
    )


def _has_later_frame(lines: Sequence[bytes], expected: int) -> bool:
    """Return whether these lines hold the record of a commit after the expected one, so that not only it is torn.

    A record ends with its line, but may begin within it: the line feed before it may be what was damaged.
    """
    for line in lines:
        at = line.find(b'{"') if b'"kind":"commit"' in line else -1
        while at >= 0:
            try:
                record = parse_line(line[at:])
            except ValueError:
                at = line.find(b'{"', at + 1)
                continue
            if isinstance(record, Commit) and record.number > expected:
                return True
            break
    return False


class JournalFile:
    """The file of a journal, for its writer; opened when something is written. `handle` is -1 until then."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.handle = -1
        self._room = 0  # the size of the file, with what is allotted

    @property
    def is_open(self) -> bool:
        """Return whether something was written since it was opened or closed."""
        return self.handle >= 0

    def write(self, data: bytes, end: int) -> int:
        """Write these bytes where the last frame ends, sync them, once, and return how many they are.

        When that fails, the file is cut off there, if the disk allows it. Raises: OSError.
        """
        if self.handle < 0:
            is_new = not os.path.lexists(self.path)
            # What a sealed journal left, which could not be removed, goes first.
            how = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | (0 if end else os.O_TRUNC)
            self.handle = os.open(self.path, how, 0o666)
            self._room = os.fstat(self.handle).st_size
            if is_new:
                disk.sync_folder(self.path.parent)
        after = end + len(data)
        allots = after > self._room and len(data) < _LARGE
        room = b"\0" * (after // ALLOTTED * ALLOTTED + ALLOTTED - after) if allots else b""
        try:
            growing.write_at(self.handle, data + room, end)
            os.fdatasync(self.handle)
        except BaseException:
            with suppress(OSError):
                os.ftruncate(self.handle, end)
            raise
        self._room = max(self._room, after + len(room))
        return len(data)

    def trim(self, end: int) -> None:
        """Give back what is allotted beyond the last frame. Raises: OSError."""
        os.ftruncate(self.handle, end)
        os.fsync(self.handle)

    def remove(self) -> None:
        """Remove the file, whose frames are elsewhere now; if the disk refuses, the next writer does it."""
        self.close()
        with suppress(OSError):
            os.unlink(self.path)
            disk.sync_folder(self.path.parent)

    def close(self) -> None:
        """Close the file."""
        if self.handle >= 0:
            disk.close(self.handle)
            self.handle = -1
