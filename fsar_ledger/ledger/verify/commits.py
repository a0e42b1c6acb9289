"""The files of a ledger and its chain of records, read without doubt or named: what `verify` looks at before any rows."""

import os
import stat
from collections.abc import Iterator
from pathlib import Path

import msgspec

from fsar_ledger.errors import FsarLedgerError
from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.log.tiles import TILE
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.derived import CHECKPOINT
from fsar_ledger.ledger.store.problem import Problem, refusal, unexpected
from fsar_ledger.ledger.store.read import commit_names
from fsar_ledger.ledger.store.record import (
    COMMITS,
    MANIFEST,
    SEGMENTS,
    STAGING,
    CommitRecord,
    contradictions,
    parse_manifest,
    parse_record,
    sha256_hex,
    staged_path,
)


class Commit(msgspec.Struct, frozen=True):
    """One commit as its file says; None where it could not be read."""

    number: int
    sha256: str | None
    record: CommitRecord | None


_FOLDERS = frozenset({COMMITS, SEGMENTS, STAGING, TILE})
_FILES = frozenset({MANIFEST, CHECKPOINT})
_MAY_BE_MISSING = frozenset({STAGING, TILE, CHECKPOINT})  # what is derived has a check of its own


def check_folder(path: Path) -> Iterator[Problem]:
    """The ledger holds its folders and files, and nothing else."""
    known = ", ".join(sorted(_FOLDERS | _FILES))
    found = set()
    for entry in disk.entries(path):
        found.add(entry.name)
        if entry.name not in _FOLDERS | _FILES:
            yield Problem(entry.name, "an unknown file", f"only {known}; take it away")
        elif not (
            entry.is_dir(follow_symlinks=False) if entry.name in _FOLDERS else entry.is_file(follow_symlinks=False)
        ):
            yield Problem(entry.name, "something else, or a link", "a folder" if entry.name in _FOLDERS else "a file")
    for name in sorted((_FOLDERS | _FILES) - found - _MAY_BE_MISSING):
        yield Problem(name, "nothing", "a file" if name in _FILES else "a folder")


def check_manifest(path: Path, problems: list[Problem]) -> tuple[str | None, str | None]:
    """The origin and the SHA-256 of ledger.json; None where it cannot be read."""
    try:
        data = disk.read_document(path / MANIFEST)
    except OSError as error:
        if os.path.lexists(path / MANIFEST):
            problems.append(
                Problem(MANIFEST, f"an unreadable file ({error.strerror})", "the description of the ledger")
            )
        return None, None
    try:
        return parse_manifest(Path(MANIFEST), data).origin, sha256_hex(data)
    except FsarLedgerError as error:
        problems.append(
            Problem(MANIFEST, f"no description of a ledger {refusal(MANIFEST, error)}", "one as it is written")
        )
    except Exception as error:
        problems.append(unexpected(MANIFEST, None, error))
    return None, sha256_hex(data)


def read_commits(path: Path, problems: list[Problem]) -> list[Commit]:
    """Every commit from 0 to the last whose record exists; gaps and strays are problems."""
    numbers = set()
    for name in commit_names(path) if entries(path / COMMITS) else ():
        stem, _, suffix = name.partition(".")
        if suffix == "json" and len(stem) == 12 and stem.isascii() and stem.isdecimal():
            numbers.add(int(stem))
        else:
            problems.append(Problem(f"{COMMITS}/{name}", "a stray file", "only records NNNNNNNNNNNN.json"))
    count = len(numbers)
    gaps = sorted(numbers - set(range(count)))
    problems += [
        Problem(
            f"{COMMITS}/{number:012d}.json", f"number {number}", f"numbers below {count}, without gaps", commit=number
        )
        for number in gaps
    ]
    return [_read_commit(path, number, problems) for number in range(count)]


def _read_commit(path: Path, number: int, problems: list[Problem]) -> Commit:
    """The commit as its file says, as far as that can be read."""
    where = f"{COMMITS}/{number:012d}.json"
    sha256: str | None = None
    try:
        data = disk.read_document(f"{path}/{where}")
        sha256 = sha256_hex(data)
        return Commit(number, sha256, parse_record(where, data))
    except OSError as error:
        problems.append(Problem(where, f"an unreadable file ({error.strerror})", "a commit record", commit=number))
    except FsarLedgerError as error:
        problems.append(
            Problem(where, f"no commit record {refusal(where, error)}", "one as it is written", commit=number)
        )
    except Exception as error:
        problems.append(unexpected(where, number, error))
    return Commit(number, sha256, None)


def entries(folder: Path) -> list["os.DirEntry[str]"]:
    """What is in the folder, by name; nothing if it is not one. Raises: OSError if it cannot be read or holds too much."""
    return disk.entries(folder) if folder.is_dir() and not folder.is_symlink() else []


def segment_file(path: Path, commit: Commit) -> str:
    """Where the segment is, within the ledger: in place, or in staging where its writer was interrupted."""
    place = f"{SEGMENTS}/{commit.number:012d}.parquet"
    if commit.record is not None and not os.path.lexists(f"{path}/{place}"):
        staged = staged_path(path, commit.record.segment_sha256)
        if staged.exists() and stat.S_ISREG(staged.lstat().st_mode):
            return str(staged.relative_to(path))
    return place


def check_record(
    number: int, record: CommitRecord, previous: str | None, origin: str | None, before: Frontier | None
) -> Iterator[Problem]:
    """The record agrees with its place, the file before it and the tree before it, as far as those are known."""
    unknown = {
        name
        for name, is_unknown in (
            ("previous_sha256", previous is None),
            ("note", origin is None),
            ("rows", before is None),
        )
        if is_unknown
    }
    for name, found, expected in contradictions(record, number, previous or "", origin or "", before or Frontier()):
        if name not in unknown:
            because = f", the SHA-256 of {COMMITS}/{number - 1:012d}.json" if number else f", the SHA-256 of {MANIFEST}"
            because = (
                because if name == "previous_sha256" else f", with the origin of {MANIFEST}" if name == "note" else ""
            )
            yield Problem(
                f"{COMMITS}/{number:012d}.json", f"{found!r}", f"{expected!r}{because}", commit=number, field=name
            )


def check_strays(path: Path, count: int) -> Iterator[Problem]:
    """No segment is there without its commit."""
    expected = {f"{number:012d}.parquet" for number in range(count)}
    for entry in entries(path / SEGMENTS):
        if entry.name not in expected:
            yield Problem(
                f"{SEGMENTS}/{entry.name}",
                "a file of no commit",
                f"segments of {count} commits; restore the record or take it away",
            )
