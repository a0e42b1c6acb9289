"""Make a segment of the rows of a journal, in a thread: its writer goes on with another journal meanwhile.

Nothing is written here. What is made in vain, because another writer was quicker, is dropped.
"""

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

from fsar_ledger.ledger.log import pack
from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.rows.blocks import Block, blocks_of
from fsar_ledger.ledger.store.journal import Frame, leaves_in, lines_of
from fsar_ledger.ledger.store.paths import JOURNAL
from fsar_ledger.ledger.store.tables import UnstagedSegment, made_of, table_of


class Sealed(NamedTuple):
    """The segment of some frames, its blocks, the tree after them, and what they add to the pack of the tree."""

    made: UnstagedSegment
    blocks: tuple[Block, ...]
    tree: Frontier
    nodes: bytes


def sealed(path: Path, frames: Sequence[Frame], before: Frontier) -> Sealed:
    """Make the segment of these frames of the journal of a ledger, whose tree is this one before them.

    Raises: LedgerCorrupted if their rows are no events.
    """
    table = table_of(path / JOURNAL, lines_of(frames))
    leaves = leaves_in(frames)
    return Sealed(made_of(table, leaves), tuple(blocks_of(table)), *pack.grow(before, leaves))


class Sealing:
    """What is being made in a thread: of some frames, the last of which tells which."""

    def __init__(self) -> None:
        self._threads: ThreadPoolExecutor | None = None
        self._found: Future[Sealed] | None = None
        self._last: Frame | None = None

    def begin(self, path: Path, frames: Sequence[Frame], before: Frontier) -> None:
        """Begin to make the segment of these frames."""
        if self._threads is None:
            self._threads = ThreadPoolExecutor(1, "fsar-ledger-sealing")
        self._found, self._last = self._threads.submit(sealed, path, frames, before), frames[-1]

    @property
    def is_begun(self) -> bool:
        """Return whether something is being made, or was."""
        return self._found is not None

    @property
    def is_done(self) -> bool:
        """Return whether something was made."""
        return self._found is not None and self._found.done()

    def taken(self, path: Path, frames: Sequence[Frame], before: Frontier) -> Sealed:
        """Return the segment of these frames, which is made now if that was not begun. Raises: As `sealed`."""
        ready, last = self._found, self._last
        self._found = self._last = None
        if ready is None or last is None or last.commit != frames[-1].commit or last.line != frames[-1].line:
            return sealed(path, frames, before)
        return ready.result()

    def close(self) -> None:
        """End the thread, after what it is at."""
        if self._threads is not None:
            self._threads.shutdown()
            self._threads = None
