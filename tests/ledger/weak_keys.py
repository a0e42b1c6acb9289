"""Public keys under which anybody signs: the encodings of points of small order, and a forger who has no secret."""

import base64
import hashlib
from collections.abc import Iterator

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from fsar_ledger.ledger.log.note import Checkpoint, Signature, Signer

L = 2**252 + 27742317777372353535851937790883648493

# Chalkias, Garillot, Nikolaenko, "Taming the many EdDSAs" (2020), table 6: each point in its canonical encoding
SMALL_ORDER = {
    "order 1": "0100000000000000000000000000000000000000000000000000000000000000",
    "order 2": "ecffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f",
    "order 4, even": "0000000000000000000000000000000000000000000000000000000000000000",
    "order 4, odd": "0000000000000000000000000000000000000000000000000000000000000080",
    "order 8, first, even": "26e8958fc2b227b045c3f489f2ef98f0d5dfac05d3c63339b13802886d53fc05",
    "order 8, first, odd": "26e8958fc2b227b045c3f489f2ef98f0d5dfac05d3c63339b13802886d53fc85",
    "order 8, second, even": "c7176a703d4dd84fba3c0b760d10670f2a2053fa2c39ccc64ec7fd7792ac037a",
    "order 8, second, odd": "c7176a703d4dd84fba3c0b760d10670f2a2053fa2c39ccc64ec7fd7792ac03fa",
}
SECOND_WAY = {  # table 5: the same points in other encodings
    "order 1, sign of zero": "0100000000000000000000000000000000000000000000000000000000000080",
    "order 2, sign of zero": "ecffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff",
    "order 1, y = p + 1": "eeffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f",
    "order 1, y = p + 1, sign of zero": "eeffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff",
    "order 4, y = p": "edffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f",
    "order 4, y = p, odd": "edffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff",
}
WEAK = {name: bytes.fromhex(text) for name, text in (SMALL_ORDER | SECOND_WAY).items()}


def tries() -> Iterator[tuple[bytes, bytes]]:
    """Yield S B, as a point, and S, for one known S after the other."""
    for number in range(1_000):
        seed = number.to_bytes(32)
        scalar = (
            int.from_bytes(hashlib.sha512(seed).digest()[:32], "little") & ~7 & 2**254 - 1 | 2**254
        )  # RFC 8032, section 5.1.5
        yield (
            Ed25519PrivateKey.from_private_bytes(seed).public_key().public_bytes_raw(),
            (scalar % L).to_bytes(32, "little"),
        )


def forged(public: bytes, text: bytes) -> bytes:
    """Return a signature that the library accepts under this key for this text: R = S B is right whenever the order of
    the key divides the hash."""
    verifier = Ed25519PublicKey.from_public_bytes(public)
    for point, scalar in tries():
        try:
            verifier.verify(point + scalar, text)
        except InvalidSignature:
            continue
        return point + scalar
    raise AssertionError("no signature found")


class Forger(Signer):
    """Signs under a public key whose secret nobody has."""

    def __init__(self, name: str, public: bytes):
        self.name, self.public = name, public
        self.key_id = hashlib.sha256(name.encode() + b"\n\x01" + public).digest()[:4]

    def __str__(self) -> str:
        return f"{self.name}+{self.key_id.hex()}+" + base64.b64encode(b"\x01" + self.public).decode()

    def sign(self, checkpoint: Checkpoint) -> Signature:
        return Signature(self.name, self.key_id, forged(self.public, checkpoint.text().encode()))
