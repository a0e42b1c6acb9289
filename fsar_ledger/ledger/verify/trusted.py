"""Find how much of a ledger can be trusted, mend it, and copy the trusted part: parts of `recover`."""

import os
import shutil
import stat
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Literal

import msgspec

from fsar_ledger.base.errors import LedgerCorrupted
from fsar_ledger.base.progress import Progress
from fsar_ledger.ledger.log import pack
from fsar_ledger.ledger.log.hashing import HASH_BYTES, sha256_hex
from fsar_ledger.ledger.log.merkle import Frontier, consistency_proof, is_consistent
from fsar_ledger.ledger.log.note import Checkpoint, Note, VerifierKey, doubt, parse_note
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.store import disk, growing
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.derived import derived_sizes, line_of
from fsar_ledger.ledger.store.links import Chain
from fsar_ledger.ledger.store.manifest import FORMAT, VERSION, Manifest
from fsar_ledger.ledger.store.paths import CHAIN, CHECKPOINT, INDEX, JOURNAL, MANIFEST, NODES, SEGMENTS, STAGING
from fsar_ledger.ledger.store.prepare import repair
from fsar_ledger.ledger.store.problem import Problem
from fsar_ledger.ledger.store.read import View, open_chain
from fsar_ledger.ledger.store.record import EMPTY_HEAD, Head, Placement, Record, segment_of
from fsar_ledger.ledger.store.segments import check_manifest, names_in
from fsar_ledger.ledger.store.snapshot import behind, read_checkpoint
from fsar_ledger.ledger.verify.chain import FILES, FOLDERS, SEGMENT_NAME, Verification, unplaced
from fsar_ledger.ledger.verify.report import Nodes, VerifyOptions, VerifyReport, check_anchor

Did = Literal["moved into place", "made again", "set aside"]
SetAside = Callable[[str], None]
Done = Callable[[Did, str, str], None]

FITS = "record and segment fit each other"
NO_SEGMENT = "the segment is missing or not as its record says"
ROWS_FIT = "record and rows fit each other"
NO_ROWS = "rows are missing or not as the record says, or follow such rows"


class Later(msgspec.Struct, frozen=True):
    """A commit after the trusted ones, judged on its own.

    `restore` is the SHA-256 of its segment if that is lost or altered and all records up to this one are whole: a copy
    with this SHA-256 can be put back as `file` of the ledger.
    """

    number: int
    found: str
    restore: str | None = None
    file: str | None = None


class TrustedPart(msgspec.Struct, frozen=True):
    """The part of a ledger that can be trusted: the view of it, and the number of its placements and commits.

    `problems` are why no more; none if the ledger is whole except for derived files. `report` is that of `verify`
    before anything is mended, with ledger.json taken as correct.
    """

    view: View
    placements: int
    commits: int
    problems: tuple[Problem, ...]
    report: VerifyReport
    anchored: int | None = None

    @property
    def is_whole(self) -> bool:
        """Return whether there is nothing to mend, including leftovers of a crash."""
        _, manifest, _ = check_manifest(self.view.path)
        is_described = manifest is not None and sha256_hex(manifest) == self.view.manifest_sha256
        return is_described and self.report.ok and not self.report.remarks and not names_in(self.view.path / STAGING)

    def later(self) -> Iterator[Later]:
        """Yield each commit after the trusted ones, judged by its segment or the journal alone."""
        view, chain = self.view, self.view.chain
        for number, placement in enumerate(chain.placed[self.placements :], start=self.placements):
            commits = self._after(placement.first, placement.end)
            try:
                view.segment(number)
            except LedgerCorrupted:
                yield from (
                    Later(commit, NO_SEGMENT, placement.segment_sha256, segment_of(placement)) for commit in commits
                )
            else:
                yield from (Later(commit, FITS) for commit in commits)
        whole = view.commits.up_to(chain.placed_size) + len(view.journal.frames)
        for commit in self._after(chain.placed_size, view.head.size):
            yield Later(commit, ROWS_FIT if commit < whole else NO_ROWS)

    def _after(self, first: int, end: int) -> range:
        """Return the commits after the trusted ones that end after index `first` and no later than `end`."""
        start, stop = self.view.commits.up_to(first), self.view.commits.up_to(end)
        return range(max(start, self.commits), stop)

    @property
    def head(self) -> Head:
        """Return the head of the trusted part."""
        if not self.commits:
            return EMPTY_HEAD
        last = self.view.commits[self.commits - 1]
        run = msgspec.json.decode(self.view.event(last.tree_size - 1), type=dict[str, object])["run_id"]
        return Head(self.commits, last.tree_size, last.tree_root, str(run))


def find_trusted(path: Path, workers: int, progress: Progress | None, asked: VerifyOptions) -> TrustedPart:
    """Find how much of the ledger can be trusted. Changes nothing.

    Raises: LedgerCorrupted if ledger.json cannot be read or reconstructed.
    """
    manifest = manifest_of(path)
    view = open_chain(path, manifest, is_damage_told=False)
    verification = Verification(path, msgspec.structs.replace(asked, is_quick=False))
    report = verification.run(workers, progress, manifest)
    mendable = {NODES, INDEX, CHECKPOINT, MANIFEST, *_strays(view)}
    problems = [problem for problem in verification.problems if problem.where not in mendable]
    problems += _removed(view) + _contradicted(view, asked.trusted)
    if not problems and not report.ok:
        problems += verification.check_signatures(view)[0]  # `verify` does so only for a ledger without a problem
    placements, commits = verification.trusted
    if asked.trusted is not None:
        key, origin = asked.trusted, view.manifest.origin
        while commits and doubt(view.commits[commits - 1].note(origin), key) is not None:
            commits -= 1
        while placements and view.chain.placed[placements - 1].end > _size(view, commits):
            placements -= 1
    if placements < len(view.chain.placed):
        commits = min(commits, view.commits.up_to(view.chain.placed[placements - 1].end if placements else 0))
    if _is_contradicted(view, verification, asked, commits):
        placements = commits = 0
    anchored = _anchored(view, verification, asked, commits) if report.problems else report.anchored
    return TrustedPart(view, placements, commits, tuple(problems), report, anchored)


def _is_contradicted(view: View, verification: Verification, asked: VerifyOptions, commits: int) -> bool:
    """Return whether the rows of the first `commits` commits contradict the anchor."""
    if asked.anchor is None or asked.anchor.note is None:
        return False
    size = asked.anchor.note.checkpoint.size
    root = verification.roots.get(size)
    is_covered = root is not None and size <= _size(view, commits)
    return is_covered and bool(check_anchor(asked.anchor, view.manifest.origin, size, root, asked.trusted))


def _anchored(view: View, verification: Verification, asked: VerifyOptions, commits: int) -> int | None:
    """Return for how many events of the first `commits` commits the anchor vouches; None if it cannot."""
    anchor, origin, size = asked.anchor, view.manifest.origin, _size(view, commits)
    if anchor is None or anchor.note is None:
        return None
    checkpoint = anchor.note.checkpoint
    if checkpoint.size <= size:
        return (
            None
            if check_anchor(anchor, origin, size, verification.roots.get(checkpoint.size), asked.trusted)
            else checkpoint.size
        )
    is_own = not check_anchor(anchor, origin, checkpoint.size, checkpoint.root, asked.trusted)
    root = view.commits[commits - 1].tree_root if commits else ""
    return size if is_own and _begins_with(view.node, checkpoint, size, root) else None


def _begins_with(nodes: Nodes, checkpoint: Checkpoint, size: int, root: str) -> bool:
    """Return whether these hashes prove that a checkpoint's tree begins with the tree of `size` events, at least one.

    Only the proof counts, not the hashes as such.
    """
    if not 0 < size <= checkpoint.size:
        return False
    try:
        proof = consistency_proof(nodes(checkpoint.size), size, checkpoint.size)
    except LedgerCorrupted:
        return False
    return is_consistent(size, bytes.fromhex(root), checkpoint.size, checkpoint.root, proof)


def _size(view: View, commits: int) -> int:
    return view.commits[commits - 1].tree_size if commits else 0


def _strays(view: View) -> list[str]:
    """Return the names in the ledger's folder, or among its segments, that do not belong to it.

    A file with the name of a segment is not one of them: it shows that its commits were removed.
    """
    strays = [name for name in names_in(view.path) if name not in FILES | FOLDERS]
    return strays + [name for name in unplaced(view) if not SEGMENT_NAME.fullmatch(name)]


def _removed(view: View) -> list[Problem]:
    """Return a problem if something exists only because the ledger once had more commits.

    If a record or a frame is damaged, those after it still exist, and were not removed.
    """
    if view.followed.problem is not None or view.journal.problem is not None:
        return []
    expected = (
        f"nothing of a tree of more than the {view.head.size} events that are committed: the newest commits were "
        "removed"
    )
    note = _checkpoint_note(view.path)
    if note is not None and note.checkpoint.origin == view.manifest.origin and note.checkpoint.size > view.head.size:
        return [Problem(CHECKPOINT, f"a checkpoint of {note.checkpoint.size} events", expected)]
    for name, size in derived_sizes(view.chain).items():
        with suppress(OSError):
            status = os.lstat(view.path / name)  # of a folder or a link the size tells nothing
            if stat.S_ISREG(status.st_mode) and status.st_size - size >= HASH_BYTES:  # fewer are no hash, and no line
                return [Problem(name, f"{status.st_size} bytes", expected)]
    return []


def _contradicted(view: View, key: VerifierKey | None) -> list[Problem]:
    """Return a problem if the key signed the file `checkpoint` and no commit has its tree."""
    note, origin = _checkpoint_note(view.path), view.manifest.origin
    if note is None or key is None or doubt(note, key) is not None:
        return []
    if note.checkpoint in (commit.note(origin).checkpoint for commit in view.commits):
        return []
    expected = "the tree of a commit, because the trusted key signed it: history was rewritten"
    return [Problem(CHECKPOINT, f"a checkpoint of {note.checkpoint.size} events", expected)]


def _checkpoint_note(path: Path) -> Note | None:
    """Return the note in the file `checkpoint`; None if there is none."""
    text = read_checkpoint(path)
    try:
        return parse_note(CHECKPOINT, text) if isinstance(text, str) else None
    except LedgerCorrupted:
        return None


def manifest_of(path: Path) -> bytes:
    """Return the content of ledger.json or, if that is wrong, its content reconstructed to match the chain's hash.

    Raises: LedgerCorrupted if it cannot be read or reconstructed.
    """
    data = b""
    try:
        data = disk.read_document(path / MANIFEST)
        if sha256_hex(data) == _first_hash(path):
            return data
    except OSError:
        pass
    note = _checkpoint_note(path)
    if note is not None:
        document = canonical.document(Manifest(FORMAT, note.checkpoint.origin, VERSION))
        if sha256_hex(document) == _first_hash(path):
            return document
    if data:
        return data
    raise LedgerCorrupted(
        f"{path / MANIFEST}: it cannot be read, and nothing says which origin it named, expected the description of "
        "the ledger; restore it"
    )


def _first_hash(path: Path) -> str:
    """Return the hash of ledger.json in the chain's first line; empty if it has none."""
    try:
        line = growing.read_at(path / CHAIN, 0, 1 << 20).partition(b"\n")[0]
        return str(msgspec.json.decode(line, type=dict[str, object]).get("previous_sha256", ""))
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return ""


def mend(trusted: TrustedPart, set_aside: SetAside, done: Done) -> None:
    """Make the ledger whole again: its derived files, and what an interrupted writer left. Raises: OSError."""
    view, path = trusted.view, trusted.view.path
    for name in _strays(view):
        set_aside(name)
    manifest = canonical.document(view.manifest)
    _make_again(path, MANIFEST, manifest, set_aside, done)
    for placement in view.chain.placed:
        target = path / segment_of(placement)
        if (source := view.located(placement)) != target:
            disk.move(source, target)
            done("moved into place", str(source.relative_to(path)), segment_of(placement))
    _make_again(path, NODES, _nodes(view), set_aside, done)
    _make_again(path, INDEX, _index(view), set_aside, done)
    try:
        is_behind = behind(view) > 0
    except LedgerCorrupted:
        _make_again(path, CHECKPOINT, str(view.note()).encode() if view.commits else b"", set_aside, done)
        is_behind = False
    if is_behind:
        disk.replace_durably(path / CHECKPOINT, str(view.note()).encode(), path / STAGING)
        done("made again", CHECKPOINT, CHECKPOINT)
    repair(open_chain(path, manifest), is_alone=True)


def _make_again(path: Path, name: str, data: bytes, set_aside: SetAside, done: Done) -> None:
    """Write the file if it does not hold these bytes, setting any existing one aside. No bytes mean no file."""
    with suppress(OSError):  # missing, a link or longer
        if disk.read_large(path / name, len(data)) == data:
            return
    if os.path.lexists(path / name):
        set_aside(name)
    if data:
        disk.make_folder(path / STAGING)
        disk.replace_durably(path / name, data, path / STAGING)
        done("made again", name, name)


def _nodes(view: View) -> bytes:
    tree, hashes = Frontier(), []
    for number in range(len(view.chain.placed)):
        tree, nodes = pack.grow(tree, canonical.leaves(view.table(number)))
        hashes.append(nodes)
    return b"".join(hashes)


def _index(view: View) -> bytes:
    return b"".join(line for number in range(len(view.chain.placed)) for line in view.index_lines(number))


def write_copy(trusted: TrustedPart, work: Path) -> None:
    """Write a ledger of the trusted commits in segments to this new folder, durably.

    Raises: OSError, LedgerCorrupted.
    """
    view = trusted.view
    for folder in (work, work / SEGMENTS, work / STAGING):
        folder.mkdir()
    manifest = canonical.document(view.manifest)
    disk.write_temporary(work / MANIFEST, manifest)
    chain = Chain(sha256_hex(manifest))
    lines: list[bytes] = []
    for number, placement in enumerate(view.chain.placed[: trusted.placements]):
        source = view.located(placement)
        with open(source, "rb") as original, open(work / segment_of(placement), "xb") as target:
            shutil.copyfileobj(original, target)
            target.flush()
            os.fsync(target.fileno())
        within = view.commits.within(placement.first, placement.end)
        trusted_commits = [commit for commit in within if commit.number < trusted.commits]
        line = line_of(placement.first, view.table(number))
        lines += [_relinked(commit, chain) for commit in trusted_commits]
        lines.append(_relinked(_adding(placement, line), chain))
    if lines:
        growing.append_durably(work / CHAIN, b"".join(line + b"\n" for line in lines), 0)
    frames = [frame for frame in view.journal.frames if frame.commit.number < trusted.commits]
    if frames:
        journal = b"".join(b"\n".join((_relinked(frame.commit, chain), frame.rows)) for frame in frames)
        disk.write_temporary(work / JOURNAL, journal)
    disk.write_temporary(work / CHECKPOINT, str(view.commits[trusted.commits - 1].note(view.manifest.origin)).encode())
    with Writer(work, view.manifest.origin, adopts=True):  # appends nothing
        pass  # derives the rest


def _adding(placement: Placement, line: bytes) -> Placement:
    """Return the placement as one that adds its events, with this line of the index."""
    return msgspec.structs.replace(placement, index_bytes=len(line), index_sha256=sha256_hex(line))


def _relinked(record: Record, chain: Chain) -> bytes:
    """Add the record to another chain, and return its new line."""
    number = len(chain.placements if isinstance(record, Placement) else chain.commits)
    relinked: Record = msgspec.structs.replace(record, number=number, previous_sha256=chain.sha256)
    line = canonical.document(relinked)
    chain.add(relinked, sha256_hex(line))
    return line
