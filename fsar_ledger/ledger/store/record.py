"""The JSON files of a ledger: `ledger.json` describes it, `commits/NNNNNNNNNNNN.json` what was committed.

Each file is the RFC 8785 JSON of one struct, to the byte. Each record holds the SHA-256 of the record before it (the
first: of ledger.json), so the last record vouches for all.
"""

import hashlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, TypeVar

import msgspec

from fsar_ledger.errors import FormatVersionMismatch, LedgerCorrupted, NotALedger
from fsar_ledger.ledger.log.hashing import HASH_BYTES
from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.log.note import Checkpoint, Note, checkpoint_of, is_name, parse_note
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.rows.bounds import MAX_ROWS, MAX_SEGMENT_BYTES
from fsar_ledger.ledger.rows.releases import FINGERPRINTS, RELEASE, is_later
from fsar_ledger.ledger.rows.schema import MAX_INTEGER

FORMAT = "fsar-ledger"
VERSION = 1
CHAINED = 2
"""The version of ledgers whose runs may span commits (see `ledger.chain`)."""
_SIGNATURE_BYTES = 64  # RFC 8032

Count = Annotated[int, msgspec.Meta(ge=0, le=MAX_INTEGER)]

_Document = TypeVar("_Document", bound=msgspec.Struct)


class Manifest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The content of `ledger.json`: the format, and the origin, the name under which tree heads are published."""

    format: str
    origin: str
    version: int


class CommitRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What one commit added, and the state of the ledger after it.

    `release` is the first with the event types and columns of these rows.

    Units: `segment_bytes` bytes, `rows` and `tree_size` events. `tree_root` and `frontier` (the roots of the complete
    subtrees, largest first, which determine it) are hex; `note` is the C2SP checkpoint of that tree, with one signature
    or none.
    """

    number: Count
    previous_sha256: str
    release: str
    schema_sha256: str
    segment_sha256: str
    segment_bytes: Annotated[int, msgspec.Meta(ge=1, le=MAX_SEGMENT_BYTES)]
    rows: Annotated[int, msgspec.Meta(ge=1, le=MAX_ROWS)]
    first_run: str
    last_run: str
    tree_size: Count
    tree_root: str
    frontier: tuple[str, ...]
    note: str

    def tree(self) -> Frontier:
        """Return the tree after this commit. Raises: ValueError if a hash is not hex."""
        return Frontier(self.tree_size, bytes.fromhex("".join(self.frontier)))

    def signed_note(self, where: str = "note") -> Note:
        """Parse the note. Raises: LedgerCorrupted if it is not in the form of C2SP."""
        return parse_note(where, self.note)


def sha256_hex(data: bytes) -> str:
    """Return the SHA-256 in hex."""
    return hashlib.sha256(data).hexdigest()


def parse_manifest(path: Path, data: bytes, versions: Sequence[int] = (VERSION,)) -> Manifest:
    """Parse these bytes of `path` as a manifest.

    Raises:
        NotALedger: They are the JSON of something else.
        FormatVersionMismatch: They describe a ledger of a format version that is not among these.
        LedgerCorrupted: They are not the canonical JSON of a manifest.
    """
    try:
        header = msgspec.json.decode(data, type=dict[str, object])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise LedgerCorrupted(
            f"{path}: found no JSON object ({error}), expected the description of a ledger; restore it"
        ) from error
    if header.get("format") != FORMAT:
        raise NotALedger(
            f"{path}: found format {header.get('format')!r:.80}, expected {FORMAT!r}; this is no FSAR ledger"
        )
    if header.get("version") not in versions:
        raise FormatVersionMismatch(
            f"{path}: found format version {header.get('version')!r:.80}, expected {' or '.join(map(str, versions))}; "
            "read it with the version that wrote it"
        )
    manifest = _parse(path, data, Manifest)
    if not is_name(manifest.origin):
        raise LedgerCorrupted(
            f"{path}: field origin: found {manifest.origin!r:.80}, expected a printable name without spaces; restore it"
        )
    return manifest


def parse_record(path: Path | str, data: bytes) -> CommitRecord:
    """Parse these bytes of `path` as a commit record.

    Raises: LedgerCorrupted if they are not the canonical JSON of one with fields in range.
    """
    record = _parse(path, data, CommitRecord)
    _require_hash(path, "segment_sha256", record.segment_sha256)  # part of a path; other hashes are compared later
    for subtree in record.frontier:
        _require_hash(path, "frontier", subtree)
    if len(record.frontier) != record.tree_size.bit_count():
        raise LedgerCorrupted(
            f"{path}: field frontier: found {len(record.frontier)} hashes, expected one for each bit set in tree size "
            f"{record.tree_size}"
        )
    return record


def contradictions(
    record: CommitRecord, number: int, previous: str, origin: str, before: Frontier
) -> Iterator[tuple[str, object, object]]:
    """Yield each field (name, found, expected) that contradicts something.

    That may be the record itself, its place, the tree before it, or what this version knows.
    """
    tree = record.tree()
    if record.release not in FINGERPRINTS:
        yield "release", record.release, _readable_releases(record.release)
    pairs: dict[str, tuple[object, object]] = {
        "number": (record.number, number),
        "previous_sha256": (record.previous_sha256, previous),
        "schema_sha256": (record.schema_sha256, FINGERPRINTS.get(record.release, record.schema_sha256)),
        "rows": (record.rows, record.tree_size - before.size),
        "tree_root": (record.tree_root, tree.root().hex()),
    }
    for name, (found, expected) in pairs.items():
        if found != expected:
            yield name, found, expected
    checkpoint = checkpoint_of(origin, tree)
    if not _is_note_of(record, checkpoint):
        yield "note", record.note, f"{checkpoint.text()}\n, with one signature or none"


def _readable_releases(found: str) -> str:
    """Describe in words which releases a record may name."""
    return (
        f"at most {RELEASE}; read it with fsar-ledger {found} or later"
        if is_later(found)
        else f"one of {', '.join(sorted(FINGERPRINTS))}"
    )


def _is_note_of(record: CommitRecord, checkpoint: Checkpoint) -> bool:
    """Return whether the record's note is that of this checkpoint, unsigned or signed by the ledger's own key."""
    if record.note == str(Note(checkpoint)):  # unsigned, as most are: no need to parse it
        return True
    try:
        note = record.signed_note()
    except LedgerCorrupted:
        return False
    is_own = all(
        signature.name == checkpoint.origin and len(signature.data) == _SIGNATURE_BYTES for signature in note.signatures
    )
    return note.checkpoint == checkpoint and len(note.signatures) <= 1 and is_own


def _require_hash(path: Path | str, name: str, value: str) -> None:
    if len(value) != 2 * HASH_BYTES or value.strip("0123456789abcdef"):
        raise LedgerCorrupted(
            f"{path}: field {name}: found {value!r:.80}, expected a SHA-256 in lower-case hex; restore the file"
        )


def _parse(path: Path | str, data: bytes, kind: type[_Document]) -> _Document:
    """Parse these bytes as the struct. Raises: LedgerCorrupted unless they are its canonical JSON."""
    try:
        found = msgspec.json.decode(data, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise LedgerCorrupted(f"{path}: found other JSON than expected ({error}); restore the file") from error
    expected = canonical.document(found)
    if data != expected:
        at = next(
            (at for at, (one, other) in enumerate(zip(data, expected, strict=False)) if one != other),
            min(len(data), len(expected)),
        )
        raise LedgerCorrupted(
            f"{path}: byte {at}: found {data[at : at + 20]!r}, expected {expected[at : at + 20]!r} (canonical JSON); "
            "restore the file"
        )
    return found
