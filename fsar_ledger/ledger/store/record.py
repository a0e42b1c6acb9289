"""The lines of a chain: commits, and the segments that hold their rows.

Each line is the RFC 8785 JSON of one struct, to the byte, and holds the SHA-256 of the line before it (the first: of
ledger.json), so the last line vouches for all. There are two kinds:

```
commit      events were added: how many, the tree with them, perhaps a signature; never superseded
placement   events FIRST to FIRST + ROWS are in this segment; a later one of the same events supersedes it
```

An end torn by a crash differs from damage: damage is followed by bytes that were on disk only after the unreadable
ones. Unreadable bytes may be anything, so each byte is scanned a few times at most.
"""

import base64
import binascii
import re
from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from typing import Annotated, TypeAlias, TypeVar, overload

import msgspec
import pyarrow as pa

from fsar_ledger.ledger.log.hashing import HASH_BYTES
from fsar_ledger.ledger.log.merkle import EMPTY_ROOT, Frontier
from fsar_ledger.ledger.log.note import ID_BYTES, SIGNATURE_BYTES, Checkpoint, Note, Signature
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.rows.bounds import MAX_ROWS, MAX_SEGMENT_BYTES
from fsar_ledger.ledger.rows.schema import MAX_INTEGER
from fsar_ledger.ledger.store.paths import segment_name

LEAST_LINE_BYTES, MAX_LINE_BYTES = 200, 1 << 20
"""A record has more bytes than the first, and fewer than the second."""
_AT_ONCE = 64  # records encoded again at a time: their lines stay in the CPU caches

Count = Annotated[int, msgspec.Meta(ge=0, le=MAX_INTEGER)]

Line = TypeVar("Line", bound=msgspec.Struct)


class Commit(
    msgspec.Struct,
    frozen=True,
    gc=False,  # it refers only to text, and a ledger may have a hundred thousand
    forbid_unknown_fields=True,
    omit_defaults=True,
    tag="commit",
    tag_field="kind",
):
    """The events that one commit added, and the tree after it.

    `release` is the first with the event types of its rows. `continues` names each run that it continues, with the seq
    of the run's first event in it. `goes_on` names each of its runs that later commits may extend; a run that is not
    named there has ended. `signature` is base64 of key id and Ed25519 signature of the checkpoint by the key whose name
    is the origin; empty if there is none.

    Units: `rows` and `tree_size` events; `tree_root` hex.
    """

    number: Count
    previous_sha256: str
    # See docs/decisions/commits-name-their-release.md.
    release: str
    rows: Annotated[int, msgspec.Meta(ge=1, le=MAX_ROWS)]
    tree_size: Count
    tree_root: str
    continues: tuple[tuple[str, Count], ...] = ()
    # See docs/decisions/commits-say-which-runs-may-continue.md.
    goes_on: tuple[str, ...] = ()
    signature: str = ""

    def checkpoint(self, origin: str) -> Checkpoint:
        """Return the tree head after this commit, under the ledger's origin."""
        return Checkpoint(origin, self.tree_size, bytes.fromhex(self.tree_root))

    def note(self, origin: str) -> Note:
        """Return the note of the tree after this commit."""
        signatures: tuple[Signature, ...] = ()
        if self.signature:
            data = base64.b64decode(self.signature)
            signatures = (Signature(origin, data[:ID_BYTES], data[ID_BYTES:]),)
        return Note(self.checkpoint(origin), signatures)


class Placement(
    msgspec.Struct,
    frozen=True,
    gc=False,
    forbid_unknown_fields=True,
    omit_defaults=True,
    tag="placement",
    tag_field="kind",
):
    """The segment that holds the `rows` events from `first` on, with the columns of `release`.

    `frontier` holds the roots of the complete subtrees of the tree that ends with these events, largest first. For a
    placement that adds events, `index_bytes` and `index_sha256` are those of their line of the index.

    Units: `rows` events, `segment_bytes` and `index_bytes` bytes; hashes in hex.
    """

    number: Count
    previous_sha256: str
    release: str
    schema_sha256: str
    segment_sha256: str
    segment_bytes: Annotated[int, msgspec.Meta(ge=1, le=MAX_SEGMENT_BYTES)]
    first: Count
    rows: Annotated[int, msgspec.Meta(ge=1, le=MAX_ROWS)]
    # See docs/decisions/placements-hold-the-frontier.md.
    frontier: tuple[str, ...]
    index_bytes: Annotated[int, msgspec.Meta(ge=0, le=MAX_SEGMENT_BYTES)] = 0
    # See docs/decisions/index-is-bound-by-hashes.md.
    index_sha256: str = ""

    @property
    def end(self) -> int:
        """Return the index in the ledger after the last of these events."""
        return self.first + self.rows

    def tree(self) -> Frontier:
        """Return the tree that ends with these events."""
        return Frontier(self.end, bytes.fromhex("".join(self.frontier)))


Record: TypeAlias = Commit | Placement

_DECODER = msgspec.json.Decoder(Record)


def line_at(text: bytes, start: int, end: int) -> bytes:
    """Return the line from offset `start` to `end` of a text (an end of -1 is that of the text).

    A line too long for a record is cut to a length that still shows this.
    """
    return text[start : min(len(text) if end < 0 else end, start + MAX_LINE_BYTES)]


def parse_line(line: bytes) -> Record:
    """Parse one line of a chain, without its line feed.

    Raises: ValueError, with the reason, if it is not the canonical JSON of a record with fields in range, or too long.
    """
    (record,) = parse_lines(line[:MAX_LINE_BYTES] + b"\n", [line])
    return record


def parse_lines(data: bytes, lines: Sequence[bytes]) -> list[Record]:
    """Parse `data`, which consists of `lines` of a chain; as `parse_line`, and three times as fast.

    Raises: ValueError if one of them is not a valid record.
    """
    if max(map(len, lines), default=0) >= MAX_LINE_BYTES:
        raise ValueError(f"a line of {MAX_LINE_BYTES} bytes or more")
    return _parsed(data)


def _parsed(data: bytes) -> list[Record]:
    """Parse these lines. Raises: ValueError, with the reason, if one is not a valid record."""
    try:
        records: list[Record] = _DECODER.decode_lines(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(f"other JSON than expected ({error})") from error
    if not _are_canonical(data, records):
        raise ValueError("JSON that is not canonical")
    hashes = _hashes_at_once(records)
    if set(map(len, hashes)) - {2 * HASH_BYTES} or not _is_hex("".join(hashes)):
        value = next(digest for digest in hashes if len(digest) != 2 * HASH_BYTES or digest.strip("0123456789abcdef"))
        raise ValueError(f"{value!r:.80}, which is no SHA-256 in lower-case hex")
    return records


def _are_canonical(data: bytes, records: Sequence[Record]) -> bool:
    """Return whether these bytes are the canonical lines of these records, encoding a few at a time."""
    offset = 0
    for first in range(0, len(records), _AT_ONCE):
        lines = canonical.documents(records[first : first + _AT_ONCE])
        if not data.startswith(lines, offset):
            return False
        offset += len(lines)
    return offset == len(data)


def _is_hex(text: str) -> bool:
    """Return whether this text consists of lower-case hex digits."""
    return text.isascii() and not text.encode().translate(None, b"0123456789abcdef")


def _hashes_at_once(records: Sequence[Record]) -> list[str]:
    """Return the fields of these records that must be hashes, in any order. Raises: ValueError, as `_hashes`."""
    commits = [record for record in records if type(record) is Commit]
    placements = [record for record in records if type(record) is Placement]
    line_hashes = [placement.index_sha256 if placement.index_bytes else "" for placement in placements]
    sizes = [(placement.first + placement.rows).bit_count() for placement in placements]
    if (
        any(record.signature for record in commits)
        or "" in line_hashes
        or sizes != [len(record.frontier) for record in placements]
    ):
        return list(chain.from_iterable(map(_hashes, records)))
    return [
        *[record.previous_sha256 for record in records],
        *[commit.tree_root for commit in commits],
        *[placement.schema_sha256 for placement in placements],
        *[placement.segment_sha256 for placement in placements],
        *chain.from_iterable([placement.frontier for placement in placements]),
        *line_hashes,
    ]


def _hashes(record: Record) -> tuple[str, ...]:
    """Return the fields of this record that must be hashes. Raises: ValueError, with the reason, if inconsistent."""
    if isinstance(record, Commit):
        if record.signature and not _is_signature(record.signature):
            raise ValueError(f"signature {record.signature!r:.80}, which is not 68 bytes in base64")
        return record.previous_sha256, record.tree_root
    if len(record.frontier) != record.end.bit_count():
        raise ValueError(f"{len(record.frontier)} hashes of a tree of {record.end} events")
    line_hash = (record.index_sha256,) if record.index_sha256 else ()
    return record.previous_sha256, record.schema_sha256, record.segment_sha256, *record.frontier, *line_hash


def _is_signature(text: str) -> bool:
    try:
        data = base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError):
        return False
    return len(data) == ID_BYTES + SIGNATURE_BYTES and base64.b64encode(data).decode() == text


def segment_of(placement: Placement) -> str:
    """Return the name within the ledger of this placement's segment, once it is in place."""
    return segment_name(placement.first, placement.end)


_OF_COMMIT, PLACEMENT, _MORE = b'"kind":"commit"', b'"kind":"placement"', re.compile(rb"[^\n]")
_BEGINNINGS = (b'{"continues":', b'{"goes_on":', b'{"kind":"commit"')
"""The possible beginnings of a commit's record: its alphabetically first member. They never occur within a record."""


# See docs/decisions/torn-ends-are-not-damage.md.
def has_later_append(data: bytes, start: int) -> bool:
    """Return whether anything follows a placement in these bytes of a chain, from `start` on."""
    return any(
        isinstance(_record(data, first, end), Placement) and _MORE.search(data, end)
        for first, end in _lines_with(PLACEMENT, data, start)
    )


def has_later_commit(text: bytes, start: int, expected: int) -> bool:
    """Return whether a line of a journal, from `start` on, ends with the record of a commit after the expected one.

    The record may begin within the line, as the line feed before it may be damaged.
    """
    for first, end in _lines_with(_OF_COMMIT, text, start):
        begins = max([text.rfind(beginning, first, end) for beginning in _BEGINNINGS])
        record = _record(text, begins, end) if begins >= 0 else None
        if isinstance(record, Commit) and record.number > expected:
            return True
    return False


def _lines_with(kind: bytes, text: bytes, start: int) -> Iterator[tuple[int, int]]:
    """Yield the start and end of each whole line that contains `kind` and may be a record."""
    offset = text.find(kind, start)
    while offset >= 0 and (end := text.find(b"\n", offset)) >= 0:
        first = text.rfind(b"\n", start, offset) + 1 or start
        if end - first > LEAST_LINE_BYTES:
            yield first, end
        start = end + 1
        offset = text.find(kind, start)


def _record(text: bytes, first: int, end: int) -> Record | None:
    try:
        return parse_line(line_at(text, first, end))
    except ValueError:
        return None


class Head(msgspec.Struct, frozen=True):
    """The end of a ledger: the number of commits and events, the Merkle root over them in hex, and the last run."""

    commits: int
    size: int
    root: str
    last_run: str | None = None

    @property
    def events(self) -> int:
        """Return the number of events that a query at this head covers."""
        return self.size


EMPTY_HEAD = Head(0, 0, EMPTY_ROOT.hex())


_PACKED = 4096
"""The number of commits packed together, and unpacked when one of them is read."""
_PACKING, _UNPACKING = msgspec.msgpack.Encoder(), msgspec.msgpack.Decoder(list[Commit])


# See docs/decisions/commits-are-packed.md.
class Commits(Sequence[Commit]):
    """A sequence of commits, the older ones packed: a live ledger has one per command, a million in a year.

    `sizes` are the tree sizes after each of them, in events.
    """

    def __init__(self) -> None:
        self.sizes = array("q")
        self._packs: list[tuple[int, bytes]] = []  # the unpacked size of each in bytes, and its packed data
        self._recent: list[Commit] = []
        self._unpacked: tuple[int, list[Commit]] = -1, []  # the number of a pack, and its commits

    def __len__(self) -> int:
        return len(self.sizes)

    @overload
    def __getitem__(self, at: int) -> Commit: ...
    @overload
    def __getitem__(self, at: slice) -> list[Commit]: ...
    def __getitem__(self, at: int | slice) -> Commit | list[Commit]:
        if isinstance(at, slice):
            return [self[number] for number in range(*at.indices(len(self)))]
        number = at + len(self) if at < 0 else at
        if not 0 <= number < len(self):
            raise IndexError(f"commit {at} of {len(self)}")
        recent = number - len(self._packs) * _PACKED
        return self._recent[recent] if recent >= 0 else self._pack(number // _PACKED)[number % _PACKED]

    def __iter__(self) -> Iterator[Commit]:
        return chain(chain.from_iterable(map(self._pack, range(len(self._packs)))), self._recent)

    def copy(self) -> "Commits":
        """Return an independent copy."""
        other = Commits()
        other.sizes, other._packs, other._recent = self.sizes[:], [*self._packs], [*self._recent]
        return other

    def up_to(self, size: int) -> int:
        """Return the number of commits that end within the first `size` events."""
        return bisect_right(self.sizes, size)

    def ending_at(self, size: int) -> Commit | None:
        """Return the commit after which the tree has `size` events; None if there is none."""
        index = bisect_left(self.sizes, size)
        return self[index] if index < len(self) and self.sizes[index] == size else None

    def within(self, first: int, end: int) -> list[Commit]:
        """Return the commits that end after index `first`, and no later than `end`."""
        return self[self.up_to(first) : self.up_to(end)]

    def extend(self, commits: Iterable[Commit]) -> None:
        """Append these commits."""
        added = list(commits)
        self._recent += added
        self.sizes.extend([commit.tree_size for commit in added])

    def cut(self, count: int) -> None:
        """Keep only the first `count` commits."""
        while count < len(self._packs) * _PACKED:
            self._recent[:0] = self._pack(len(self._packs) - 1)
            self._packs.pop()
            self._unpacked = -1, []
        del self._recent[count - len(self._packs) * _PACKED :], self.sizes[count:]

    def let_go(self, count: int) -> None:
        """Drop the first `count` commits; the others are then numbered from 0."""
        self._recent, self.sizes = self[count:], self.sizes[count:]
        self._packs, self._unpacked = [], (-1, [])

    def pack(self, count: int) -> None:
        """Pack the older ones of the first `count` commits."""
        while count - len(self._packs) * _PACKED >= 2 * _PACKED:
            data = _PACKING.encode(self._recent[:_PACKED])
            self._packs.append((len(data), pa.compress(data, codec="zstd", asbytes=True)))
            del self._recent[:_PACKED]

    def _pack(self, number: int) -> list[Commit]:
        if self._unpacked[0] != number:
            size, data = self._packs[number]
            self._unpacked = number, _UNPACKING.decode(pa.decompress(data, size, codec="zstd", asbytes=True))
        return self._unpacked[1]
