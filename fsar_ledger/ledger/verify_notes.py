"""Who signed a ledger, and whether it only grew since an earlier checkpoint: a part of `verify`."""

from pathlib import Path
from typing import Literal

import msgspec

from fsar_ledger.errors import LedgerCorrupted, UsageError
from fsar_ledger.ledger import disk
from fsar_ledger.ledger.note import Note, VerifierKey, parse_note
from fsar_ledger.ledger.problem import Problem
from fsar_ledger.ledger.record import COMMITS, MANIFEST, CommitRecord

Signed = Literal["unsigned", "signer not checked", "signed"]


class Anchor(msgspec.Struct, frozen=True):
    """An earlier checkpoint, kept elsewhere: the file it was in, and the note, None with the reason where it is none."""

    file: str
    note: Note | None
    reason: str = ""


def read_anchor(path: Path) -> Anchor:
    """The checkpoint in this file. Raises: UsageError if there is no such file."""
    try:
        return Anchor(str(path), parse_note("anchor", disk.read_document(path).decode()))
    except FileNotFoundError as error:
        raise UsageError(f"--anchor {path}: found no file, expected a checkpoint of this ledger that was kept elsewhere") from error
    except (OSError, UnicodeDecodeError, LedgerCorrupted) as error:
        return Anchor(str(path), None, (error.strerror or str(error)) if isinstance(error, OSError) else str(error))


def check_signatures(records: list[CommitRecord], trusted: VerifierKey | None) -> tuple[list[Problem], Signed]:
    """The newest note is signed by the trusted key, and no note pretends to be; without a key, whether the newest is signed at all."""
    newest = records[-1].signed_note() if records else None
    if trusted is None:
        return [], "signer not checked" if newest is not None and newest.signatures else "unsigned"
    if newest is None:
        return [Problem(MANIFEST, "no commit, so no note", f"one signed by {trusted.name}+{trusted.key_id.hex()}")], "unsigned"
    problems = [
        Problem(
            f"{COMMITS}/{record.number:012d}.json", found, f"one of {trusted.name}+{trusted.key_id.hex()}, the trusted key", commit=record.number, field="note"
        )
        for record in records
        if (found := _doubt(record.signed_note(), trusted, is_newest=record is records[-1])) is not None
    ]
    return problems, "signer not checked" if problems else "signed"


def _doubt(note: Note, trusted: VerifierKey, *, is_newest: bool) -> str | None:
    """What is wrong with the signatures of a note; only the newest must have one, for it vouches for all before it."""
    names = [f"{signature.name}+{signature.key_id.hex()}" for signature in note.signatures]
    if f"{trusted.name}+{trusted.key_id.hex()}" in names:
        return None if trusted.has_signed(note) else "a signature that this key did not make"
    return (f"a signature of {names[0]}" if names else "no signature") if is_newest else None


def check_anchor(anchor: Anchor, origin: str | None, size: int, root_then: bytes | None, trusted: VerifierKey | None) -> list[Problem]:
    """The ledger, of this origin and size, begins with the events of the anchor.

    Args:
        anchor: The earlier checkpoint.
        origin: The ledger's.
        size: The ledger's, in events.
        root_then: The root of the ledger's first so many events as the anchor counts; None if it cannot be known.
        trusted: The key that must have signed the anchor too.
    """
    if anchor.note is None:
        return [Problem(anchor.file, anchor.reason, "a checkpoint of this ledger")]
    then = anchor.note.checkpoint
    if then.origin != origin:
        return [Problem(anchor.file, f"a checkpoint of {then.origin}", f"one of {origin}, this ledger's origin")]
    if trusted is not None and not trusted.has_signed(anchor.note):
        return [Problem(anchor.file, "a checkpoint that the trusted key did not sign", f"one signed by {trusted.name}+{trusted.key_id.hex()}")]
    if then.size > size:
        return [Problem(COMMITS, f"{size} events", f"at least {then.size}, as {anchor.file} says: the newest were removed")]
    if root_then is None:
        return [Problem(anchor.file, "rows or tiles that cannot be relied on", "a ledger whose first events can be compared with the anchor")]
    if root_then != then.root:
        return [
            Problem(COMMITS, f"root {root_then.hex()} over the first {then.size} events", f"{then.root.hex()}, as {anchor.file} says: history was rewritten")
        ]
    return []
