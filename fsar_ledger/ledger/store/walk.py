"""The one walk through a ledger: what is at each commit.

It changes nothing and reports damage as findings, not exceptions. Everything that opens a ledger folds this walk. What
each needs from it, and at what cost:

```
reader, info   every record; the first finding refuses the ledger        one small file per commit
writer         as a reader, and where each segment is                    + one look at a name per commit
verify         every finding, and (verify/walk.py) the rows as well      + each segment, read, hashed and decoded
recover        the commits before the first finding, and their rows;     as verify, and the names again
               then what comes after them, and every stray
```

So the walk is lazy and touches no segment: `find_segment` says where one is, `read_segment` whether it is the committed
one. A file means the same to all of them:

```
a link, or no file, in place of a record or a segment        is not read; the commit is in doubt
a link in staging/                                           is no segment: the segment is missing
a link, or no folder, in place of a folder                   holds nothing of the ledger
a file of no commit                                          a stray; in staging/ harmless, as a crash leaves it
a record without its segment, or after a gap                 in doubt, with its number
```
"""

import hashlib
import os
import stat
from collections.abc import Container, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

import msgspec

from fsar_ledger.errors import FsarLedgerError
from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.log.tiles import TILE
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.paths import (
    CHECKPOINT,
    COMMITS,
    MANIFEST,
    SEGMENTS,
    STAGING,
    commit_file,
    commit_name,
    segment_file,
    staged_file,
)
from fsar_ledger.ledger.store.problem import Problem, refusal, unexpected
from fsar_ledger.ledger.store.record import (
    CHAINED,
    VERSION,
    CommitRecord,
    contradictions,
    parse_manifest,
    parse_record,
    sha256_hex,
)

FOLDERS = frozenset({COMMITS, SEGMENTS, STAGING, TILE})
FILES = frozenset({MANIFEST, CHECKPOINT})
MISSING = "nothing"
_MAY_BE_MISSING = frozenset({STAGING, TILE})
_NO_LINK = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK


class Commit(msgspec.Struct, frozen=True):
    """What is at one commit.

    `sha256` is the hash of the record's file, None if it cannot be read; `record` is what it holds, None if that is not
    a record; `before` is the tree that the record before claims, None if there is none. `problems` are all that is
    wrong with the record, by itself and compared with those before it.
    """

    number: int
    sha256: str | None
    record: CommitRecord | None
    before: Frontier | None
    problems: tuple[Problem, ...] = ()


class Stored(Protocol):
    """What is on record about a segment: a record of a commit, or of a placement in a ledger of format 2."""

    @property
    def release(self) -> str:
        """Return the release that has its columns."""

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
    """Where a segment is within the ledger once it is in place, and the file that says so."""

    place: str
    said_by: str


def names_of(number: int) -> Names:
    """Return the names of the segment of this commit of a ledger of format 1."""
    return Names(segment_file(number), commit_file(number))


class FoundSegment(NamedTuple):
    """Where the segment of a commit is: in place, or in staging if its writer was interrupted.

    `status` is that of the file. With a `problem`, no file there can be the segment.
    """

    file: str
    status: os.stat_result | None
    problem: Problem | None = None


def walk(ledger: Path, origin: str | None, previous: str | None, count: int) -> Iterator[Commit]:
    """Yield what is at each of the first `count` commits, in order.

    Args:
        ledger: Its folder.
        origin: The origin in ledger.json; None if unknown.
        previous: The SHA-256 of ledger.json; None if unknown.
        count: How many records there are (see `commit_names`); a missing one is a finding.
    """
    before: Frontier | None = Frontier()
    for number in range(count):
        commit = read_commit(ledger, number, origin, previous, before)
        yield commit
        previous, before = commit.sha256, commit.record.tree() if commit.record is not None else None


def read_commit(
    ledger: Path, number: int, origin: str | None = None, previous: str | None = None, before: Frontier | None = None
) -> Commit:
    """Read one commit, and compare its record with as much as is known of what comes before."""
    where = commit_file(number)
    sha256: str | None = None
    try:
        data = disk.read_document(f"{ledger}/{where}")
        sha256 = sha256_hex(data)
        record = parse_record(where, data)
        return Commit(number, sha256, record, before, tuple(_doubts(number, record, origin, previous, before)))
    except OSError as error:
        problem = Problem(where, f"an unreadable file ({error.strerror})", "a commit record", commit=number)
    except FsarLedgerError as error:
        problem = Problem(where, f"no commit record {refusal(where, error)}", "one as it is written", commit=number)
    except Exception as error:  # a check that fails unexpectedly is still a finding
        problem = unexpected(where, number, error)
    return Commit(number, sha256, None, before, (problem,))


def _doubts(
    number: int, record: CommitRecord, origin: str | None, previous: str | None, before: Frontier | None
) -> Iterator[Problem]:
    """Yield a problem for each field that contradicts the record's place, the file before or the tree before it.

    Whatever is unknown of these is not compared.
    """
    known = {"previous_sha256": previous, "note": origin, "rows": before}
    for name, found, expected in contradictions(record, number, previous or "", origin or "", before or Frontier()):
        if name in known and known[name] is None:
            continue
        because = ""
        if name == "previous_sha256":
            because = f", the SHA-256 of {commit_file(number - 1) if number else MANIFEST}"
        elif name == "note":
            because = f", with the origin of {MANIFEST}"
        wanted = f"{expected}" if name == "release" else f"{expected!r}{because}"  # already worded
        yield Problem(commit_file(number), f"{found!r}", wanted, commit=number, field=name)


def find_segment(ledger: Path, number: int, record: Stored, names: Names | None = None) -> FoundSegment:
    """Find the segment of this commit, or with these names, without reading it. Never raises."""
    names = names or names_of(number)
    place, staged = names.place, staged_file(record.segment_sha256)
    for file in (place, staged, place):  # a writer may move it meanwhile
        try:
            status = os.lstat(f"{ledger}/{file}")
            if file == staged and (not stat.S_ISREG(status.st_mode) or os.path.islink(ledger / STAGING)):
                continue
        except (FileNotFoundError, NotADirectoryError):
            continue
        except OSError as error:
            return FoundSegment(file, None, _no_segment(file, number, record, f"an unreadable file ({error.strerror})"))
        return FoundSegment(file, status, _unfit(file, number, record, status, names.said_by))
    return FoundSegment(place, None, _no_segment(place, number, record, "no segment"))


def _no_segment(file: str, number: int, record: Stored, found: str) -> Problem:
    return Problem(file, found, f"a segment of {record.rows} events", commit=number, field="segment_sha256")


def _unfit(file: str, number: int, record: Stored, status: os.stat_result, said_by: str) -> Problem | None:
    """Return why a file of this kind and size cannot be the segment; None if it can."""
    if not stat.S_ISREG(status.st_mode):
        return _no_segment(file, number, record, "a link or something else than a file")
    if status.st_size != record.segment_bytes:
        expected = f"{record.segment_bytes}, as {said_by} says"
        return Problem(file, f"{status.st_size} bytes", expected, commit=number, field="segment_bytes")
    return None


def read_segment(
    ledger: Path, file: str, number: int, record: Stored, names: Names | None = None, *, is_kept: bool = True
) -> tuple[bytes, Problem | None]:
    """Read this file and check that it is the one that the record names; return its bytes, if `is_kept`, and a problem.

    Raises:
        FileNotFoundError: It is not there, or no longer.
    """
    said_by = (names or names_of(number)).said_by
    try:
        handle = os.open(f"{ledger}/{file}", _NO_LINK)
        with open(handle, "rb") as opened:
            problem = _unfit(file, number, record, os.fstat(handle), said_by)
            if problem is not None:
                return b"", problem
            data = opened.read(record.segment_bytes + 1) if is_kept else b""
            digest = hashlib.sha256(data) if is_kept else hashlib.file_digest(opened, "sha256")
    except FileNotFoundError:
        raise
    except OSError as error:
        return b"", _no_segment(file, number, record, f"an unreadable file ({error.strerror})")
    if digest.hexdigest() != record.segment_sha256:
        expected = f"{record.segment_sha256}, as {said_by} says"
        return b"", Problem(file, f"SHA-256 {digest.hexdigest()}", expected, commit=number, field="segment_sha256")
    return data, None


# --- names ---


def commit_names(ledger: Path) -> list[str]:
    """List the folder of the commit records, sorted; nothing if it is missing or a link.

    A listing may lack a commit that is made meanwhile, and yet hold a later one: then the folder is listed again.

    Raises: OSError if it cannot be listed.
    """
    while True:
        names = names_in(ledger / COMMITS)
        lacking = set(map(commit_name, range(len(names)))).difference(names)
        if not any(os.path.lexists(ledger / COMMITS / name) for name in lacking):
            return names


def check_names(names: Sequence[str]) -> Iterator[Problem]:
    """Yield a problem for each name in the folder of records that is not a record's, or that follows a gap."""
    numbers = numbers_of(names, ".json")
    for name in names:
        if not numbers_of([name], ".json"):
            yield Problem(f"{COMMITS}/{name}", "a stray file", "only records NNNNNNNNNNNN.json")
    missing = min(set(range(len(numbers))) - numbers, default=0)
    for number in sorted(numbers - set(range(len(numbers)))):
        expected = f"numbers below {len(numbers)}, without gaps: {commit_file(missing)} is missing"
        yield Problem(commit_file(number), f"number {number}", expected, commit=number)


def names_in(folder: Path) -> list[str]:
    """List a folder, sorted; nothing if it is missing or a link.

    Raises: OSError if it cannot be read or holds too many names.
    """
    try:
        return [entry.name for entry in disk.entries(folder)] if stat.S_ISDIR(os.lstat(folder).st_mode) else []
    except FileNotFoundError:
        return []


def numbers_of(names: Sequence[str], suffix: str) -> set[int]:
    """Return the numbers of the commits that have a file with this suffix among these names."""
    return {int(name[:12]) for name in names if name[12:] == suffix and name[:12].isascii() and name[:12].isdecimal()}


def check_folders(ledger: Path) -> Iterator[Problem]:
    """Yield a problem for each folder of the ledger that is missing or is not a folder."""
    for name in sorted(FOLDERS):
        try:
            is_folder = stat.S_ISDIR(os.lstat(f"{ledger}/{name}").st_mode)
        except FileNotFoundError:
            if name not in _MAY_BE_MISSING:
                yield Problem(name, MISSING, "a folder of the ledger")
            continue
        if not is_folder:
            yield Problem(name, "a link or something else than a folder", "a folder of the ledger")


def check_manifest(ledger: Path) -> tuple[str | None, bytes | None, Problem | None]:
    """Return the origin and the bytes of ledger.json, each None if it cannot be read, and then the problem."""
    try:
        data = disk.read_document(ledger / MANIFEST)
    except OSError as error:
        found = f"an unreadable file ({error.strerror})" if os.path.lexists(ledger / MANIFEST) else MISSING
        return None, None, Problem(MANIFEST, found, "the description of the ledger")
    try:
        return parse_manifest(Path(MANIFEST), data, (VERSION, CHAINED)).origin, data, None
    except FsarLedgerError as error:
        found = f"no description of a ledger {refusal(MANIFEST, error)}"
        return None, data, Problem(MANIFEST, found, "one as it is written")
    except Exception as error:
        return None, data, unexpected(MANIFEST, None, error)


def strays(ledger: Path, kept: Container[str], folders: Sequence[str] = (COMMITS, SEGMENTS, STAGING)) -> Iterator[str]:
    """Name every file outside `tile/` that is not the ledger's, and what is in place of one of its folders.

    Args:
        ledger: Its folder.
        kept: The names within it that are the ledger's: its files, those of its commits, and committed segments in
            staging.
        folders: Those that are looked into.
    """
    wrong = {problem.where for problem in check_folders(ledger) if problem.found != MISSING}
    yield from (name for name in names_in(ledger) if name in wrong or (name not in FOLDERS and name not in kept))
    for folder in folders:
        yield from (f"{folder}/{name}" for name in names_in(ledger / folder) if f"{folder}/{name}" not in kept)
