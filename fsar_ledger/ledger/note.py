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
import os
import stat
from pathlib import Path

import msgspec

from fsar_ledger.errors import LedgerCorrupted, UsageError
from fsar_ledger.ledger import disk
from fsar_ledger.ledger.ed25519 import KEY_BYTES, flaw_of
from fsar_ledger.ledger.merkle import HASH_BYTES, Frontier

_ED25519 = b"\x01"
_ID_BYTES = 4
_SIGNATURE_BYTES = 64
_SECRET = "PRIVATE+KEY"
_DASH = "\N{EM DASH} "
MAX_SIGNATURES = 16
"""So many a note may carry: the log's own, and witnesses'."""


def is_name(name: str) -> bool:
    """Whether a key or an origin can have this name: printable, not empty, without spaces and plus signs."""
    return name.isprintable() and name != "" and not set(name) & {" ", "+"}


class Checkpoint(msgspec.Struct, frozen=True):
    """A tree head as it is published: whose log, how many events, and their Merkle root."""

    origin: str
    size: int
    root: bytes

    def text(self) -> str:
        """The text that is signed: origin, size and base64 root, one a line."""
        return f"{self.origin}\n{self.size}\n{base64.b64encode(self.root).decode()}\n"


class Signature(msgspec.Struct, frozen=True):
    """One signature of a note: by which key (name and id), and its bytes."""

    name: str
    key_id: bytes
    data: bytes

    @property
    def key(self) -> str:
        """The key that it names: `name+id`."""
        return f"{self.name}+{self.key_id.hex()}"

    def line(self) -> str:
        """The line that it is in the note."""
        return f"{_DASH}{self.name} {base64.b64encode(self.key_id + self.data).decode()}\n"


class Note(msgspec.Struct, frozen=True):
    """A checkpoint with its signatures."""

    checkpoint: Checkpoint
    signatures: tuple[Signature, ...] = ()

    def __str__(self) -> str:
        return f"{self.checkpoint.text()}\n{''.join(signature.line() for signature in self.signatures)}"


class VerifierKey(msgspec.Struct, frozen=True):
    """The public half of a key: it tells whether a note was signed by the other half.

    There is none of a point that is written in a second way, is not on the curve, or is outside the prime-order subgroup: `ValueError` says which.
    """

    name: str
    public: bytes

    def __post_init__(self) -> None:
        if (flaw := flaw_of(self.public)) is not None:
            raise ValueError(flaw)

    @property
    def key_id(self) -> bytes:
        """The first four bytes of SHA-256(name, line feed, 0x01, public key)."""
        return hashlib.sha256(self.name.encode() + b"\n" + _ED25519 + self.public).digest()[:_ID_BYTES]

    @property
    def key(self) -> str:
        """How a signature names it: `name+id`."""
        return f"{self.name}+{self.key_id.hex()}"

    def __str__(self) -> str:
        return f"{self.key}+{base64.b64encode(_ED25519 + self.public).decode()}"

    def made(self, signature: bytes, text: bytes) -> bool:
        """Whether this is the signature of this key under the text, by RFC 8032, section 5.1.7, in its strict form.

        64 bytes; S below L, so that a signature has no second form; R in its one way of writing, for it is compared as bytes; no cofactor, which makes
        no difference for a key of the prime-order subgroup.
        """
        from cryptography.exceptions import InvalidSignature
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

        try:
            Ed25519PublicKey.from_public_bytes(self.public).verify(signature, text)
        except (InvalidSignature, ValueError):
            return False
        return True

    def has_signed(self, note: Note) -> bool:
        """Whether the note is of the log with this key's name and carries a signature of this key, and every one that it carries is right."""
        found = [signature.data for signature in note.signatures if signature.key == self.key]
        text = note.checkpoint.text().encode()
        return note.checkpoint.origin == self.name and bool(found) and all(self.made(data, text) for data in found)


class Signer:
    """The secret half of a key: it signs the notes of the ledger whose origin is its name."""

    def __init__(self, name: str, secret: bytes):
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

        self._key = Ed25519PrivateKey.from_private_bytes(secret)
        self.verifier = VerifierKey(name, self._key.public_key().public_bytes_raw())

    def sign(self, checkpoint: Checkpoint) -> Signature:
        """The signature of this key under the checkpoint; the same each time (RFC 8032)."""
        return Signature(self.verifier.name, self.verifier.key_id, self.signature_of(checkpoint.text().encode()))

    def under(self, name: str) -> "Signer":
        """The same secret under another name: it signs the ledger of that origin."""
        return Signer(name, self._key.private_bytes_raw())

    def signature_of(self, text: bytes) -> bytes:
        """The 64 bytes of the signature under this text."""
        return self._key.sign(text)


def checkpoint_of(origin: str, tree: Frontier) -> Checkpoint:
    """The checkpoint of this tree."""
    return Checkpoint(origin, tree.size, tree.root())


def parse_note(where: str, text: str) -> Note:
    """The note in this text, which it gives back to the byte; an error calls it `where`.

    Raises:
        LedgerCorrupted: It is not a checkpoint, is not written as C2SP says, or has signatures that no Ed25519 key makes.
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
            f"{where}: found {text!r:.120}, expected a C2SP checkpoint (origin, size, root, an empty line, signatures); restore it"
        )
    return note


def _parse_signature(line: str) -> Signature:
    """The signature on this line. Raises: ValueError if there is none."""
    name, _, data = line.removeprefix(_DASH).partition(" ")
    signed = base64.b64decode(data, validate=True)
    if not is_name(name) or len(signed) <= _ID_BYTES:
        raise ValueError(f"signature line {line!r:.80}")
    return Signature(name, signed[:_ID_BYTES], signed[_ID_BYTES:])


def new_key(path: Path, name: str) -> VerifierKey:
    """There is a new key: its secret half in the file, which only its owner may read, its public half in the same name with `.pub`.

    Raises:
        UsageError: The name cannot be that of a key, or one of the files exists; it is left as it is.
        WriteFailed: The disk refused; there is no key.
    """
    if not is_name(name):
        raise UsageError(f"--name {name!r}: expected a printable name without spaces and plus signs")
    public = path.parent / (path.name + ".pub")
    for file in (path, public):
        if os.path.lexists(file):
            raise UsageError(f"{file}: found a file, expected a free name; a key is never overwritten")
    secret = os.urandom(KEY_BYTES)
    verifier = Signer(name, secret).verifier
    text = f"{_SECRET}+{verifier.key}+{base64.b64encode(_ED25519 + secret).decode()}\n"
    with disk.refusals(path, "writing a key"):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            disk.write_secret(path, text.encode())
            disk.write_durably(public, f"{verifier}\n".encode())
        except FileExistsError:  # another was quicker; it is that one's
            raise
        except BaseException:
            disk.remove(path)
            raise
    return verifier


def read_signer(path: Path) -> Signer:
    """The key in this file. Raises: UsageError if it cannot be read, is none, or is open to others."""
    text = _read_key(path)
    parts = text.removeprefix(_SECRET + "+").split("+", 2)
    expected = f"{path}: found no secret key, expected the file that `fsar-ledger key new` wrote"
    if not text.startswith(_SECRET + "+") or len(parts) != 3:
        raise UsageError(expected)
    name, key_id, data = parts
    secret = _key_bytes(data)
    if secret is None or not is_name(name):
        raise UsageError(expected)
    mode = stat.S_IMODE(path.stat().st_mode)
    if mode & 0o077:
        raise UsageError(
            f"{path}: found a secret key with mode {mode:o}, which others may read, expected 600; run chmod 600 on it, or make a new key"
        )
    signer = Signer(name, secret)
    if signer.verifier.key_id.hex() != key_id:
        raise UsageError(
            f"{path}: found key id {key_id}, expected {signer.verifier.key_id.hex()} for this key; it was altered, restore it"
        )
    return signer


def read_verifier(key: str) -> VerifierKey:
    """The public key that this is, or that is in the file of this name. Raises: UsageError if it is none."""
    is_text = key.count("+") >= 2 and not os.path.lexists(key)
    text = key if is_text else _read_key(Path(key))
    name, _, rest = text.partition("+")
    key_id, _, data = rest.partition("+")
    public = _key_bytes(data)
    where = "--trusted-key" if is_text else f"--trusted-key {key}"
    if name == "PRIVATE" or public is None or not is_name(name):  # the text is not shown: it may be the secret half
        raise UsageError(
            f"{where}: found no public key, expected one as `fsar-ledger key new` prints, or its .pub file"
        )
    if (flaw := flaw_of(public)) is not None:
        raise UsageError(
            f"{where}: found {flaw}, expected an Ed25519 public key of prime order; no signature of it would prove anything, get another key"
        )
    verifier = VerifierKey(name, public)
    if verifier.key_id.hex() != key_id:
        raise UsageError(
            f"--trusted-key: found key id {key_id:.40}, expected {verifier.key_id.hex()} for this key; it was altered, get it again"
        )
    return verifier


def _read_key(path: Path) -> str:
    try:
        return disk.read_document(Path(os.path.realpath(path))).decode().removesuffix("\n")
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not text"
        raise UsageError(
            f"{path}: the key cannot be read ({reason}); give the file that `fsar-ledger key new` wrote"
        ) from error


def _key_bytes(data: str) -> bytes | None:
    """The 32 bytes of an Ed25519 key; None if it is none."""
    try:
        key = base64.b64decode(data, validate=True)
    except (binascii.Error, ValueError):
        return None
    is_right = key[:1] == _ED25519 and len(key) == 1 + KEY_BYTES and base64.b64encode(key).decode() == data
    return key[1:] if is_right else None
