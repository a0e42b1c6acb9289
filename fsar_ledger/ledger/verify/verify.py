"""Derive again from the rows everything that a ledger says about itself, and compare.

Without a signature or an anchor this proves that nothing was altered, removed or added *inside* the ledger that its
last commit record vouches for. Rewriting every record, or removing the newest ones, is caught by a trusted key (nobody
else can sign other records) and by an anchor, an earlier checkpoint kept elsewhere.
"""

import os
from collections.abc import Iterator
from pathlib import Path

from fsar_ledger.errors import FsarLedgerError, NotALedger, WorkerDied
from fsar_ledger.ledger.log import merkle
from fsar_ledger.ledger.store import disk, turns
from fsar_ledger.ledger.store.derived import check_checkpoint, read_checkpoint
from fsar_ledger.ledger.store.paths import (
    COMMITS,
    MANIFEST,
    SEGMENTS,
    STAGING,
    commit_file,
    require_created,
    segment_file,
)
from fsar_ledger.ledger.store.problem import Problem, unexpected
from fsar_ledger.ledger.store.record import CommitRecord, sha256_hex
from fsar_ledger.ledger.store.walk import (
    FILES,
    FOLDERS,
    check_folders,
    check_manifest,
    check_names,
    commit_names,
    numbers_of,
    strays,
    walk,
)
from fsar_ledger.ledger.verify.chain import ChainVerification, chain_moment, is_chained
from fsar_ledger.ledger.verify.derived import BEHIND, TileCheck
from fsar_ledger.ledger.verify.notes import (
    Anchor,
    ByHashes,
    Signatures,
    check_anchor,
    check_signatures,
    not_compared,
    root_by_tiles,
)
from fsar_ledger.ledger.verify.report import MAX_PROBLEMS, OF_RECORDS, Asked, Progress, VerifyReport
from fsar_ledger.ledger.verify.walk import RowWalk, Standing


def verify(path: Path, workers: int = 1, progress: Progress | None = None, asked: Asked | None = None) -> VerifyReport:
    """Derive every field of every record again, and report every difference as a problem.

    Damage never raises, whatever the files hold. Symbolic links count as damage. If a writer is at work and what was
    read does not fit together, the writer waits while all is read once more.

    Args:
        path: The directory of the ledger.
        workers: Processes that read segments, or threads if rows are not read.
        progress: Called with (segments done, segments in all).
        asked: A quick look, a key that must have signed, an earlier checkpoint.

    Raises:
        NotALedger: There is no directory at the path, nothing of a ledger is in it, or its creation was interrupted.
        WorkerDied: A process that reads segments was ended, so nothing is known about the ledger.
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
        with turns.turn(path / (SEGMENTS if is_chained(path) else COMMITS), is_shared=True):
            report = _look(path, workers, progress, asked or Asked())
    return report


def _moment(path: Path) -> tuple[list[str], list[str], str | None] | None:
    """Return what changes while a writer is at work; None where it cannot be read."""
    try:
        if is_chained(path):
            return list(map(str, chain_moment(path))), [], read_checkpoint(path)
        commits, staged = ([entry.name for entry in disk.entries(path / folder)] for folder in (COMMITS, STAGING))
        return commits, staged, read_checkpoint(path)
    except (OSError, FsarLedgerError):
        return None


def _look(path: Path, workers: int, progress: Progress | None, asked: Asked) -> VerifyReport:
    """Look at the whole ledger once. Raises: WorkerDied, and what `unexpected` raises: then nothing is known."""
    verification = ChainVerification(path, asked) if is_chained(path) else _Verification(path, asked)
    try:
        return verification.run(max(1, workers), progress)
    except WorkerDied:
        raise
    except (Exception, RecursionError) as error:  # a check that fails unexpectedly is still a finding
        problems = (*verification.problems[: MAX_PROBLEMS - 1], unexpected(str(path), None, error))
        return VerifyReport(False, problems, 0, 0, 0, None, is_quick=verification.asked.is_quick)


class _Verification:
    """One look at a ledger, commit by commit."""

    def __init__(self, path: Path, asked: Asked) -> None:
        self.path, self.asked = path, asked
        self.problems: list[Problem] = []
        self.rows = RowWalk(path, asked.sizes(), is_quick=asked.is_quick)
        self.commits = self.events = 0
        self.tiles = TileCheck(path)
        self.is_behind = False  # the derived files are those of the commit before the newest

    def run(self, workers: int, progress: Progress | None) -> VerifyReport:
        """Look at the whole ledger."""
        self.problems += check_folders(self.path)
        origin, document, doubt = check_manifest(self.path)
        self.problems += [doubt] if doubt is not None else []
        names = commit_names(self.path)
        manifest_sha256 = sha256_hex(document) if document is not None else None
        commits = list(walk(self.path, origin, manifest_sha256, len(numbers_of(names, ".json"))))
        self.problems += check_names(names)
        for standing in self.rows.over(commits, workers, self.asked.second_reader):
            self._add(standing)
            if progress is not None:
                progress(standing.commit.number + 1, len(commits))
        self.problems += _check_strays(self.path, len(commits))
        newest = commits[-1].sha256 if commits else manifest_sha256
        return self._report(origin, [commit.record for commit in commits if commit.record is not None], newest)

    def _add(self, standing: Standing) -> None:
        """Add one commit."""
        self.problems += standing.problems
        if standing.made:
            self.tiles.add(standing.commit.number, standing.made)
        if not standing.problems:
            self.commits, self.events = self.commits + 1, self.events + standing.facts.rows

    def _report(self, origin: str | None, records: list[CommitRecord], newest: str | None) -> VerifyReport:
        signed = Signatures("signer not checked")
        if not self.problems:
            doubts, signed = check_signatures(
                [record.signed_note() for record in records], commit_file, self.asked.trusted
            )
            self.problems += doubts
        remarks = self._check_derived(records)
        anchored, proved = self._check_anchor(origin, records)
        ok = not self.problems
        if ok and self.asked.is_quick:
            remarks += (not_compared(anchored, proved, records[-1].tree_size if records else 0),)
        root = (self.rows.tree.root() if self.rows.tree is not None else merkle.EMPTY_ROOT).hex() if ok else None
        return VerifyReport(
            ok,
            tuple(self.problems[:MAX_PROBLEMS]),
            self.commits,
            self.events,
            len(self.rows.runs - self.rows.alone),
            root,
            signature=signed.state,
            signer=signed.signer,
            signed=signed.commits,
            is_quick=self.asked.is_quick,
            anchored=anchored if ok else None,
            remarks=remarks,
            record_sha256=newest if ok else None,
            not_looked_at=OF_RECORDS if self.asked.is_quick else (),
        )

    def _check_derived(self, records: list[CommitRecord]) -> tuple[str, ...]:
        """Compare the derived files, but only if what they derive from is beyond doubt; return the remarks on them."""
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
        """Check the anchors.

        Returns the events that the anchor vouches for, and the size of the tree up to which that was shown.
        """
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

    def _look_then(self, anchor: Anchor, records: list[CommitRecord], size: int) -> ByHashes:
        """Return the root of the ledger when it had as many events as the anchor counts, if it is known."""
        then = anchor.note.checkpoint if anchor.note is not None else None
        if then is not None and then.size == 0:
            return ByHashes(merkle.EMPTY_ROOT, size)
        if then is not None and self.asked.is_quick:
            return root_by_tiles(self.path, then, records[: -3 if self.is_behind else -2 : -1])
        return ByHashes(self.rows.roots.get(then.size) if then is not None else None, size)


def _check_strays(path: Path, count: int) -> Iterator[Problem]:
    """Yield a problem for every file that the ledger should not hold.

    Files in staging are harmless, and `check_names` looks at the records.
    """
    for name in strays(path, FILES.union(map(segment_file, range(count))), [SEGMENTS]):
        if name.startswith(f"{SEGMENTS}/"):
            expected = f"segments of {count} commits; restore the record or take it away"
            yield Problem(name, "a file of no commit", expected)
        elif name not in FOLDERS:
            yield Problem(name, "an unknown file", f"only {', '.join(sorted(FOLDERS | FILES))}; take it away")
