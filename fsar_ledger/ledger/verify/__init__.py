"""Verify a ledger: re-derive from the rows all that its records claim, and compare; recover it.

Without a signature or an anchor this proves that nothing was altered, removed or added *inside* the ledger for which
its last record vouches. Rewriting every record, or removing the newest ones, is caught by a trusted key (no other key
can sign its records) and by an anchor, an earlier checkpoint kept elsewhere.

Recovery finishes or sets aside what a crash left, explains what was altered, and deletes nothing:

1. First find what can be trusted, without changing anything (`trusted.py`). If nothing needs mending, that is all.
2. If it is the whole ledger, committed segments move into place, and files that can be derived from the commits
   (ledger.json, nodes, index, checkpoint) are rebuilt if they are wrong. Everything else is set aside: it moves to
   `LEDGER.set-aside/NNN/` under the same name. A crash may follow any step; the next recovery continues from there.
3. If it is not, the ledger stays unchanged, as evidence; `into` copies the trusted commits to a new ledger, byte for
   byte.

```
chain     one pass over the ledger, segment by segment
segment   one segment: the task of a worker
report    the options and the findings: problems, signatures, and whether the ledger only grew
trusted   how much of a ledger can be trusted; mending and copying it
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
    """Re-derive every field of every record, and report every difference as a problem.

    Damage never raises, whatever is in the files. Symbolic links count as damage. If a writer changed the ledger
    meanwhile and the result is inconsistent, everything is read once more under a lock that keeps writers out.

    Args:
        path: The directory of the ledger.
        workers: Processes that read segments, or threads if rows are not read.
        progress: Called with (segments done, total).
        asked: A quick look, a key that must have signed, an earlier checkpoint.

    Raises:
        NotALedger: There is no directory at the path, no part of a ledger is in it, or its creation was interrupted.
        FormatVersionMismatch: Its ledger.json declares format 1.
        WorkerDied: A process that reads segments was ended, so nothing is known about the ledger.
    """
    require_ledger(path)
    state = _moment(path)
    report = _look(path, workers, progress, asked or VerifyOptions())
    if not report.ok and _moment(path) != state:  # late reads may be inconsistent with early ones
        with suppress(LedgerCorrupted), disk.shared_lock(path / SEGMENTS):
            report = _look(path, workers, progress, asked or VerifyOptions())
    return report


def require_ledger(path: Path) -> None:
    """Require that at least part of a ledger is at this path, and not one of format 1.

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
    """Return the file sizes, inodes and checkpoint, which an active writer changes; None if they cannot be read."""
    files = [path / name for name in (CHAIN, JOURNAL, SEALING, NODES, INDEX)]
    try:
        return (*map(growing.size_of, files), *map(growing.inode_of, files)), read_checkpoint(path)
    except OSError:
        return None


class Reading(NamedTuple):
    """Functions that open shards and read the model versions of their runs."""

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
    """Verify the shards of this log, whose own report is given, and compare them with their recorded heads.

    Returns the report on all, and the hashes of the newest records of what was verified without doubt.
    """
    try:
        heads = shards.heads_of(log)
    except LedgerCorrupted as error:
        problem = Problem(CHAIN, f"{error}", "a log that holds heads of shards alone")
        return msgspec.structs.replace(report, ok=False, problems=(problem,), root=None, record_sha256=None), []
    problems, verified, reports = shards.doubts(heads), list[shards.Shard](), list[VerifyReport]()
    for head in shards.newest(heads):
        folder = head.place(log.path)
        try:
            view = reading.opened(folder)
        except FsarLedgerError as error:
            problems.append(shards.unreadable(head, folder, error))
            continue
        doubt = shards.doubt_of(head, view, heads)
        anchors = () if doubt is not None else (_as_recorded(head),)
        options = VerifyOptions(asked.is_quick, witnessed=anchors, second_reader=asked.second_reader)
        result = verify(folder, workers, progress, options)
        if result.ok and doubt is None:
            doubt = shards.doubt_of_past(head, view, heads)
        problems += [] if doubt is None else [doubt]
        problems += [msgspec.structs.replace(each, where=f"{folder}/{each.where}") for each in result.problems]
        if result.ok and doubt is None:
            verified.append(shards.Shard(head, view))
            reports.append(result)
    if (doubt := shards.twice({shard.head.origin: shard.view for shard in verified})) is not None:
        problems.append(doubt)
    records = [each.record_sha256 for each in reports]
    if problems:
        named = tuple(problems[:MAX_PROBLEMS])
        return msgspec.structs.replace(report, ok=False, problems=named, root=None, record_sha256=None), records
    whole = _of_all(report, shards.joined(log, verified), reports, reading)
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
    # A shard that has grown during verification was not verified as it was opened.
    is_same = [told.record_sha256 for told in reports] == [view.record_sha256 for view in federation.views]
    return msgspec.structs.replace(
        report,
        runs=sum(told.runs for told in reports),
        remarks=tuple(remarks),
        record_sha256=federation.record_sha256 if is_same else report.record_sha256,
        shards=len(reports),
    )


def _look(path: Path, workers: int, progress: Progress | None, asked: VerifyOptions) -> VerifyReport:
    """Verify the whole ledger once. Raises: WorkerDied, and as `unexpected`; then nothing is known."""
    verification = Verification(path, asked)
    try:
        return verification.run(max(1, workers), progress)
    except WorkerDied:
        raise
    except (Exception, RecursionError) as error:  # a check that fails unexpectedly is still a finding
        earlier = dict.fromkeys((*verification.names, *verification.problems))
        problems = (*[*earlier][: MAX_PROBLEMS - 1], unexpected(str(path), None, error))
        return VerifyReport(False, problems, 0, 0, 0, None, is_quick=verification.asked.is_quick)


Outcome = Literal["whole", "mended", "damaged", "continued"]


class Step(msgspec.Struct, frozen=True):
    """One recovery action: what was done, the file of the ledger, and where the file is now."""

    did: Did
    file: str
    to: str


class Recovery(msgspec.Struct, frozen=True):
    """The result of `recover`.

    `outcome`: the ledger was *whole* already, or is so again (*mended*); or it is *damaged* and was not touched, with
    the trusted commits in a new ledger (*continued*) if that was requested. `head` is that of the trusted commits.
    `problems` are those of the first commit after them, `later` each commit after them, judged on its own. `anchored`
    is the number of trusted events for which the anchor vouches, None if it cannot or none was given. `report` is that
    of `verify` on the whole, the mended or the new ledger. `shards` are the problems of the shards of a log.
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
    """Mend the ledger so that it verifies, or leave it unchanged and report how much of it can be trusted.

    Args:
        path: The directory of the ledger.
        workers: Processes that read segments.
        progress: Called with (segments done, total), from the beginning each time that they are read.
        asked: A key that must have signed, an earlier checkpoint.
        into: Where to copy the trusted commits of a damaged ledger; the path must be free.

    Raises:
        NotALedger, FormatVersionMismatch: There is no ledger that this version reads, or its creation was interrupted
            before anything was in it.
        UsageError: The path `into` exists, or is within the ledger, or the anchor is not a checkpoint.
        LedgerCorrupted: No commit can be trusted, so there is nothing to copy; or files changed while they were read.
        WriteFailed: Another writer has the ledger open, or the disk refused; what was done so far stays, and the next
            recovery continues.
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
        with disk.refusals(path, "mending", "what was mended stays"):
            mend(trusted, mending.set_aside, mending.did)
            for folder in (path, path / SEGMENTS) if mending.steps else ():
                disk.sync_folder(folder)
        report = verify(path, workers, progress, asked)
    outcome = "damaged" if not report.ok else "mended" if mending.steps else "whole"
    steps = tuple(mending.steps)
    return Recovery(outcome, trusted.head, steps, report.problems, anchored=trusted.anchored, report=report)


def shards_to_recover(log: View, workers: int = 1, progress: Progress | None = None) -> list[Problem]:
    """Return the problems of a log's shards, including leftovers of a crash. Raises: LedgerCorrupted, as `heads_of`."""
    problems = []
    for head in shards.newest(shards.heads_of(log)):
        folder = head.place(log.path)
        try:
            require_ledger(folder)
            with _alone(folder):
                trusted = find_trusted(folder, workers, progress, VerifyOptions(anchor=_as_recorded(head)))
        except FsarLedgerError as error:
            problems.append(shards.unreadable(head, folder, error))
        else:
            problems += [msgspec.structs.replace(each, where=f"{folder}/{each.where}") for each in trusted.problems[:1]]
            if not (trusted.problems or trusted.is_whole):
                problems.append(Problem(str(folder), "what an interrupted writer left", f"{head} alone"))
    return problems


def _require_free(path: Path, into: Path | None) -> None:
    if into is None:
        return
    if os.path.lexists(into):
        raise UsageError(f"{option('into', into)}: found a file or folder, expected a free path; give another one")
    if path.resolve() in into.resolve().parents:
        raise UsageError(
            f"{option('into', into)}: found a path within {path}, expected one outside of it; give another one"
        )


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Lock out writers, if the file system has locks. Raises: WriteFailed if one is active, or locking fails."""
    with disk.refusals(path, "locking", "nothing was changed"):
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
            f"{path}: found another writer, expected none; wait until it ends, or stop it, and run this again"
        ) from error
    except OSError:  # the file system has no locks
        return


class _Mending:
    """The steps of mending one ledger. A crash may follow any of them; all of them can be repeated."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.steps: list[Step] = []
        self._aside: Path | None = None

    def did(self, did: Did, file: str, to: str) -> None:
        """Record a step."""
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
    """Create a new numbered folder beside the ledger, durably."""
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
    """Copy the trusted commits to a new ledger, byte for byte, and verify it; on failure nothing is left."""
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
        with disk.refusals(into, "copying the trusted commits", "nothing was copied"):
            disk.make_folder(into.parent)
            write_copy(trusted, work)
        report = verify(work, workers, progress, asked)
        if not report.ok:
            raise LedgerCorrupted(
                f"{report.problems[0]}\n{path}: found other files than a moment ago, expected no other writer; "
                "run it again"
            )
        with disk.refusals(into, "naming the new ledger", "nothing was copied"):
            os.rename(work, into)
            disk.sync_folder(into.absolute().parent)
    except BaseException:
        shutil.rmtree(work, ignore_errors=True)
        raise
    return report
