import base64
import hashlib

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from fsar_ledger.base.errors import LedgerCorrupted, UsageError
from fsar_ledger.ledger.log.note import Checkpoint, Note, Signature, VerifierKey
from fsar_ledger.witness import (
    MAX_TIME_S,
    Cosigner,
    WitnessKey,
    parse_cosigned,
    parse_secret,
    parse_vkey,
    read_log_key,
    secret_text,
)
from tests.ledger.weak_keys import WEAK
from tests.witness.conftest import LOG, NOW_S, ORIGIN, Log

COSIGNER = Cosigner("example.org/w1", bytes(32))
EXAMPLE = (  # of C2SP tlog-cosignature
    b"example.com/behind-the-sofa\n20852163\nCsUYapGGPo4dkMgIAUqom/Xajj7h2fB2MPA3j2jxq2I=\n\n"
    b"\xe2\x80\x94 example.com/behind-the-sofa "
    b"Az3grlgtzPICa5OS8npVmf1Myq/5IZniMp+ZJurmRDeOoRDe4URYN7u5/Zhcyv2q1gGzGku9nTo+zyWE+xeMcTOAYQ8=\n"
    b"\xe2\x80\x94 witness.example.com/w1 "
    b"jWbPPwAAAABkGFDLEZMHwSRaJNiIDoe9DYn/zXcrtPHeolMI5OWXEhZCB9dlrDJsX3b2oyin1nPZqhf5nNo0xUe+mbIUBkBIfZ+qnA==\n"
)


def test_a_cosignature_is_what_the_text_of_c2sp_says_byte_for_byte() -> None:
    secret = Ed25519PrivateKey.from_private_bytes(bytes(32))
    public = secret.public_key().public_bytes_raw()
    checkpoint = Checkpoint(
        "example.com/behind-the-sofa", 20852163, base64.b64decode("CsUYapGGPo4dkMgIAUqom/Xajj7h2fB2MPA3j2jxq2I=")
    )
    text = (
        b"cosignature/v1\ntime 1679315147\n"
        b"example.com/behind-the-sofa\n20852163\nCsUYapGGPo4dkMgIAUqom/Xajj7h2fB2MPA3j2jxq2I=\n"
    )
    key_id = hashlib.sha256(b"example.org/w1\n\x04" + public).digest()[:4]
    line = (
        "— example.org/w1 "
        + base64.b64encode(key_id + (1679315147).to_bytes(8, "big") + secret.sign(text)).decode()
        + "\n"
    )
    assert COSIGNER.cosign(checkpoint, 1679315147).line() == line
    assert str(COSIGNER.key) == f"example.org/w1+{key_id.hex()}+" + base64.b64encode(b"\x04" + public).decode()


def test_the_example_of_c2sp_is_read_and_written_again() -> None:
    note = parse_cosigned("example", EXAMPLE)
    assert str(note).encode() == EXAMPLE
    own = note.signatures[1]
    assert (own.name, own.key_id.hex(), int.from_bytes(own.data[:8], "big"), len(own.data)) == (
        "witness.example.com/w1",
        "8d66cf3f",
        1679315147,
        72,
    )


def test_the_time_of_a_cosignature_is_the_newest_that_the_key_made() -> None:
    checkpoint = Log(3).checkpoint(3)
    older, newer = COSIGNER.cosign(checkpoint, NOW_S - 60), COSIGNER.cosign(checkpoint, NOW_S)
    assert COSIGNER.key.time_of(Note(checkpoint)) is None
    assert COSIGNER.key.time_of(Note(checkpoint, (newer, older))) == NOW_S
    for other in (
        Log(3).checkpoint(2),
        Checkpoint("example.org/other", 3, checkpoint.root),
        Checkpoint(ORIGIN, 3, bytes(32)),
    ):
        assert COSIGNER.key.time_of(Note(other, (newer,))) is None


@pytest.mark.parametrize(
    "change",
    [
        lambda data: (NOW_S + 1).to_bytes(8, "big") + data[8:],
        lambda data: bytes(8) + data[8:],
        lambda data: (MAX_TIME_S + 1).to_bytes(8, "big") + data[8:],
        lambda data: data[8:],
        lambda data: data + b"\0",
        lambda data: data[:-1],
        lambda data: data[:-1] + bytes([data[-1] ^ 1]),
        lambda data: data[:8] + LOG.signature_of(Log(3).checkpoint(3).text().encode()),
    ],
)
def test_a_cosignature_that_was_altered_counts_for_nothing(change: object) -> None:
    assert callable(change)
    checkpoint = Log(3).checkpoint(3)
    good = COSIGNER.cosign(checkpoint, NOW_S)
    altered = Signature(good.name, good.key_id, change(good.data))
    assert COSIGNER.key.time_of(Note(checkpoint, (altered,))) is None
    assert COSIGNER.key.time_of(Note(checkpoint, (altered, good))) == NOW_S


def test_a_cosignature_under_another_name_or_key_counts_for_nothing() -> None:
    checkpoint = Log(3).checkpoint(3)
    note = Note(checkpoint, (COSIGNER.cosign(checkpoint, NOW_S),))
    for other in (Cosigner("example.org/w2", bytes(32)), Cosigner("example.org/w1", bytes([1] * 32))):
        assert other.key.time_of(note) is None


@pytest.mark.parametrize("time_s", [0, -1, MAX_TIME_S + 1])
def test_nothing_is_cosigned_at_an_impossible_time(time_s: int) -> None:
    with pytest.raises(ValueError, match="expected seconds since 1970"):
        COSIGNER.cosign(Log(1).checkpoint(1), time_s)


def test_keys_are_read_as_they_are_written() -> None:
    assert parse_vkey(str(COSIGNER.key)) == COSIGNER.key
    assert parse_vkey(str(LOG.verifier)) == LOG.verifier
    text = secret_text(COSIGNER.key, bytes(32))
    read = parse_secret(text)
    assert read is not None
    assert read.key == COSIGNER.key
    for wrong in (
        "",
        text[:-1],
        text + "\n",
        text.replace("PRIVATE", "PUBLIC"),
        text.replace("w1", "w2"),
        str(COSIGNER.key),
        "PRIVATE+KEY+a+b+c\n",
    ):
        assert parse_secret(wrong) is None, wrong


def test_one_key_for_signing_and_for_cosigning_has_two_ids() -> None:
    both = VerifierKey("example.org/w1", COSIGNER.key.public), COSIGNER.key
    assert len({key.key_id for key in both}) == 2
    assert {type(parse_vkey(str(key))) for key in both} == {VerifierKey, WitnessKey}


@pytest.mark.parametrize(
    "text",
    [
        "",
        "zq",
        "zq+b",
        "zq+00000000+",
        "zq+00000000+!",
        "zq+00000000+BA==",
        " +00000000+" + "A" * 44,
        "PRIVATE+KEY+zq+b+c",
    ],
)
def test_what_is_no_key_is_not_repeated(text: str) -> None:
    with pytest.raises(ValueError, match=r"^found") as error:
        parse_vkey(text)
    assert "zq" not in str(error.value)
    assert "A" * 40 not in str(error.value)


def test_a_key_with_another_id_or_of_another_kind_is_refused() -> None:
    name, key_id, data = str(COSIGNER.key).split("+", 2)
    with pytest.raises(ValueError, match="another key id"):
        parse_vkey(f"{name}+{'0' * len(key_id)}+{data}")
    with pytest.raises(ValueError, match="found no public key"):
        parse_vkey(f"{name}+{key_id}+" + base64.b64encode(b"\x02" + COSIGNER.key.public).decode())
    with pytest.raises(UsageError, match="--log: found the key of a witness"):
        read_log_key(str(COSIGNER.key))


@pytest.mark.parametrize("public", WEAK.values(), ids=WEAK.keys())
def test_a_key_under_which_anybody_cosigns_is_refused(public: bytes) -> None:
    key_id = hashlib.sha256(b"w\n\x04" + public).digest()[:4]
    with pytest.raises(ValueError, match="prime order"):
        parse_vkey(f"w+{key_id.hex()}+" + base64.b64encode(b"\x04" + public).decode())


def test_a_note_may_carry_64_cosignatures_and_no_more() -> None:
    checkpoint = Log(3).checkpoint(3)
    lines = [Signature(f"w{number}", bytes(4), bytes(72)).line() for number in range(65)]
    for count in (0, 1, 15, 16, 17, 63, 64):
        text = f"{checkpoint.text()}\n{''.join(lines[:count])}"
        note = parse_cosigned("note", text.encode())
        assert (str(note), len(note.signatures)) == (text, count)
    with pytest.raises(LedgerCorrupted, match="found 65 signatures"):
        parse_cosigned("note", f"{checkpoint.text()}\n{''.join(lines)}".encode())


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xff",
        EXAMPLE[:-1],
        EXAMPLE + b"\n",
        EXAMPLE.replace(b"\n\n", b"\n"),
        EXAMPLE.replace(b"20852163", b"020852163"),
        EXAMPLE + b"x\n",
    ],
)
def test_what_is_no_cosigned_note_is_refused(data: bytes) -> None:
    with pytest.raises(LedgerCorrupted, match=r"^note: found"):
        parse_cosigned("note", data)
