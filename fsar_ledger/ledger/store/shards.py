"""A federation of ledgers: the heads of its shards are on record in a ledger, its log, and its events are theirs.

The log is a ledger like any other. Its events are heads of shards (`ShardRecorded`) and nothing else; the newest head
of each origin holds. Whoever asks the log about events is answered from the shards at exactly these heads, as from one
ledger that holds the events of one shard after those of another, in the order in which the log first names them.

What may be wrong with a shard has a name here (`MISSING` and so on), which each message has; docs/shards.md lists them.
"""

import hashlib
import os
import re
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from itertools import accumulate, chain
from pathlib import Path

import msgspec
import pyarrow as pa

from fsar_ledger.base import printable
from fsar_ledger.base.errors import LedgerCorrupted, NotALedger
from fsar_ledger.events.fleet import ShardRecorded
from fsar_ledger.ledger.log.hashing import sha256_hex
from fsar_ledger.ledger.log.merkle import consistency_proof, is_consistent
from fsar_ledger.ledger.log.note import is_name
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store import growing
from fsar_ledger.ledger.store.derived import Index
from fsar_ledger.ledger.store.journal import lines_of
from fsar_ledger.ledger.store.paths import INDEX
from fsar_ledger.ledger.store.problem import Problem
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.record import EMPTY_HEAD, Commits, Head

MISSING, LATE, SWAPPED, OTHER_ORIGIN = "missing", "late", "swapped", "of another origin"
OTHER_HISTORY, REPLAYED, TWICE, NESTED = "of another history", "replayed", "shown twice", "a federation itself"
PREFIX = "shard-"
"""What the names of the runs begin with that hold heads of shards."""
HEAD_TYPE = str(ShardRecorded.__struct_config__.tag)
_ROOT = re.compile("[0-9a-f]{64}")
_FIRST = b'{"blocks":[{"first":0,"first_us":'
_HEAD = f'"run":"{PREFIX}'.encode()


class ShardHead(msgspec.Struct, frozen=True):
    """The head of a shard as the log has it, and the index in the log of the event that records it."""

    origin: str
    folder: str
    shard_events: int
    shard_root: str
    index: int

    def place(self, log: Path) -> Path:
        """Return where the shard of the log in this folder is."""
        return Path(os.path.normpath(log / self.folder))

    def __str__(self) -> str:
        return f"shard {printable.value(self.origin)}"


class Shard(msgspec.Struct, frozen=True):
    """A shard at its recorded head."""

    head: ShardHead
    view: View


class LogHead(Head, frozen=True):
    """The head of a log: `size` counts heads of shards, and `of_shards` the events of these."""

    of_shards: int = 0

    @property
    def events(self) -> int:
        """Return the number of events of the shards."""
        return self.of_shards


# See docs/decisions/a-federation-is-a-ledger-of-heads.md.
class Federation(View, frozen=True, dict=True):
    """A federation of ledgers, as a reader of one ledger sees it.

    Events, segments, runs and the index are those of the shards, one after the other; head, note and proofs are those
    of the log.
    """

    shards: tuple[Shard, ...] = ()

    @cached_property
    def log(self) -> View:
        """Return the log alone, as a ledger of heads."""
        return View(
            *(self.path, self.manifest, self.manifest_sha256, self.chain, self.followed, self.journal, self.checkpoint)
        )

    @cached_property
    def views(self) -> Sequence[View]:
        """Return the shards as ledgers."""
        return [shard.view for shard in self.shards]

    @property
    def head(self) -> LogHead:
        """Return how far the log goes, and how many events that is."""
        return msgspec.convert({**msgspec.structs.asdict(self.log.head), "of_shards": self._firsts[-1]}, LogHead)

    @property
    def commits(self) -> Commits:
        """Return the commits of all shards; `tree_size` counts on, each root is that of the shard."""
        found = Commits()
        for first, view in zip(self._firsts, self.views, strict=False):
            found.extend(msgspec.structs.replace(commit, tree_size=first + commit.tree_size) for commit in view.commits)
            found.pack(len(found))
        return found

    @property
    def record_sha256(self) -> str:
        """Return a hash that covers the newest line of the log and of each shard."""
        newest = [self.chain.sha256, *(view.record_sha256 for view in self.views)]
        return hashlib.sha256("\n".join(newest).encode()).hexdigest()

    @cached_property
    def releases(self) -> list[str]:
        """Return for each segment the release that has its columns."""
        return [release for view in self.views for release in view.releases]

    @cached_property
    def _firsts(self) -> list[int]:
        """Return the index of the first event of each shard, and the number of all events."""
        return [*accumulate((view.head.size for view in self.views), initial=0)]

    @cached_property
    def _segments(self) -> list[tuple[int, int]]:
        """Return for each segment the number of its shard, and its own number there."""
        return [(at, number) for at, view in enumerate(self.views) for number in range(len(view.releases))]

    @cached_property
    def _lines(self) -> list[tuple[int, int]]:
        """Return for each line of the index the number of its shard, and its own number there."""
        return [
            (at, number)
            for at, view in enumerate(self.views)
            for number in range(len(view.chain.added) + bool(view.journal.frames))
        ]

    def first(self, number: int) -> int:
        """Return the index of the first event of this segment."""
        at, own = self._segments[number]
        return self._firsts[at] + self.shards[at].view.first(own)

    def end(self, number: int) -> int:
        """Return the index after the last event of this segment."""
        at, own = self._segments[number]
        return self._firsts[at] + self.shards[at].view.end(own)

    def segment(self, number: int, is_laid_out: bool = False) -> Path:
        """Return this segment, checked. Raises: As `View.segment`."""
        at, own = self._segments[number]
        return self.shards[at].view.segment(own, is_laid_out)

    def table(self, number: int, columns: list[str] | None = None) -> pa.Table:
        """Return the stored rows of this segment with these columns (None: all). Raises: As `segment`."""
        at, own = self._segments[number]
        return self.shards[at].view.table(own, columns)

    def tables_from(self, first: int, columns: list[str]) -> Iterator[pa.Table]:
        """Yield these columns of the events from this index on, a table for each segment. Raises: As `segment`."""
        for number in range(len(self._segments)):
            if self.end(number) > first:
                yield self.table(number, columns).slice(max(0, first - self.first(number))).combine_chunks()

    def shard_of(self, index: int) -> tuple[Shard, int]:
        """Return the shard that holds the event at this index, and the event's index there."""
        at = bisect_right(self._firsts, index) - 1
        return self.shards[at], index - self._firsts[at]

    def rows(self, first: int, end: int) -> list[bytes]:
        """Return the canonical bytes of these events. Raises: As `segment`."""
        return [
            row
            for start, view in zip(self._firsts, self.views, strict=False)
            if (own := max(first - start, 0)) < (until := min(end - start, view.head.size))
            for row in view.rows(own, until)
        ]

    def runs(self) -> Iterator[LedgerRun]:
        """Yield every run of every shard. Raises: As `View.runs`."""
        return chain.from_iterable(view.runs() for view in self.views)

    @cached_property
    def index(self) -> Index:
        """Return the index of all events. Raises: As `View.index`."""
        return Index([line for view in self.views for line in view.index.lines])

    def span_of_line(self, number: int) -> tuple[int, int]:
        """Return the indexes between which the events of this line of the index are."""
        at, own = self._lines[number]
        first, end = self.shards[at].view.span_of_line(own)
        return self._firsts[at] + first, self._firsts[at] + end

    def believe_index(self, placement: int | None = None) -> None:
        """Take over where runs are as the chains of all shards say."""
        for view in self.views:
            view.believe_index(placement)

    def require_index(self, *segments: int) -> None:
        """Require that the chains say of these segments what their rows do. Raises: As `View.require_index`."""
        for at, own in {self._segments[number] for number in segments}:
            self.shards[at].view.require_index(own)


def views_of(view: View) -> Sequence[View]:
    """Return the ledgers whose events these are, one after the other: the shards of a federation, or the ledger."""
    return view.views if isinstance(view, Federation) else [view]


def log_of(view: View) -> View:
    """Return the ledger whose head this is: the log of a federation, or the ledger."""
    return view.log if isinstance(view, Federation) else view


def is_log(view: View) -> bool:
    """Return whether the first event of a ledger is the head of a shard. Raises: LedgerCorrupted as `View.event`."""
    if not view.chain.size:
        return False
    if view.chain.added:
        return names_head(_first_line(view)) and _type(view.event(0)) == HEAD_TYPE
    return _type(lines_of(view.journal.frames[:1]).partition(b"\n")[0]) == HEAD_TYPE


def names_head(line: bytes) -> bool:
    """Return whether an index that begins with this line says that its ledger begins with the head of a shard."""
    return line.startswith(_FIRST) and _HEAD in line.partition(b"}")[0]


def _first_line(view: View) -> bytes:
    """Return the first line of the index, as placed: to read all of it would take long where there are many runs."""
    placement = view.chain.added[0]
    try:
        line = growing.read_at(view.path / INDEX, 0, placement.index_bytes)
    except OSError:
        line = b""
    return line if sha256_hex(line) == placement.index_sha256 else view.index_lines(0)[0]


def _type(row: bytes) -> object:
    return msgspec.json.decode(row, type=dict[str, object])["type"]


def heads_of(view: View) -> list[ShardHead]:
    """Return all heads that a log has, in order.

    Raises: LedgerCorrupted if it holds an event of another type, or as `View.rows`.
    """
    found = []
    for index, row in enumerate(view.rows(0, view.chain.size)):
        event = msgspec.json.decode(row, type=dict[str, object])
        if (of := event["type"]) != HEAD_TYPE:
            raise LedgerCorrupted(
                f"{view.path}: found event {index} of type {printable.value(f'{of}')}, expected heads of shards alone, "
                "as in the log of a federation; record the heads in a new log"
            )
        head = msgspec.convert({**event, "index": index}, ShardHead)
        is_tree = head.shard_events >= 0 and _ROOT.fullmatch(head.shard_root) is not None
        is_placed = event["run_id"] == f"{PREFIX}{index}" and "\0" not in head.folder
        if not (is_tree and is_placed and is_name(head.origin)):
            raise LedgerCorrupted(
                f"{view.path}: found event {index}, {printable.value(f'{event}')}, expected a head with an origin, a "
                f"folder, a number of events and a root in hex, as run {PREFIX}{index}; record the heads in a new log"
            )
        found.append(head)
    return found


def newest(heads: Sequence[ShardHead]) -> list[ShardHead]:
    """Return the newest head of each origin, in the order in which the log first names them."""
    return [*{head.origin: head for head in heads}.values()]


def doubts(heads: Sequence[ShardHead]) -> list[Problem]:
    """Return where the heads of a log contradict each other: an origin only grows."""
    known: dict[str, ShardHead] = {}
    found = []
    for head in heads:
        before = known.get(head.origin)
        if before is not None and _is_older(head, before):
            was = f"{REPLAYED}: after its head of {before.shard_events:,} events one of {head.shard_events:,}"
            expected = "heads that only grow; record it again in a new log"
            found.append(Problem(str(head), was, expected))
        known[head.origin] = head
    return found


def _is_older(head: ShardHead, before: ShardHead) -> bool:
    if head.shard_events == before.shard_events:
        return head.shard_root != before.shard_root
    return head.shard_events < before.shard_events


def doubt_of(head: ShardHead, view: View, heads: Sequence[ShardHead]) -> Problem | None:
    """Return why the ledger of this view is not the recorded shard, or not all of it; None if it holds all.

    It may have grown since. `heads` are all of the log.
    """
    place, has = str(view.path), view.manifest.origin
    if is_log(view):
        return Problem(place, f"{NESTED}: the log of other ledgers", f"{head}, a ledger of runs; record those others")
    if has != head.origin:
        is_other = any(one.origin == has for one in heads)
        was = SWAPPED if is_other else OTHER_ORIGIN
        of = f"shard {printable.value(has)}" if is_other else f"origin {printable.value(has)}"
        return Problem(place, f"{was}: the ledger of {of}", f"that of {head}; put it back, or record where it is")
    at = f"{head.shard_events:,} events under root {head.shard_root}"
    size, root = view.head.size, view.head.root
    if size < head.shard_events:
        if (rewritten := doubt_of_past(head, view, [one for one in heads if one.shard_events <= size])) is not None:
            return rewritten
        earlier = [one for one in heads if one.origin == has and one.index < head.index]
        was = REPLAYED if any((size, root) == (one.shard_events, one.shard_root) for one in earlier) else LATE
        told = "as at an earlier head" if was == REPLAYED else "of which the log has more"
        return Problem(
            place, f"{was}: {size:,} events, {told}", f"{at}, as recorded; bring what is missing from where it is"
        )
    if not begins_with(view, head.shard_events, head.shard_root):
        return Problem(place, f"{OTHER_HISTORY}: {size:,} events under root {root}", f"{at}, or more after them")
    return None


def doubt_of_past(head: ShardHead, view: View, heads: Sequence[ShardHead]) -> Problem | None:
    """Return which earlier head of this shard is none that it had; None if it had all. Raises: As `begins_with`."""
    for one in heads:
        if one.origin == head.origin and not begins_with(view, one.shard_events, one.shard_root):
            was = f"{OTHER_HISTORY}: it never had the root {one.shard_root} of {one.shard_events:,} events"
            return Problem(str(view.path), was, f"heads of {head} that it had; record it in a new log")
    return None


def begins_with(view: View, size: int, root: str) -> bool:
    """Return whether the stored hashes prove that the first so many events have this root.

    Raises: LedgerCorrupted if a hash that it takes is missing.
    """
    now = view.head
    if not size:
        return root == EMPTY_HEAD.root
    if size == now.size:
        return root == now.root
    proof = consistency_proof(view.node(now.size), size, now.size)
    return is_consistent(size, bytes.fromhex(root), now.size, bytes.fromhex(now.root), proof)


def twice(views: Mapping[str, View]) -> Problem | None:
    """Return that two of these shards, by origin, hold a run of the same name; None if none do."""
    seen: dict[str, str] = {}
    for origin, view in views.items():
        names = view.run_names
        for run in (*names.runs, *names.plans):
            if (other := seen.setdefault(run, origin)) != origin:
                place = str(view.path)
                was = f"{TWICE}: run {printable.value(run)}, which shard {printable.value(other)} holds, too"
                return Problem(place, was, "runs that no other shard holds; leave one of the two out")
    return None


def unreadable(head: ShardHead, place: Path, error: Exception) -> Problem:
    """Return that there is no ledger where a shard should be, or none that can be read."""
    if isinstance(error, NotALedger):
        return Problem(str(place), f"{MISSING}: no ledger", f"{head}; put it back, or record where it is")
    return Problem(str(place), f"{error}", f"{head}, a ledger that can be read")


def told(head: ShardHead, view: View, runs: int | None, models: Sequence[str], log: Path) -> str:
    """Return a line on a shard that was verified, with so many runs (None: not counted) of these model versions."""
    size = view.head.size
    more = f"{head.shard_events:,} of them are recorded, run fsar-ledger shards {printable.word(log)} for the rest"
    grown = f"; {more}" if size > head.shard_events else ""
    of = "" if runs is None else f" of {printable.counted(runs, 'run')}"
    model = ", ".join(map(printable.value, models)) or "unknown"
    return f"{head}: consistent, {printable.counted(size, 'event')}{of}, model version {model}{grown}"


def joined(log: View, shards: Sequence[Shard]) -> Federation:
    """Return the federation of this log and these shards."""
    return Federation(
        *(log.path, log.manifest, log.manifest_sha256, log.chain, log.followed, log.journal, log.checkpoint),
        shards=tuple(shards),
    )


def record_of_head(head: ShardHead) -> LedgerRun:
    """Return the record to commit for a head: a run with one event, at time 0.

    Its name has its place in the log, so that of two writers who read the same log only one adds to it.
    """
    event = ShardRecorded(
        origin=head.origin, folder=head.folder, shard_events=head.shard_events, shard_root=head.shard_root
    )
    return LedgerRun(f"{PREFIX}{head.index}", (0,), (None,), (event,))
