"""A proof as a COSE transparent statement: the event, signed, and a receipt of it, as CBOR (RFC 9052, 9942, 9943).

```
18([<<{1: -8, 3: "application/json", 4: KEY ID, 15: {1: ORIGIN, 2: "event INDEX"}}>>,
    {394: [<<18([<<{1: -8, 4: KEY ID, 15: {1: ORIGIN, 2: CHECKPOINT}, 395: 1}>>,
                 {396: {-1: [<<[SIZE, INDEX, [HASH, ...]]>>]}},
                 null,                                             the root, detached
                 SIGNATURE])>>]},
    EVENT,                                                         its canonical bytes: the leaf of the tree
    SIGNATURE])
```

`<<...>>` is the CBOR of its content, as a byte string. A receipt of RFC 9942 signs only the root, to which some hashes
also lead from another index in a tree of another size. So its protected header also has the checkpoint (origin, size,
root), in C2SP form. See docs/decisions/receipts-are-signed-when-proving.md.
"""

from types import ModuleType
from typing import Any

import msgspec

from fsar_ledger.base.errors import LedgerCorrupted, UsageError
from fsar_ledger.ledger.log.note import Checkpoint, Note, Signer, VerifierKey, doubt, parse_note
from fsar_ledger.ledger.store.proof import Proof, Proven, check_proof

SIGN1, ALG, CONTENT_TYPE, KEY_ID, CLAIMS, RECEIPTS, VDS, VDP = 18, 1, 3, 4, 15, 394, 395, 396
ISSUER, SUBJECT, INCLUSION, EDDSA, RFC9162_SHA256 = 1, 2, -1, -8, 1
_START = b"\xd2\x84"
"""Tag 18 and an array of four, in two bytes."""


class Statement(msgspec.Struct, frozen=True):
    """A proof whose note is unsigned, the id of a key, and two Ed25519 signatures: of the event and of the root."""

    proof: Proof
    key_id: bytes
    of_event: bytes = b""
    of_root: bytes = b""

    @property
    def signer(self) -> str:
        """Return the key that the statement names: `name+id`."""
        return f"{self.proof.note.checkpoint.origin}+{self.key_id.hex()}"


def is_statement(data: bytes) -> bool:
    """Return whether the file begins as a COSE_Sign1 does, which none of our text formats does."""
    return data.startswith(_START)


def library(where: str) -> ModuleType:
    """Return the CBOR library. Raises: UsageError if it is not installed; the error names what needs it, `where`."""
    try:
        import cbor2
    except ImportError as error:
        raise UsageError(
            f"{where}: found no library cbor2, expected it for COSE; install it (`pip install cbor2`, or the extra "
            "`cose` of this package)"
        ) from error
    module: ModuleType = cbor2
    return module


def signed_statement(where: str, proof: Proof, signer: Signer) -> bytes:
    """Return the transparent statement of this proof, signed by the key that signed its checkpoint.

    Raises:
        UsageError: The key did not sign the checkpoint, so the receipt would vouch for more than the ledger does; the
            tree has one event, for which no receipt is possible; or cbor2 is not installed.
    """
    cbor, tree, key = library(where), proof.note.checkpoint, signer.verifier
    if (why := doubt(proof.note, key)) is not None:
        raise UsageError(
            f"{where}: found {why} on the newest checkpoint, expected one of {key.key}: a receipt is signed with the "
            "key that signed the ledger; give that key, or sign the next commit with this one"
        )
    if not proof.hashes:
        raise UsageError(
            f"{where}: found a ledger of one event, expected more, since RFC 9942 has no receipt without a hash; prove "
            "it as a tlog-proof, or after the next commit"
        )
    bare = Statement(msgspec.structs.replace(proof, note=Note(tree)), key.key_id)
    of_event, of_root = (signer.signature_of(text) for text in _signed_texts(cbor, bare))
    return _encoded(cbor, msgspec.structs.replace(bare, of_event=of_event, of_root=of_root))


def check_statement(where: str, data: bytes, trusted: VerifierKey | None = None) -> Proven:
    """Check that the event leads to the root that its receipt names, and that the trusted key, if given, signed both.

    Errors name the file `where`.

    Raises:
        LedgerCorrupted: The file is not, to the byte, what `signed_statement` writes; the hashes do not lead to the
            root; the event is not canonical; or the key did not sign the event and the root.
        UsageError: cbor2 is not installed.
    """
    cbor = library(where)
    statement = _parsed(cbor, where, data)
    proven = check_proof(where, statement.proof)
    if trusted is None:
        return msgspec.structs.replace(proven, signature="signer not checked", signer=statement.signer)
    if statement.signer != trusted.key:
        raise LedgerCorrupted(
            f"{where}: found a receipt of {statement.signer}, expected one of {trusted.key}, the trusted key; rely on "
            "nothing in it"
        )
    signatures = (statement.of_event, statement.of_root)
    for what, text, signature in zip(("event", "root"), _signed_texts(cbor, statement), signatures, strict=True):
        if not trusted.verifies(signature, text):
            raise LedgerCorrupted(
                f"{where}: found a signature of the {what} that this key did not make, expected one of {trusted.key}, "
                "the trusted key; rely on nothing in it"
            )
    return msgspec.structs.replace(proven, signature="signed", signer=trusted.key)


def _parsed(cbor: Any, where: str, data: bytes) -> Statement:
    """Parse a statement, checking only its form. Raises: LedgerCorrupted if that is wrong."""
    try:
        outer = cbor.loads(data).value
        inner = cbor.loads(outer[1][RECEIPTS][0]).value
        match outer, inner, cbor.loads(inner[0]), cbor.loads(inner[1][VDP][INCLUSION][0]):
            case (
                [_, _, bytes(event), bytes(of_event)],
                [_, _, None, bytes(of_root)],
                {4: bytes(key_id), 15: {2: str(text)}},
                [int(), int(index), [bytes(), *_] as hashes],
            ) if all(isinstance(entry, bytes) for entry in hashes):
                tree = parse_note(where, f"{text}\n").checkpoint
                proof = Proof(event, int(index), tuple(hashes), Note(tree))
                statement = Statement(proof, key_id, of_event, of_root)
                if _encoded(cbor, statement) == data:
                    return statement
    except (cbor.CBORDecodeError, LookupError, TypeError, ValueError, AttributeError, RecursionError):
        pass  # cbor2 5 has no depth limit
    raise LedgerCorrupted(
        f"{where}: found COSE of another form, or a part of it, expected what `fsar-ledger prove --as cose` wrote; get "
        "it again"
    )


def _encoded(cbor: Any, statement: Statement) -> bytes:
    """Return the bytes of the statement."""
    proof, tree = statement.proof, statement.proof.note.checkpoint
    path: bytes = cbor.dumps([tree.size, proof.index, list(proof.hashes)])
    of_event, of_root = _headers(cbor, statement)
    receipt = cbor.dumps(cbor.CBORTag(SIGN1, [of_root, {VDP: {INCLUSION: [path]}}, None, statement.of_root]))
    encoded: bytes = cbor.dumps(cbor.CBORTag(SIGN1, [of_event, {RECEIPTS: [receipt]}, proof.event, statement.of_event]))
    return encoded


def _headers(cbor: Any, statement: Statement) -> tuple[bytes, bytes]:
    """Return the protected headers of the statement and of its receipt."""
    tree: Checkpoint = statement.proof.note.checkpoint
    about_event = {ISSUER: tree.origin, SUBJECT: f"event {statement.proof.index}"}
    about_root = {ISSUER: tree.origin, SUBJECT: tree.text()}
    of_event = {ALG: EDDSA, CONTENT_TYPE: "application/json", KEY_ID: statement.key_id, CLAIMS: about_event}
    of_root = {ALG: EDDSA, KEY_ID: statement.key_id, CLAIMS: about_root, VDS: RFC9162_SHA256}
    return cbor.dumps(of_event), cbor.dumps(of_root)


def _signed_texts(cbor: Any, statement: Statement) -> tuple[bytes, bytes]:
    """Return the signed bytes of the event and of the root: the Sig_structure of RFC 9052, section 4.4.

    Each begins with 0x84, with which no note begins, since its text is UTF-8. So no signature is valid for both.
    """
    proof = statement.proof
    of_event, of_root = (
        cbor.dumps(["Signature1", header, b"", payload])
        for header, payload in zip(_headers(cbor, statement), (proof.event, proof.note.checkpoint.root), strict=True)
    )
    return of_event, of_root
