"""Follow a chain line by line: what it records, and where it contradicts itself. No segment is read.

`chain.jsonl` only grows, by whole appends, and each append ends with a placement: commits and the segment that holds
their rows. So what follows the last placement is an interrupted append, torn at any byte, and nothing of it was
acknowledged. More after a later placement is damage; so is a readable line that contradicts those before it, since no
crash leaves one.
"""

from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from itertools import accumulate, pairwise
from operator import lt, sub
from typing import NamedTuple

import msgspec

from fsar_ledger.base.memory import without_collection
from fsar_ledger.ledger.log.hashing import digests, sha256_hex
from fsar_ledger.ledger.log.merkle import EMPTY_ROOT, Frontier
from fsar_ledger.ledger.rows.schema import FINGERPRINTS, RELEASE, is_later
from fsar_ledger.ledger.store.paths import CHAIN, MANIFEST
from fsar_ledger.ledger.store.problem import LaterRelease, Problem
from fsar_ledger.ledger.store.record import (
    LEAST_LINE_BYTES,
    PLACEMENT,
    Commit,
    Commits,
    Placement,
    Record,
    has_later_append,
    parse_line,
    parse_lines,
)
from fsar_ledger.ledger.store.staging import Staged

_MANY_BYTES, _FEW_BYTES = 1 << 20, 1 << 14
"""Bytes parsed at once: the usual number, and that for lines too short to be records."""

Doubt = tuple[str, object, object]
"""A field, the value found in it, and the expected one."""


class Mark(NamedTuple):
    """A chain's number of commits, the hash of its newest line, and the runs that later commits may extend."""

    commits: int
    sha256: str
    going_on: frozenset[str]


class Chain:
    """The state of a chain after the lines read so far.

    `placed` are the placements in force, which hold all events from 0 on without a gap; `added` are those that added
    events, in force or not, each with a line of the index, which has `index_bytes`. Segments hold the first
    `placed_size` events. `sha256` is the hash of the newest
    line; `going_on` are the runs that later commits may extend. The last append began when segments held the first
    `settled` events, and so when everything derived from these was on disk.

    There are `count` commits. `commits` are all of them, or the newest ones once `let_go` has dropped the others.

    Each frontier is compared with the root of its commit, unless it `trusts_frontiers`; then `has_right_tree` checks
    the last one, on which everything later builds.
    """

    def __init__(self, manifest_sha256: str, *, trusts_frontiers: bool = False) -> None:
        self.sha256 = manifest_sha256
        self._trusts_frontiers = trusts_frontiers
        self.commits = Commits()
        self.count = 0
        self.placements: list[Placement] = []
        self.placed: list[Placement] = []
        self.added: list[Placement] = []
        self.placed_size = 0
        self.index_bytes = 0
        self.settled = 0
        self.going_on: frozenset[str] = frozenset()

    @property
    def size(self) -> int:
        """Return the number of events."""
        return self.commits.sizes[-1] if self.commits else 0

    def tree(self) -> Frontier:
        """Return the tree of the events that segments hold."""
        return self.placed[-1].tree() if self.placed else Frontier()

    def has_right_tree(self) -> bool:
        """Return whether the tree of the events that segments hold has the root that was committed."""
        return self.tree().root() == self.root_at(self.placed_size)

    def tree_at(self, end: int) -> Frontier:
        """Return the tree of the events up to `end`, where a segment in force ends; the empty tree for 0."""
        return next((placement.tree() for placement in self.placed if placement.end == end), Frontier())

    def added_in(self, number: int) -> range:
        """Return the indexes in `added` of the placements in this segment in force; none is in two."""
        placement = self.placed[number]
        return range(
            bisect_left(self.added, placement.first, key=lambda each: each.first),
            bisect_left(self.added, placement.end, key=lambda each: each.first),
        )

    def placed_in(self, number: int) -> list[Placement]:
        """Return the placements in `added` that are in this segment in force."""
        return [self.added[index] for index in self.added_in(number)]

    def span_of_line(self, number: int) -> tuple[int, int]:
        """Return the first and end index in the ledger of the events of this line of the index.

        The line after those of the segments is that of the journal.
        """
        if number == len(self.added):
            return self.placed_size, self.size
        return self.added[number].first, self.added[number].end

    def index_lines(self, data: bytes) -> Iterator[bytes]:
        """Yield from `data` the index line of each placement that added events; b"" where the hash differs."""
        ends = list(accumulate([placement.index_bytes for placement in self.added], initial=0))
        lines = [data[start:end] for start, end in pairwise(ends)]
        for line, sha256, placement in zip(lines, digests(lines), self.added, strict=True):
            yield line if sha256 == placement.index_sha256 else b""

    def let_go(self) -> None:
        """Drop the commits whose rows are in segments, except the last of them: appending needs no other."""
        self.commits.let_go(bisect_left(self.commits.sizes, self.placed_size))

    def mark(self) -> Mark:
        """Return a mark of the chain's current end, for `back`."""
        return Mark(self.count, self.sha256, self.going_on)

    def back(self, mark: Mark) -> None:
        """Drop the commits since the mark; none of them was placed, or dropped by `let_go`."""
        self.commits.cut(len(self.commits) - self.count + mark.commits)
        self.count, self.sha256, self.going_on = mark

    def add(self, record: Record, sha256: str) -> None:
        """Add the record of a line with this SHA-256, for which `doubt` found nothing."""
        self.sha256 = sha256
        if isinstance(record, Commit):
            self.commits.extend((record,))
            self.count += 1
            self._go_on(record)
            return
        self.placements.append(record)
        self.settled = self.placed_size
        if record.first == self.settled:
            self.placed.append(record)
            self.added.append(record)
            self.index_bytes += record.index_bytes
        else:
            start = bisect_left(self.placed, record.first, key=lambda placement: placement.first)
            end = bisect_left(self.placed, record.end, key=lambda placement: placement.first)
            self.placed[start:end] = [record]
        self.placed_size = self.placed[-1].end

    def adds(self, records: Sequence[Record], hashes: Sequence[str]) -> bool:
        """Add the records of lines with these SHA-256 if each is a commit, or a placement that adds events.

        This takes a third of the time of single adds. Returns False, with nothing added, if any record may be wrong.
        """
        commits = [record for record in records if type(record) is Commit]
        placements = [record for record in records if type(record) is Placement]
        ends = [commit.tree_size for commit in commits]
        if not (
            self._trusts_frontiers
            and [record.previous_sha256 for record in records] == [self.sha256, *hashes][:-1]
            and FINGERPRINTS.keys() >= {commit.release for commit in commits}
            and FINGERPRINTS.items() >= {(placement.release, placement.schema_sha256) for placement in placements}
            and [commit.number for commit in commits] == list(range(self.count, self.count + len(commits)))
            and [placement.number for placement in placements]
            == [len(self.placements) + index for index in range(len(placements))]
            and [placement.first for placement in placements]
            == [self.placed_size, *[placement.end for placement in placements]][:-1]
            and [commit.rows for commit in commits] == [*map(sub, ends, [self.size, *ends])]
            and all(placement.index_bytes and placement.index_sha256 for placement in placements)
            and (not placements or records[-1] is placements[-1])  # otherwise no mark could be taken after it
            and self._are_committed(records, placements, ends)
        ):
            return False
        going_on_before = self.going_on
        for commit in commits:
            if len(commit.goes_on) == len(commit.continues) == 1 and commit.goes_on[0] in self.going_on:
                (run, first), (goes_on,) = commit.continues[0], commit.goes_on
                if run == goes_on and first:
                    continue  # the usual case of a live run
            if self._of_runs(commit) is not None:
                self.going_on = going_on_before
                return False
            self._go_on(commit)
        if placements:
            self.settled, self.placed_size = placements[-1].first, placements[-1].end
        self.sha256 = [self.sha256, *hashes][-1]
        self.commits.extend(commits)
        self.count += len(commits)
        self.placements += placements
        self.placed += placements
        self.added += placements
        self.index_bytes += sum(placement.index_bytes for placement in placements)
        return True

    def _are_committed(self, records: Sequence[Record], placements: Sequence[Placement], ends: Sequence[int]) -> bool:
        """Return whether each of these placements ends where an earlier commit does.

        `ends` are the tree sizes of the commits among the records.
        """
        indexes = {size: index for index, size in enumerate(ends)}
        numbers = [number for number, record in enumerate(records) if type(record) is Placement]
        return all(
            indexes[placement.end] < number - earlier
            if placement.end in indexes
            else self.commits.ending_at(placement.end) is not None
            for earlier, (number, placement) in enumerate(zip(numbers, placements, strict=True))
        )

    def _go_on(self, commit: Commit) -> None:
        if not commit.continues and not commit.goes_on:
            return
        if len(commit.continues) == len(commit.goes_on) == 1 and commit.continues[0][0] == commit.goes_on[0]:
            return  # the usual case: one live run stays live
        ended = {run for run, _ in commit.continues}.difference(commit.goes_on)
        if ended or not self.going_on.issuperset(commit.goes_on):
            self.going_on = self.going_on - ended | frozenset(commit.goes_on)

    def placement(
        self, staged: Staged, first: int, tree: Frontier, previous_sha256: str, line: bytes = b""
    ) -> Placement:
        """Return the next placement: of rows from `first` to the end of this tree, with this line of the index."""
        return Placement(
            len(self.placements),
            previous_sha256,
            staged.release,
            staged.schema_sha256,
            staged.segment_sha256,
            staged.segment_bytes,
            first,
            staged.rows,
            tuple(subtree.hex() for subtree in tree.subtrees),
            len(line),
            sha256_hex(line) if line else "",
        )

    def doubt(self, record: Record) -> Doubt | None:
        """Return the first field that contradicts the record itself, earlier lines, or this version's releases."""
        if record.release not in FINGERPRINTS:
            later = is_later(record.release)
            expected = (
                f"at most {RELEASE}; read it with fsar-ledger {record.release} or later"
                if later
                else f"one of {', '.join(sorted(FINGERPRINTS))}"
            )
            return "release", record.release, expected
        if record.previous_sha256 != self.sha256:
            predecessor = "the line before" if self.commits else MANIFEST
            return "previous_sha256", record.previous_sha256, f"{self.sha256}, the SHA-256 of {predecessor}"
        return self._of_commit(record) if isinstance(record, Commit) else self._of_placement(record)

    def _of_commit(self, commit: Commit) -> Doubt | None:
        if commit.number != self.count:
            return "number", commit.number, self.count
        if (rows := commit.tree_size - self.size) != commit.rows:
            return "rows", commit.rows, rows
        return self._of_runs(commit)

    def _of_runs(self, commit: Commit) -> Doubt | None:
        if not commit.continues and not commit.goes_on:
            return None
        runs = [run for run, _ in commit.continues]
        if not _is_sorted(runs) or not all(first for _, first in commit.continues):
            return "continues", f"{commit.continues!r:.200}", "each run once, sorted, each from a seq after 0"
        if ended := [run for run in runs if run not in self.going_on]:
            return "continues", f"{ended[0]!r:.200}", "runs that an earlier commit says go on"
        if not _is_sorted(commit.goes_on):
            return "goes_on", f"{commit.goes_on!r:.200}", "each run once, sorted"
        return None

    def _of_placement(self, placement: Placement) -> Doubt | None:
        if placement.number != len(self.placements):
            return "number", placement.number, len(self.placements)
        if (fingerprint := FINGERPRINTS.get(placement.release)) not in (None, placement.schema_sha256):
            return "schema_sha256", placement.schema_sha256, fingerprint
        is_added, end = placement.first == self.placed_size, placement.end
        if not is_added and not self._starts(placement.first):
            return "first", placement.first, f"{self.placed_size}, or the first event of a segment"
        root = self.root_at(end)
        if root is None or (end < self.placed_size and not self._starts(end)):
            return "rows", placement.rows, "events up to the end of a commit, and of the segments that it supersedes"
        if not self._trusts_frontiers and (placed_root := placement.tree().root()) != root:
            return "frontier", placed_root.hex(), f"one of root {root.hex()}, as committed"
        for name in ("index_bytes", "index_sha256"):
            if is_added != bool(value := getattr(placement, name)):
                expected = "that of the events' line of the index" if is_added else "none, as no events are added"
                return name, value, expected
        return None

    def _starts(self, index: int) -> bool:
        """Return whether a segment in force begins with this event."""
        position = bisect_left(self.placed, index, key=lambda placement: placement.first)
        return position < len(self.placed) and self.placed[position].first == index

    def root_at(self, size: int) -> bytes | None:
        """Return the committed root of this many events; None if no commit ends there."""
        if not size:
            return EMPTY_ROOT
        commit = self.commits.ending_at(size)
        return None if commit is None else bytes.fromhex(commit.tree_root)


def _is_sorted(names: Sequence[str]) -> bool:
    """Return whether these names are sorted and distinct."""
    return len(names) < 2 or all(map(lt, names, names[1:]))


class Followed(msgspec.Struct, frozen=True):
    """How far the bytes of a chain were followed: the end of the last whole append, and why no further.

    The last append begins at `last`. `problem` is None where the bytes end, or where an append was interrupted; then
    `torn` is the number of its bytes. The last append `is_hidden` if only its last line feed is missing; it counts.
    """

    end: int
    torn: int = 0
    problem: Problem | None = None
    last: int = 0
    is_hidden: bool = False


def follow(data: bytes, chain: Chain) -> Followed:
    """Add the lines in these bytes to the chain, up to the last whole append."""
    offset = last = end = 0
    mark = chain.mark()
    problem: Problem | None = None
    for lines in _parts(data):
        hashes = digests(lines)
        with without_collection():
            parsed = _parsed(data[offset : offset + sum(map(len, lines)) + len(lines)], lines)
            are_added = isinstance(parsed, list) and chain.adds(parsed, hashes)
        for line, record, line_sha256 in zip(lines, parsed, hashes, strict=True):
            if not are_added and (problem := _add(record, line_sha256, chain)) is not None:
                break
            offset += len(line) + 1
            if isinstance(record, Placement):
                last, end, mark = end, offset, chain.mark()
        chain.commits.pack(chain.commits.up_to(chain.placed_size))
        if problem is not None:
            break
    else:
        if offset < len(data):
            problem = Problem(CHAIN, "a line without end", "whole lines", commit=chain.count)
    chain.back(mark)
    if problem is not None and (problem.field is not None or has_later_append(data, offset)):
        return Followed(end, problem=problem, last=last)
    return Followed(end, len(data) - end, last=last)


def _parts(data: bytes) -> Iterator[list[bytes]]:
    """Yield the lines of a chain in batches, each ending with a placement if it has one.

    Batches are smaller if the lines are too short to be records.
    """
    end = data.rfind(b"\n") + 1
    at_once = _MANY_BYTES if data.count(b"\n") * LEAST_LINE_BYTES <= end else _FEW_BYTES
    offset = 0
    if not end:
        yield []
    while offset < end:
        placed = data.rfind(PLACEMENT, offset, offset + at_once)
        batch_end = data.rfind(b"\n", offset, offset + at_once) if placed < 0 else data.find(b"\n", placed)
        batch_end = (batch_end if batch_end >= offset else data.find(b"\n", offset)) + 1
        yield data[offset:batch_end].split(b"\n")[:-1]
        offset = batch_end


def _add(record: Record | ValueError, sha256: str, chain: Chain) -> Problem | None:
    """Add the record of the next line, which has this SHA-256, or return the problem with it."""
    number = chain.count
    if isinstance(record, ValueError):
        return Problem(CHAIN, f"no record ({record})", "one as it is written", commit=number)
    if (doubt := chain.doubt(record)) is None:
        chain.add(record, sha256)
        return None
    name, found, expected = doubt
    kind = LaterRelease if name == "release" and is_later(record.release) else Problem
    return kind(CHAIN, f"{found!r}", f"{expected}", commit=number, field=name)


def _parsed(data: bytes, lines: Sequence[bytes]) -> Iterable[Record | ValueError]:
    """Parse these lines, together if all are records, else one by one to find the first that is not, and why."""
    try:
        return parse_lines(data, lines)
    except ValueError:
        return map(_parsed_line, lines)


def _parsed_line(line: bytes) -> Record | ValueError:
    try:
        return parse_line(line)
    except ValueError as error:
        return ValueError(str(error))  # its traceback would hold the line in memory
