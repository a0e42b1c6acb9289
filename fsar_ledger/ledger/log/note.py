"""Signed notes and the keys that sign them, as C2SP signed-note says; the text of ours is a C2SP tlog-checkpoint.

```
fsar-ledger/simulated                              the origin
167003                                             events
GOniXQYJeSjvAPLjEaJ...UJtQ=                        their Merkle root

— fsar-ledger/simulated GQu2...                    one line a signature, none if the note is unsigned
```
"""

import base64
import binascii
import hashlib
from typing import Literal

import msgspec

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.log.ed25519 import flaw_of
from fsar_ledger.ledger.log.merkle import HASH_BYTES, Frontier

ED25519 = b"\x01"
_ID_BYTES = 4
_SIGNATURE_BYTES = 64
_DASH = "\N{EM DASH} "
Signed = Literal["unsigned", "signer not checked", "signed"]

MAX_SIGNATURES = 16
"""So many a note may carry: the log's own, and witnesses'."""


def is_name(name: str) -> bool:
    """Return whether a key or an origin can have this name: printable, not empty, without spaces and plus signs."""
    return name.isprintable() and name != "" and not set(name) & {" ", "+"}


class Checkpoint(msgspec.Struct, frozen=True):
    """A published tree head: whose log, how many events, and their Merkle root."""

    origin: str
    size: int
    root: bytes

    def text(self) -> str:
        """Return the text that is signed: origin, size and base64 root, one a line."""
        return f"{self.origin}\n{self.size}\n{base64.b64encode(self.root).decode()}\n"


class Signature(msgspec.Struct, frozen=True):
    """One signature of a note: by which key (name and id), and its bytes."""

    name: str
    key_id: bytes
    data: bytes

    @property
    def key(self) -> str:
        """Return the key that it names: `name+id`."""
        return f"{self.name}+{self.key_id.hex()}"

    def line(self) -> str:
        """Return its line in the note."""
        return f"{_DASH}{self.name} {base64.b64encode(self.key_id + self.data).decode()}\n"


class Note(msgspec.Struct, frozen=True):
    """A checkpoint with its signatures."""

    checkpoint: Checkpoint
    signatures: tuple[Signature, ...] = ()

    def __str__(self) -> str:
        return f"{self.checkpoint.text()}\n{''.join(signature.line() for signature in self.signatures)}"


class VerifierKey(msgspec.Struct, frozen=True):
    """The public half of a key, which tells whether the other half signed a note.

    There is none of a point that is written in a second way, is not on the curve, or is outside the prime-order
    subgroup: `ValueError` says which.
    """

    name: str
    public: bytes

    def __post_init__(self) -> None:
        if (flaw := flaw_of(self.public)) is not None:
            raise ValueError(flaw)

    @property
    def key_id(self) -> bytes:
        """Return the first four bytes of SHA-256(name, line feed, 0x01, public key)."""
        return hashlib.sha256(self.name.encode() + b"\n" + ED25519 + self.public).digest()[:_ID_BYTES]

    @property
    def key(self) -> str:
        """Return the key as a signature names it: `name+id`."""
        return f"{self.name}+{self.key_id.hex()}"

    def __str__(self) -> str:
        return f"{self.key}+{base64.b64encode(ED25519 + self.public).decode()}"

    def made(self, signature: bytes, text: bytes) -> bool:
        """Return whether this is the signature of this key under the text.

        Checked by RFC 8032, section 5.1.7, in its strict form.

        64 bytes; S below L, so that a signature has no second form; R in its one way of writing, for it is compared as
        bytes; no cofactor, which makes no difference for a key of the prime-order subgroup.
        """
        from cryptography.exceptions import InvalidSignature
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

        try:
            Ed25519PublicKey.from_public_bytes(self.public).verify(signature, text)
        except (InvalidSignature, ValueError):
            return False
        return True

    def has_signed(self, note: Note) -> bool:
        """Return whether this key signed the note.

        The note must be of the log with this key's name, and every signature of this key on it must be right.
        """
        found = [signature.data for signature in note.signatures if signature.key == self.key]
        text = note.checkpoint.text().encode()
        return note.checkpoint.origin == self.name and bool(found) and all(self.made(data, text) for data in found)


class Signer:
    """The secret half of a key, which signs the notes of the ledger whose origin is its name."""

    def __init__(self, name: str, secret: bytes):
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

        self._key = Ed25519PrivateKey.from_private_bytes(secret)
        self.verifier = VerifierKey(name, self._key.public_key().public_bytes_raw())

    def sign(self, checkpoint: Checkpoint) -> Signature:
        """Sign the checkpoint; the signature is the same each time (RFC 8032)."""
        return Signature(self.verifier.name, self.verifier.key_id, self.signature_of(checkpoint.text().encode()))

    def under(self, name: str) -> "Signer":
        """Return the same secret under another name, to sign the ledger of that origin."""
        return Signer(name, self._key.private_bytes_raw())

    def signature_of(self, text: bytes) -> bytes:
        """Return the 64 bytes of the signature under this text."""
        return self._key.sign(text)


def checkpoint_of(origin: str, tree: Frontier) -> Checkpoint:
    """Return the checkpoint of this tree."""
    return Checkpoint(origin, tree.size, tree.root())


def parse_note(where: str, text: str) -> Note:
    """Parse the note in this text. `str` gives the text back to the byte; errors call it `where`.

    Raises:
        LedgerCorrupted: It is not a checkpoint, is not written as C2SP says, or has signatures that no Ed25519 key
            makes.
    """
    body, _, lines = text.rpartition("\n\n")
    origin, size, root, *_ = [*body.split("\n"), "", ""]
    number = int(size) if size.isdecimal() and len(size) <= 16 else -1
    try:
        note = Note(
            Checkpoint(origin, number, base64.b64decode(root, validate=True)),
            tuple(map(_parse_signature, lines.splitlines())),
        )
    except (binascii.Error, ValueError) as error:
        raise LedgerCorrupted(
            f"{where}: found a note with a part that is not base64 ({error}), expected a C2SP checkpoint; restore it"
        ) from error
    is_checkpoint = number >= 0 and is_name(origin) and len(note.checkpoint.root) == HASH_BYTES
    if str(note) != text or not is_checkpoint or len(note.signatures) > MAX_SIGNATURES:
        raise LedgerCorrupted(
            f"{where}: found {text!r:.120}, expected a C2SP checkpoint (origin, size, root, an empty line, "
            "signatures); restore it"
        )
    return note


def _parse_signature(line: str) -> Signature:
    """Parse the signature on this line. Raises: ValueError if there is none."""
    name, _, data = line.removeprefix(_DASH).partition(" ")
    signed = base64.b64decode(data, validate=True)
    if not is_name(name) or len(signed) <= _ID_BYTES:
        raise ValueError(f"signature line {line!r:.80}")
    return Signature(name, signed[:_ID_BYTES], signed[_ID_BYTES:])


def names(note: Note, key: VerifierKey) -> bool:
    """Return whether the note has a signature that claims to be of this key."""
    return any(signature.key == key.key for signature in note.signatures)


def signers_of(note: Note) -> str | None:
    """Return the keys that the note names, unchecked; None if it is unsigned."""
    return ", ".join(signature.key for signature in note.signatures) or None


def doubt(note: Note, trusted: VerifierKey) -> str | None:
    """Say why this note is not one that the trusted key signed; None if it is."""
    if trusted.has_signed(note):
        return None
    if names(note, trusted):
        return (
            "a signature that this key did not make"
            if note.checkpoint.origin == trusted.name
            else f"a checkpoint of {note.checkpoint.origin}"
        )
    signers = signers_of(note)
    return f"a signature of {signers}" if signers else "no signature"
