"""The longest verified prefix of a ledger, found without changing anything: a part of `recover`.

The prefix is commits 0 to k-1, whose every record, segment, row and hash was derived again and agrees. With a trusted
key it ends with a commit that the key signed; with an anchor, it agrees with the anchor. What comes after is examined
piece by piece.
"""

from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path

import msgspec

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.log.note import VerifierKey, names
from fsar_ledger.ledger.log.tiles import node_of
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.store.derived import tile_reader
from fsar_ledger.ledger.store.paths import CHECKPOINT, COMMITS, MANIFEST, SEGMENTS, commit_file, segment_file
from fsar_ledger.ledger.store.problem import Problem
from fsar_ledger.ledger.store.record import FORMAT, VERSION, CommitRecord, Manifest, parse_manifest, sha256_hex
from fsar_ledger.ledger.store.view import EMPTY_HEAD, Head
from fsar_ledger.ledger.store.walk import (
    MISSING,
    Commit,
    check_folders,
    check_manifest,
    commit_names,
    names_in,
    numbers_of,
    read_commit,
    strays,
    walk,
)
from fsar_ledger.ledger.verify.notes import Anchor, check_anchor
from fsar_ledger.ledger.verify.rederive import Redo, TilePlan, begins_with, checkpoint_note, grown_beyond, tile_strays
from fsar_ledger.ledger.verify.report import Asked, Progress
from fsar_ledger.ledger.verify.segment import examine_file
from fsar_ledger.ledger.verify.walk import RowWalk

FITS = "record and segment fit each other"
NO_RECORD = "no record that can be read"
NO_SEGMENT = "the segment is missing or not as its record says"


class Later(msgspec.Struct, frozen=True):
    """A commit after the trusted ones, judged on its own.

    `restore` is the SHA-256 of its segment if that is lost or altered and all records up to this one are whole: whoever
    has the file with this SHA-256 can put it back as `file` of the ledger.
    """

    number: int
    found: str
    restore: str | None = None
    file: str | None = None


class TrustedPrefix(msgspec.Struct, frozen=True):
    """What can be trusted, and the first doubt after it.

    `manifest` is the right content of ledger.json, None if unknown; `records` are the trusted records and `files` their
    segments within the ledger. `problems` are those of the first commit in doubt, none if the ledger is whole; then
    `redo` and `strays` say what a crash has left. `anchored` counts the events that the anchor vouches for.
    """

    origin: str | None
    manifest: bytes | None
    records: tuple[CommitRecord, ...] = ()
    files: tuple[str, ...] = ()
    problems: tuple[Problem, ...] = ()
    later: tuple[Later, ...] = ()
    anchored: int | None = None
    redo: Redo | None = None
    strays: tuple[str, ...] = ()

    @property
    def head(self) -> Head:
        """Return how far it goes."""
        if not self.records:
            return EMPTY_HEAD
        last = self.records[-1]
        return Head(len(self.records), last.tree_size, last.tree_root, last.last_run)


def find_prefix(
    path: Path, workers: int = 1, progress: Progress | None = None, asked: Asked | None = None
) -> TrustedPrefix:
    """Find how much of the ledger can be trusted. Changes nothing; damage never raises.

    Args:
        path: The directory of the ledger.
        workers: Processes that read segments.
        progress: Called with (segments done, segments in all).
        asked: A key that must have signed, an earlier checkpoint.

    Raises:
        NotALedger, FormatVersionMismatch: ledger.json is of something else, and the records cannot tell what it was.
    """
    search = _Search(path, asked or Asked())
    return search.prefix(search.go(workers, progress))


class _Search:
    """One walk from the first commit to the first that is in doubt."""

    def __init__(self, path: Path, asked: Asked) -> None:
        self.path, self.trusted = path, asked.trusted
        self.names = commit_names(path)
        self.problems = [
            problem
            for problem in check_folders(path)
            if problem.where in (COMMITS, SEGMENTS)
            and problem.found != MISSING  # other folders, and missing ones, are made again
        ]
        self.origin, self.manifest = _right_manifest(path, self.problems)
        self.chain: list[CommitRecord] = []  # records without doubt
        self.files: list[str] = []  # segments without doubt
        self.plan = TilePlan(path)
        self.anchor, self.anchors = (
            asked.anchor,
            [*([asked.anchor] if asked.anchor else []), *_signed_checkpoint(path, asked.trusted)],
        )
        self.rows = RowWalk(path, {anchor.note.checkpoint.size for anchor in self.anchors if anchor.note is not None})

    def go(self, workers: int, progress: Progress | None) -> list[Problem]:
        """Check the records, then the rows of those without doubt; return the first doubt."""
        commits, broken = self._whole_records()
        for standing in self.rows.over(commits, workers):
            if standing.problems or standing.edge is None:
                return list(standing.problems)
            self.plan.compare(self.plan.add(Redo(standing.commit.number, standing.edge), standing.made))
            self.files.append(standing.facts.file)
            if progress is not None:
                progress(len(self.files), len(commits))
        return broken

    def _whole_records(self) -> tuple[list[Commit], list[Problem]]:
        """Return the commits whose records fit each other, and the problems of the first whose record does not."""
        commits: list[Commit] = []
        if self.manifest is None:
            return commits, []
        for commit in walk(self.path, self.origin, sha256_hex(self.manifest), len(numbers_of(self.names, ".json"))):
            if commit.record is None or commit.problems:
                return commits, list(commit.problems)
            commits.append(commit)
            self.chain.append(commit.record)
        return commits, []

    def prefix(self, doubts: list[Problem]) -> TrustedPrefix:
        """Combine what the walk found with what the key, the anchor and the files beside the commits say."""
        problems = self.problems + doubts
        kept = len(self.files)
        is_cut = False
        signed, doubt = self._signed(kept)
        if doubt is not None:
            kept, problems, is_cut = signed, [doubt, *problems], True
        for anchor in self.anchors:
            contradiction, is_beyond = self._ask(anchor, is_whole=not problems)
            if contradiction:
                kept, is_cut = (kept if is_beyond else 0), True
                problems = [*contradiction, *problems]
        found = TrustedPrefix(
            self.origin,
            self.manifest,
            tuple(self.chain[:kept]),
            tuple(self.files[:kept]),
            tuple(problems),
        )
        if not problems:
            found = msgspec.structs.replace(found, problems=tuple(self._grown_beyond(found.head)))
        if found.problems:
            return msgspec.structs.replace(
                found, later=tuple(self._later(kept, is_cut=is_cut)), anchored=self._anchored(found.head)
            )
        partial = self.plan.partial()
        self.plan.compare(partial)
        strays = (*_strays(self.path, found), *tile_strays(self.path, found.head, partial))
        return msgspec.structs.replace(found, redo=self.plan.redo(), strays=strays, anchored=self._anchored(found.head))

    def _signed(self, kept: int) -> tuple[int, Problem | None]:
        """Return how many of these commits the trusted key vouches for, and why not for more."""
        if self.trusted is None or self.problems:
            return kept, None
        signed, found = 0, "no signature of it"
        for number, note in enumerate(record.signed_note() for record in self.chain[:kept]):
            if self.trusted.has_signed(note):
                signed = number + 1
            elif names(note, self.trusted):
                found = "a signature that this key did not make"
                break
        if kept and signed == kept:
            return kept, None
        expected = f"a note signed by {self.trusted.key}, the trusted key"
        return signed, Problem(
            commit_file(signed), found if kept else "no commit", expected, commit=signed, field="note"
        )

    def _ask(self, anchor: Anchor, *, is_whole: bool) -> tuple[list[Problem], bool]:
        """Return how an anchor contradicts what was verified, and whether it counts more events and so cannot."""
        size = self.chain[len(self.files) - 1].tree_size if self.files else 0
        if self.origin is None or anchor.note is None:
            return [], False
        is_beyond = anchor.note.checkpoint.size > size
        if is_beyond and not is_whole:
            return [], True
        return check_anchor(
            anchor, self.origin, size, self.rows.roots.get(anchor.note.checkpoint.size), self.trusted
        ), is_beyond

    def _anchored(self, head: Head) -> int | None:
        """Count the trusted events that the given anchor vouches for."""
        note = self.anchor.note if self.anchor is not None else None
        if self.anchor is None or note is None:
            return None
        then = note.checkpoint
        if then.size <= head.size:
            return None if self._ask(self.anchor, is_whole=True)[0] else then.size
        nodes = partial(node_of, tile_reader(self.path))
        is_own = not check_anchor(self.anchor, self.origin, then.size, then.root, self.trusted)
        return head.size if is_own and begins_with(nodes, then, head.size, head.root) else None

    def _grown_beyond(self, head: Head) -> Iterator[Problem]:
        """Yield the evidence that the newest commits were removed."""
        yield from grown_beyond(self.path, head, self.origin or "")
        for number in sorted(self._segments()):
            if number >= head.commits:
                expected = "its commit record, which was there before: the newest commits were removed"
                yield Problem(segment_file(number), "a segment of no commit", expected, commit=head.commits)

    def _segments(self) -> set[int]:
        """Return the numbers of the commits that have a segment in place."""
        return numbers_of(names_in(self.path / SEGMENTS), ".parquet")

    def _later(self, kept: int, *, is_cut: bool) -> Iterator[Later]:
        """Yield each commit after the trusted ones, examined on its own."""
        for number in sorted(numbers_of(self.names, ".json") | self._segments()):
            if number < kept:
                continue
            record = read_commit(self.path, number).record
            if record is None:
                yield Later(number, NO_RECORD)
                continue
            is_known = number < len(self.chain) and not is_cut
            yield (
                Later(number, NO_SEGMENT, *((record.segment_sha256, segment_file(number)) if is_known else ()))
                if examine_file(str(self.path), number, record).problems
                else Later(number, FITS)
            )


def _right_manifest(path: Path, problems: list[Problem]) -> tuple[str | None, bytes | None]:
    """Return the origin and the right content of ledger.json, each None if unknown.

    The first record vouches for them.

    Raises:
        NotALedger, FormatVersionMismatch: They are of something else, and the first record cannot tell what they were.
    """
    origin, data, problem = check_manifest(path)
    first = read_commit(path, 0).record
    if first is not None and (data is None or sha256_hex(data) != first.previous_sha256):
        again = _manifest_of(first)
        if again is not None:
            return first.signed_note().checkpoint.origin, again
    if problem is None:
        return origin, data
    if data is not None:
        with suppress(LedgerCorrupted):
            parse_manifest(Path(MANIFEST), data)
    problems.append(problem)
    return None, None


def _manifest_of(first: CommitRecord) -> bytes | None:
    """Return the content of ledger.json, if this first record vouches for it."""
    try:
        data = canonical.document(Manifest(FORMAT, first.signed_note().checkpoint.origin, VERSION))
    except LedgerCorrupted:
        return None
    return data if sha256_hex(data) == first.previous_sha256 else None


def _signed_checkpoint(path: Path, trusted: VerifierKey | None) -> list[Anchor]:
    """Return the ledger's own checkpoint if the trusted key signed it.

    It then vouches like one that was kept elsewhere.
    """
    note = checkpoint_note(path)
    return [Anchor(CHECKPOINT, note)] if note is not None and trusted is not None and trusted.has_signed(note) else []


def _strays(path: Path, found: TrustedPrefix) -> Iterator[str]:
    """Name every file that is not the ledger's, except below `tile/`."""
    numbers = range(len(found.records))
    own = {MANIFEST, *((CHECKPOINT,) if found.records else ()), *found.files}
    return strays(path, own.union(map(commit_file, numbers), map(segment_file, numbers)))
