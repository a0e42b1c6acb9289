"""The files of a ledger that are derived from the events in its segments, and grow with them.

`nodes` is the pack of the tree, `index.jsonl` the index: which runs are in the ledger, and where. The index has a line
for each append that added events, whose placement holds the line's size and hash. So a reader can check a line against
its placement without reading rows. A missing or different line is derived from the rows. No signature binds a
placement: a reader compares it with the rows unless that was done before.
"""

import os
import stat
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import accumulate
from pathlib import Path

import msgspec
import pyarrow as pa

from fsar_ledger.base.errors import LedgerCorrupted
from fsar_ledger.ledger.log import merkle, pack
from fsar_ledger.ledger.log.hashing import HASH_BYTES, leaves_of, sha256_hex
from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.rows.blocks import Block, Runs, blocks_of, by_run
from fsar_ledger.ledger.rows.runs import Flaw
from fsar_ledger.ledger.store import disk, growing
from fsar_ledger.ledger.store.links import Chain
from fsar_ledger.ledger.store.paths import CHAIN, INDEX, NODES
from fsar_ledger.ledger.store.problem import Problem
from fsar_ledger.ledger.store.record import Count, Placement


def read_node(ledger: Path, place: int) -> bytes:
    """Return the hash at this position of the pack. Raises: LedgerCorrupted if it is missing."""
    path = ledger / NODES
    try:
        handle = disk.open_to_read(path)
        try:
            node = os.pread(handle, HASH_BYTES, place * HASH_BYTES)
        finally:
            disk.close(handle)
    except OSError as error:
        raise LedgerCorrupted(
            f"{path}: it cannot be read ({error.strerror}); run fsar-ledger maintain recover, which derives it again"
        ) from error
    if len(node) != HASH_BYTES:
        raise LedgerCorrupted(
            f"{path}: found no hash {place}, expected {HASH_BYTES} bytes there; run fsar-ledger maintain recover, "
            "which derives it again"
        )
    return node


def holds_nodes(ledger: Path, leaves: int) -> bool:
    """Return whether the pack is long enough for the tree of this many leaves."""
    try:
        return growing.size_of(ledger / NODES) >= pack.count(leaves) * HASH_BYTES
    except OSError:  # reading a node reports why
        return False


def node_reader(ledger: Path, tree: Frontier, others: bytes, rows: Callable[[int, int], list[bytes]]) -> merkle.Node:
    """Return a function that returns the complete subtrees of a ledger's tree, and so of each smaller one.

    `tree` is that of the events whose nodes the pack holds, `others` the packed leaves of those after them, and `rows`
    returns the canonical bytes of the events between two indexes. It raises LedgerCorrupted if the pack is too short.
    """
    start, size = pack.count(tree.size), tree.size + len(others) // HASH_BYTES
    _, more = pack.grow(tree, others)

    def read(place: int) -> bytes:
        offset = (place - start) * HASH_BYTES
        return more[offset : offset + HASH_BYTES] if offset >= 0 else read_node(ledger, place)

    @lru_cache(maxsize=4)
    def leaf_hashes(first: int, end: int) -> bytes:
        return leaves_of(rows(first, end))

    def cached_hashes(first: int, end: int) -> bytes:
        block = first >> pack.BASE << pack.BASE  # read and hash a block once
        nodes = leaf_hashes(block, min(block + (1 << pack.BASE), size))
        return nodes[(first - block) * HASH_BYTES : (end - block) * HASH_BYTES]

    edge = tree.nodes()
    stored = pack.node_of(read, cached_hashes)
    return lambda height, number: edge.get((height, number)) or stored(height, number)


def append_derived(ledger: Path, name: str, data: bytes, start: int) -> None:
    """Write these bytes, durably, to a derived file from byte `start` on.

    Anything beyond `start` is replaced. The name of a new file is durable, too: a checkpoint must never exist without
    it. Raises: OSError, also if the file is shorter than `start`.
    """
    is_new = not os.path.lexists(ledger / name)
    if not is_new and not stat.S_ISREG(os.lstat(ledger / name).st_mode):  # a pipe would wait for who reads it
        raise OSError(0, f"{name} is a link or not a regular file; fsar-ledger maintain recover sets it aside")
    handle = os.open(ledger / name, os.O_WRONLY | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
    try:
        size = os.fstat(handle).st_size
        if size < start:
            raise OSError(0, f"it has {size} bytes, and needs {start} before the next ones")
        growing.write_at(handle, data, start)
        os.ftruncate(handle, start + len(data))
        os.fdatasync(handle)
    finally:
        os.close(handle)
    if is_new:
        disk.sync_folder(ledger)


def derived_sizes(chain: Chain) -> dict[str, int]:
    """Return the size in bytes of each derived file when complete."""
    return {NODES: pack.count(chain.placed_size) * HASH_BYTES, INDEX: chain.index_bytes}


class Part(msgspec.Struct, frozen=True):
    """A part of a run: its events from index `first` to `end` of the ledger.

    Events of other runs may be among them. The block has neither `observes` nor `concerns`.
    """

    first: int
    end: int
    block: Block


class Extent(msgspec.Struct, frozen=True):
    """The number of events of a run or plan, and the indexes of the ledger between which they are, perhaps mixed."""

    run: str
    rows: int
    first: int
    end: int


class RunNames(msgspec.Struct, frozen=True):
    """The names of a ledger's runs, and of its plans, each in the order of their first events."""

    runs: tuple[str, ...] = ()
    plans: tuple[str, ...] = ()

    def numbers(self) -> dict[str, int]:
        """Return the 1-based number of each run, by name, except numbers that are the name of a run or a plan."""
        names = {*self.runs, *self.plans}
        return {name: number for number, name in enumerate(self.runs, start=1) if f"{number}" not in names}


class IndexLine(msgspec.Struct, frozen=True):
    """The runs of the events that one append added: a block for each, in the order of their first rows.

    Rows of a block may have rows of other blocks between them. `first` is the index in the ledger of the first event.
    """

    blocks: tuple[Block, ...]
    first: Count


class _Named(msgspec.Struct, gc=False):
    """The fields of a block that identify its run or plan."""

    run: str
    first: int
    is_alone: bool = False


class _NamedLine(msgspec.Struct):
    blocks: list[_Named]


_LINE, _NAMED = msgspec.json.Decoder(IndexLine), msgspec.json.Decoder(_NamedLine)

_BEGINNING, _PLAN, _GOES_ON = b'{"first":0,"first_us":', b'"is_alone":true,', b'"goes_on_from":'
"""The bytes with which the first block of a run or plan begins, and those found only in blocks of plans and of runs
that continue others. No name contains them: in a name, each quotation mark is escaped by a backslash."""


def index_line(first: int, blocks: Sequence[Block]) -> bytes:
    """Return the index line of the events from index `first` of the ledger on, with a line feed."""
    return canonical.document(IndexLine(by_run(blocks), first)) + b"\n"


def line_of(first: int, table: pa.Table) -> bytes:
    """Return the index line of these rows, which begin at index `first` of the ledger."""
    return index_line(first, tuple(blocks_of(table)))


def line_doubt(placement: Placement, line: bytes) -> Problem | None:
    """Return the problem if this index line, derived from the rows, is not the one that was placed; None if it is."""
    record = placement
    if (len(line), sha256_hex(line)) == (record.index_bytes, record.index_sha256):
        return None
    actual, expected = f"{record.index_sha256} of {record.index_bytes} bytes", f"{sha256_hex(line)} of {len(line)}"
    return Problem(CHAIN, actual, f"{expected}, by the rows from event {record.first}", field="index_sha256")


def read_index(ledger: Path, chain: Chain, by_rows: Callable[[int], Sequence[bytes]]) -> list[bytes]:
    """Return the index lines of the events in segments, each the one that was placed.

    If the file holds another, `by_rows` derives those of a segment in force. Raises: As `by_rows` and `require_lines`.
    """
    lines = list(chain.index_lines(read_placed(ledger, chain)))
    for number in range(len(chain.placed)):
        indexes = chain.added_in(number)
        if all(lines[index] for index in indexes):
            continue
        rows_of_index = by_rows(number)
        require_lines(ledger, chain.placed_in(number), rows_of_index)
        for index, line in zip(indexes, rows_of_index, strict=True):
            lines[index] = line
    return lines


def require_lines(ledger: Path, added: Sequence[Placement], lines: Sequence[bytes]) -> None:
    """Require that these lines, from the rows, are those that were placed. Raises: LedgerCorrupted if one is not."""
    for placement, line in zip(added, lines, strict=True):
        if (problem := line_doubt(placement, line)) is not None:
            raise LedgerCorrupted(
                f"{ledger}/{problem}; the chain contradicts the rows, so it is unknown which runs there are and how "
                "far they go; run fsar-ledger verify"
            )


def read_placed(ledger: Path, chain: Chain) -> bytes:
    """Return the placed bytes of the index file, or fewer; none if it cannot be read."""
    try:
        return growing.read_at(ledger / INDEX, 0, min(chain.index_bytes, growing.size_of(ledger / INDEX)))
    except OSError:
        return b""


def extents_of(parts: Iterable[Part]) -> list[Extent]:
    """Return the extent of each run and plan of these parts, in the order of their first events."""
    extents: dict[str, Extent] = {}
    for first, end, block in map(msgspec.structs.astuple, parts):
        extent = extents.get(block.run)
        rows = block.rows + (extent.rows if extent else 0)
        extents[block.run] = Extent(block.run, rows, extent.first if extent else first, end)
    return list(extents.values())


class Index:
    """The lines of an index, in order."""

    def __init__(self, lines: Sequence[bytes]) -> None:
        self.lines = lines
        self._text = b"".join(lines)
        self._ends = list(accumulate(map(len, lines)))
        self._ordinals: dict[str, int] = {}  # cached, by run
        self._found: dict[str, list[int]] = {}  # cached, by run: the numbers of the lines that name it
        self._earlier: Mapping[str, str] | Flaw | None = None

    def run_names(self) -> RunNames:
        """Return the names of the runs and plans, in the order of their first events."""
        lines = _NAMED.decode_lines(self._text)
        begins = [block for line in lines for block in line.blocks if not block.first]
        runs = tuple([block.run for block in begins if not block.is_alone])
        return RunNames(runs, tuple([block.run for block in begins if block.is_alone]))

    def ordinal_of(self, run: str) -> int:
        """Return the 1-based number of this run in `run_names`; 0 if it is not there."""
        if run not in self._ordinals:
            lines = self._lines_of(run)
            self._ordinals[run] = self._ordinal(_of_run(run), lines[0]) if lines else 0
        return self._ordinals[run]

    def _ordinal(self, name: bytes, number: int) -> int:
        """Return the 1-based number of the run that these bytes first name in this line; 0 if it is a plan."""
        offset = self._text.find(name, self._ends[number] - len(self.lines[number]))
        first = self._text.rfind(b"{", 0, offset)
        if not self._text.startswith(_BEGINNING, first) or _PLAN in self._text[first:offset]:
            return 0
        return self._text.count(_BEGINNING, 0, offset) - self._text.count(_PLAN, 0, offset)

    def continues(self) -> dict[str, str]:
        """Return the run that each run claims to continue, by name."""
        lines = [_LINE.decode(self.lines[number]) for number in self._lines_with(_GOES_ON)]
        blocks = [block for line in lines for block in line.blocks]
        return {block.run: block.goes_on_from[0] for block in blocks if block.goes_on_from is not None}

    def earlier(self) -> Mapping[str, str] | Flaw:
        """Return `continues` for runs that are here, or the flaw of one that does not follow; free if empty."""
        if self._earlier is None:
            self._earlier = _earlier(self.blocks()) if (continues := self.continues()) else continues
        return self._earlier

    def blocks(self) -> Iterator[Block]:
        """Yield the blocks of all lines."""
        for line in self.lines:
            yield from _LINE.decode(line).blocks

    def by_line(self) -> Iterator[tuple[int, Block]]:
        """Yield the number of each line, and each of its blocks."""
        for number, line in enumerate(self.lines):
            for block in _LINE.decode(line).blocks:
                yield number, block

    def of_run(self, run: str) -> Iterator[tuple[int, Block]]:
        """Yield the number of each line that names the run, and its block there."""
        for number in self._lines_of(run):
            yield from ((number, block) for block in _LINE.decode(self.lines[number]).blocks if block.run == run)

    def _lines_of(self, run: str) -> list[int]:
        if run not in self._found:
            self._found[run] = list(self._lines_with(_of_run(run)))
        return self._found[run]

    def _lines_with(self, name: bytes) -> Iterator[int]:
        """Yield the number of each line that contains these bytes. All are searched at once, which is fastest."""
        offset = self._text.find(name)
        while offset >= 0:
            number = bisect_right(self._ends, offset)
            yield number
            offset = self._text.find(name, self._ends[number])


def _earlier(blocks: Iterable[Block]) -> Mapping[str, str] | Flaw:
    runs = Runs()
    for block in blocks:
        if (flaw := runs.flaw(block)) is not None:
            return flaw
        runs.add(block)
    return {later: run for run, later in runs.continued.items() if run in runs.known}


def _of_run(run: str) -> bytes:
    """Return the bytes found only in blocks of this run: their last member."""
    return b'"run":' + canonical.document(run)


def groups_of(segments: Iterable[Sequence[str]]) -> list[tuple[int, ...]]:
    """Return the numbers of these segments, each a list of its runs, in groups of neighbours that share no run."""
    reach: dict[str, int] = {}
    ends: list[int] = []
    for number, runs in enumerate(segments):
        ends.append(number)
        for run in runs:
            ends[reach.setdefault(run, number)] = number
    groups: list[tuple[int, ...]] = []
    first = 0
    while first < len(ends):
        last = current = first
        while current <= last:
            last, current = max(last, ends[current]), current + 1
        groups.append(tuple(range(first, last + 1)))
        first = last + 1
    return groups
