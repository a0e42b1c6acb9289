"""Everything a ledger says about itself, derived again from its rows and compared.

What this proves without a signature or an anchor: nothing was altered, removed or added *inside* the ledger
that its last commit record vouches for. Who rewrites every record, or removes the newest ones, is not caught;
that needs the signature or an earlier checkpoint kept elsewhere.
"""

import os
import stat
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import repeat
from pathlib import Path
from typing import Literal

import msgspec

from fsar_ledger.errors import FsarLedgerError, NotALedger
from fsar_ledger.ledger import disk, merkle
from fsar_ledger.ledger.merkle import Frontier
from fsar_ledger.ledger.record import (
    COMMITS,
    MANIFEST,
    SEGMENTS,
    STAGING,
    CommitRecord,
    commit_path,
    contradictions,
    parse_manifest,
    parse_record,
    segment_path,
    sha256_hex,
    staged_path,
)
from fsar_ledger.ledger.verify_segment import Problem, SegmentFacts, examine, unexpected
from fsar_ledger.workers import WorkerPool

MAX_PROBLEMS = 100
"""A report names the first so many; a ledger with more is lost anyway."""


class VerifyReport(msgspec.Struct, frozen=True):
    """What `verify` found. Units: `commits`, `events` and `runs` are counts of what was read without doubt.

    `root` is the Merkle root in hex over the rows themselves, None if some could not be read.
    """

    ok: bool
    problems: tuple[Problem, ...]
    commits: int
    events: int
    runs: int
    root: str | None
    signature: Literal["unsigned"] = "unsigned"


class _Commit(msgspec.Struct, frozen=True):
    """One commit as its file says; None where it could not be read."""

    number: int
    data: bytes | None
    record: CommitRecord | None


def verify(path: Path, workers: int = 1, progress: Callable[[int, int], None] | None = None) -> VerifyReport:
    """Every field of every record was derived again, and every difference is a problem of the report.

    Damage never raises, whatever the files hold. Symbolic links are refused as damage.

    Args:
        path: The directory of the ledger.
        workers: Processes that read segments.
        progress: Called with (segments done, segments in all).

    Raises:
        NotALedger: There is no directory at the path, or nothing of a ledger is in it.
    """
    if not os.path.isdir(path) or not any(os.path.lexists(path / name) for name in (MANIFEST, COMMITS, SEGMENTS)):
        raise NotALedger(f"{path}: found no ledger there, expected its directory; give the path that `fsar-ledger simulate` wrote to")
    problems: list[Problem] = []
    try:
        return _verify(path, max(1, workers), progress, problems)
    except (Exception, RecursionError) as error:  # a check that fails in a way nobody thought of is still a finding
        problems.append(unexpected(str(path), None, error))
        return VerifyReport(False, tuple(problems), 0, 0, 0, None)


def _verify(path: Path, workers: int, progress: Callable[[int, int], None] | None, problems: list[Problem]) -> VerifyReport:
    problems += _check_folder(path)
    origin, previous = _check_manifest(path, problems)
    commits = _read_commits(path, problems)
    tree: Frontier | None = Frontier()  # None: not known, because a record or segment before could not be read
    runs: set[str] = set()
    verified = events = 0
    for commit, facts in zip(commits, _examine_all(path, commits, workers), strict=True):
        before = len(problems)
        if commit.record is None:
            tree = None
        else:
            known = tree if tree is not None else _claimed_before(commits, commit.number)
            problems += _check_record(commit.number, commit.record, previous, origin, known)
            problems += facts.problems
            tree = _check_tree(commit.number, commit.record, known, facts, problems)
            problems += _check_runs(commit, facts, runs)
        previous = sha256_hex(commit.data) if commit.data is not None else None
        if len(problems) == before:
            verified, events = verified + 1, events + facts.rows
        if progress is not None:
            progress(commit.number + 1, len(commits))
    problems += _check_strays(path, len(commits))
    root = (tree.root() if commits and tree is not None else merkle.EMPTY_ROOT).hex() if not problems else None
    return VerifyReport(not problems, tuple(problems[:MAX_PROBLEMS]), verified, events, len(runs), root)


def _check_folder(path: Path) -> Iterator[Problem]:
    """The ledger holds its folders and ledger.json, and nothing else."""
    folders = {COMMITS, SEGMENTS, STAGING}
    found = set()
    for entry in sorted(os.scandir(path), key=lambda entry: entry.name):
        found.add(entry.name)
        if entry.name not in folders | {MANIFEST}:
            yield Problem(entry.name, "an unknown file", f"only {MANIFEST}, {COMMITS}, {SEGMENTS} and {STAGING}; take it away")
        elif not (entry.is_dir(follow_symlinks=False) if entry.name in folders else entry.is_file(follow_symlinks=False)):
            yield Problem(entry.name, "something else, or a link", "a folder" if entry.name in folders else "a file")
    for name in sorted((folders | {MANIFEST}) - found - {STAGING}):
        yield Problem(name, "nothing", "a file" if name == MANIFEST else "a folder")


def _check_manifest(path: Path, problems: list[Problem]) -> tuple[str | None, str | None]:
    """The origin and the SHA-256 of ledger.json; None where it cannot be read."""
    try:
        data = disk.read_document(path / MANIFEST)
    except OSError as error:
        if os.path.lexists(path / MANIFEST):
            problems.append(Problem(MANIFEST, f"an unreadable file ({error.strerror})", "the description of the ledger"))
        return None, None
    try:
        return parse_manifest(Path(MANIFEST), data).origin, sha256_hex(data)
    except FsarLedgerError as error:
        problems.append(Problem(MANIFEST, str(error), "the description of the ledger"))
    except Exception as error:
        problems.append(unexpected(MANIFEST, None, error))
    return None, sha256_hex(data)


def _read_commits(path: Path, problems: list[Problem]) -> list[_Commit]:
    """Every commit from 0 to the last whose record exists; gaps and strays are problems."""
    numbers = set()
    for entry in _entries(path / COMMITS):
        stem, _, suffix = entry.name.partition(".")
        if suffix == "json" and len(stem) == 12 and stem.isascii() and stem.isdecimal():
            numbers.add(int(stem))
        else:
            problems.append(Problem(f"{COMMITS}/{entry.name}", "a stray file", "only records NNNNNNNNNNNN.json"))
    count = len(numbers)
    gaps = sorted(numbers - set(range(count)))
    problems += [Problem(f"{COMMITS}/{number:012d}.json", f"number {number}", f"numbers below {count}, without gaps", commit=number) for number in gaps]
    return [_read_commit(path, number, problems) for number in range(count)]


def _read_commit(path: Path, number: int, problems: list[Problem]) -> _Commit:
    """The commit as its file says, as far as that can be read."""
    where = f"{COMMITS}/{number:012d}.json"
    data: bytes | None = None
    try:
        data = disk.read_document(commit_path(path, number))
        return _Commit(number, data, parse_record(Path(where), data))
    except OSError as error:
        problems.append(Problem(where, f"an unreadable file ({error.strerror})", "a commit record", commit=number))
    except FsarLedgerError as error:
        problems.append(Problem(where, str(error), "the canonical JSON of a commit record", commit=number))
    except Exception as error:
        problems.append(unexpected(where, number, error))
    return _Commit(number, data, None)


def _entries(folder: Path) -> list["os.DirEntry[str]"]:
    """What is in the folder, by name; nothing if it is not one."""
    if folder.is_symlink() or not folder.is_dir():
        return []
    return sorted(os.scandir(folder), key=lambda entry: entry.name)


def _examine_all(path: Path, commits: list[_Commit], workers: int) -> Iterator[SegmentFacts]:
    """What each segment holds, in order; nothing of those whose record is unreadable."""
    files = [_segment_file(path, commit) for commit in commits]
    records = [commit.record for commit in commits]
    numbers = range(len(commits))
    with ExitStack() as stack:
        if workers > 1 and len(commits) > 1:
            pool = stack.enter_context(WorkerPool(min(workers, len(commits))))
            yield from pool.map(examine, files, repeat(str(path)), numbers, records)
        else:
            yield from map(examine, files, repeat(str(path)), numbers, records)


def _segment_file(path: Path, commit: _Commit) -> str:
    """Where the segment is, within the ledger: in place, or in staging where its writer was interrupted."""
    place = segment_path(path, commit.number)
    if commit.record is not None and not os.path.lexists(place):
        staged = staged_path(path, commit.record.segment_sha256)
        if staged.exists() and stat.S_ISREG(staged.lstat().st_mode):
            return str(staged.relative_to(path))
    return str(place.relative_to(path))


def _claimed_before(commits: list[_Commit], number: int) -> Frontier | None:
    """The tree that the record before this one claims, where the rows before it could not be read."""
    record = commits[number - 1].record if number else None
    return record.tree() if record is not None else None


def _check_record(number: int, record: CommitRecord, previous: str | None, origin: str | None, before: Frontier | None) -> Iterator[Problem]:
    """The record agrees with its place, the file before it and the tree before it, as far as those are known."""
    unknown = {name for name, is_unknown in (("previous_sha256", previous is None), ("note", origin is None), ("rows", before is None)) if is_unknown}
    for name, found, expected in contradictions(record, number, previous or "", origin or "", before or Frontier()):
        if name not in unknown:
            because = f", the SHA-256 of {COMMITS}/{number - 1:012d}.json" if number else f", the SHA-256 of {MANIFEST}"
            because = because if name == "previous_sha256" else f", with the origin of {MANIFEST}" if name == "note" else ""
            yield Problem(f"{COMMITS}/{number:012d}.json", f"{found!r}", f"{expected!r}{because}", commit=number, field=name)


def _check_tree(number: int, record: CommitRecord, before: Frontier | None, facts: SegmentFacts, problems: list[Problem]) -> Frontier | None:
    """The tree after this commit: that of the rows if they could be read and agree, else the claimed one, so that each error shows once."""
    claimed = record.tree()
    if before is None or facts.leaves is None:
        return claimed
    tree = before.extend(facts.leaves)
    if tree.size != claimed.size:
        problems.append(Problem(f"{COMMITS}/{number:012d}.json", f"{claimed.size}", f"{tree.size} leaves", commit=number, field="tree_size"))
    elif tree != claimed:
        problems.append(
            Problem(facts.file, f"Merkle root {tree.root().hex()}", f"{record.tree_root} as committed: a row was altered", commit=number, field="tree_root")
        )
    return claimed


def _check_runs(commit: _Commit, facts: SegmentFacts, runs: set[str]) -> Iterator[Problem]:
    """The runs are those of the record, and in no other commit."""
    if facts.runs is None or commit.record is None:
        return
    where = f"{COMMITS}/{commit.number:012d}.json"
    for name, found, expected in (("first_run", commit.record.first_run, facts.runs[0]), ("last_run", commit.record.last_run, facts.runs[-1])):
        if found != expected:
            yield Problem(where, repr(found), repr(expected), commit=commit.number, field=name)
    again = next((run for run in facts.runs if run in runs), None)
    if again is not None:
        yield Problem(facts.file, f"run {again} once more", "each run in one commit", commit=commit.number, run=again, seq=0, field="run_id")
    runs.update(facts.runs)


def _check_strays(path: Path, count: int) -> Iterator[Problem]:
    """No segment is there without its commit."""
    expected = {segment_path(path, number).name for number in range(count)}
    for entry in _entries(path / SEGMENTS):
        if entry.name not in expected:
            yield Problem(f"{SEGMENTS}/{entry.name}", "a file of no commit", f"segments of {count} commits; restore the record or take it away")
