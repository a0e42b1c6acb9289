"""Verify a ledger: derive again from the rows everything that it says about itself, and compare; recover it.

Without a signature or an anchor this proves that nothing was altered, removed or added *inside* the ledger that its
last record vouches for. Rewriting every record, or removing the newest ones, is caught by a trusted key (nobody else
can sign other records) and by an anchor, an earlier checkpoint kept elsewhere.

To recover is to finish or set aside what a crash left, to explain what was altered, and to delete nothing:

1. First find what can be trusted, without changing anything (`trusted.py`). If nothing is to be mended, that is all.
2. If it is the whole ledger, committed segments move into place, and what can be derived from the commits
   (ledger.json, nodes, index, checkpoint) is made again where it is wrong. Everything else is set aside: it moves to
   `LEDGER.set-aside/NNN/` under the same name. A crash may follow any step; the next recovery goes on from there.
3. If it is not, the ledger stays as it is, as evidence; `into` copies the trusted commits to a new ledger, byte for
   byte.

```
chain     one look at the ledger, segment by segment
segment   one segment: what a worker does
report    what is asked, what was found, who signed, and whether the ledger only grew
trusted   how much of a ledger can be trusted, mended or copied
```
"""

import fcntl
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import Literal, NamedTuple

import msgspec

from fsar_ledger.base.errors import (
    FsarLedgerError,
    LedgerCorrupted,
    NotALedger,
    UsageError,
    WorkerDied,
    WriteFailed,
    option,
)
from fsar_ledger.base.progress import Progress
from fsar_ledger.ledger.log.note import Checkpoint, Note
from fsar_ledger.ledger.store import disk, growing, shards
from fsar_ledger.ledger.store.manifest import refuse_version_1
from fsar_ledger.ledger.store.paths import CHAIN, INDEX, JOURNAL, MANIFEST, NODES, SEALING, SEGMENTS, require_created
from fsar_ledger.ledger.store.problem import Problem, unexpected
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.record import Head
from fsar_ledger.ledger.store.snapshot import read_checkpoint
from fsar_ledger.ledger.verify.chain import Verification
from fsar_ledger.ledger.verify.report import MAX_PROBLEMS, Anchor, VerifyOptions, VerifyReport
from fsar_ledger.ledger.verify.trusted import Did, Later, TrustedPart, find_trusted, mend, write_copy


def verify(
    path: Path, workers: int = 1, progress: Progress | None = None, asked: VerifyOptions | None = None
) -> VerifyReport:
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
        FormatVersionMismatch: Its ledger.json says that it has format 1.
        WorkerDied: A process that reads segments was ended, so nothing is known about the ledger.
    """
    require_ledger(path)
    before = _moment(path)
    report = _look(path, workers, progress, asked or VerifyOptions())
    if not report.ok and _moment(path) != before:  # what was read late need not fit what was read early
        with disk.shared_lock(path / SEGMENTS):
            report = _look(path, workers, progress, asked or VerifyOptions())
    return report


def require_ledger(path: Path) -> None:
    """Require that something of a ledger is at this path, and not one of format 1.

    Raises: NotALedger, FormatVersionMismatch.
    """
    if not any(os.path.lexists(path / name) for name in (MANIFEST, CHAIN, SEGMENTS)):
        raise NotALedger(
            f"{path}: found no ledger there, expected its directory; give the path that `fsar-ledger simulate` wrote to"
        )
    require_created(path)
    with suppress(OSError):
        refuse_version_1(path, disk.read_document(path / MANIFEST))


def _moment(path: Path) -> tuple[tuple[int, ...], str | Problem | None] | None:
    """Return what changes while a writer is at work; None where it cannot be read."""
    files = [path / name for name in (CHAIN, JOURNAL, SEALING, NODES, INDEX)]
    try:
        return (*map(growing.size_of, files), *map(growing.inode_of, files)), read_checkpoint(path)
    except OSError:
        return None


class Reading(NamedTuple):
    """How shards are opened, and how the model versions of their runs are read."""

    opened: Callable[[Path], View]
    models_of: Callable[[View], list[str]]


def verify_shards(
    report: VerifyReport,
    log: View,
    reading: Reading,
    workers: int,
    progress: Progress | None,
    asked: VerifyOptions,
) -> tuple[VerifyReport, list[str | None]]:
    """Verify the shards of a log that this report is about, and compare them with their recorded heads.

    Returns the report on all, and the newest records of what was verified without doubt.
    """
    try:
        heads = shards.heads_of(log)
    except LedgerCorrupted as error:
        problem = Problem(CHAIN, f"{error}", "a log that holds heads of shards alone")
        return msgspec.structs.replace(report, ok=False, problems=(problem,), root=None, record_sha256=None), []
    problems, found, reports = shards.doubts(heads), list[shards.Shard](), list[VerifyReport]()
    for head in shards.newest(heads):
        place = head.place(log.path)
        try:
            view = reading.opened(place)
        except FsarLedgerError as error:
            problems.append(shards.unreadable(head, place, error))
            continue
        doubt = shards.doubt_of(head, view, heads)
        kept = () if doubt is not None else (_as_recorded(head),)
        own = VerifyOptions(asked.is_quick, witnessed=kept, second_reader=asked.second_reader)
        told = verify(place, workers, progress, own)
        if told.ok and doubt is None:
            doubt = shards.doubt_of_past(head, view, heads)
        problems += [] if doubt is None else [doubt]
        problems += [msgspec.structs.replace(one, where=f"{place}/{one.where}") for one in told.problems]
        if told.ok and doubt is None:
            found.append(shards.Shard(head, view))
            reports.append(told)
    if (doubt := shards.twice({one.head.origin: one.view for one in found})) is not None:
        problems.append(doubt)
    records = [one.record_sha256 for one in reports]
    if problems:
        named = tuple(problems[:MAX_PROBLEMS])
        return msgspec.structs.replace(report, ok=False, problems=named, root=None, record_sha256=None), records
    whole = _of_all(report, shards.joined(log, found), reports, reading)
    return whole, [whole.record_sha256, report.record_sha256, *records]


def _as_recorded(head: shards.ShardHead) -> Anchor:
    tree = Checkpoint(head.origin, head.shard_events, bytes.fromhex(head.shard_root))
    return Anchor(f"{head}, as recorded", Note(tree))


def _of_all(
    report: VerifyReport, federation: shards.Federation, reports: Sequence[VerifyReport], reading: Reading
) -> VerifyReport:
    """Return the report on a federation without a problem, given those on its shards."""
    remarks, models = list(report.remarks), set[str]()
    for shard, told in zip(federation.shards, reports, strict=True):
        own = reading.models_of(shard.view)
        models.update(own)
        remarks.append(shards.told(shard.head, shard.view, None if told.is_quick else told.runs, own, federation.path))
    if len(models) > 1:
        remarks.append(f"shards of model versions {', '.join(sorted(models))}: no answer pools them")
    # One that has grown while it was verified was not verified as it was opened.
    is_same = [told.record_sha256 for told in reports] == [view.record_sha256 for view in federation.views]
    return msgspec.structs.replace(
        report,
        runs=sum(told.runs for told in reports),
        remarks=tuple(remarks),
        record_sha256=federation.record_sha256 if is_same else report.record_sha256,
        shards=len(reports),
    )


def _look(path: Path, workers: int, progress: Progress | None, asked: VerifyOptions) -> VerifyReport:
    """Look at the whole ledger once. Raises: WorkerDied, and what `unexpected` raises: then nothing is known."""
    verification = Verification(path, asked)
    try:
        return verification.run(max(1, workers), progress)
    except WorkerDied:
        raise
    except (Exception, RecursionError) as error:  # a check that fails unexpectedly is still a finding
        found = dict.fromkeys((*verification.names, *verification.problems))
        problems = (*[*found][: MAX_PROBLEMS - 1], unexpected(str(path), None, error))
        return VerifyReport(False, problems, 0, 0, 0, None, is_quick=verification.asked.is_quick)


Outcome = Literal["whole", "mended", "damaged", "continued"]


class Step(msgspec.Struct, frozen=True):
    """One thing that was done: to which file of the ledger, and where the file is now."""

    did: Did
    file: str
    to: str


class Recovery(msgspec.Struct, frozen=True):
    """What `recover` found and did.

    `outcome`: the ledger was *whole* already, or is so again (*mended*); or it is *damaged* and was not touched, with
    the trusted commits in a new ledger (*continued*) if that was asked for. `head` is that of the trusted commits.
    `problems` are those of the first commit after them, `later` each commit after them, judged on its own. `anchored`
    counts the trusted events that the anchor vouches for, None if it cannot or none was given. `report` is what
    `verify` says about the whole, the mended or the new ledger. `shards` are what is wrong with the shards of a log.
    """

    outcome: Outcome
    head: Head
    steps: tuple[Step, ...] = ()
    problems: tuple[Problem, ...] = ()
    later: tuple[Later, ...] = ()
    anchored: int | None = None
    report: VerifyReport | None = None
    shards: tuple[Problem, ...] = ()


def recover(
    path: Path,
    workers: int = 1,
    progress: Progress | None = None,
    asked: VerifyOptions | None = None,
    into: Path | None = None,
) -> Recovery:
    """Mend the ledger so that it verifies, or leave it as it is and report what of it can be trusted.

    Args:
        path: The directory of the ledger.
        workers: Processes that read segments.
        progress: Called with (segments done, segments in all), from the beginning each time that they are read.
        asked: A key that must have signed, an earlier checkpoint.
        into: Where the trusted commits of a damaged ledger go; nothing may be there yet.

    Raises:
        NotALedger, FormatVersionMismatch: There is no ledger that this version reads, or its creation was interrupted
            before anything was in it.
        UsageError: Something is at `into` already, or it is within the ledger, or the anchor is not a checkpoint.
        LedgerCorrupted: No commit can be trusted, so there is nothing to copy; or files changed while they were read.
        WriteFailed: Another writer is at work, or the disk refused; what was done so far stays, and the next recovery
            goes on.
    """
    asked = asked or VerifyOptions()
    require_ledger(path)
    _require_free(path, into)
    if asked.anchor is not None and asked.anchor.note is None:
        raise UsageError(
            f"{option('anchor', asked.anchor.file)}: found {asked.anchor.reason}, expected a checkpoint of this ledger"
        )
    with _alone(path):
        trusted = find_trusted(path, workers, progress, asked)
        if trusted.problems:
            report = _copy(path, trusted, into, workers, progress, asked) if into is not None else None
            outcome: Outcome = "damaged" if into is None else "continued"
            later = tuple(trusted.later())
            return Recovery(outcome, trusted.head, (), trusted.problems, later, trusted.anchored, report)
        if trusted.is_whole:
            return Recovery("whole", trusted.head, anchored=trusted.anchored, report=trusted.report)
        mending = _Mending(path)
        with disk.refusals(path, "mending"):
            mend(trusted, mending.set_aside, mending.did)
            for folder in (path, path / SEGMENTS) if mending.steps else ():
                disk.sync_folder(folder)
        report = verify(path, workers, progress, asked)
    outcome = "damaged" if not report.ok else "mended" if mending.steps else "whole"
    steps = tuple(mending.steps)
    return Recovery(outcome, trusted.head, steps, report.problems, anchored=trusted.anchored, report=report)


def shards_to_recover(log: View, workers: int = 1, progress: Progress | None = None) -> list[Problem]:
    """Return what is wrong with shards of a log, or was left there by a crash. Raises: LedgerCorrupted: `heads_of`."""
    found = []
    for head in shards.newest(shards.heads_of(log)):
        place = head.place(log.path)
        try:
            require_ledger(place)
            with _alone(place):
                look = find_trusted(place, workers, progress, VerifyOptions(anchor=_as_recorded(head)))
        except FsarLedgerError as error:
            found.append(shards.unreadable(head, place, error))
        else:
            found += [msgspec.structs.replace(one, where=f"{place}/{one.where}") for one in look.problems[:1]]
            if not (look.problems or look.is_whole):
                found.append(Problem(str(place), "what an interrupted writer left", f"{head} alone"))
    return found


def _require_free(path: Path, into: Path | None) -> None:
    if into is None:
        return
    if os.path.lexists(into):
        raise UsageError(f"{option('into', into)}: found something there, expected a free path; give another one")
    if path.resolve() in into.resolve().parents:
        raise UsageError(
            f"{option('into', into)}: found a path within {path}, expected one outside of it; give another one"
        )


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Lock out writers, where the file system has locks. Raises: WriteFailed if one is at work, or locking fails."""
    with disk.refusals(path, "locking"):
        handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY)  # not ledger.json, which may be missing or replaced
    try:
        _lock(path, handle)
        yield
    finally:
        disk.close(handle)


def _lock(path: Path, handle: int) -> None:
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise WriteFailed(
            f"{path}: found a writer at work, expected none; wait until it ends, or end it, and run it again"
        ) from error
    except OSError:  # the file system has no locks
        return


class _Mending:
    """The steps on one ledger. A crash may follow any of them; all of them can be repeated."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.steps: list[Step] = []
        self._aside: Path | None = None

    def did(self, did: Did, file: str, to: str) -> None:
        """Note what was done."""
        self.steps.append(Step(did, file, to))

    def set_aside(self, name: str) -> None:
        """Move the file beside the ledger, durably, under the same name below the first free number."""
        if self._aside is None:
            self._aside = _new_folder(self.path)
        target = self._aside / name
        disk.make_folder(target.parent)
        disk.move(self.path / name, target)
        self.steps.append(Step("set aside", name, str(target)))


def _new_folder(ledger: Path) -> Path:
    """Make a new folder beside the ledger, durably."""
    real = ledger.resolve() if ledger.is_symlink() or ledger.name in ("", "..") else ledger
    top = real.with_name(f"{real.name}.set-aside")
    disk.make_folder(top)
    for number in count():
        with suppress(FileExistsError):
            os.mkdir(top / f"{number:03d}")
            disk.sync_folder(top)
            return top / f"{number:03d}"
    raise AssertionError("count() never ends")


def _copy(
    path: Path, trusted: TrustedPart, into: Path, workers: int, progress: Progress | None, asked: VerifyOptions
) -> VerifyReport:
    """Copy the trusted commits to a new ledger, byte for byte, and verify it; on failure nothing is there."""
    if not trusted.head.commits:
        raise LedgerCorrupted(
            f"{trusted.problems[0]}\n{path}: found no commit that can be trusted, expected one to copy to {into}; "
            "begin a new ledger there"
        )
    work = disk.temporary_name(into)
    note = asked.anchor.note if asked.anchor is not None else None
    if note is not None and note.checkpoint.size > trusted.head.size:
        asked = msgspec.structs.replace(asked, anchor=None)
    try:
        with disk.refusals(into, "copying the trusted commits"):
            disk.make_folder(into.parent)
            write_copy(trusted, work)
        report = verify(work, workers, progress, asked)
        if not report.ok:
            raise LedgerCorrupted(
                f"{report.problems[0]}\n{path}: found other files than a moment ago, expected nobody else to write; "
                "run it again"
            )
        with disk.refusals(into, "naming the new ledger"):
            os.rename(work, into)
            disk.sync_folder(into.absolute().parent)
    except BaseException:
        shutil.rmtree(work, ignore_errors=True)
        raise
    return report
