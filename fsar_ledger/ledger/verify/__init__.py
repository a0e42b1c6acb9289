"""Verify a ledger: derive again from the rows everything that it says about itself, and compare; recover it.

Without a signature or an anchor this proves that nothing was altered, removed or added *inside* the ledger that its
last record vouches for. Rewriting every record, or removing the newest ones, is caught by a trusted key (nobody else
can sign other records) and by an anchor, an earlier checkpoint kept elsewhere.

```
chain     one look at the ledger, segment by segment
segment   one segment: what a worker does
report    what is asked, what was found, who signed, and whether the ledger only grew
recover   finishes or sets aside what a crash left; deletes nothing
trusted   how much of a ledger can be trusted, mended or copied
```
"""

import os
from contextlib import suppress
from pathlib import Path

from fsar_ledger.base.errors import NotALedger, WorkerDied
from fsar_ledger.base.progress import Progress
from fsar_ledger.ledger.store import disk, growing
from fsar_ledger.ledger.store.manifest import refuse_version_1
from fsar_ledger.ledger.store.paths import CHAIN, INDEX, JOURNAL, MANIFEST, NODES, SEALING, SEGMENTS, require_created
from fsar_ledger.ledger.store.problem import Problem, unexpected
from fsar_ledger.ledger.store.snapshot import read_checkpoint
from fsar_ledger.ledger.verify.chain import Verification
from fsar_ledger.ledger.verify.report import MAX_PROBLEMS, VerifyOptions, VerifyReport


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
        with disk.locked(path / SEGMENTS, is_shared=True):
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


def _look(path: Path, workers: int, progress: Progress | None, asked: VerifyOptions) -> VerifyReport:
    """Look at the whole ledger once. Raises: WorkerDied, and what `unexpected` raises: then nothing is known."""
    verification = Verification(path, asked)
    try:
        return verification.run(max(1, workers), progress)
    except WorkerDied:
        raise
    except (Exception, RecursionError) as error:  # a check that fails unexpectedly is still a finding
        problems = (*verification.problems[: MAX_PROBLEMS - 1], unexpected(str(path), None, error))
        return VerifyReport(False, problems, 0, 0, 0, None, is_quick=verification.asked.is_quick)
