"""What every reader of a ledger sees, whatever its format."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Protocol

import msgspec
import pyarrow as pa

from fsar_ledger.ledger.log import merkle
from fsar_ledger.ledger.log.note import Note
from fsar_ledger.ledger.rows.blocks import Block
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.record import Manifest


class Head(msgspec.Struct, frozen=True):
    """How far a ledger goes: commits, events, the Merkle root over them in hex, and the last run."""

    commits: int
    size: int
    root: str
    last_run: str | None = None


EMPTY_HEAD = Head(0, 0, merkle.EMPTY_ROOT.hex())


class Part(msgspec.Struct, frozen=True):
    """A part of a run: those of the events from index `first` to `end` of the ledger that are its own.

    Events of other runs may be among them. The block has neither `observes` nor `concerns`.
    """

    first: int
    end: int
    block: Block


class Extent(msgspec.Struct, frozen=True):
    """How many events a run or plan has, and between which indexes of the ledger they are, perhaps among others."""

    run: str
    rows: int
    first: int
    end: int


class RunNames(msgspec.Struct, frozen=True):
    """The names of a ledger's runs, and of its plans, each in the order of their first events."""

    runs: tuple[str, ...] = ()
    plans: tuple[str, ...] = ()

    def numbers(self) -> dict[str, int]:
        """Return the number that names each run, from 1; none that is itself the name of a run or a plan."""
        names = {*self.runs, *self.plans}
        return {name: number for number, name in enumerate(self.runs, start=1) if f"{number}" not in names}


class Committed(Protocol):
    """What a commit says in every format: the events of the ledger after it, and how many it added."""

    @property
    def tree_size(self) -> int:
        """Return the number of events up to the end of this commit."""

    @property
    def rows(self) -> int:
        """Return the number of events that it added."""


class View(Protocol):
    """A ledger as it was when it was opened; later commits do not show.

    Its rows are in segments, in order. In format 1 each commit has one; in format 2 a segment holds some commits, and
    the rows that are still in the journal come last, as a segment outside the ledger.
    """

    @property
    def path(self) -> Path:
        """Return its folder."""

    @property
    def manifest(self) -> Manifest:
        """Return what ledger.json says."""

    @property
    def manifest_sha256(self) -> str:
        """Return the hash of ledger.json."""

    @property
    def record_sha256(self) -> str:
        """Return the hash of the newest record, which vouches for every byte but the derived ones."""

    @property
    def head(self) -> Head:
        """Return how far the ledger goes."""

    @property
    def commits(self) -> Sequence[Committed]:
        """Return what each commit says, in order."""

    @property
    def releases(self) -> list[str]:
        """Return for each segment the release that has its columns."""

    def first(self, number: int) -> int:
        """Return the index in the ledger of the first event of this segment."""

    def end(self, number: int) -> int:
        """Return the index in the ledger after the last event of this segment."""

    def segment(self, number: int) -> Path:
        """Return this segment, counted from 0, after checking that it is as committed. Raises: LedgerCorrupted."""

    def segments(self) -> list[Path]:
        """Return all segments, each checked. Raises: LedgerCorrupted."""

    def tables(self, columns: list[str] | None = None) -> Iterator[pa.Table]:
        """Yield the stored rows of each segment with these columns (None: all). Raises: LedgerCorrupted."""

    def tables_from(self, first: int, columns: list[str]) -> Iterator[pa.Table]:
        """Yield these columns of the events from this index on, a table for each segment. Raises: LedgerCorrupted."""

    def event(self, index: int) -> bytes:
        """Return the canonical bytes of the event at this index. Raises: LedgerCorrupted."""

    def runs(self) -> Iterator[LedgerRun]:
        """Yield every run, in the order of their first events. Raises: LedgerCorrupted, UnknownEventTag."""

    @property
    def run_names(self) -> RunNames:
        """Return the names of the runs and plans, read once. Raises: LedgerCorrupted."""

    def has_run(self, run: str) -> bool:
        """Return whether a run or a plan has this name. Raises: LedgerCorrupted."""

    def ordinal_of(self, run: str) -> int:
        """Return the number of this run in `run_names.runs`, from 1; 0 if there is none. Raises: LedgerCorrupted."""

    def extents(self) -> list[Extent]:
        """Return where each run and plan is, in the order of their first events. Raises: LedgerCorrupted."""

    def parts(self, run: str) -> list[Part]:
        """Return where the run of this name is, in order; empty if there is none. Raises: LedgerCorrupted."""

    def groups(self) -> list[tuple[int, ...]]:
        """Return the segments in groups that share no run, each of neighbours. Raises: LedgerCorrupted."""

    def note(self) -> Note | None:
        """Return the note of the newest commit; None if there is none."""

    def published(self, index: int = 0) -> Note | None:
        """Return the newest note whose tree has this event, and the hashes for proofs.

        Raises: LedgerCorrupted if the file `checkpoint` cannot be read.
        """

    def node(self, size: int) -> merkle.Node:
        """Return a function that gives the complete subtrees of the tree of this many events."""
