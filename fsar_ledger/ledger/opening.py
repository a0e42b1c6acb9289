"""Open a ledger to answer from it, after the checks of `verify --quick`.

The records, their chain and notes, and the file `checkpoint` are compared here; the bytes of a segment when it is
handed out (`View.segment`). Stray files are left to `verify`, because no answer reads a file that no record names.
So are the derived hashes, except those of a proof, which is checked against the root, and of the index, whose lines are
compared with their records.
"""

from collections.abc import Callable, Iterator
from pathlib import Path

from fsar_ledger.base.errors import LedgerCorrupted, UsageError
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.manifest import read_manifest
from fsar_ledger.ledger.store.paths import CHAIN, CHECKPOINT, JOURNAL, MANIFEST, SEGMENTS
from fsar_ledger.ledger.store.read import View, open_chain
from fsar_ledger.ledger.store.shards import Federation, federation, is_log
from fsar_ledger.ledger.store.snapshot import check_chain_checkpoint

Pause = Callable[[], None]
"""Waits a moment; what it raises ends the waiting."""


def open_ledger(path: Path) -> View:
    """Open the ledger at this path: check its records against each other, without reading any events of segments.

    Raises:
        NotALedger: There is no ledger.
        FormatVersionMismatch: It was written in another format, or holds events of a later release.
        LedgerCorrupted: A record is missing, is not canonical, or contradicts the one before it.
    """
    return open_chain(path, read_manifest(path))


def open_for_answers(path: Path) -> View:
    """Open the ledger at this path as `open_checked` does; where it is the log of a federation, the federation.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted, UsageError: As `open_checked`, and as `federation`.
    """
    view = open_checked(path)
    return federation(view, open_checked) if is_log(view) else view


def open_checked(path: Path) -> View:
    """Open the ledger at this path, and compare its checkpoint with its newest commits.

    An older note is accepted where a crash may leave it: that of any commit since which the journal holds all. If they
    do not fit, both are read once more while any writer waits.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `open_ledger`; LedgerCorrupted also for any other
            checkpoint, or none.
    """
    view = open_ledger(path)
    problems = check_chain_checkpoint(view)
    if problems:
        with disk.locked(path / SEGMENTS, is_shared=True):
            view = open_ledger(path)
            problems = check_chain_checkpoint(view)
    for problem in problems:
        raise LedgerCorrupted(
            f"{path}/{problem}: commits were removed, or the file was altered; run fsar-ledger verify, and "
            "fsar-ledger maintain recover if it says so"
        )
    return view


def growth(ledger: Path, pause: Pause | None) -> Iterator[tuple[View, int]]:
    """Yield the ledger as it is, then, with `pause`, each time it has grown; and the first event not yet yielded.

    Between two looks only the state of a few files is read.

    Raises:
        UsageError: It is a federation, and is to be watched as it grows.
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `open_for_answers` and `_require_same`.
    """
    state = _state(ledger)
    view = open_for_answers(ledger)
    if pause is not None and isinstance(view, Federation):
        raise UsageError(f"{ledger}: found a federation, expected one ledger to follow; follow each of its shards")
    yield view, 0
    while pause is not None:
        pause()
        # A file system may give two changes in a row one time.
        if (found := _state(ledger)) == state and view.is_current():
            continue
        state, grown = found, open_for_answers(ledger)
        _require_same(view, grown)
        if grown.head.size > view.head.size:
            yield grown, view.head.size
        view = grown


def _state(ledger: Path) -> tuple[tuple[int, int, int] | None, ...]:
    """Return what changes when the ledger grows or is replaced; None for a file that is not there."""
    found: list[tuple[int, int, int] | None] = []
    for name in (MANIFEST, CHAIN, JOURNAL, CHECKPOINT):
        try:
            status = (ledger / name).stat()
        except OSError:
            found.append(None)
        else:
            found.append((status.st_ino, status.st_size, status.st_mtime_ns))
    return tuple(found)


def _require_same(view: View, grown: View) -> None:
    """Require that the ledger still begins with the commits that it had. Raises: LedgerCorrupted."""
    count = len(view.commits)
    if grown.manifest_sha256 != view.manifest_sha256 or grown.commits[:count] != view.commits:
        raise LedgerCorrupted(
            f"{view.path}: found another ledger of {len(grown.commits):,} commits, expected the one of {count:,} whose "
            "lines were told, or more of it; it was replaced; run fsar-ledger verify"
        )
