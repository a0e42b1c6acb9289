"""How much of a ledger can be trusted, found without changing anything: the longest verified prefix. A part of `recover`.

The prefix is commits 0 to k-1 of which every record, segment, row and hash was derived again and agrees; with a trusted key it
ends with a commit that the key signed, and with an anchor it agrees with it. What comes after is looked at piece by piece.
"""

import os
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import count, repeat
from pathlib import Path

import msgspec

from fsar_ledger.errors import FsarLedgerError, LedgerCorrupted
from fsar_ledger.ledger.log import merkle
from fsar_ledger.ledger.log.merkle import HASH_BYTES, Frontier
from fsar_ledger.ledger.log.note import VerifierKey, names
from fsar_ledger.ledger.log.tiles import TILE, Edge
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.derived import CHECKPOINT
from fsar_ledger.ledger.store.problem import Problem, refusal, unexpected
from fsar_ledger.ledger.store.read import EMPTY_HEAD, Head
from fsar_ledger.ledger.store.record import (
    COMMITS,
    FORMAT,
    MANIFEST,
    SEGMENTS,
    STAGING,
    VERSION,
    CommitRecord,
    Manifest,
    commit_path,
    parse_manifest,
    parse_record,
    segment_path,
    sha256_hex,
    staged_path,
)
from fsar_ledger.ledger.verify.commits import check_record
from fsar_ledger.ledger.verify.notes import Anchor, check_anchor
from fsar_ledger.ledger.verify.rederive import Redo, TilePlan, begins_with, checkpoint_note, grown_beyond, tile_strays
from fsar_ledger.ledger.verify.segment import SegmentFacts, examine, examine_file
from fsar_ledger.ledger.verify.verify import Asked, Progress
from fsar_ledger.workers import WorkerPool

FITS = "record and segment fit each other"
NO_RECORD = "no record that can be read"
NO_SEGMENT = "the segment is missing or not as its record says"


class Later(msgspec.Struct, frozen=True):
    """A commit after the trusted ones, on its own.

    `restore` is the SHA-256 of its segment where that is lost or altered and all records up to this one are whole: whoever has the file
    with this SHA-256 can put it back.
    """

    number: int
    found: str
    restore: str | None = None


class Prefix(msgspec.Struct, frozen=True):
    """What can be trusted, and the first doubt after it.

    `manifest` are the right bytes of ledger.json, None where they cannot be known; `records` and `documents` are the trusted records and
    their bytes, `files` their segments within the ledger. `problems` are those of the first commit in doubt, none if the ledger
    is whole; then `redo` and `strays` say what a crash has left. `anchored` counts the events that the anchor vouches for.
    """

    origin: str | None
    manifest: bytes | None
    records: tuple[CommitRecord, ...] = ()
    documents: tuple[bytes, ...] = ()
    files: tuple[str, ...] = ()
    problems: tuple[Problem, ...] = ()
    later: tuple[Later, ...] = ()
    anchored: int | None = None
    redo: Redo | None = None
    strays: tuple[str, ...] = ()

    @property
    def head(self) -> Head:
        """How far it goes."""
        if not self.records:
            return EMPTY_HEAD
        last = self.records[-1]
        return Head(len(self.records), last.tree_size, last.tree_root, last.last_run)


def find_prefix(path: Path, workers: int = 1, progress: Progress | None = None, asked: Asked | None = None) -> Prefix:
    """What of the ledger can be trusted. Nothing is changed; damage never raises.

    Args:
        path: The directory of the ledger.
        workers: Processes that read segments.
        progress: Called with (segments done, segments in all).
        asked: A key that must have signed, an earlier checkpoint.

    Raises:
        NotALedger, FormatVersionMismatch: ledger.json is of something else, and the records cannot tell what it was.
    """
    walk = _Walk(path, asked or Asked())
    broken = walk.read_chain()
    return walk.prefix(walk.read_segments(workers, progress) or broken)


class _Walk:
    """One walk from the first commit to the first that is in doubt."""

    def __init__(self, path: Path, asked: Asked) -> None:
        self.path, self.trusted = path, asked.trusted
        self.numbers = _numbers(path, COMMITS, ".json")
        self.problems = list(_check_folders(path))
        self.origin, self.manifest = _read_manifest(path, self.problems)
        self.chain: list[tuple[CommitRecord, bytes]] = []  # records without doubt
        self.files: list[str] = []  # segments without doubt
        self.runs: set[str] = set()
        self.edge, self.plan = Edge(), TilePlan(path)
        self.anchor, self.anchors = (
            asked.anchor,
            [*([asked.anchor] if asked.anchor else []), *_signed_checkpoint(path, asked.trusted)],
        )
        self.roots = {0: merkle.EMPTY_ROOT}  # by the number of events, as far as an anchor asks

    def read_chain(self) -> list[Problem]:
        """Each record fits the one before it; the problems of the first that does not."""
        if self.manifest is None:
            return []
        previous, tree = sha256_hex(self.manifest), Frontier()
        for number in count():
            if number not in self.numbers:
                beyond = min((one for one in self.numbers if one > number), default=None)
                where = f"{COMMITS}/{number:012d}.json"
                return (
                    []
                    if beyond is None
                    else [
                        Problem(where, "no file", f"a commit record, as there is one of commit {beyond}", commit=number)
                    ]
                )
            record, data, problems = _read_record(self.path, number)
            if record is not None:
                problems += check_record(number, record, previous, self.origin, tree)
            if record is None or problems:
                return problems
            self.chain.append((record, data))
            previous, tree = sha256_hex(data), record.tree()
        raise AssertionError("count() never ends")

    def read_segments(self, workers: int, progress: Progress | None) -> list[Problem]:
        """Each segment of the chain is as its record says; the problems of the first that is not."""
        for (record, _), facts in zip(self.chain, self._examined(workers), strict=True):
            problems = [
                *facts.problems,
                *(self._grow(record, facts) if facts.leaves is not None and facts.runs is not None else ()),
            ]
            if problems:
                return problems
            self.files.append(facts.file)
            if progress is not None:
                progress(len(self.files), len(self.chain))
        return []

    def _examined(self, workers: int) -> Iterator[SegmentFacts]:
        files = [_segment_file(self.path, number, record) for number, (record, _) in enumerate(self.chain)]
        arguments = (files, repeat(str(self.path)), range(len(files)), [record for record, _ in self.chain])
        with ExitStack() as stack:
            if min(workers, len(files)) > 1:
                yield from stack.enter_context(WorkerPool(min(workers, len(files)))).map(examine, *arguments)
            else:
                yield from map(examine, *arguments)

    def _grow(self, record: CommitRecord, facts: SegmentFacts) -> Iterator[Problem]:
        """The tree and the runs go on as the record says."""
        leaves, runs = facts.leaves or b"", facts.runs or ()
        for size in [anchor.note.checkpoint.size for anchor in self.anchors if anchor.note is not None]:
            if 0 <= (wanted := (size - self.edge.size) * HASH_BYTES) <= len(leaves):
                self.roots[size] = self.edge.extend(leaves[:wanted])[0].frontier().root()
        by = Redo(record.number, self.edge)
        self.edge, made = self.edge.extend(leaves)
        self.plan.compare(self.plan.add(by, made))
        if self.edge.frontier() != record.tree():
            found = f"{self.edge.size} events with Merkle root {self.edge.frontier().root().hex()}"
            yield Problem(
                facts.file,
                found,
                f"{record.tree_size} with {record.tree_root} as committed",
                commit=record.number,
                field="tree_root",
            )
        for name, said, run in (("first_run", record.first_run, runs[0]), ("last_run", record.last_run, runs[-1])):
            if said != run:
                yield Problem(
                    f"{COMMITS}/{record.number:012d}.json", repr(said), repr(run), commit=record.number, field=name
                )
        again = next((run for run in runs if run in self.runs), None)
        if again is not None:
            yield Problem(
                facts.file,
                f"run {again} once more",
                "each run in one commit",
                commit=record.number,
                run=again,
                seq=0,
                field="run_id",
            )
        self.runs.update(runs)

    def prefix(self, doubts: list[Problem]) -> Prefix:
        """What the walk has found, and what the key, the anchor and the files beside the commits say to it."""
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
        records = tuple(record for record, _ in self.chain[:kept])
        found = Prefix(
            self.origin,
            self.manifest,
            records,
            tuple(data for _, data in self.chain[:kept]),
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
        """How many of these commits the trusted key vouches for, and why not for more."""
        if self.trusted is None or self.problems:
            return kept, None
        signed, found = 0, "no signature of it"
        for number, note in enumerate(record.signed_note() for record, _ in self.chain[:kept]):
            if self.trusted.has_signed(note):
                signed = number + 1
            elif names(note, self.trusted):
                found = "a signature that this key did not make"
                break
        if kept and signed == kept:
            return kept, None
        expected = f"a note signed by {self.trusted.key}, the trusted key"
        return signed, Problem(
            f"{COMMITS}/{signed:012d}.json", found if kept else "no commit", expected, commit=signed, field="note"
        )

    def _ask(self, anchor: Anchor, *, is_whole: bool) -> tuple[list[Problem], bool]:
        """What an anchor says against what was verified, and whether it knows of more than that and so cannot contradict it."""
        size = self.chain[len(self.files) - 1][0].tree_size if self.files else 0
        if self.origin is None or anchor.note is None:
            return [], False
        is_beyond = anchor.note.checkpoint.size > size
        if is_beyond and not is_whole:
            return [], True
        return check_anchor(
            anchor, self.origin, size, self.roots.get(anchor.note.checkpoint.size), self.trusted
        ), is_beyond

    def _anchored(self, head: Head) -> int | None:
        """The events of the trusted ones that the anchor that was given vouches for."""
        note = self.anchor.note if self.anchor is not None else None
        if self.anchor is None or note is None:
            return None
        then = note.checkpoint
        if then.size <= head.size:
            return None if self._ask(self.anchor, is_whole=True)[0] else then.size
        is_own = not check_anchor(self.anchor, self.origin, then.size, then.root, self.trusted)
        return head.size if is_own and begins_with(self.path, then, head) else None

    def _grown_beyond(self, head: Head) -> Iterator[Problem]:
        """What shows that the newest commits were removed."""
        yield from grown_beyond(self.path, head, self.origin or "")
        for number in sorted(_numbers(self.path, SEGMENTS, ".parquet")):
            if number >= head.commits:
                expected = "its commit record, which was there before: the newest commits were removed"
                yield Problem(
                    str(segment_path(Path(), number)), "a segment of no commit", expected, commit=head.commits
                )

    def _later(self, kept: int, *, is_cut: bool) -> Iterator[Later]:
        """Each commit after the trusted ones, on its own."""
        for number in sorted(self.numbers | _numbers(self.path, SEGMENTS, ".parquet")):
            if number < kept:
                continue
            record = _read_record(self.path, number)[0]
            if record is None:
                yield Later(number, NO_RECORD)
                continue
            facts = examine_file(_segment_file(self.path, number, record), str(self.path), number, record)
            is_known = number < len(self.chain) and not is_cut
            yield (
                Later(number, NO_SEGMENT, record.segment_sha256 if is_known else None)
                if facts.problems
                else Later(number, FITS)
            )


def _check_folders(path: Path) -> Iterator[Problem]:
    """Commits and segments are in folders of the ledger itself."""
    for name in (COMMITS, SEGMENTS):
        if os.path.lexists(path / name) and (os.path.islink(path / name) or not os.path.isdir(path / name)):
            yield Problem(name, "something else, or a link", "a folder")


def _numbers(path: Path, folder: str, suffix: str) -> set[int]:
    """The numbers of the commits that have a file with this suffix here."""
    return {int(name[:12]) for name in _names(path / folder) if _is_numbered(name, suffix)}


def _is_numbered(name: str, suffix: str) -> bool:
    return name[12:] == suffix and name[:12].isascii() and name[:12].isdecimal()


def _names(folder: Path) -> list[str]:
    """What is in the folder, sorted; nothing if it is none, or a link."""
    return sorted(os.listdir(folder)) if os.path.isdir(folder) and not os.path.islink(folder) else []


def _read_manifest(path: Path, problems: list[Problem]) -> tuple[str | None, bytes | None]:
    """The origin and the right bytes of ledger.json, which the first record vouches for; None where they cannot be known."""
    data = _read(path / MANIFEST)
    first = _read_record(path, 0)[0]
    if first is not None and (data is None or sha256_hex(data) != first.previous_sha256):
        again = _manifest_of(first)
        if again is not None:
            return first.signed_note().checkpoint.origin, again
    if data is None:
        problems.append(
            Problem(
                MANIFEST,
                "no file that can be read",
                "the description of the ledger, which no commit record can replace",
            )
        )
        return None, None
    try:
        return parse_manifest(Path(MANIFEST), data).origin, data
    except LedgerCorrupted as error:
        problems.append(
            Problem(MANIFEST, f"no description of a ledger {refusal(MANIFEST, error)}", "one as it is written")
        )
        return None, None


def _manifest_of(first: CommitRecord) -> bytes | None:
    """The bytes of ledger.json, if this first record vouches for them."""
    try:
        data = canonical.document(Manifest(FORMAT, first.signed_note().checkpoint.origin, VERSION))
    except LedgerCorrupted:
        return None
    return data if sha256_hex(data) == first.previous_sha256 else None


def _read(path: Path) -> bytes | None:
    try:
        return disk.read_document(path)
    except OSError:
        return None


def _read_record(path: Path, number: int) -> tuple[CommitRecord | None, bytes, list[Problem]]:
    """The record of this commit and its bytes, None with the reason where it cannot be read."""
    where = f"{COMMITS}/{number:012d}.json"
    data = _read(commit_path(path, number))
    if data is None:
        return None, b"", [Problem(where, "no file that can be read", "a commit record", commit=number)]
    try:
        return parse_record(where, data), data, []
    except FsarLedgerError as error:
        return (
            None,
            data,
            [Problem(where, f"no commit record {refusal(where, error)}", "one as it is written", commit=number)],
        )
    except Exception as error:
        return None, data, [unexpected(where, number, error)]


def _segment_file(path: Path, number: int, record: CommitRecord) -> str:
    """Where the segment is, within the ledger: in place, or in staging where its writer was interrupted."""
    place, staged = segment_path(Path(), number), staged_path(Path(), record.segment_sha256)
    is_staged = (
        not os.path.lexists(path / place) and os.path.lexists(path / staged) and not os.path.islink(path / STAGING)
    )
    return str(staged if is_staged else place)


def _signed_checkpoint(path: Path, trusted: VerifierKey | None) -> list[Anchor]:
    """The ledger's own checkpoint, if the trusted key signed it: then it vouches like one that was kept elsewhere."""
    note = checkpoint_note(path)
    return [Anchor(CHECKPOINT, note)] if note is not None and trusted is not None and trusted.has_signed(note) else []


def _strays(path: Path, found: Prefix) -> Iterator[str]:
    """Every file that is not the ledger's, but for those below `tile/`."""
    folders = {COMMITS, SEGMENTS, STAGING, TILE}
    files = {MANIFEST, *((CHECKPOINT,) if found.records else ())}
    for name in _names(path):
        is_folder = os.path.isdir(path / name) and not os.path.islink(path / name)
        if name not in folders | files or (name in folders and not is_folder):
            yield name
    kept = {
        str(place(Path(), number)) for number in range(len(found.records)) for place in (commit_path, segment_path)
    } | set(found.files)
    yield from (
        f"{folder}/{name}"
        for folder in (COMMITS, SEGMENTS, STAGING)
        for name in _names(path / folder)
        if f"{folder}/{name}" not in kept
    )
