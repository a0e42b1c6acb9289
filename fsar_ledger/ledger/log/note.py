"""Signed notes (C2SP signed-note), their keys, and which keys can be trusted. The text is a C2SP tlog-checkpoint.

```
fsar-ledger/simulated                              the origin
167003                                             number of events
GOniXQYJeSjvAPLjEaJ...UJtQ=                        their Merkle root
— fsar-ledger/simulated GQu2...                    one line per signature, none if the note is unsigned
```

An Ed25519 key (RFC 8032, section 5.1) is a point on a curve with 8 L points, where L is prime. Honest keys are
multiples of the base point: the L points of the prime-order subgroup. Under a point of small order (1, 2, 4 or 8),
anyone can sign anything without a secret. A key with a small-order component lets verifiers disagree. A point in a
second encoding is a second key for the same secret. Chalkias, Garillot, Nikolaenko, "Taming the many EdDSAs" (2020),
lists these encodings; common libraries accept most of them. Python integers are good enough here: nothing is secret,
and each key is read once.
"""

import base64
import binascii
import hashlib
from functools import lru_cache
from typing import ClassVar, Literal

import msgspec

from fsar_ledger.base.errors import LedgerCorrupted
from fsar_ledger.ledger.log.hashing import HASH_BYTES
from fsar_ledger.ledger.log.merkle import Frontier

KEY_BYTES = 32
_P = 2**255 - 19
_L = 2**252 + 27742317777372353535851937790883648493
_D = -121665 * pow(121666, -1, _P) % _P
_SQRT_OF_MINUS_1 = pow(2, (_P - 1) // 4, _P)

Point = tuple[int, int, int, int]
"""Extended coordinates (X, Y, Z, T): x = X / Z, y = Y / Z, x y = T / Z."""

_IDENTITY: Point = (0, 1, 1, 0)


@lru_cache(maxsize=64)
def flaw_of(public: bytes) -> str | None:
    """Return why this public key cannot be trusted, phrased to follow "found"; None if it can.

    Takes about 1.5 ms, once per key.
    """
    if len(public) != KEY_BYTES:
        return f"{len(public)} bytes"
    number = int.from_bytes(public, "little")
    y, sign = number % 2**255, number >> 255
    if y >= _P:
        return "a point that is not written in its one way"
    x = _x_of(y)
    if x is None:
        return "no point on the curve"
    if x == 0 and sign:
        return "a point that is not written in its one way"
    if x & 1 != sign:
        x = _P - x
    point = (x, y, 1, x * y % _P)
    if _is_identity(_times(8, point)):
        return "a point of small order, under which anyone can sign"
    return None if _is_identity(_times(_L, point)) else "a point with a part of small order"


def _x_of(y: int) -> int | None:
    """Return one of the two x coordinates for this y; None if no point has it."""
    numerator, denominator = (y * y - 1) % _P, (_D * y * y + 1) % _P
    square = numerator * pow(denominator, -1, _P) % _P
    root = pow(square, (_P + 3) // 8, _P)
    for x in (root, root * _SQRT_OF_MINUS_1 % _P):
        if x * x % _P == square:
            return x
    return None


def _plus(a: Point, b: Point) -> Point:
    """Add two points, with a formula that is valid for every pair."""
    low, high = (a[1] - a[0]) * (b[1] - b[0]) % _P, (a[1] + a[0]) * (b[1] + b[0]) % _P
    product, doubled = 2 * a[3] * b[3] * _D % _P, 2 * a[2] * b[2] % _P
    e, f, g, h = high - low, doubled - product, doubled + product, high + low
    return e * f % _P, g * h % _P, f * g % _P, e * h % _P


def _times(count: int, point: Point) -> Point:
    """Return `count` times the point."""
    product = _IDENTITY
    while count:
        if count & 1:
            product = _plus(product, point)
        point = _plus(point, point)
        count >>= 1
    return product


def _is_identity(point: Point) -> bool:
    return point[0] == 0 and point[1] == point[2]


ED25519 = b"\x01"
ID_BYTES = 4
SIGNATURE_BYTES = 64  # RFC 8032
_DASH = "\N{EM DASH} "
Signed = Literal["unsigned", "signer not checked", "signed"]

MAX_SIGNATURES = 64
"""The most signatures on a note: the log's own, and those of witnesses."""


def is_name(name: str) -> bool:
    """Return whether this is a valid name of a key or an origin: printable, not empty, no spaces, no plus signs."""
    return name.isprintable() and name != "" and not set(name) & {" ", "+"}


class Checkpoint(msgspec.Struct, frozen=True):
    """A published tree head: the origin of the log, the number of its events, and their Merkle root."""

    origin: str
    size: int
    root: bytes

    def text(self) -> str:
        """Return the text that is signed: origin, size and base64 root, one per line."""
        return f"{self.origin}\n{self.size}\n{base64.b64encode(self.root).decode()}\n"


class Signature(msgspec.Struct, frozen=True):
    """One signature on a note: the name and id of its key, and the bytes."""

    name: str
    key_id: bytes
    data: bytes

    @property
    def key(self) -> str:
        """Return the key that the signature names: `name+id`."""
        return f"{self.name}+{self.key_id.hex()}"

    def line(self) -> str:
        """Return the line of the signature in the note."""
        return f"{_DASH}{self.name} {base64.b64encode(self.key_id + self.data).decode()}\n"


class Note(msgspec.Struct, frozen=True):
    """A checkpoint with its signatures."""

    checkpoint: Checkpoint
    signatures: tuple[Signature, ...] = ()

    def __str__(self) -> str:
        return f"{self.checkpoint.text()}\n{''.join(signature.line() for signature in self.signatures)}"


class PublicKey(msgspec.Struct, frozen=True):
    """The public half of an Ed25519 key under a name. `KIND` is the C2SP byte for what it signs.

    Raises: ValueError, with the reason, if the point is in a second encoding, off the curve, or outside the prime-order
    subgroup.
    """

    KIND: ClassVar[bytes]

    name: str
    public: bytes

    def __post_init__(self) -> None:
        if (flaw := flaw_of(self.public)) is not None:
            raise ValueError(flaw)

    @property
    def key_id(self) -> bytes:
        """Return the first four bytes of SHA-256(name, line feed, kind, public key)."""
        return hashlib.sha256(self.name.encode() + b"\n" + self.KIND + self.public).digest()[:ID_BYTES]

    @property
    def key(self) -> str:
        """Return the key as a signature names it: `name+id`."""
        return f"{self.name}+{self.key_id.hex()}"

    def __str__(self) -> str:
        return f"{self.key}+{base64.b64encode(self.KIND + self.public).decode()}"

    def verifies(self, signature: bytes, text: bytes) -> bool:
        """Return whether this key made the signature of this text.

        Checked strictly by RFC 8032, section 5.1.7. The signature has 64 bytes. S is below L, so that there is no
        second form. R is in canonical form, because it is compared as bytes. There is no cofactor, which makes no
        difference for a key in the prime-order subgroup.
        """
        from cryptography.exceptions import InvalidSignature
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

        try:
            Ed25519PublicKey.from_public_bytes(self.public).verify(signature, text)
        except (InvalidSignature, ValueError):
            return False
        return True


class VerifierKey(PublicKey, frozen=True):
    """The public key of a log, which checks the notes that the secret half signed."""

    KIND: ClassVar[bytes] = ED25519

    def has_signed(self, note: Note) -> bool:
        """Return whether this key signed the note.

        The note's origin must be the name of this key, and every signature of this key on it must be valid.
        """
        own_signatures = [signature.data for signature in note.signatures if signature.key == self.key]
        text = note.checkpoint.text().encode()
        return (
            note.checkpoint.origin == self.name
            and bool(own_signatures)
            and all(self.verifies(data, text) for data in own_signatures)
        )


class Signer:
    """The secret half of a key, which signs the notes of the ledger whose origin is the key's name."""

    def __init__(self, name: str, secret: bytes):
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

        self._key = Ed25519PrivateKey.from_private_bytes(secret)
        self.verifier = VerifierKey(name, self._key.public_key().public_bytes_raw())

    def sign(self, checkpoint: Checkpoint) -> Signature:
        """Sign the checkpoint. The signature is deterministic (RFC 8032)."""
        return Signature(self.verifier.name, self.verifier.key_id, self.signature_of(checkpoint.text().encode()))

    def under(self, name: str) -> "Signer":
        """Return the same secret under another name, to sign the ledger of that origin."""
        return Signer(name, self._key.private_bytes_raw())

    def signature_of(self, text: bytes) -> bytes:
        """Return the 64-byte signature of this text."""
        return self._key.sign(text)


def checkpoint_of(origin: str, tree: Frontier) -> Checkpoint:
    """Return the checkpoint of this tree."""
    return Checkpoint(origin, tree.size, tree.root())


def parse_note(where: str, text: str) -> Note:
    """Parse this text as a note, whose `str` is the same text to the byte.

    Errors name it `where`.

    Raises:
        LedgerCorrupted: It is not a checkpoint, not in C2SP form, or has signatures that no Ed25519 key makes.
    """
    body, _, end = text.rpartition("\n\n")
    if len(lines := end.splitlines()) > MAX_SIGNATURES:
        raise LedgerCorrupted(f"{where}: found {len(lines):,} signatures, expected at most {MAX_SIGNATURES}")
    origin, size, root, *_ = [*body.split("\n"), "", ""]
    event_count = int(size) if size.isdecimal() and len(size) <= 16 else -1
    try:
        note = Note(
            Checkpoint(origin, event_count, base64.b64decode(root, validate=True)),
            tuple(map(_parse_signature, lines)),
        )
    except (binascii.Error, ValueError) as error:
        raise LedgerCorrupted(
            f"{where}: found a note with a part that is not base64 ({error}), expected a C2SP checkpoint; restore it"
        ) from error
    is_checkpoint = event_count >= 0 and is_name(origin) and len(note.checkpoint.root) == HASH_BYTES
    if str(note) != text or not is_checkpoint:
        raise LedgerCorrupted(
            f"{where}: found {text!r:.120}, expected a C2SP checkpoint (origin, size, root, an empty line, "
            "signatures); restore it"
        )
    return note


def _parse_signature(line: str) -> Signature:
    """Parse the signature on this line. Raises: ValueError if it is not one."""
    name, _, data = line.removeprefix(_DASH).partition(" ")
    signed = base64.b64decode(data, validate=True)
    if not is_name(name) or len(signed) <= ID_BYTES:
        raise ValueError(f"signature line {line!r:.80}")
    return Signature(name, signed[:ID_BYTES], signed[ID_BYTES:])


def names(note: Note, key: VerifierKey) -> bool:
    """Return whether a signature on the note claims to be by this key."""
    return any(signature.key == key.key for signature in note.signatures)


def signers_of(note: Note) -> str | None:
    """Return the keys that the signatures name, unchecked; None if the note is unsigned."""
    return ", ".join(signature.key for signature in note.signatures) or None


def doubt(note: Note, trusted: VerifierKey) -> str | None:
    """Return why this note does not count as signed by the trusted key; None if it does."""
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
