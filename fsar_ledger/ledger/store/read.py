"""A reader's view of what is committed in a ledger.

Readers never write. `snapshot` reads the chain and the journal alongside writers; rows are read on demand.
"""

import os
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from itertools import takewhile
from pathlib import Path

import msgspec
import pyarrow as pa

from fsar_ledger.base.errors import LedgerCorrupted
from fsar_ledger.ledger.log import merkle
from fsar_ledger.ledger.log.hashing import leaves_of, sha256_hex
from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.log.note import Note
from fsar_ledger.ledger.rows import canonical, codec, segment
from fsar_ledger.ledger.rows.blocks import BLOCK_COLUMNS
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.rows.layout import check_layout
from fsar_ledger.ledger.rows.runs import gathered
from fsar_ledger.ledger.rows.schema import RELEASE, SCHEMA
from fsar_ledger.ledger.store import derived, growing
from fsar_ledger.ledger.store.derived import Extent, Index, Part, RunNames
from fsar_ledger.ledger.store.journal import Journal, leaves_in, lines_of
from fsar_ledger.ledger.store.links import Chain, Followed
from fsar_ledger.ledger.store.manifest import Manifest, parse_manifest
from fsar_ledger.ledger.store.paths import CHAIN, JOURNAL, MANIFEST, SEALING, SEGMENTS, STAGING
from fsar_ledger.ledger.store.problem import Problem
from fsar_ledger.ledger.store.record import EMPTY_HEAD, Commits, Head, Placement, parse_line, segment_of
from fsar_ledger.ledger.store.segments import Names, find_segment, read_segment
from fsar_ledger.ledger.store.snapshot import take_snapshot
from fsar_ledger.ledger.store.staging import materialized, table_of

_TRIES = 10


class View(msgspec.Struct, frozen=True, dict=True):
    """A ledger as it was when it was opened, without later commits.

    Its rows are in segments, in order; those that are still in the journal come last, as a segment outside the ledger.

    `followed` is how far the chain could be followed, `journal` what is not in a segment yet, `checkpoint` the content
    of that file, or why it cannot be read. For the `believed` segments, the chain's index hashes were compared with the
    rows.
    """

    path: Path
    manifest: Manifest
    manifest_sha256: str
    chain: Chain
    followed: Followed
    journal: Journal
    checkpoint: str | Problem | None = None
    checked: dict[int, Path] = msgspec.field(default_factory=dict)
    kept: dict[int, pa.Table] = msgspec.field(default_factory=dict)
    believed: set[int] = msgspec.field(default_factory=set)

    @property
    def record_sha256(self) -> str:
        """Return the hash of the newest line, which vouches for every byte of the ledger except the derived ones."""
        return self.chain.sha256

    @property
    def commits(self) -> Commits:
        """Return the commits, in order."""
        return self.chain.commits

    @property
    def head(self) -> Head:
        """Return the head of the ledger."""
        last = self.chain.commits[-1] if self.chain.commits else None
        return EMPTY_HEAD if last is None else Head(self.chain.count, last.tree_size, last.tree_root)

    @cached_property
    def releases(self) -> list[str]:
        """Return for each segment the release whose columns it has."""
        return [placement.release for placement in self.chain.placed] + [RELEASE] * bool(self.journal.frames)

    def first(self, number: int) -> int:
        """Return the index in the ledger of the first event of this segment."""
        placed = self.chain.placed
        return placed[number].first if number < len(placed) else self.chain.placed_size

    def end(self, number: int) -> int:
        """Return the index in the ledger after the last event of this segment."""
        placed = self.chain.placed
        return placed[number].end if number < len(placed) else self.chain.size

    def segment(self, number: int, is_laid_out: bool = False) -> Path:
        """Return this segment, after checking that it is the placed one and, unless `is_laid_out`, within the bounds.

        For the journal, or a segment compacted since, it is a file elsewhere that is removed when the process ends.
        Raises: LedgerCorrupted if it is missing, is not as placed, or exceeds the bounds.
        """
        if number not in self.checked or not self.checked[number].exists():
            placed = self.chain.placed[number : number + 1]
            self.checked[number] = (
                self.placed_segment(placed[0], is_laid_out) if placed else materialized(self.journal_table())
            )
        return self.checked[number]

    def segments(self, are_laid_out: bool = False) -> list[Path]:
        """Return all segments, in order, each checked. Raises: As `segment`."""
        return [self.segment(number, are_laid_out) for number in range(len(self.releases))]

    def placed_segment(self, placement: Placement, is_laid_out: bool = False) -> Path:
        """Return the segment of this placement, checked as by `segment`. Raises: As `segment`."""
        path, data = self._placed_segment(placement)
        if not is_laid_out:
            check_layout(path, data)
        return path

    def _placed_segment(self, placement: Placement) -> tuple[Path, bytes]:
        """Return the segment of this placement, and its bytes as placed. Raises: As `segment`."""
        names = Names(segment_of(placement), CHAIN)
        number = placement.number
        for _ in range(_TRIES):
            segment = find_segment(self.path, number, placement, names)
            if segment.status is None and (elsewhere := self._compacted(placement)) is not None:
                return elsewhere
            if segment.problem is not None:
                raise LedgerCorrupted(f"{self.path}/{segment.problem}; restore the file")
            try:
                data, problem = read_segment(self.path, segment.file, number, placement, names)
            except FileNotFoundError:  # a writer moved it into place meanwhile
                continue
            if problem is not None:
                raise LedgerCorrupted(f"{self.path}/{problem}; restore the file")
            return self.path / segment.file, data
        raise LedgerCorrupted(f"{self.path}/{names.place}: found no file to read, expected the segment; restore it")

    def _compacted(self, placement: Placement) -> tuple[Path, bytes] | None:
        """Return, as `_placed_segment`, a temporary file with the rows of a segment compacted since; None if not."""
        current = open_chain(self.path, canonical.document(self.manifest), is_damage_told=False)
        if placement in current.chain.placed or placement not in current.chain.placements:
            return None
        number = bisect_right(current.chain.placed, placement.first, key=lambda placed: placed.first) - 1
        path = materialized(current.table(number).slice(placement.first - current.first(number), placement.rows))
        return path, path.read_bytes()

    def located(self, placement: Placement) -> Path:
        """Find the segment of this placement, in place or in staging, without reading it.

        Raises: LedgerCorrupted if it is in neither place, is not a regular file, or has another size.
        """
        segment = find_segment(self.path, placement.number, placement, Names(segment_of(placement), CHAIN))
        if segment.problem is not None:
            raise LedgerCorrupted(f"{self.path}/{segment.problem}; restore the file")
        return self.path / segment.file

    # See docs/decisions/journal-status-is-never-read.md.
    def is_current(self, chain: growing.OpenFile | None = None, journal: int = -1) -> bool:
        """Return whether nothing was appended since the ledger was opened; `chain` and `journal` are the open files.

        Sealing appends to the chain, handing over trims the journal and renames it, and other writers write where it
        ends. Its size is not read: after a stat the file system must give the next change a distinct timestamp.
        """
        try:
            chain_path, path, sealing = self._growing
            if (chain.size() if chain else growing.size_of(chain_path)) != self.followed.end:
                return False
            if journal >= 0 and (following := os.pread(journal, 2, self.journal.end)):
                return not following.strip(b"\0")  # the second byte is that of a hidden frame
            has_same = os.access(sealing, os.F_OK) == self.journal.has_sealing
            return has_same and not growing.read_at(path, self.journal.end, 2).strip(b"\0")
        except OSError:
            return False

    @cached_property
    def _growing(self) -> tuple[str, ...]:
        return tuple(str(self.path / name) for name in (CHAIN, JOURNAL, SEALING))

    def grown(self, lines: Sequence[bytes], placed: int, tree: Frontier) -> "View":
        """Return the view after these lines were appended to the chain: the journal's missing ones, and more.

        They place the rows of the first `placed` frames; `tree` is that of all events.
        """
        journal, end = self.journal, self.followed.end
        for line in lines[len(journal.frames) - journal.chained :]:
            self.chain.add(parse_line(line), sha256_hex(line))
        frames = journal.frames[placed:]
        return msgspec.structs.replace(
            self,
            followed=Followed(end + sum(map(len, lines)) + len(lines), last=end),
            journal=Journal(frames, tree, 0, journal.rows, journal.end, len(frames)) if frames else Journal([], tree),
            checked={},
            kept={},
        )

    def journal_table(self) -> pa.Table:
        """Return the rows of the journal. Raises: LedgerCorrupted if they are no events."""
        return table_of(self.path / JOURNAL, lines_of(self.journal.frames))

    def tables(self, columns: list[str] | None = None) -> Iterator[pa.Table]:
        """Yield the stored rows of each segment, in order, with these columns (None: all). Raises: As `segment`."""
        for number in range(len(self.releases)):
            yield self.table(number, columns)

    def table(self, number: int, columns: list[str] | None = None) -> pa.Table:
        """Return the stored rows of this segment with these columns (None: all). Raises: As `segment`."""
        path = self.segment(number)
        try:
            return segment.read_table(path, columns)
        except LedgerCorrupted:
            if path.exists():
                raise
            return segment.read_table(self.segment(number), columns)  # it was compacted meanwhile

    def tables_from(self, first: int, columns: list[str]) -> Iterator[pa.Table]:
        """Yield these columns of the events from this index on, a table for each segment. Raises: As `segment`."""
        for number, placement in enumerate(self.chain.placed):
            if placement.end > first:
                table = self.table(number, columns)
                yield table.slice(max(0, first - placement.first)).combine_chunks()
        if self.journal.frames:
            table = self.journal_table().select(columns)
            yield table.slice(max(0, first - self.chain.placed_size)).combine_chunks()

    def rows(self, first: int, end: int) -> list[bytes]:
        """Return the canonical bytes of these events. Raises: As `segment`."""
        rows: list[bytes] = []
        placed = self.chain.placed
        while first < end:
            if first >= self.chain.placed_size:
                offset = first - self.chain.placed_size
                lines = lines_of(self.journal.frames).split(b"\n")
                return [*rows, *lines[offset : offset + end - first]]
            number = bisect_right(placed, first, key=lambda placement: placement.first) - 1
            start, stop = first - placed[number].first, min(end, placed[number].end) - placed[number].first
            rows += canonical.from_table(self._coded(number).slice(start, stop - start).cast(SCHEMA).combine_chunks())
            first = placed[number].first + stop
        return rows

    def _coded(self, number: int) -> pa.Table:
        """Return the rows of this segment, caching those of the last one. Raises: As `segment`."""
        if number not in self.kept:
            self.kept.clear()
            self.kept[number] = self._read(number)
        return self.kept[number]

    def _read(self, number: int, columns: list[str] | None = None) -> pa.Table:
        """Read the rows of this segment in force, coded, with these columns (None: all). Raises: As `segment`."""
        placement = self.chain.placed[number]
        path, data = self._placed_segment(placement)
        layout = check_layout(path, data)
        if layout.rows != placement.rows:
            raise LedgerCorrupted(f"{path}: found {layout.rows} rows, expected {placement.rows}; restore the file")
        self.checked.setdefault(number, path)
        return segment.read_coded(path, data, layout, columns)

    def event(self, index: int) -> bytes:
        """Return the canonical bytes of the event at this index. Raises: As `segment`."""
        return self.rows(index, index + 1)[0]

    def runs(self) -> Iterator[LedgerRun]:
        """Yield every run, as soon as its last event is read, with its events in their newest versions.

        Raises: LedgerCorrupted or UnknownEventTag if a segment does not hold valid events.
        """
        last: dict[str, int] = {}  # start of the last commit of each run that spans several
        for commit in self.commits:
            last.update((run, commit.tree_size - commit.rows) for run, _ in commit.continues)
        yield from gathered(self._pieces(), last)

    def _pieces(self) -> Iterator[tuple[int, list[LedgerRun]]]:
        """Yield the end of each segment, and its pieces of runs. Raises: As `runs`."""
        for number, table in enumerate(self.tables()):
            try:
                yield self.first(number) + table.num_rows, list(codec.decode(table, is_whole=False))
            except LedgerCorrupted as error:
                raise type(error)(f"{self.segment(number)}: {error}") from error

    @cached_property
    def index(self) -> Index:
        """Return the index of all events; for the journal, and where the file is wrong, it is derived from the rows.

        Raises: LedgerCorrupted if rows are needed and are not events, or differ from the chain.
        """
        lines = derived.read_index(self.path, self.chain, self.index_lines)
        if self.journal.frames:
            lines.append(derived.line_of(self.chain.placed_size, self.journal_table()))
        return Index(lines)

    def believe_index(self, placement: int | None = None) -> None:
        """Trust the chain's index lines up to this placement (None: all), as already compared with the rows."""
        placed = self.chain.placed
        most = len(self.chain.placements) if placement is None else placement
        self.believed.update(number for number in range(len(placed)) if placed[number].number <= most)

    def require_index(self, *segments: int) -> None:
        """Require that the chain's index lines for these segments in force match their rows.

        Raises: LedgerCorrupted if they do not, or as `segment`.
        """
        for number in {*segments}.intersection(range(len(self.chain.placed))) - self.believed:
            derived.require_lines(self.path, self.chain.placed_in(number), self.index_lines(number))
            self.believed.add(number)

    def index_lines(self, number: int) -> list[bytes]:
        """Return this segment's lines of the index, derived from its rows. Raises: As `segment`."""
        start = self.chain.placed[number].first
        table = self._read(number, BLOCK_COLUMNS).combine_chunks()
        added = self.chain.placed_in(number)
        return [
            derived.line_of(placement.first, table.slice(placement.first - start, placement.rows))
            for placement in added
        ]

    @cached_property
    def run_names(self) -> RunNames:
        """Return the names of the runs and plans, in the order of their first events. Raises: As `index`."""
        return self.index.run_names()

    def has_run(self, run: str) -> bool:
        """Return whether a run or a plan has this name. Raises: As `index`."""
        return any(True for _ in self.index.of_run(run))

    def ordinal_of(self, run: str) -> int:
        """Return the 1-based number of this run among all; 0 if there is none. Raises: As `index`."""
        return self.index.ordinal_of(run)

    def span_of_line(self, number: int) -> tuple[int, int]:
        """Return the first and end index in the ledger of the events of this line of the index."""
        return self.chain.span_of_line(number)

    def extents(self) -> list[Extent]:
        """Return the extent of each run and plan, in the order of their first events. Raises: As `index`."""
        return derived.extents_of(Part(*self.span_of_line(number), block) for number, block in self.index.by_line())

    def parts(self, run: str) -> list[Part]:
        """Return the parts of the run of this name. Raises: As `require_index`."""
        parts = [Part(*self.span_of_line(number), block) for number, block in self.index.of_run(run)]
        self.require_index(*self.segments_of(parts))
        return parts

    def segments_of(self, parts: Iterable[Part | Extent]) -> list[int]:
        """Return the numbers of the segments that hold these parts of runs, or whole runs, in order."""
        return sorted({number for part in parts for number in self.segments_between(part.first, part.end)})

    def segments_between(self, first: int, end: int) -> list[int]:
        """Return the numbers of the segments that hold events from `first` up to `end`, in order."""
        numbers = range(len(self.releases))
        start = bisect_right(numbers, first, key=self.end)
        return list(takewhile(lambda number: self.first(number) < end, numbers[start:]))

    def groups(self) -> list[tuple[int, ...]]:
        """Return the segments in groups of neighbours that share no run with another group."""
        return derived.groups_of(list(table.column("run_id").unique().to_pylist()) for table in self.tables(["run_id"]))

    def note(self) -> Note | None:
        """Return the note of the newest commit; None if there is none."""
        return self.chain.commits[-1].note(self.manifest.origin) if self.chain.commits else None

    def node(self, size: int) -> merkle.Node:  # noqa: ARG002  complete subtrees are those of every later tree
        """Return a function that returns the complete subtrees of the tree of this many events.

        What an interrupted append left out of the pack is hashed from its rows. The function raises LedgerCorrupted
        if more is missing. Raises: As `segment`.
        """
        tree, leaves = self.chain.tree(), leaves_in(self.journal.frames)
        if not derived.holds_nodes(self.path, tree.size):
            tree = self.chain.tree_at(self.chain.settled)
            leaves = leaves_of(self.rows(tree.size, self.chain.placed_size)) + leaves
        return derived.node_reader(self.path, tree, leaves, self.rows)

    def tree(self) -> Frontier:
        """Return the tree of all events."""
        return self.journal.tree


def open_chain(path: Path, manifest_bytes: bytes, *, is_damage_told: bool = True, has_turn: bool = False) -> View:
    """Open a ledger whose ledger.json holds these bytes.

    Args:
        path: Its folder.
        manifest_bytes: The content of its ledger.json.
        is_damage_told: Raise an error for a chain or a journal that contradicts itself; else return what precedes it.
        has_turn: The caller holds the writers' turn lock.

    Raises:
        FormatVersionMismatch: It has another format, or holds events of a later release.
        LedgerCorrupted: A line of the chain or of the journal is not canonical, or contradicts those before it; or a
            folder is a link.
    """
    for folder in (SEGMENTS, STAGING) if is_damage_told else ():
        if os.path.islink(path / folder):
            raise LedgerCorrupted(f"{path / folder}: found a link, expected a folder of the ledger; restore it")
    manifest, sha256 = parse_manifest(path / MANIFEST, manifest_bytes), sha256_hex(manifest_bytes)
    snapshot = take_snapshot(path, sha256, trusts_frontiers=is_damage_told, has_turn=has_turn)
    if is_damage_told:
        snapshot.require_whole(path)
    return View(path, manifest, sha256, *snapshot)
