"""Find and read the segments of a ledger, and detect what is wrong with their files.

It changes nothing and reports damage as problems, not exceptions:

```
a link, or no file, in place of a segment      is not read; the segment is in doubt
a link in staging/                             is not a segment: the segment is missing
```
"""

import hashlib
import os
import stat
from pathlib import Path
from typing import NamedTuple, Protocol

from fsar_ledger.base.errors import FsarLedgerError
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.manifest import parse_manifest
from fsar_ledger.ledger.store.paths import MANIFEST, STAGING, staged_file
from fsar_ledger.ledger.store.problem import Problem, refusal, unexpected

MISSING = "nothing"


class Stored(Protocol):
    """The recorded properties of a segment."""

    @property
    def release(self) -> str:
        """Return the release whose columns it has."""

    @property
    def schema_sha256(self) -> str:
        """Return the fingerprint of its columns."""

    @property
    def segment_sha256(self) -> str:
        """Return the hash of its file."""

    @property
    def segment_bytes(self) -> int:
        """Return the size of its file in bytes."""

    @property
    def rows(self) -> int:
        """Return the number of its events."""


class Names(NamedTuple):
    """The final path of a segment within the ledger, and the file that records it."""

    place: str
    said_by: str


class FoundSegment(NamedTuple):
    """The location of a segment: in place, or in staging if its writer was interrupted.

    `status` is that of the file. With a `problem`, no file there can be the segment.
    """

    file: str
    status: os.stat_result | None
    problem: Problem | None = None


def find_segment(ledger: Path, number: int, record: Stored, names: Names) -> FoundSegment:
    """Find the segment with these names, without reading it. Never raises."""
    in_place, staged = names.place, staged_file(record.segment_sha256)
    for file in (in_place, staged, in_place):  # a writer may move it meanwhile
        try:
            status = os.lstat(f"{ledger}/{file}")
            if file == staged and (not stat.S_ISREG(status.st_mode) or os.path.islink(ledger / STAGING)):
                continue
        except (FileNotFoundError, NotADirectoryError):
            continue
        except OSError as error:
            return FoundSegment(file, None, _no_segment(file, number, record, f"an unreadable file ({error.strerror})"))
        return FoundSegment(file, status, _unfit(file, number, record, status, names.said_by))
    return FoundSegment(in_place, None, _no_segment(in_place, number, record, "no segment"))


def _no_segment(file: str, number: int, record: Stored, found: str) -> Problem:
    return Problem(file, found, f"a segment of {record.rows} events", commit=number, field="segment_sha256")


def _unfit(file: str, number: int, record: Stored, status: os.stat_result, said_by: str) -> Problem | None:
    """Return why a file of this kind and size cannot be the segment; None if it can."""
    if not stat.S_ISREG(status.st_mode):
        return _no_segment(file, number, record, "a link or not a regular file")
    if status.st_size != record.segment_bytes:
        expected = f"{record.segment_bytes}, as {said_by} says"
        return Problem(file, f"{status.st_size} bytes", expected, commit=number, field="segment_bytes")
    return None


def read_segment(
    ledger: Path, file: str, number: int, record: Stored, names: Names, *, is_kept: bool = True
) -> tuple[bytes, Problem | None]:
    """Read this file and check that it is the recorded one; return its bytes, if `is_kept`, and any problem.

    Raises:
        FileNotFoundError: It does not exist, or no longer.
    """
    said_by = names.said_by
    try:
        handle = os.open(f"{ledger}/{file}", disk.READ)
        with open(handle, "rb") as stream:
            problem = _unfit(file, number, record, os.fstat(handle), said_by)
            if problem is not None:
                return b"", problem
            data = stream.read(record.segment_bytes + 1) if is_kept else b""
            digest = hashlib.sha256(data) if is_kept else hashlib.file_digest(stream, "sha256")
    except FileNotFoundError:
        raise
    except OSError as error:
        return b"", _no_segment(file, number, record, f"an unreadable file ({disk.reason(error)})")
    if digest.hexdigest() != record.segment_sha256:
        expected = f"{record.segment_sha256}, as {said_by} says"
        return b"", Problem(file, f"SHA-256 {digest.hexdigest()}", expected, commit=number, field="segment_sha256")
    return data, None


def names_in(folder: Path) -> list[str]:
    """Return the sorted names in a folder; none if it is missing or a link.

    Raises: LedgerCorrupted if it cannot be read or holds too many names.
    """
    try:
        return [entry.name for entry in disk.entries(folder)] if stat.S_ISDIR(os.lstat(folder).st_mode) else []
    except FileNotFoundError:
        return []
    except OSError as error:
        raise disk.unreadable(folder, error) from error


def check_manifest(ledger: Path) -> tuple[str | None, bytes | None, Problem | None]:
    """Return the origin and the bytes of ledger.json, each None if it cannot be read, and the problem if any."""
    try:
        data = disk.read_document(ledger / MANIFEST)
    except OSError as error:
        reason = f"an unreadable file ({error.strerror})" if os.path.lexists(ledger / MANIFEST) else MISSING
        return None, None, Problem(MANIFEST, reason, "the description of the ledger")
    try:
        return parse_manifest(Path(MANIFEST), data).origin, data, None
    except FsarLedgerError as error:
        reason = f"no description of a ledger {refusal(MANIFEST, error)}"
        return None, data, Problem(MANIFEST, reason, "one as it is written")
    except Exception as error:
        return None, data, unexpected(MANIFEST, None, error)
