"""A federation of ledgers: the heads of its shards are recorded in a ledger, its log, and its events are the shards'.

The log is a ledger like any other. Its events are heads of shards (`ShardRecorded`) and nothing else; the newest head
of each origin is in force. Queries on the log read the shards at exactly these heads, as one ledger that holds the
events of one shard after those of another, in the order in which the log first names them.

Each fault of a shard has a name here (`MISSING` and so on), used in its message; docs/shards.md lists them.
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
"""The prefix of the names of runs that hold heads of shards."""
HEAD_TYPE = str(ShardRecorded.__struct_config__.tag)
_ROOT = re.compile("[0-9a-f]{64}")
_FIRST = b'{"blocks":[{"first":0,"first_us":'
_HEAD = f'"run":"{PREFIX}'.encode()


class ShardHead(msgspec.Struct, frozen=True):
    """The head of a shard as recorded in the log, and the index in the log of the event that records it."""

    origin: str
    folder: str
    shard_events: int
    shard_root: str
    index: int

    def place(self, log: Path) -> Path:
        """Return the folder of this shard, given that of its log."""
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
    """A federation of ledgers, read as one ledger.

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
        """Return the head of the log, with the number of events of the shards."""
        return msgspec.convert({**msgspec.structs.asdict(self.log.head), "of_shards": self._firsts[-1]}, LogHead)

    @property
    def commits(self) -> Commits:
        """Return the commits of all shards; `tree_size` is cumulative, each root is that of the shard."""
        joined = Commits()
        for first, view in zip(self._firsts, self.views, strict=False):
            joined.extend(msgspec.structs.replace(each, tree_size=first + each.tree_size) for each in view.commits)
            joined.pack(len(joined))
        return joined

    @property
    def record_sha256(self) -> str:
        """Return a hash that covers the newest line of the log and of each shard."""
        newest = [self.chain.sha256, *(view.record_sha256 for view in self.views)]
        return hashlib.sha256("\n".join(newest).encode()).hexdigest()

    @cached_property
    def releases(self) -> list[str]:
        """Return for each segment the release whose columns it has."""
        return [release for view in self.views for release in view.releases]

    @cached_property
    def _firsts(self) -> list[int]:
        """Return the index of the first event of each shard, and the number of all events."""
        return [*accumulate((view.head.size for view in self.views), initial=0)]

    @cached_property
    def _segments(self) -> list[tuple[int, int]]:
        """Return for each segment the number of its shard, and its number within the shard."""
        return [(i, number) for i, view in enumerate(self.views) for number in range(len(view.releases))]

    @cached_property
    def _lines(self) -> list[tuple[int, int]]:
        """Return for each line of the index the number of its shard, and its number within the shard."""
        return [
            (i, number)
            for i, view in enumerate(self.views)
            for number in range(len(view.chain.added) + bool(view.journal.frames))
        ]

    def first(self, number: int) -> int:
        """Return the index of the first event of this segment."""
        shard, local = self._segments[number]
        return self._firsts[shard] + self.shards[shard].view.first(local)

    def end(self, number: int) -> int:
        """Return the index after the last event of this segment."""
        shard, local = self._segments[number]
        return self._firsts[shard] + self.shards[shard].view.end(local)

    def segment(self, number: int, is_laid_out: bool = False) -> Path:
        """Return this segment, checked. Raises: As `View.segment`."""
        shard, local = self._segments[number]
        return self.shards[shard].view.segment(local, is_laid_out)

    def table(self, number: int, columns: list[str] | None = None) -> pa.Table:
        """Return the stored rows of this segment with these columns (None: all). Raises: As `segment`."""
        shard, local = self._segments[number]
        return self.shards[shard].view.table(local, columns)

    def tables_from(self, first: int, columns: list[str]) -> Iterator[pa.Table]:
        """Yield these columns of the events from this index on, a table for each segment. Raises: As `segment`."""
        for number in range(len(self._segments)):
            if self.end(number) > first:
                yield self.table(number, columns).slice(max(0, first - self.first(number))).combine_chunks()

    def shard_of(self, index: int) -> tuple[Shard, int]:
        """Return the shard that holds the event at this index, and the event's index there."""
        shard = bisect_right(self._firsts, index) - 1
        return self.shards[shard], index - self._firsts[shard]

    def rows(self, first: int, end: int) -> list[bytes]:
        """Return the canonical bytes of these events. Raises: As `segment`."""
        return [
            row
            for start, view in zip(self._firsts, self.views, strict=False)
            if (local := max(first - start, 0)) < (stop := min(end - start, view.head.size))
            for row in view.rows(local, stop)
        ]

    def runs(self) -> Iterator[LedgerRun]:
        """Yield every run of every shard. Raises: As `View.runs`."""
        return chain.from_iterable(view.runs() for view in self.views)

    @cached_property
    def index(self) -> Index:
        """Return the index of all events. Raises: As `View.index`."""
        return Index([line for view in self.views for line in view.index.lines])

    def span_of_line(self, number: int) -> tuple[int, int]:
        """Return the first and end index of the events of this line of the index."""
        shard, local = self._lines[number]
        first, end = self.shards[shard].view.span_of_line(local)
        return self._firsts[shard] + first, self._firsts[shard] + end

    def believe_index(self, placement: int | None = None) -> None:
        """Trust the index lines in the chains of all shards, as already compared with the rows."""
        for view in self.views:
            view.believe_index(placement)

    def require_index(self, *segments: int) -> None:
        """Require that the chains' index lines of these segments match their rows. Raises: As `View.require_index`."""
        for shard, local in {self._segments[number] for number in segments}:
            self.shards[shard].view.require_index(local)


def views_of(view: View) -> Sequence[View]:
    """Return the ledgers that hold this view's events, in order: the shards of a federation, or the ledger itself."""
    return view.views if isinstance(view, Federation) else [view]


def log_of(view: View) -> View:
    """Return the ledger that has this view's head: the log of a federation, or the ledger itself."""
    return view.log if isinstance(view, Federation) else view


def is_log(view: View) -> bool:
    """Return whether the first event of a ledger is the head of a shard. Raises: LedgerCorrupted as `View.event`."""
    if not view.chain.size:
        return False
    if view.chain.added:
        return names_head(_first_line(view)) and _type(view.event(0)) == HEAD_TYPE
    return _type(lines_of(view.journal.frames[:1]).partition(b"\n")[0]) == HEAD_TYPE


def names_head(line: bytes) -> bool:
    """Return whether this first line of an index shows that its ledger begins with the head of a shard."""
    return line.startswith(_FIRST) and _HEAD in line.partition(b"}")[0]


def _first_line(view: View) -> bytes:
    """Return the first line of the index, as placed: reading all of it would be slow if there are many runs."""
    placement = view.chain.added[0]
    try:
        line = growing.read_at(view.path / INDEX, 0, placement.index_bytes)
    except OSError:
        line = b""
    return line if sha256_hex(line) == placement.index_sha256 else view.index_lines(0)[0]


def _type(row: bytes) -> object:
    return msgspec.json.decode(row, type=dict[str, object])["type"]


def heads_of(view: View) -> list[ShardHead]:
    """Return all heads in a log, in order.

    Raises: LedgerCorrupted if it holds an event of another type, or as `View.rows`.
    """
    heads = []
    for index, row in enumerate(view.rows(0, view.chain.size)):
        event = msgspec.json.decode(row, type=dict[str, object])
        if (tag := event["type"]) != HEAD_TYPE:
            raise LedgerCorrupted(
                f"{view.path}: found event {index} of type {printable.value(f'{tag}')}, expected heads of shards "
                "alone, as in the log of a federation; record the heads in a new log"
            )
        head = msgspec.convert({**event, "index": index}, ShardHead)
        is_tree = head.shard_events >= 0 and _ROOT.fullmatch(head.shard_root) is not None
        is_placed = event["run_id"] == f"{PREFIX}{index}" and "\0" not in head.folder
        if not (is_tree and is_placed and is_name(head.origin)):
            raise LedgerCorrupted(
                f"{view.path}: found event {index}, {printable.value(f'{event}')}, expected a head with an origin, a "
                f"folder, a number of events and a root in hex, as run {PREFIX}{index}; record the heads in a new log"
            )
        heads.append(head)
    return heads


def newest(heads: Sequence[ShardHead]) -> list[ShardHead]:
    """Return the newest head of each origin, in the order in which the log first names them."""
    return [*{head.origin: head for head in heads}.values()]


def doubts(heads: Sequence[ShardHead]) -> list[Problem]:
    """Return the contradictions between the heads of a log: an origin only grows."""
    latest: dict[str, ShardHead] = {}
    problems = []
    for head in heads:
        previous = latest.get(head.origin)
        if previous is not None and _is_older(head, previous):
            was = f"{REPLAYED}: after its head of {previous.shard_events:,} events one of {head.shard_events:,}"
            expected = "heads that only grow; record it again in a new log"
            problems.append(Problem(str(head), was, expected))
        latest[head.origin] = head
    return problems


def _is_older(head: ShardHead, previous: ShardHead) -> bool:
    if head.shard_events == previous.shard_events:
        return head.shard_root != previous.shard_root
    return head.shard_events < previous.shard_events


def doubt_of(head: ShardHead, view: View, heads: Sequence[ShardHead]) -> Problem | None:
    """Return why the ledger of this view is not the recorded shard, or not all of it; None if it holds all.

    It may have grown since it was recorded. `heads` are all heads of the log.
    """
    place, actual = str(view.path), view.manifest.origin
    if is_log(view):
        return Problem(place, f"{NESTED}: the log of other ledgers", f"{head}, a ledger of runs; record those others")
    if actual != head.origin:
        is_other = any(other.origin == actual for other in heads)
        was = SWAPPED if is_other else OTHER_ORIGIN
        of = f"shard {printable.value(actual)}" if is_other else f"origin {printable.value(actual)}"
        return Problem(place, f"{was}: the ledger of {of}", f"that of {head}; put it back, or record where it is")
    tree = f"{head.shard_events:,} events under root {head.shard_root}"
    size, root = view.head.size, view.head.root
    if size < head.shard_events:
        if (flaw := doubt_of_past(head, view, [other for other in heads if other.shard_events <= size])) is not None:
            return flaw
        earlier = [other for other in heads if other.origin == actual and other.index < head.index]
        was = REPLAYED if any((size, root) == (other.shard_events, other.shard_root) for other in earlier) else LATE
        note = "as at an earlier head" if was == REPLAYED else "of which the log has more"
        return Problem(
            place, f"{was}: {size:,} events, {note}", f"{tree}, as recorded; bring what is missing from where it is"
        )
    if not begins_with(view, head.shard_events, head.shard_root):
        return Problem(place, f"{OTHER_HISTORY}: {size:,} events under root {root}", f"{tree}, or more after them")
    return None


def doubt_of_past(head: ShardHead, view: View, heads: Sequence[ShardHead]) -> Problem | None:
    """Return the problem with a head of this shard that it never had; None if it had all. Raises: As `begins_with`."""
    for past in heads:
        if past.origin == head.origin and not begins_with(view, past.shard_events, past.shard_root):
            was = f"{OTHER_HISTORY}: it never had the root {past.shard_root} of {past.shard_events:,} events"
            return Problem(str(view.path), was, f"heads of {head} that it had; record it in a new log")
    return None


def begins_with(view: View, size: int, root: str) -> bool:
    """Return whether the stored hashes prove that the first `size` events have this root.

    Raises: LedgerCorrupted if a required hash is missing.
    """
    current = view.head
    if not size:
        return root == EMPTY_HEAD.root
    if size == current.size:
        return root == current.root
    proof = consistency_proof(view.node(current.size), size, current.size)
    return is_consistent(size, bytes.fromhex(root), current.size, bytes.fromhex(current.root), proof)


def twice(views: Mapping[str, View]) -> Problem | None:
    """Return the problem if two of these shards, by origin, hold a run of the same name; None if none do."""
    seen: dict[str, str] = {}
    for origin, view in views.items():
        names = view.run_names
        for run in (*names.runs, *names.plans):
            if (other := seen.setdefault(run, origin)) != origin:
                place = str(view.path)
                was = f"{TWICE}: run {printable.value(run)}, which shard {printable.value(other)} also holds"
                return Problem(place, was, "runs that no other shard holds; leave one of the two out")
    return None


def unreadable(head: ShardHead, place: Path, error: Exception) -> Problem:
    """Return the problem of a shard's folder that has no ledger, or an unreadable one."""
    if isinstance(error, NotALedger):
        return Problem(str(place), f"{MISSING}: no ledger", f"{head}; put it back, or record where it is")
    return Problem(str(place), f"{error}", f"{head}, a ledger that can be read")


def told(head: ShardHead, view: View, runs: int | None, models: Sequence[str], log: Path) -> str:
    """Return a line on a verified shard, with its number of runs (None: not counted) and their model versions."""
    size = view.head.size
    more = f"{head.shard_events:,} of them are recorded, run fsar-ledger shards {printable.word(log)} for the rest"
    grown = f"; {more}" if size > head.shard_events else ""
    count_text = "" if runs is None else f" of {printable.counted(runs, 'run')}"
    model = ", ".join(map(printable.value, models)) or "unknown"
    return f"{head}: consistent, {printable.counted(size, 'event')}{count_text}, model version {model}{grown}"


def joined(log: View, shards: Sequence[Shard]) -> Federation:
    """Return the federation of this log and these shards."""
    return Federation(
        *(log.path, log.manifest, log.manifest_sha256, log.chain, log.followed, log.journal, log.checkpoint),
        shards=tuple(shards),
    )


def record_of_head(head: ShardHead) -> LedgerRun:
    """Return the record to commit for a head: a run with one event, at time 0.

    Its name contains its index in the log, so if two writers read the same log, only one can append.
    """
    event = ShardRecorded(
        origin=head.origin, folder=head.folder, shard_events=head.shard_events, shard_root=head.shard_root
    )
    return LedgerRun(f"{PREFIX}{head.index}", (0,), (None,), (event,))
