"""The options and the report of `verify`: problems, signatures, and whether the ledger grew from a checkpoint."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeAlias

import msgspec

from fsar_ledger.base.errors import LedgerCorrupted, UsageError, option
from fsar_ledger.ledger.log.merkle import Node, consistency_proof, is_consistent
from fsar_ledger.ledger.log.note import Checkpoint, Note, Signed, VerifierKey, doubt, names, parse_note, signers_of
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.paths import CHAIN, INDEX, MANIFEST, NODES
from fsar_ledger.ledger.store.problem import Problem
from fsar_ledger.ledger.verify.segment import SecondReader


class Signatures(msgspec.Struct, frozen=True):
    """The signatures of a ledger: the state of the newest note, the key (`name+id`) that it names, and signed commits.

    `commits` is the number of commits signed by this key, or by any key if none is trusted.
    """

    state: Signed
    signer: str | None = None
    commits: int = 0


class Anchor(msgspec.Struct, frozen=True):
    """An earlier checkpoint kept elsewhere: its file, and its note or the reason why there is none."""

    file: str
    note: Note | None
    reason: str = ""


def read_anchor(path: Path) -> Anchor:
    """Read the checkpoint in this file. Raises: UsageError if there is no such file."""
    try:
        return Anchor(str(path), parse_note("anchor", disk.read_document(Path(os.path.realpath(path))).decode()))
    except FileNotFoundError as error:
        raise UsageError(
            f"{option('anchor', path)}: found no file, expected a checkpoint of this ledger that was kept elsewhere"
        ) from error
    except (OSError, UnicodeDecodeError, LedgerCorrupted) as error:
        return Anchor(str(path), None, (error.strerror or str(error)) if isinstance(error, OSError) else str(error))


def check_signatures(
    notes: Sequence[Note], place: Callable[[int], str], trusted: VerifierKey | None
) -> tuple[list[Problem], Signatures]:
    """Check that the trusted key signed the newest note, and that no note falsely claims its signature.

    Without a key, only report whether the newest note is signed at all. `place` returns the file of a commit's record.
    """
    signers = signers_of(notes[-1]) if notes else None
    if trusted is None:
        return [], Signatures(
            "signer not checked" if signers else "unsigned", signers, sum(1 for note in notes if note.signatures)
        )
    if not notes:
        return [Problem(MANIFEST, "no commit, so no note", f"one signed by {trusted.key}")], Signatures("unsigned")
    problems = [
        Problem(
            place(number),
            note_doubt,
            f"one of {trusted.key}, the trusted key",
            commit=number,
            field="note",
        )
        for number, note in enumerate(notes)
        if (note_doubt := doubt(note, trusted)) is not None and (note is notes[-1] or names(note, trusted))
    ]
    if problems:
        return problems, Signatures("signer not checked" if signers else "unsigned", signers)
    return [], Signatures("signed", trusted.key, sum(1 for note in notes if names(note, trusted)))


Nodes: TypeAlias = Callable[[int], Node]
"""Returns, for a size in events, the function that reads complete subtrees of the tree of that size."""


class ByHashes(msgspec.Struct, frozen=True):
    """The result of comparing an anchor with the stored hashes.

    Its root, None if they prove nothing; the size in events of the tree that begins with it; which hash was missing.
    """

    root: bytes | None = None
    size: int = 0
    missing: str = ""


# See docs/decisions/anchors-need-consistency-proofs.md.
def root_by_hashes(ledger: Path, nodes: Nodes, then: Checkpoint, size: int, root: bytes) -> ByHashes:
    """Return the root of an earlier checkpoint if the ledger's hashes prove that the tree of this size begins with it.

    Only the proof counts: an attacker who rewrote history may have left old hashes and records in place.
    """
    try:
        proof = consistency_proof(nodes(size), then.size, size)
    except LedgerCorrupted as error:
        return ByHashes(missing=str(error).removeprefix(f"{ledger}/").partition(", expected")[0])
    return ByHashes(then.root, size) if is_consistent(then.size, then.root, size, root, proof) else ByHashes()


def check_anchor(
    anchor: Anchor,
    origin: str | None,
    size: int,
    root_then: bytes | None,
    trusted: VerifierKey | None,
    missing: str = "",
) -> list[Problem]:
    """Check that the ledger, of this origin and size, begins with the events of the anchor.

    Args:
        anchor: The earlier checkpoint.
        origin: The ledger's.
        size: The ledger's, in events.
        root_then: The root of the ledger at the size of the anchor; None if unknown.
        trusted: The key that must have signed the anchor too.
        missing: The stored hash that is missing, if that is the only reason why that root is unknown.
    """
    if anchor.note is None:
        return [Problem(anchor.file, anchor.reason, "a checkpoint of this ledger")]
    checkpoint = anchor.note.checkpoint
    if checkpoint.origin != origin:
        return [Problem(anchor.file, f"a checkpoint of {checkpoint.origin}", f"one of {origin}, this ledger's origin")]
    if trusted is not None and not trusted.has_signed(anchor.note):
        return [
            Problem(
                anchor.file,
                f"a checkpoint with {doubt(anchor.note, trusted)}",
                f"one signed by {trusted.key}, the trusted key; to compare one from before the key changed, leave out "
                f"{option('trusted_key')}",
            )
        ]
    if checkpoint.size > size:
        return [
            Problem(
                CHAIN, f"{size} events", f"at least {checkpoint.size}, as {anchor.file} says: the newest were removed"
            )
        ]
    if missing:
        expected = (
            f"those from the {checkpoint.size} events of {anchor.file} to the ledger's {size}; run fsar-ledger "
            f"maintain recover, or verify without {option('quick')}"
        )
        return [Problem(NODES, f"one that cannot be read ({missing})", expected)]
    if root_then is None:
        gap = f"no way from its {checkpoint.size} events to the ledger's {size}"
        return [
            Problem(
                anchor.file,
                gap,
                "a ledger that begins with them: history was rewritten, or rows or hashes were damaged",
            )
        ]
    if root_then != checkpoint.root:
        return [
            Problem(
                CHAIN,
                f"root {root_then.hex()} over the first {checkpoint.size} events",
                f"{checkpoint.root.hex()}, as {anchor.file} says: history was rewritten",
            )
        ]
    return []


def not_compared(anchored: int | None) -> str:
    """Return the remark on what a quick look did not compare; the anchor has `anchored` events."""
    if anchored is None:
        return "rows were not compared with the recorded roots"
    return f"the recorded roots only grew since the anchor's {anchored:,} events; rows were not compared with them"


MAX_PROBLEMS = 100
"""The most problems in a report; a ledger with more is lost anyway."""


class VerifyOptions(msgspec.Struct, frozen=True):
    """Options of `verify`: what to check beyond the ledger itself.

    With `is_quick`, no rows are read: only the chain of records, the hashes of the files and the notes are checked.
    `witnessed` are more anchors, whose signatures were checked when they were obtained. `second_reader` reads the rows
    of each segment again, with other code, and compares them; it can be pickled.
    """

    is_quick: bool = False
    trusted: VerifierKey | None = None
    anchor: Anchor | None = None
    witnessed: tuple[Anchor, ...] = ()
    second_reader: SecondReader | None = None

    def sizes(self) -> set[int]:
        """Return the sizes of the anchors' trees."""
        anchors = (self.anchor, *self.witnessed)
        return {anchor.note.checkpoint.size for anchor in anchors if anchor is not None and anchor.note is not None}


NOT_LOOKED_AT = ("rows of segments", NODES, INDEX, f"continues, goes_on and index_sha256 in {CHAIN}")
"""The parts that a quick look does not check."""


class VerifyReport(msgspec.Struct, frozen=True):
    """The findings of `verify`.

    Units: `commits`, `events` and `runs` count what was read without doubt; `signed` counts commits.

    `root` is the Merkle root in hex over the rows themselves (as recorded, if rows were not read), None if there is any
    doubt. `signer` is the trusted key (`name+id`) if one was given, else the one that the newest note names; `anchored`
    is the number of events of the anchor. `remarks` are not doubts: leftovers of a crash, and what a quick look did not
    compare. `not_looked_at` names the parts that a quick look skipped; it is empty otherwise. `record_sha256` is the
    hash of the newest commit record (of ledger.json if there is none), which vouches for all earlier ones; None if
    there is any doubt. For the log of a federation, `events` are heads of its `shards`, which have the `runs`; the hash
    covers all of it.
    """

    ok: bool
    problems: tuple[Problem, ...]
    commits: int
    events: int
    runs: int
    root: str | None
    signature: Signed = "unsigned"
    signer: str | None = None
    signed: int = 0
    is_quick: bool = False
    anchored: int | None = None
    remarks: tuple[str, ...] = ()
    record_sha256: str | None = None
    not_looked_at: tuple[str, ...] = ()
    shards: int = 0
