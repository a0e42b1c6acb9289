"""The files of a ledger that are derived from the events that segments hold, and grow with these.

`nodes` is the pack of the tree, `index.jsonl` the index: which runs are in the ledger, and where. The index has a line
for each append that added events, whose placement holds the line's size and hash. So a reader knows without reading
rows whether a line is the one that was placed. One that is not there, or another, it derives from the rows. No
signature binds a placement: a reader compares it with the rows where no look has done so before.
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

_READ = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK


def read_node(ledger: Path, place: int) -> bytes:
    """Return the hash at this place of the pack. Raises: LedgerCorrupted if it is not there."""
    path = ledger / NODES
    try:
        handle = os.open(path, _READ)
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
    """Return whether the pack is as long as that of the tree of this many leaves."""
    try:
        return growing.size_of(ledger / NODES) >= pack.count(leaves) * HASH_BYTES
    except OSError:  # whoever reads a node says why
        return False


def node_reader(ledger: Path, tree: Frontier, others: bytes, rows: Callable[[int, int], list[bytes]]) -> merkle.Node:
    """Return a function that gives the complete subtrees of a ledger's tree, and so of each smaller one.

    `tree` is that of the events whose nodes the pack holds, `others` the packed leaves of those after them, and `rows`
    gives the canonical bytes of the events between two indexes. It raises LedgerCorrupted where the pack is too short.
    """
    start, size = pack.count(tree.size), tree.size + len(others) // HASH_BYTES
    _, more = pack.grow(tree, others)

    def read(place: int) -> bytes:
        at = (place - start) * HASH_BYTES
        return more[at : at + HASH_BYTES] if at >= 0 else read_node(ledger, place)

    @lru_cache(maxsize=4)
    def leaf_hashes(first: int, end: int) -> bytes:
        return leaves_of(rows(first, end))

    def some(first: int, end: int) -> bytes:
        block = first >> pack.BASE << pack.BASE  # read and hash a block once
        nodes = leaf_hashes(block, min(block + (1 << pack.BASE), size))
        return nodes[(first - block) * HASH_BYTES : (end - block) * HASH_BYTES]

    edge = tree.nodes()
    stored = pack.node_of(read, some)
    return lambda height, number: edge.get((height, number)) or stored(height, number)


def append_derived(ledger: Path, name: str, data: bytes, start: int) -> None:
    """Write these bytes, durably, to a derived file after the first so many, which are there.

    What is there already beyond is replaced. Of a new file the name is durable, too: a checkpoint must never be there
    without it. Raises: OSError.
    """
    is_new = not os.path.lexists(ledger / name)
    if not is_new and not stat.S_ISREG(os.lstat(ledger / name).st_mode):  # a pipe would wait for who reads it
        raise OSError(0, f"{name} is a link or something else than a file; fsar-ledger maintain recover sets it aside")
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
    """Return the bytes that each derived file has when it has all."""
    return {NODES: pack.count(chain.placed_size) * HASH_BYTES, INDEX: chain.index_bytes}


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


class IndexLine(msgspec.Struct, frozen=True):
    """The runs of the events that one append added: a block for each, in the order of their first rows.

    Rows of a block may have rows of other blocks between them. `first` is the index in the ledger of the first event.
    """

    blocks: tuple[Block, ...]
    first: Count


class _Named(msgspec.Struct, gc=False):
    """What a block says of a name alone."""

    run: str
    first: int
    is_alone: bool = False


class _NamedLine(msgspec.Struct):
    blocks: list[_Named]


_LINE, _NAMED = msgspec.json.Decoder(IndexLine), msgspec.json.Decoder(_NamedLine)

_BEGINNING, _PLAN, _GOES_ON = b'{"first":0,"first_us":', b'"is_alone":true,', b'"goes_on_from":'
"""What the blocks of runs and plans begin with where these begin, and what those of plans, and of runs that continue
others, have, too. No name has them: there each quotation mark comes after a backslash."""


def index_line(first: int, blocks: Sequence[Block]) -> bytes:
    """Return the line of the events from this index in the ledger on, with a line feed."""
    return canonical.document(IndexLine(by_run(blocks), first)) + b"\n"


def line_of(first: int, table: pa.Table) -> bytes:
    """Return the line of these rows, which begin with this index in the ledger."""
    return index_line(first, tuple(blocks_of(table)))


def line_doubt(placement: Placement, line: bytes) -> Problem | None:
    """Return that this line of the index, by the rows, is not the one that was placed; None if it is."""
    record = placement
    if (len(line), sha256_hex(line)) == (record.index_bytes, record.index_sha256):
        return None
    actual, expected = f"{record.index_sha256} of {record.index_bytes} bytes", f"{sha256_hex(line)} of {len(line)}"
    return Problem(CHAIN, actual, f"{expected}, by the rows from event {record.first}", field="index_sha256")


def read_index(ledger: Path, chain: Chain, by_rows: Callable[[int], Sequence[bytes]]) -> list[bytes]:
    """Return the lines of the index for what segments hold, each the one that was placed.

    Where the file holds another, `by_rows` gives the lines of a segment in force. Raises: As that, and `require_lines`.
    """
    lines = list(chain.index_lines(read_placed(ledger, chain)))
    for number in range(len(chain.placed)):
        places = chain.added_in(number)
        if all(lines[at] for at in places):
            continue
        rows_of_index = by_rows(number)
        require_lines(ledger, chain.placed_in(number), rows_of_index)
        for at, line in zip(places, rows_of_index, strict=True):
            lines[at] = line
    return lines


def require_lines(ledger: Path, added: Sequence[Placement], lines: Sequence[bytes]) -> None:
    """Require that these lines, by the rows, are those that were placed. Raises: LedgerCorrupted if one is not."""
    for placement, line in zip(added, lines, strict=True):
        if (problem := line_doubt(placement, line)) is not None:
            raise LedgerCorrupted(
                f"{ledger}/{problem}; which runs there are, and how far they go, is not told where the chain "
                "contradicts the rows; run fsar-ledger verify"
            )


def read_placed(ledger: Path, chain: Chain) -> bytes:
    """Return as many bytes of the file as were placed, or fewer; none if it cannot be read."""
    try:
        return growing.read_at(ledger / INDEX, 0, min(chain.index_bytes, growing.size_of(ledger / INDEX)))
    except OSError:
        return b""


def extents_of(parts: Iterable[Part]) -> list[Extent]:
    """Return where each run and plan of these parts is, in the order of their first events."""
    extents: dict[str, Extent] = {}
    for first, end, block in map(msgspec.structs.astuple, parts):
        known = extents.get(block.run)
        rows = block.rows + (known.rows if known else 0)
        extents[block.run] = Extent(block.run, rows, known.first if known else first, end)
    return list(extents.values())


class Index:
    """The lines of an index, in order."""

    def __init__(self, lines: Sequence[bytes]) -> None:
        self.lines = lines
        self._text = b"".join(lines)
        self._ends = list(accumulate(map(len, lines)))
        self._ordinals: dict[str, int] = {}  # of runs that were asked for
        self._found: dict[str, list[int]] = {}  # for each of them, the lines that name it
        self._earlier: Mapping[str, str] | Flaw | None = None

    def run_names(self) -> RunNames:
        """Return the names of the runs and plans, in the order of their first events."""
        lines = _NAMED.decode_lines(self._text)
        begins = [block for line in lines for block in line.blocks if not block.first]
        runs = tuple([block.run for block in begins if not block.is_alone])
        return RunNames(runs, tuple([block.run for block in begins if block.is_alone]))

    def ordinal_of(self, run: str) -> int:
        """Return the number of this run in `run_names`, from 1; 0 if there is none."""
        if run not in self._ordinals:
            lines = self._lines_of(run)
            self._ordinals[run] = self._ordinal(_of_run(run), lines[0]) if lines else 0
        return self._ordinals[run]

    def _ordinal(self, name: bytes, number: int) -> int:
        """Return the number of the run that this line is the first to name with these bytes; 0 if it is a plan."""
        at = self._text.find(name, self._ends[number] - len(self.lines[number]))
        first = self._text.rfind(b"{", 0, at)
        if not self._text.startswith(_BEGINNING, first) or _PLAN in self._text[first:at]:
            return 0
        return self._text.count(_BEGINNING, 0, at) - self._text.count(_PLAN, 0, at)

    def continues(self) -> dict[str, str]:
        """Return by its name each run that says that it continues another, and the name of that."""
        lines = [_LINE.decode(self.lines[number]) for number in self._lines_with(_GOES_ON)]
        blocks = [block for line in lines for block in line.blocks]
        return {one.run: one.goes_on_from[0] for one in blocks if one.goes_on_from is not None}

    def earlier(self) -> Mapping[str, str] | Flaw:
        """As `continues`, of runs that are here; or why one does not follow. Where no run says so, it costs nothing."""
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
        """Yield the number of each line that has these bytes. All are searched at once, which is quickest."""
        at = self._text.find(name)
        while at >= 0:
            number = bisect_right(self._ends, at)
            yield number
            at = self._text.find(name, self._ends[number])


def _earlier(blocks: Iterable[Block]) -> Mapping[str, str] | Flaw:
    runs = Runs()
    for block in blocks:
        if (flaw := runs.flaw(block)) is not None:
            return flaw
        runs.add(block)
    return {later: run for run, later in runs.continued.items() if run in runs.known}


def _of_run(run: str) -> bytes:
    """Return what a block of this run, and no other, has: its last member."""
    return b'"run":' + canonical.document(run)


def groups_of(segments: Iterable[Sequence[str]]) -> list[tuple[int, ...]]:
    """Return segments, each given by its runs, in groups that share no run, each of neighbours."""
    reach: dict[str, int] = {}
    ends: list[int] = []
    for number, runs in enumerate(segments):
        ends.append(number)
        for run in runs:
            ends[reach.setdefault(run, number)] = number
    groups: list[tuple[int, ...]] = []
    first = 0
    while first < len(ends):
        last = at = first
        while at <= last:
            last, at = max(last, ends[at]), at + 1
        groups.append(tuple(range(first, last + 1)))
        first = last + 1
    return groups
