"""Proof that one event is in a ledger, in one file that can be checked without the ledger: a C2SP tlog-proof.

```
c2sp.org/tlog-proof@v1
extra eyJhY3Rpb25faWQiOiJBMS0xLzIuMSIs...    the canonical bytes of the event; leaf = SHA-256(0x00 || bytes)
index 1234                                   its index in the ledger, from 0
gSKyXoYZUgZ6jduWYrkDOARinOMGJveXjgMkBTcdPlQ=   the inclusion proof: the leaf's sibling first, one per line
...

fsar-ledger/simulated                        the checkpoint, signed or not
...
```

The proof of an event of a federation has two steps, each a tlog-proof, with an empty line between them: that the event
is in the shard, and that the federation's log has the head of the shard to which the first one leads.
"""

import base64
from bisect import bisect_right
from pathlib import Path

import msgspec

from fsar_ledger.base.errors import LedgerCorrupted, UsageError
from fsar_ledger.ledger.log.hashing import HASH_BYTES
from fsar_ledger.ledger.log.merkle import Node, inclusion_proof, leaf_hash, root_of_inclusion
from fsar_ledger.ledger.log.note import Checkpoint, Note, Signed, VerifierKey, doubt, parse_note, signers_of
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.rows.schema import MAX_INTEGER
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.shards import HEAD_TYPE, Federation

TITLE = "c2sp.org/tlog-proof@v1"

Value = str | int | bool | list[str]
"""The value of a field of an event."""


class Proof(msgspec.Struct, frozen=True):
    """An event (its canonical bytes), its index in the ledger, the hashes from it to the root, and a checkpoint.

    For a shard of a federation, `log` is the proof that the federation's log has the head in that checkpoint.
    """

    event: bytes
    index: int
    hashes: tuple[bytes, ...]
    note: Note
    log: "Proof | None" = None

    def __str__(self) -> str:
        lines = [TITLE, f"extra {_base64(self.event)}", f"index {self.index}", *map(_base64, self.hashes), ""]
        return "\n".join(lines) + f"\n{self.note}" + ("" if self.log is None else f"\n{self.log}")


class Proven(msgspec.Struct, frozen=True):
    """The result of a checked proof: the event as stored, and the ledger that holds it, as far as the signature shows.

    `index` and `size` count events, `root` is hex. `signer` is the trusted key (`name+id`), or else the one that the
    note names. For a shard, `log` is the result for its head, by the trusted key if there is one.
    """

    event: dict[str, Value]
    index: int
    size: int
    root: str
    origin: str
    signature: Signed
    signer: str | None
    log: "Proven | None" = None


def prove(view: View, index: int) -> Proof:
    """Prove that the ledger holds the event with this index, from 0.

    The proof leads to the root of the newest commit whose tiles exist; in a federation, to that of its log.

    Raises:
        ValueError: There is no such event.
        LedgerCorrupted: The row, the tiles and the root do not agree, or one of them cannot be read.
    """
    if not 0 <= index < view.head.events:
        raise ValueError(f"found index {index}, expected one of {view.head.events} events")
    if isinstance(view, Federation):
        shard, shard_index = view.shard_of(index)
        return msgspec.structs.replace(prove(shard.view, shard_index), log=prove(view.log, shard.head.index))
    event = view.event(index)
    note = view.note()
    assert note is not None  # as there is an event
    leaf, hashes = prove_inclusion(view.path, view.node(note.checkpoint.size), note.checkpoint, index)
    if leaf_hash(event) != leaf:
        raise LedgerCorrupted(
            f"{_segment_of(view, index)}: event {index} has leaf hash {leaf_hash(event).hex()}, expected {leaf.hex()} "
            "as the ledger's root says: "
            "the row was altered; run fsar-ledger verify"
        )
    return Proof(event, index, hashes, note)


def prove_inclusion(ledger: Path, node: Node, tree: Checkpoint, index: int) -> tuple[bytes, tuple[bytes, ...]]:
    """Return the leaf hash at this index and its inclusion proof to the root of this tree, from its stored hashes.

    Raises:
        ValueError: The tree has no such leaf.
        LedgerCorrupted: A hash is missing, or they do not lead to that root.
    """
    hashes = inclusion_proof(node, index, tree.size)
    leaf = node(0, index)
    root = root_of_inclusion(leaf, index, tree.size, hashes)
    if root != tree.root:
        raise LedgerCorrupted(
            f"{ledger}: the stored hashes lead from event {index} to the root "
            f"{root.hex() if root else 'of no tree'}, expected {tree.root.hex()} of {tree.size} "
            "events; run fsar-ledger verify, and fsar-ledger maintain recover if only these are damaged"
        )
    return leaf, hashes


def _segment_of(view: View, index: int) -> Path:
    """Return the segment that holds the event at this index. Raises: LedgerCorrupted if it is not as committed."""
    return view.segment(bisect_right(range(len(view.releases)), index, key=view.first) - 1)


def read_given(path: Path) -> bytes:
    """Read a proof of any form from this file or pipe. Raises: UsageError if it is missing, LedgerCorrupted."""
    try:
        return disk.read_given(path)
    except FileNotFoundError as error:
        raise UsageError(f"{path}: found no file, expected a proof that `fsar-ledger prove` wrote") from error
    except OSError as error:
        raise _unreadable(str(path), str(error.strerror)) from error


def proof_of(where: str, data: bytes) -> Proof:
    """Parse the content of file `where`, which may have CRLF lines. Raises: LedgerCorrupted if it is not a proof."""
    try:
        text = data.decode()
    except UnicodeDecodeError as error:
        raise _unreadable(where, "it is not UTF-8") from error
    return parse_proof(where, text.replace("\r\n", "\n"))


def _unreadable(where: str, reason: str) -> LedgerCorrupted:
    return LedgerCorrupted(
        f"{where}: the proof cannot be read ({reason}), expected what `fsar-ledger prove` wrote; get it again"
    )


def parse_proof(where: str, text: str) -> Proof:
    """Parse this text as a proof, whose `str` is the same text to the byte. Nothing is checked. Errors name it `where`.

    Raises:
        LedgerCorrupted: It is not in C2SP form, or lacks the event.
    """
    first, *others = text.split(f"\n\n{TITLE}\n")
    if len(others) > 1:
        raise LedgerCorrupted(
            f"{where}: found more than two steps, expected one, or two for an event of a federation, no third step; "
            "get it again"
        )
    if others:
        log = _parse_step(where, f"{TITLE}\n{others[0]}")
        return msgspec.structs.replace(_parse_step(where, f"{first}\n"), log=log)
    return _parse_step(where, text)


def _parse_step(where: str, text: str) -> Proof:
    """Parse this text as a proof of one step. Raises: As `parse_proof`."""
    head, _, note = text.partition("\n\n")
    lines = head.split("\n")
    if len(lines) < 3 or not note:
        what = f"a file of another kind or a part of one ({head!r:.80})" if text else "an empty file"
        raise LedgerCorrupted(f"{where}: found {what}, expected what `fsar-ledger prove` wrote; get it again")
    _, extra, index, *hashes = lines
    try:
        event, *decoded = [base64.b64decode(line, validate=True) for line in (extra.removeprefix("extra "), *hashes)]
        proof = Proof(event, int(index.removeprefix("index ")), tuple(decoded), parse_note(where, note))
    except ValueError as error:
        raise LedgerCorrupted(
            f"{where}: found no C2SP tlog-proof (an event or a hash that is not base64, or an index that is not a "
            "number), expected what `fsar-ledger prove` wrote; get it again"
        ) from error
    if str(proof) != text or proof.index < 0 or any(len(entry) != HASH_BYTES for entry in proof.hashes):
        raise LedgerCorrupted(
            f"{where}: found {head!r:.80}, expected a C2SP tlog-proof (title, extra, index, hashes of 32 bytes, an "
            "empty line, checkpoint); get it again"
        )
    return proof


def check_proof(where: str, proof: Proof, trusted: VerifierKey | None = None) -> Proven:
    """Check that the event is in the ledger of the proof's checkpoint, and that the trusted key, if given, signed it.

    Errors name the proof `where`.

    Raises:
        LedgerCorrupted: The hashes do not lead to the root, the event is not canonical, or the key did not sign; or the
            log of a federation does not have the head of the shard.
    """
    if proof.log is not None:
        return _check_steps(where, proof, proof.log, trusted)
    tree = proof.note.checkpoint
    root = root_of_inclusion(leaf_hash(proof.event), proof.index, tree.size, proof.hashes)
    if root != tree.root:
        path = (
            f"a way to root {root.hex()}"
            if root
            else f"{len(proof.hashes)} hashes for event {proof.index} of {tree.size}, which lead nowhere"
        )
        raise LedgerCorrupted(
            f"{where}: found {path}, expected one to {tree.root.hex()}: the event is not proven; get the proof again"
        )
    event = _event(where, proof.event)
    if trusted is not None and (why := doubt(proof.note, trusted)) is not None:
        raise LedgerCorrupted(
            f"{where}: found {why}, expected one of {trusted.key}, the trusted key; rely on nothing in it"
        )
    signers = signers_of(proof.note)
    state: Signed = "signed" if trusted else "signer not checked" if signers else "unsigned"
    return Proven(
        event, proof.index, tree.size, tree.root.hex(), tree.origin, state, trusted.key if trusted else signers
    )


def _check_steps(where: str, proof: Proof, log: Proof, trusted: VerifierKey | None) -> Proven:
    """Check both steps, and that the second is about the tree to which the first leads. Raises: As `check_proof`."""
    proven = check_proof(f"{where}, step 1 (event in shard)", msgspec.structs.replace(proof, log=None))
    of_log = check_proof(f"{where}, step 2 (shard in log)", msgspec.structs.replace(log, log=None), trusted)
    head = of_log.event
    if log.log is not None or head["type"] != HEAD_TYPE:
        raise LedgerCorrupted(
            f"{where}, step 2 (shard in log): found event {head['type']!r:.80}, expected the head of a shard "
            f"({HEAD_TYPE}), and no third step; rely on nothing in it"
        )
    for name, found in (("origin", proven.origin), ("shard_events", proven.size), ("shard_root", proven.root)):
        if head.get(name) != found:
            raise LedgerCorrupted(
                f"{where}: found step 1 in a tree of {name} {found}, expected {head.get(name)!s:.100}, which step 2 "
                "proves to be in the log: they are about different trees; get the proof again"
            )
    return msgspec.structs.replace(proven, log=of_log)


def require_tree(where: str, proven: Proven, kept: Checkpoint, source: str) -> None:
    """Check that the proof's root is that of the checkpoint `kept` elsewhere, in the file `source`.

    Raises:
        UsageError: The checkpoint is of another size, so only the ledger can show whether one grew from the other.
        LedgerCorrupted: The checkpoint is of another ledger, or has another root.
    """
    if (kept.origin, kept.size) == (proven.origin, proven.size):
        require_root(where, proven, kept.root.hex(), source)
    elif kept.origin != proven.origin:
        raise LedgerCorrupted(
            f"{where}: found an event of {proven.origin}, expected one of {kept.origin}, as in {source}; do not rely "
            "on it"
        )
    else:
        raise UsageError(
            f"{where}: found the root of {proven.size:,} events, expected one of {kept.size:,}, as in {source}; "
            "compare checkpoints of one size, or run `fsar-ledger verify LEDGER --anchor` where the ledger is"
        )


def require_root(where: str, proven: Proven, root: str, source: str) -> None:
    """Check that the proof leads to this root, in hex. Raises: LedgerCorrupted if it leads to another."""
    if proven.root != root:
        raise LedgerCorrupted(
            f"{where}: found a proof that leads to root {proven.root}, expected {root}, as in {source}: the event is "
            "not proven; do not rely on it"
        )


def _event(where: str, data: bytes) -> dict[str, Value]:
    """Decode the fields of an event.

    Raises: LedgerCorrupted unless the bytes are the RFC 8785 JSON of a row with run, seq and type.
    """
    try:
        row = msgspec.json.decode(data, type=dict[str, Value])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise LedgerCorrupted(
            f"{where}: found an event that is no flat JSON object ({error}), expected a row of a ledger; get the "
            "proof again"
        ) from error
    numbers = [value for value in row.values() if isinstance(value, int)]
    is_row = isinstance(row.get("run_id"), str) and isinstance(row.get("type"), str) and type(row.get("seq")) is int
    is_canonical = (
        all(map(str.isascii, row))
        and all(abs(number) <= MAX_INTEGER for number in numbers)
        and canonical.document(row) == data
    )
    if not is_row or not is_canonical:
        raise LedgerCorrupted(
            f"{where}: found event {data!r:.80}, expected the RFC 8785 JSON of a row with run_id, seq and type; get "
            "the proof again"
        )
    return row


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()
