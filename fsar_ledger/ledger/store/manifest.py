"""The file `ledger.json`, which describes a ledger."""

import os
from pathlib import Path
from typing import TypeVar

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import FormatVersionMismatch, LedgerCorrupted, NotALedger
from fsar_ledger.ledger.log.note import is_name
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.paths import CHAIN, MANIFEST, require_created

FORMAT, VERSION = "fsar-ledger", 2
# See docs/decisions/there-is-one-format.md.
VERSION_1 = 1
"""The version of ledgers that only `fsar-ledger maintain upgrade` reads."""

_Document = TypeVar("_Document", bound=msgspec.Struct)


class Manifest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The content of `ledger.json`: the format, and the origin, the name under which tree heads are published."""

    format: str
    origin: str
    version: int


def read_manifest(path: Path) -> bytes:
    """Read ledger.json of the ledger at this path.

    Raises: NotALedger if there is none, or its creation was interrupted; LedgerCorrupted if it alone is missing.
    """
    try:
        return disk.read_document(path / MANIFEST)
    except (FileNotFoundError, NotADirectoryError) as error:
        require_created(path)
        if os.path.lexists(path / CHAIN):
            raise LedgerCorrupted(
                f"{path / MANIFEST}: found nothing beside {CHAIN}, expected the description of the ledger; restore it: "
                "`fsar-ledger maintain recover` says how much of the ledger can be trusted"
            ) from error
        instead = "no such path" if not path.exists() else "no ledger.json in it" if path.is_dir() else "a file"
        raise NotALedger(
            f"{path}: found {instead}, expected the directory of a ledger; give the path that `fsar-ledger simulate` "
            "wrote to"
        ) from error
    except OSError as error:
        raise disk.unreadable(path / MANIFEST, error) from error


def refuse_version_1(ledger: Path, data: bytes) -> None:
    """Refuse a ledger whose ledger.json has these bytes, if they declare format 1. Raises: FormatVersionMismatch."""
    if version_of(data) == VERSION_1:
        raise _too_old(ledger)


def _too_old(ledger: Path) -> FormatVersionMismatch:
    return FormatVersionMismatch(
        f"{ledger}: found a ledger of format 1, which fsar-ledger up to 0.8 wrote, expected one of today's format; "
        f"run fsar-ledger maintain upgrade {printable.word(ledger)} --into NEW"
    )


def version_of(data: bytes) -> object:
    """Return the format version in these bytes of ledger.json; None if they are not those of a ledger."""
    try:
        header = msgspec.json.decode(data, type=dict[str, object])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None
    return header.get("version") if header.get("format") == FORMAT else None


def parse_manifest(path: Path, data: bytes) -> Manifest:
    """Parse these bytes of `path` as a manifest.

    Raises:
        NotALedger: They are the JSON of something else, with no chain beside it.
        FormatVersionMismatch: They describe a ledger of another format version.
        LedgerCorrupted: They are not the canonical JSON of a manifest.
    """
    try:
        header = msgspec.json.decode(data, type=dict[str, object])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise LedgerCorrupted(
            f"{path}: found no JSON object ({error}), expected the description of a ledger; restore it"
        ) from error
    if header.get("format") != FORMAT:
        found = f"{path}: found format {header.get('format')!r:.80}, expected {FORMAT!r}"
        if os.path.lexists(path.with_name(CHAIN)):
            raise LedgerCorrupted(f"{found}, beside {CHAIN}; restore it")
        raise NotALedger(f"{found}; this is no FSAR ledger")
    if header.get("version") == VERSION_1:
        raise _too_old(path.parent)
    if isinstance(version := header.get("version"), int) and version != VERSION:
        raise FormatVersionMismatch(
            f"{path}: found format version {version}, expected {VERSION}; read it with the version that wrote it"
        )
    manifest = parse_document(path, data, Manifest)
    if not is_name(manifest.origin):
        raise LedgerCorrupted(
            f"{path}: field origin: found {manifest.origin!r:.80}, expected a printable name without spaces; restore it"
        )
    return manifest


def parse_document(path: Path | str, data: bytes, kind: type[_Document]) -> _Document:
    """Parse these bytes as the struct. Raises: LedgerCorrupted unless they are its canonical JSON."""
    try:
        document = msgspec.json.decode(data, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise LedgerCorrupted(f"{path}: found other JSON than expected ({error}); restore the file") from error
    expected = canonical.document(document)
    if data != expected:
        offset = next(
            (offset for offset, (byte, other) in enumerate(zip(data, expected, strict=False)) if byte != other),
            min(len(data), len(expected)),
        )
        raise LedgerCorrupted(
            f"{path}: byte {offset}: found {data[offset : offset + 20]!r}, expected "
            f"{expected[offset : offset + 20]!r} (canonical JSON); restore the file"
        )
    return document
