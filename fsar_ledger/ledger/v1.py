"""Read a ledger of format 1, written by fsar-ledger 0.8 and earlier, for `fsar-ledger maintain upgrade` only.

The whole ledger is verified before anything is written. `docs/ledger-format.md` describes the format. If its writer was
interrupted, only fsar-ledger 0.8 can finish that, not this module.
"""

import base64
import os
import stat
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Annotated

import msgspec

from fsar_ledger.base.errors import LedgerCorrupted, UsageError
from fsar_ledger.base.progress import Progress
from fsar_ledger.ledger.log.hashing import sha256_hex
from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.log.note import SIGNATURE_BYTES, checkpoint_of, is_name, parse_note
from fsar_ledger.ledger.log.pack import TILE, WIDTH, Edge, Tile
from fsar_ledger.ledger.rows.blocks import Runs
from fsar_ledger.ledger.rows.bounds import MAX_ROWS, MAX_SEGMENT_BYTES
from fsar_ledger.ledger.rows.schema import FINGERPRINTS
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.manifest import FORMAT, VERSION_1, Manifest, parse_document, read_manifest, version_of
from fsar_ledger.ledger.store.paths import CHECKPOINT, COMMITS, MANIFEST, SEGMENTS, STAGING, staged_path
from fsar_ledger.ledger.store.problem import Problem
from fsar_ledger.ledger.store.record import Head
from fsar_ledger.ledger.store.segments import Names, names_in
from fsar_ledger.ledger.store.staging import Staged
from fsar_ledger.ledger.verify.segment import SegmentFacts, examine_all

_NAMES = frozenset({MANIFEST, COMMITS, SEGMENTS, STAGING, TILE, CHECKPOINT})


class CommitRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The events that one commit added, and the ledger's state after it: the content of `commits/NNNNNNNNNNNN.json`.

    Units: `segment_bytes` bytes, `rows` and `tree_size` events. `tree_root` and `frontier` (the roots of the complete
    subtrees, largest first) are hex; `note` is the C2SP checkpoint of that tree, with one signature or none.
    """

    number: int
    previous_sha256: str
    release: str
    schema_sha256: str
    segment_sha256: str
    segment_bytes: Annotated[int, msgspec.Meta(ge=1, le=MAX_SEGMENT_BYTES)]
    rows: Annotated[int, msgspec.Meta(ge=1, le=MAX_ROWS)]
    first_run: str
    last_run: str
    tree_size: int
    tree_root: str
    frontier: tuple[str, ...]
    note: str


def upgrade(ledger: Path, into: Path, progress: Progress | None = None) -> Head:
    """Verify the ledger of format 1, then write it into this new folder, commit by commit; return its head.

    Segments are copied byte for byte, and each record keeps its signature. After an interruption the same call resumes.
    `progress` is called with (commits verified, total), and then with (commits written, total).

    Raises:
        UsageError: The ledger is not of format 1, its writer was interrupted, or `into` holds other commits than these.
        LedgerCorrupted: It does not verify; nothing was written.
        NotALedger, WriteFailed: As `Writer`.
    """
    origin, records, examined = _verified(ledger, progress)
    with Writer(into, origin, adopts=True) as writer:  # with the notes of the old one
        done = writer.head.commits
        last_copied = records[done - 1] if 0 < done <= len(records) else None
        if done and (
            last_copied is None
            or (last_copied.tree_size, last_copied.tree_root) != (writer.head.size, writer.head.root)
        ):
            raise UsageError(f"{into}: found a ledger of other events, expected a free path; give another path")
        for record, facts in zip(records[done:], examined[done:], strict=True):
            writer.append(_copied(ledger, into, record, facts), _signature(record))
            if progress is not None:
                progress(record.number + 1, len(records))
        return writer.head


def _copied(ledger: Path, into: Path, record: CommitRecord, facts: SegmentFacts) -> Staged:
    """Copy the segment of this commit to the new ledger's staging folder. Raises: LedgerCorrupted, WriteFailed."""
    with disk.refusals(ledger / facts.file, "reading a segment"):
        data = disk.read_large(ledger / facts.file, record.segment_bytes)
    target = staged_path(into, record.segment_sha256)
    with disk.refusals(target, "writing a segment"):
        disk.write_durably(target, data)
    assert facts.leaves is not None  # as of every segment without problems
    return Staged(
        record.segment_sha256,
        record.segment_bytes,
        record.rows,
        facts.leaves,
        facts.blocks,
        (),
        record.release,
        record.schema_sha256,
    )


def _signature(record: CommitRecord) -> str:
    """Return the signature of the record's note in the form of a commit's; empty if there is none."""
    signatures = parse_note("note", record.note).signatures
    return base64.b64encode(signatures[0].key_id + signatures[0].data).decode() if signatures else ""


# --- verification ---


def _verified(ledger: Path, progress: Progress | None) -> tuple[str, Sequence[CommitRecord], Sequence[SegmentFacts]]:
    """Return the origin, the records and the facts of their segments, after re-deriving everything in the ledger.

    Raises: As `upgrade`.
    """
    if not os.path.lexists(ledger / COMMITS) and version_of(read_manifest(ledger)) != VERSION_1:
        raise UsageError(f"{ledger}: found no ledger of format 1, expected one; others need no upgrade")
    if names_in(ledger / STAGING):
        raise _interrupted(ledger, f"files in {STAGING}/")
    for problem in _misplaced(ledger):
        raise _damaged(ledger, problem)
    data = read_manifest(ledger)
    manifest = parse_document(ledger / MANIFEST, data, Manifest)
    if manifest != Manifest(FORMAT, manifest.origin, VERSION_1) or not is_name(manifest.origin):
        raise _damaged(ledger, Problem(MANIFEST, f"{data!r:.200}", "the description of a ledger of format 1"))
    records = list(_records(ledger, manifest.origin, sha256_hex(data)))
    _require_checkpoint(ledger, records)
    examined: list[SegmentFacts] = []
    runs = Runs()
    segments = [(record.number, record, _names(record.number)) for record in records]
    for record, facts in zip(records, examine_all(ledger, segments, 1, None, is_quick=False), strict=True):
        previous = records[record.number - 1] if record.number else None
        for problem in (*facts.problems, *_doubts_of_rows(record, previous, facts, runs)):
            raise _damaged(ledger, problem)
        examined.append(facts)
        if progress is not None:
            progress(len(examined), len(records))
    _require_tiles(ledger, (facts.leaves or b"" for facts in examined))
    return manifest.origin, records, examined


def _damaged(ledger: Path, problem: Problem) -> LedgerCorrupted:
    return LedgerCorrupted(
        f"{ledger}/{problem}; nothing was written: restore the file, or copy what can be trusted with fsar-ledger 0.8"
    )


def _interrupted(ledger: Path, found: str) -> UsageError:
    return UsageError(
        f"{ledger}: found {found}, as an interrupted writer leaves them, expected a ledger that was closed; "
        "recover it with fsar-ledger 0.8 first"
    )


def _names(number: int) -> Names:
    return Names(f"{SEGMENTS}/{number:012d}.parquet", f"{COMMITS}/{number:012d}.json")


def _misplaced(ledger: Path) -> Iterator[Problem]:
    """Yield a problem for each unexpected name, each missing one, and each link."""
    present = names_in(ledger)
    for name in present:
        is_right_kind = stat.S_ISREG if name in (MANIFEST, CHECKPOINT) else stat.S_ISDIR
        if name not in _NAMES:
            yield Problem(name, "an unknown file", f"only {', '.join(sorted(_NAMES))}; remove it")
        elif not is_right_kind(os.lstat(ledger / name).st_mode):
            yield Problem(name, "a link or something else", "a file or folder of the ledger")
    for name in sorted({MANIFEST, COMMITS, SEGMENTS}.difference(present)):
        yield Problem(name, "nothing", "a file or folder of the ledger")
    numbers = range(len(names_in(ledger / COMMITS)))
    yield from _strays(ledger, COMMITS, {_names(number).said_by for number in numbers})
    yield from _strays(ledger, SEGMENTS, {_names(number).place for number in numbers})


def _strays(ledger: Path, folder: str, expected: set[str]) -> Iterator[Problem]:
    """Yield a problem for each unexpected file in this folder, and each missing one."""
    names = {f"{folder}/{name}" for name in names_in(ledger / folder)}
    for name in (*sorted(names - expected), *sorted(expected - names)):
        what = "a stray file" if name in names else "no file"
        yield Problem(name, what, "a record and a segment for each commit, numbered from 0 without a gap")


def _records(ledger: Path, origin: str, previous: str) -> Iterator[CommitRecord]:
    """Yield the records, each checked against the hash of the one before, first `previous`. Raises: LedgerCorrupted."""
    size = 0
    for number in range(len(names_in(ledger / COMMITS))):
        where = _names(number).said_by
        try:
            data = disk.read_document(ledger / where)
        except OSError as error:
            raise _damaged(ledger, Problem(where, f"an unreadable file ({error.strerror})", "a record")) from error
        record = parse_document(ledger / where, data, CommitRecord)
        try:
            tree = Frontier(record.tree_size, bytes.fromhex("".join(record.frontier)))
        except ValueError:
            tree = Frontier()
        note, parsed_note = checkpoint_of(origin, tree), parse_note(f"{ledger / where}", record.note)
        is_signed_by_others = (
            any(
                signature.name != origin or len(signature.data) != SIGNATURE_BYTES
                for signature in parsed_note.signatures
            )
            or len(parsed_note.signatures) > 1
        )
        for name, value, expected in (
            ("release", record.release in FINGERPRINTS, True),
            ("number", record.number, number),
            ("previous_sha256", record.previous_sha256, previous),
            ("schema_sha256", record.schema_sha256, FINGERPRINTS.get(record.release)),
            ("rows", record.rows, record.tree_size - size),
            ("frontier", len(record.frontier), record.tree_size.bit_count()),
            ("tree_root", record.tree_root, tree.root().hex()),
            ("note", parsed_note.checkpoint, note),
            ("note", is_signed_by_others, False),
        ):
            if value != expected:
                raise _damaged(ledger, Problem(where, f"{value!r}", f"{expected!r}", commit=number, field=name))
        yield record
        previous, size = sha256_hex(data), record.tree_size


def _doubts_of_rows(
    record: CommitRecord, previous: CommitRecord | None, facts: SegmentFacts, runs: Runs
) -> Iterator[Problem]:
    """Yield the contradictions of the rows with the record or, by their runs, earlier commits; add their runs."""
    tree = Frontier(previous.tree_size, bytes.fromhex("".join(previous.frontier))) if previous else Frontier()
    root = tree.extend(facts.leaves or b"").root().hex()
    if root != record.tree_root:
        expected = f"{record.tree_root} as committed: a row was altered"
        yield Problem(facts.file, f"Merkle root {root}", expected, commit=record.number, field="tree_root")
    where = _names(record.number).said_by
    names = [block.run for block in facts.blocks] or ["", ""]
    for name, claimed, actual in (("first_run", record.first_run, names[0]), ("last_run", record.last_run, names[-1])):
        if claimed != actual:
            yield Problem(where, repr(claimed), repr(actual), commit=record.number, field=name)
    for block in facts.blocks:
        if block.run in runs.known or block.first:
            actual, expected = f"run {block.run} from seq {block.first}", "each run in one commit, from seq 0"
            yield Problem(facts.file, actual, expected, record.number, block.run, block.first, "run_id")
        runs.add(block)


def _require_checkpoint(ledger: Path, records: Sequence[CommitRecord]) -> None:
    """Require that `checkpoint` is the newest note. Raises: UsageError if it is the one before, LedgerCorrupted."""
    notes = [None, *(record.note for record in records)]
    try:
        note = disk.read_document(ledger / CHECKPOINT).decode()
    except FileNotFoundError:
        note = None
    except (OSError, UnicodeDecodeError):
        note = ""
    if note == notes[-1]:
        return
    if len(notes) > 1 and note == notes[-2]:
        raise _interrupted(ledger, f"tiles and a {CHECKPOINT} that lack the newest commit")
    raise _damaged(ledger, Problem(CHECKPOINT, "no file" if note is None else f"{note!r:.400}", "the newest note"))


def _require_tiles(ledger: Path, commits: Iterable[bytes]) -> None:
    """Require the tiles of the tree of these packed leaves, commit by commit, and no others.

    A partial tile stays until the full one exists. Raises: UsageError if it stayed longer, LedgerCorrupted.
    """
    edge, required, partial, outgrown = Edge(), set[str](), dict[Tile, bytes](), set[str]()
    for leaves in commits:
        edge, tiles = edge.extend(leaves)
        full = {(tile.level, tile.number) for tile in tiles if tile.width == WIDTH}
        outgrown |= {tile.name for tile in partial if (tile.level, tile.number) in full}
        partial = {tile: data for tile, data in partial.items() if (tile.level, tile.number) not in full}
        for tile, data in tiles.items():
            if tile.width < WIDTH:
                partial[tile] = data
            else:
                _require_tile(ledger, tile, data)
                required.add(tile.name)
    for tile, data in partial.items():
        _require_tile(ledger, tile, data)
        required.add(tile.name)
    listed = {
        os.path.relpath(os.path.join(folder, name), ledger)
        for folder, folders, files in os.walk(ledger / TILE)
        for name in (*files, *(name for name in folders if os.path.islink(os.path.join(folder, name))))
    }
    for name in sorted(listed - required - outgrown):
        raise _damaged(ledger, Problem(name, "a stray file", "only tiles of this tree; remove it"))
    if listed & outgrown:
        raise _interrupted(ledger, "partial tiles beside their full ones")


def _require_tile(ledger: Path, tile: Tile, expected: bytes) -> None:
    try:
        data = disk.read_document(ledger / tile.name)
    except OSError as error:
        raise _damaged(ledger, Problem(tile.name, f"no file ({error.strerror})", f"{tile.width} hashes")) from error
    if data != expected:
        raise _damaged(ledger, Problem(tile.name, f"SHA-256 {sha256_hex(data)}", sha256_hex(expected)))
