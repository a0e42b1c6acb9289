"""Everything a ledger says about itself, derived again from its rows and compared.

What this proves without a signature or an anchor: nothing was altered, removed or added *inside* the ledger
that its last commit record vouches for. Who rewrites every record, or removes the newest ones, is caught by a
trusted key (nobody else can sign what he wrote) and by an anchor, an earlier checkpoint kept elsewhere.
"""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from itertools import repeat
from pathlib import Path

import msgspec

from fsar_ledger.errors import FsarLedgerError, NotALedger, WorkerDied
from fsar_ledger.ledger.log import merkle
from fsar_ledger.ledger.log.merkle import HASH_BYTES, Frontier
from fsar_ledger.ledger.log.note import Signed, VerifierKey
from fsar_ledger.ledger.log.tiles import Edge
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.derived import check_checkpoint, read_checkpoint
from fsar_ledger.ledger.store.paths import require_created
from fsar_ledger.ledger.store.problem import Problem, unexpected
from fsar_ledger.ledger.store.record import COMMITS, MANIFEST, SEGMENTS, STAGING, CommitRecord
from fsar_ledger.ledger.verify.commits import (
    Commit,
    check_folder,
    check_manifest,
    check_record,
    check_strays,
    read_commits,
    segment_file,
)
from fsar_ledger.ledger.verify.derived import BEHIND, TileCheck
from fsar_ledger.ledger.verify.notes import Anchor, ByTiles, Signatures, check_anchor, check_signatures, root_by_tiles
from fsar_ledger.ledger.verify.segment import SecondReader, SegmentFacts, examine, examine_file
from fsar_ledger.workers import WorkerPool

MAX_PROBLEMS = 100
"""A report names the first so many; a ledger with more is lost anyway."""

Progress = Callable[[int, int], None]


class Asked(msgspec.Struct, frozen=True):
    """What `verify` shall look at beyond the ledger itself.

    With `is_quick` the rows are not read: the chain of records, the files' hashes and the notes must do. `witnessed` are more anchors, whose
    signatures were looked at where they came from. `second_reader` reads the rows of each segment once more, with other code, and compares
    them; it can be pickled.
    """

    is_quick: bool = False
    trusted: VerifierKey | None = None
    anchor: Anchor | None = None
    witnessed: tuple[Anchor, ...] = ()
    second_reader: SecondReader | None = None

    def sizes(self) -> set[int]:
        """The sizes of the anchors' trees."""
        anchors = (self.anchor, *self.witnessed)
        return {anchor.note.checkpoint.size for anchor in anchors if anchor is not None and anchor.note is not None}


class VerifyReport(msgspec.Struct, frozen=True):
    """What `verify` found. Units: `commits`, `events` and `runs` are counts of what was read without doubt; `signed` counts signed commits.

    `root` is the Merkle root in hex over the rows themselves (as recorded, where rows were not read), None if there is any doubt.
    `signer` is the trusted key (`name+id`) if one was given, else whom the newest note names; `anchored` counts the events of the anchor.
    `remarks` are no doubts: what a crash may leave behind, and what a quick look leaves open.
    `record_sha256` is the hash of the newest commit record (of ledger.json where there is none), which vouches for all before; None if there is any doubt.
    """

    ok: bool
    problems: tuple[Problem, ...]
    commits: int
    events: int
    runs: int
    root: str | None
    signature: Signed = "unsigned"
    signer: str | None = None
    signed: int = 0
    is_quick: bool = False
    anchored: int | None = None
    remarks: tuple[str, ...] = ()
    record_sha256: str | None = None


def verify(path: Path, workers: int = 1, progress: Progress | None = None, asked: Asked | None = None) -> VerifyReport:
    """Every field of every record was derived again, and every difference is a problem of the report.

    Damage never raises, whatever the files hold. Symbolic links are refused as damage. Where a writer is at work and what
    was read does not fit together, the writer waits while all is read once more.

    Args:
        path: The directory of the ledger.
        workers: Processes that read segments, or threads where rows are not read.
        progress: Called with (segments done, segments in all).
        asked: A quick look, a key that must have signed, an earlier checkpoint.

    Raises:
        NotALedger: There is no directory at the path, nothing of a ledger is in it, or its creation was interrupted.
        WorkerDied: A process that reads segments was ended; the ledger is neither consistent nor damaged for all that is known.
    """
    if not any(os.path.lexists(path / name) for name in (MANIFEST, COMMITS, SEGMENTS)):
        raise NotALedger(
            f"{path}: found no ledger there, expected its directory; give the path that `fsar-ledger simulate` wrote to"
        )
    require_created(path)
    before = _moment(path)
    report = _look(path, workers, progress, asked or Asked())
    if (
        not report.ok and _moment(path) != before
    ):  # a writer was at work: what was read late need not fit what was read early
        with disk.turn(path / COMMITS, is_shared=True):
            report = _look(path, workers, progress, asked or Asked())
    return report


def _moment(path: Path) -> tuple[list[str], list[str], str | None] | None:
    """What changes while a writer is at work; None where it cannot be read."""
    try:
        commits, staged = ([entry.name for entry in disk.entries(path / folder)] for folder in (COMMITS, STAGING))
        return commits, staged, read_checkpoint(path)
    except (OSError, FsarLedgerError):
        return None


def _look(path: Path, workers: int, progress: Progress | None, asked: Asked) -> VerifyReport:
    """One look at the whole ledger. Raises: WorkerDied, and nothing else: then nothing is known."""
    verification = _Verification(path, asked)
    try:
        return verification.run(max(1, workers), progress)
    except WorkerDied:
        raise
    except (Exception, RecursionError) as error:  # a check that fails in a way nobody thought of is still a finding
        problems = (*verification.problems[: MAX_PROBLEMS - 1], unexpected(str(path), None, error))
        return VerifyReport(False, problems, 0, 0, 0, None, is_quick=verification.asked.is_quick)


class _Verification:
    """One look at a ledger, commit by commit."""

    def __init__(self, path: Path, asked: Asked) -> None:
        self.path, self.asked = path, asked
        self.problems: list[Problem] = []
        self.runs: set[str] = set()
        self.alone: set[str] = set()  # of these, what is no run but an event that stands alone
        self.commits = self.events = 0
        self.edge: Edge | None = None if asked.is_quick else Edge()  # None: not known, because some rows were not read
        self.tree: Frontier | None = Frontier()  # None: not known, because a record or segment before could not be read
        self.tiles = TileCheck(path)
        self.roots_then: dict[int, bytes] = {}  # of the anchors' events, by their number
        self.is_behind = False  # the derived files are those of the commit before the newest

    def run(self, workers: int, progress: Progress | None) -> VerifyReport:
        """The whole look."""
        self.problems += check_folder(self.path)
        origin, previous = check_manifest(self.path, self.problems)
        commits = read_commits(self.path, self.problems)
        for commit, facts in zip(commits, _examine_all(self.path, commits, workers, self.asked), strict=True):
            before = len(self.problems)
            self._add(commits, commit, facts, previous, origin)
            previous = commit.sha256
            if len(self.problems) == before:
                self.commits, self.events = self.commits + 1, self.events + facts.rows
            if progress is not None:
                progress(commit.number + 1, len(commits))
        self.problems += check_strays(self.path, len(commits))
        return self._report(origin, [commit.record for commit in commits if commit.record is not None], previous)

    def _report(self, origin: str | None, records: list[CommitRecord], newest: str | None) -> VerifyReport:
        signed = Signatures("signer not checked")
        if not self.problems:
            doubts, signed = check_signatures(records, self.asked.trusted)
            self.problems += doubts
        remarks = self._check_derived(records)
        anchored, proved = self._check_anchor(origin, records)
        ok = not self.problems
        if ok and self.asked.is_quick:
            remarks += (_not_compared(anchored, proved, records[-1].tree_size if records else 0),)
        root = (self.tree.root() if self.tree is not None else merkle.EMPTY_ROOT).hex() if ok else None
        return VerifyReport(
            ok,
            tuple(self.problems[:MAX_PROBLEMS]),
            self.commits,
            self.events,
            len(self.runs - self.alone),
            root,
            signature=signed.state,
            signer=signed.signer,
            signed=signed.commits,
            is_quick=self.asked.is_quick,
            anchored=anchored if ok else None,
            remarks=remarks,
            record_sha256=newest if ok else None,
        )

    def _add(
        self, commits: list[Commit], commit: Commit, facts: SegmentFacts, previous: str | None, origin: str | None
    ) -> None:
        """One commit more, compared with those before it."""
        if commit.record is None:
            self.tree = self.edge = None
            return
        known = self.tree if self.tree is not None else _claimed_before(commits, commit.number)
        self.problems += check_record(commit.number, commit.record, previous, origin, known)
        self.problems += facts.problems
        self._grow(commit.number, commit.record, known, facts)
        self._check_runs(commit.number, commit.record, facts)

    def _grow(self, number: int, record: CommitRecord, before: Frontier | None, facts: SegmentFacts) -> None:
        """The tree has the commit's leaves: those of its rows if they could be read and agree, else as claimed, so that each error shows once."""
        claimed = record.tree()
        self.tree = claimed
        if facts.leaves is None or before is None:
            self.edge = None
            return
        if self.edge is not None:  # then it is the edge of the tree before
            self._look_back(self.edge, facts.leaves)
            self.edge, made = self.edge.extend(facts.leaves)
            self.tiles.add(number, made)
            tree = self.edge.frontier()
        else:
            tree = before.extend(facts.leaves)
        if (
            tree.size == claimed.size and tree != claimed
        ):  # another size is a contradiction in the record, and named there
            found = f"Merkle root {tree.root().hex()}"
            self.problems.append(
                Problem(
                    facts.file,
                    found,
                    f"{record.tree_root} as committed: a row was altered",
                    commit=number,
                    field="tree_root",
                )
            )
        if tree != claimed:
            self.edge = None

    def _look_back(self, edge: Edge, leaves: bytes) -> None:
        """The root over an anchor's events is known if they end within these leaves, or before them."""
        for size in self.asked.sizes():
            wanted = size - edge.size
            if 0 <= wanted * HASH_BYTES <= len(leaves):
                self.roots_then[size] = edge.extend(leaves[: wanted * HASH_BYTES])[0].frontier().root()

    def _check_runs(self, number: int, record: CommitRecord, facts: SegmentFacts) -> None:
        """The runs are those of the record, and in no other commit."""
        if facts.runs is None:
            return
        where = f"{COMMITS}/{number:012d}.json"
        for name, found, expected in (
            ("first_run", record.first_run, facts.runs[0]),
            ("last_run", record.last_run, facts.runs[-1]),
        ):
            if found != expected:
                self.problems.append(Problem(where, repr(found), repr(expected), commit=number, field=name))
        again = next((run for run in facts.runs if run in self.runs), None)
        if again is not None:
            self.problems.append(
                Problem(
                    facts.file,
                    f"run {again} once more",
                    "each run in one commit",
                    commit=number,
                    run=again,
                    seq=0,
                    field="run_id",
                )
            )
        self.runs.update(facts.runs)
        self.alone |= facts.alone

    def _check_derived(self, records: list[CommitRecord]) -> tuple[str, ...]:
        """What is derived is compared only where all it is derived from is beyond doubt; the remarks on it."""
        if self.problems:
            return ()
        found, self.is_behind = check_checkpoint(self.path, records)
        self.problems += found
        if self.asked.is_quick:
            return (BEHIND,) if self.is_behind else ()
        found, remarks = self.tiles.finish(is_behind=self.is_behind)
        self.problems += found
        return remarks

    def _check_anchor(self, origin: str | None, records: list[CommitRecord]) -> tuple[int | None, int]:
        """The events that the anchor vouches for, if the ledger begins with them; the events of the tree up to which that was shown."""
        size = records[-1].tree_size if records else 0
        for witnessed in self.asked.witnessed:
            found = self._look_then(witnessed, records, size)
            self.problems += check_anchor(witnessed, origin, size, found.root, None, found.missing)
        anchor = self.asked.anchor
        if anchor is None:
            return None, size
        found = self._look_then(anchor, records, size)
        self.problems += check_anchor(anchor, origin, size, found.root, self.asked.trusted, found.missing)
        return (anchor.note.checkpoint.size if anchor.note is not None else None), found.size

    def _look_then(self, anchor: Anchor, records: list[CommitRecord], size: int) -> ByTiles:
        """The root of the ledger's first so many events as the anchor counts, if it is known."""
        then = anchor.note.checkpoint if anchor.note is not None else None
        if then is not None and then.size == 0:
            return ByTiles(merkle.EMPTY_ROOT, size)
        if then is not None and self.asked.is_quick:
            return root_by_tiles(self.path, then, records[: -3 if self.is_behind else -2 : -1])
        return ByTiles(self.roots_then.get(then.size) if then is not None else None, size)


def _not_compared(anchored: int | None, proved: int, size: int) -> str:
    """What a quick look leaves open: the anchor's events begin the tree of `proved` events, and the newest has `size`."""
    if anchored is None:
        return "rows were not compared with the recorded roots"
    if proved == size:
        return f"the recorded roots only grew since the anchor's {anchored:,} events; rows were not compared with them"
    return (
        f"the recorded roots only grew from the anchor's {anchored:,} events to {proved:,}, those before the newest commit, whose tiles are missing; "
        "neither its root nor any rows were compared with them"
    )


def _examine_all(path: Path, commits: list[Commit], workers: int, asked: Asked) -> Iterator[SegmentFacts]:
    """What each segment holds, in order; nothing of those whose record is unreadable."""
    files = [segment_file(path, commit) for commit in commits]
    records = [commit.record for commit in commits]
    arguments = (files, repeat(str(path)), range(len(commits)), records)
    again = (*arguments, repeat(asked.second_reader)) if asked.second_reader is not None else arguments
    workers = min(workers, len(commits))
    with ExitStack() as stack:
        if workers > 1 and asked.is_quick:  # hashing lets other threads run
            yield from stack.enter_context(ThreadPoolExecutor(workers)).map(examine_file, *arguments)
        elif workers > 1:
            yield from stack.enter_context(WorkerPool(workers)).map(examine, *again)
        elif asked.is_quick:
            yield from map(examine_file, *arguments)
        else:
            yield from map(examine, *again)


def _claimed_before(commits: list[Commit], number: int) -> Frontier | None:
    """The tree that the record before this one claims, where the rows before it could not be read."""
    record = commits[number - 1].record if number else None
    return record.tree() if record is not None else None
