"""Keys under which a signature proves nothing are refused, and a signature has only one form."""

import hashlib
from pathlib import Path

import pytest

from fsar_ledger.base.errors import UsageError
from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.log.note import Signer, VerifierKey, checkpoint_of, flaw_of
from fsar_ledger.ledger.store.keys import read_signer, read_verifier
from tests import independent_ed25519
from tests.ledger.agreement import independent
from tests.ledger.samples import ORIGIN
from tests.ledger.weak_keys import SECOND_WAY, SMALL_ORDER, WEAK, Forger, L, forged

P = 2**255 - 19
SIGNER = Signer(ORIGIN, b"s" * 32)
TEXT = checkpoint_of(ORIGIN, Frontier()).text().encode()


def mixed(public: bytes, weak: bytes) -> bytes:
    """Return the sum of an honest key and a point of small order."""
    x, y = independent_ed25519.plus(independent_ed25519.point_of(public), independent_ed25519.point_of(weak))
    return bytes((y | (x & 1) << 255).to_bytes(32, "little"))


@pytest.mark.parametrize("name", WEAK)
def test_a_key_of_small_order_under_which_anybody_signs_is_refused_wherever_it_is_read(
    name: str, tmp_path: Path
) -> None:
    forger = Forger(ORIGIN, WEAK[name])
    assert len(forged(forger.public, TEXT)) == 64  # the library accepts a signature made without a secret
    (tmp_path / "weak.pub").write_text(f"{forger}\n")
    expected = "a point of small order" if name in SMALL_ORDER else "not written in its one way"
    for key in (str(forger), str(tmp_path / "weak.pub")):
        with pytest.raises(UsageError, match=rf"trusted_key.*: found .*{expected}.*, expected an Ed25519 public key"):
            read_verifier(key)
    with pytest.raises(ValueError, match=expected):
        VerifierKey(ORIGIN, forger.public)
    with pytest.raises(ValueError, match="no Ed25519 public key"):
        independent().read_key(str(forger))


def test_the_list_of_small_order_is_the_whole_list() -> None:
    """Eight points, and their other encodings."""
    plus, point_of = independent_ed25519.plus, independent_ed25519.point_of
    points = {point_of(bytes.fromhex(text)) for text in SMALL_ORDER.values()}
    assert len(points) == 8
    assert {plus(one, other) for one in points for other in points} == points
    encodings = {
        y + over | sign << 255
        for x, y in points
        for over in (0, P)
        for sign in (0, 1)
        if y + over < 2**255 and (x == 0 or x & 1 == sign)
    }
    assert {one.to_bytes(32, "little") for one in encodings} == set(WEAK.values())
    assert len(WEAK) == len(SMALL_ORDER) + len(SECOND_WAY) == 14


@pytest.mark.parametrize("name", [name for name in SMALL_ORDER if name != "order 1"])
def test_an_honest_key_with_a_part_of_small_order_is_refused(name: str) -> None:
    assert (
        flaw_of(mixed(SIGNER.verifier.public, bytes.fromhex(SMALL_ORDER[name]))) == "a point with a part of small order"
    )


def test_what_is_no_point_or_is_written_in_a_second_way_is_refused() -> None:
    found = {flaw_of((P + over).to_bytes(32, "little")) for over in range(19)}
    assert found == {"a point that is not written in its one way"}
    off = [y for y in range(2, 12) if flaw_of(y.to_bytes(32, "little")) == "no point on the curve"]
    assert off == [2, 7, 8, 11]
    assert all(
        pow((y * y - 1) * pow(-121665 * pow(121666, -1, P) * y * y + 1, -1, P), (P - 1) // 2, P) == P - 1 for y in off
    )
    assert flaw_of(b"") == "0 bytes"
    assert flaw_of(bytes(33)) == "33 bytes"


def test_no_honest_key_is_refused() -> None:
    for number in range(15):
        key = Signer(ORIGIN, number.to_bytes(32)).verifier
        assert flaw_of(key.public) is None
        assert independent().read_key(str(key))[2] == key.public


def test_a_secret_key_that_names_a_weak_public_half_is_refused(tmp_path: Path) -> None:
    """The public half of a secret key is computed, never read; its id must match the one in the file."""
    path = tmp_path / "key"
    path.write_text(f"PRIVATE+KEY+{Forger(ORIGIN, WEAK['order 1'])}\n")
    path.chmod(0o600)
    with pytest.raises(UsageError, match="found key id"):
        read_signer(path)


# --- signatures ---


def test_a_signature_has_no_second_form() -> None:
    key, signature = SIGNER.verifier, SIGNER.signature_of(TEXT)
    point, scalar = signature[:32], int.from_bytes(signature[32:], "little")
    assert scalar < L
    assert key.verifies(signature, TEXT)
    for other in range(scalar + L, 2**256, L):
        assert not key.verifies(point + other.to_bytes(32, "little"), TEXT)
    assert not key.verifies(point[:31] + bytes([point[31] ^ 0x80]) + signature[32:], TEXT)
    assert not key.verifies(signature + b"\x00", TEXT)


def test_a_point_of_small_order_in_a_signature_helps_nobody_without_the_secret() -> None:
    """R may be the identity in canonical form, but then S is the secret times the hash, which only the holder can
    compute."""
    key = SIGNER.verifier
    secret = int.from_bytes(hashlib.sha512(b"s" * 32).digest()[:32], "little") & ~7 & 2**254 - 1 | 2**254
    for name, point in WEAK.items():
        scalar = int.from_bytes(hashlib.sha512(point + key.public + TEXT).digest(), "little") * secret % L
        assert key.verifies(point + scalar.to_bytes(32, "little"), TEXT) == (name == "order 1")
        assert not key.verifies(point + bytes(32), TEXT)
        assert not key.verifies(point + (scalar + 1).to_bytes(32, "little"), TEXT)
