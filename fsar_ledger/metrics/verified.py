"""The heads whose rows a whole look has compared with their root.

Remembered beside the user's other caches, never in a ledger.

A name is all that is remembered: a SHA-256 over the hash of the newest commit record, which vouches for every segment's
hash, and the versions of all that read the rows. Whoever opens a ledger with that record, and compares its segments
with their hashes, has the very bytes that were looked at.

Exactly that head counts. After a commit more it is another: what the look saw is then a part of the rows, and no answer
says which part it came from. The memory is of this user on this machine, who could as well change the program; nobody
else's is believed, and to lose it costs one more look.
"""

import hashlib
import os
import secrets
import stat
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import msgspec

from fsar_ledger import __version__
from fsar_ledger.errors import LedgerCorrupted, SequenceConflict, UsageError
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.paths import require_outside
from fsar_ledger.ledger.store.read import LedgerView
from fsar_ledger.ledger.verify.verify import Asked, VerifyReport, verify

_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH


def whole_look(
    ledger: Path, workers: int = 1, progress: Callable[[int, int], None] | None = None, asked: Asked | None = None
) -> VerifyReport:
    """The report of `verify`; where it read the rows and doubts nothing, the head is remembered.

    Raises: as `verify`.
    """
    asked = asked or Asked()
    if not asked.is_quick:
        from .second_reader import read_again  # DuckDB, which a proof does without

        asked = msgspec.structs.replace(asked, second_reader=read_again)
    report = verify(ledger, workers, progress, asked)
    if report.record_sha256 is not None and not report.is_quick:
        _remember(report.record_sha256)
    return report


def required_look(ledger: Path, workers: int = 1, progress: Callable[[int, int], None] | None = None) -> str:
    """The SHA-256 of the newest record of this ledger, after a whole look that doubts nothing; for `is_verified`.

    Raises:
        LedgerCorrupted: The look doubts something; the message names the first problem.
        NotALedger: As `verify`.
    """
    report = whole_look(ledger, workers, progress)
    if report.record_sha256 is None:
        first, *others = report.problems
        more = f" ({len(others)} more of these)" if others else ""
        raise LedgerCorrupted(
            f"{ledger}: {first}{more}; no answer is given from rows that are not those under the root, run fsar-ledger "
            "verify"
        )
    return report.record_sha256


def is_verified(view: LedgerView, demanded: str | None = None) -> bool:
    """Whether the rows of this head, where its segments are as committed, are known to be those under its root.

    Args:
        view: The opened ledger.
        demanded: The newest record that `required_look` just saw, where no other head will do.

    Raises:
        SequenceConflict: The view is of another head than the one that is demanded.
    """
    if demanded is not None and view.record_sha256 != demanded:
        raise SequenceConflict(
            f"{view.path}: found another newest commit than a moment ago, when its rows were compared with its root; "
            "run it again"
        )
    return demanded is not None or not view.records or is_remembered(view.record_sha256)


def is_remembered(record_sha256: str) -> bool:
    """Return whether this user's `verify`, with these versions, found nothing in a ledger with this newest record."""
    file = _place(record_sha256)
    if file is None or not _is_own(file.parent):
        return False
    try:
        return _is_safe(file.lstat()) and disk.read_document(file) == _line(record_sha256)
    except OSError:
        return False


def _remember(record_sha256: str) -> None:
    """The head is remembered, if it can be: without memory the next answer only says less."""
    file = _place(record_sha256)
    if file is None:
        return
    folder = file.parent
    temporary = folder / f"{secrets.token_hex(8)}.part"
    with suppress(OSError, UsageError):
        require_outside(temporary, "the cache")
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not _is_own(folder):
            return
        try:
            with open(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o600), "wb") as written:
                written.write(_line(record_sha256))
            os.replace(temporary, file)
        finally:
            temporary.unlink(missing_ok=True)


def _folder() -> Path | None:
    """The user's cache of this program: `$XDG_CACHE_HOME/fsar-ledger`, else `~/.cache/fsar-ledger`.

    None where there is no home.
    """
    named = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(named):  # the specification ignores any other
        return Path(named) / "fsar-ledger"
    try:
        return Path.home() / ".cache" / "fsar-ledger"
    except RuntimeError:
        return None


def _is_own(folder: Path) -> bool:
    """Whether this is a folder, and not a link to one, into which nobody but this user can put anything."""
    try:
        status = folder.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(status.st_mode) and _is_safe(status)


def _is_safe(status: os.stat_result) -> bool:
    return status.st_uid == os.geteuid() and not status.st_mode & _BY_OTHERS


def _place(record_sha256: str) -> Path | None:
    """The file by which a head is remembered.

    None where there is no cache, or nobody knows which versions read the rows.
    """
    folder = _folder()
    try:
        read_by = (f"fsar-ledger {__version__}", *(f"{name} {version(name)}" for name in ("pyarrow", "duckdb")))
    except PackageNotFoundError:
        return None
    return folder and folder / hashlib.sha256("\n".join([record_sha256, *read_by]).encode()).hexdigest()


def _line(record_sha256: str) -> bytes:
    """All that the file of a head holds: half of it, after a full disk, is no memory."""
    return f"{record_sha256}\n".encode()
