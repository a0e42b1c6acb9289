"""A COSE statement is checked by a library that is not ours, and every change of it is refused."""

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsar_ledger.base.errors import LedgerCorrupted, UsageError
from fsar_ledger.ledger.log.note import Checkpoint, Note, Signer
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.store.cose import check_statement, is_statement, signed_statement
from fsar_ledger.ledger.store.proof import Proof, prove
from tests.ledger.samples import ORIGIN, append_all, made_up_batches

cbor2 = pytest.importorskip("cbor2", reason="make test-all installs it")
messages = pytest.importorskip("pycose.messages", reason="make test-all installs it")
keys = pytest.importorskip("pycose.keys", reason="make test-all installs it")

COMMITTED = made_up_batches(3, runs=2, size=60)  # 360 events
SIGNER = SIGNED_BY = Signer(ORIGIN, b"s" * 32)
KEY, OTHER = SIGNER.verifier, Signer(ORIGIN, b"o" * 32)
INDEX = 200
OF_EVENT, OF_ROOT = "a signature of the event that this key did not make", "a signature of the root that this key did"
ANOTHER_FORM = "COSE of another form"


@pytest.fixture(scope="module")
def proof(intact: Path) -> Proof:
    return prove(open_ledger(intact), INDEX)


@pytest.fixture(scope="module")
def statement(proof: Proof) -> bytes:
    return signed_statement("a ledger", proof, SIGNER)


def refused(data: bytes) -> str:
    with pytest.raises(LedgerCorrupted) as caught:
        check_statement("a file", data, KEY)
    assert str(caught.value).startswith("a file: found ")
    return str(caught.value)


# --- what others read ---


def root_of(event: bytes, size: int, index: int, path: Sequence[bytes]) -> bytes:
    """The root to which the path leads, by the definition of a tree in RFC 6962, section 2.1."""
    if size == 1:
        assert not path
        return hashlib.sha256(b"\x00" + event).digest()
    split = 1 << (size - 1).bit_length() - 1
    *below, sibling = path
    if index < split:
        return hashlib.sha256(b"\x01" + root_of(event, split, index, below) + sibling).digest()
    return hashlib.sha256(b"\x01" + sibling + root_of(event, size - split, index - split, below)).digest()


def message_of(data: bytes, public: bytes) -> Any:
    """A message of pycose and the key that it is to be checked with.

    Its own `decode` takes only the lists of cbor2 5, not the tuples of cbor2 6 (issue 141 of pycose).
    """
    tagged = cbor2.loads(data)
    assert tagged.tag == messages.Sign1Message.cbor_tag
    protected, unprotected, payload, signature = tagged.value
    message = messages.Sign1Message.from_cose_obj([protected, dict(unprotected), payload, signature], True)
    message.key = keys.OKPKey(crv="ED25519", x=public)
    return message


def is_verified(data: bytes, public: bytes) -> tuple[bool, bool]:
    """Whether pycose finds the signature of the event good, and that of the root to which the receipt leads."""
    message = message_of(data, public)
    (receipt,) = message.uhdr[394]
    inner = message_of(receipt, public)
    ((encoded,),) = inner.uhdr[396].values()
    root = root_of(message.payload, *cbor2.loads(encoded))
    return message.verify_signature(), inner.verify_signature(detached_payload=root)


@pytest.mark.parametrize("index", [0, 1, 127, 200, 255, 256, 358, 359])
def test_a_public_library_verifies_the_statement_and_its_receipt(intact: Path, index: int) -> None:
    found = prove(open_ledger(intact), index)
    data = signed_statement("a ledger", found, SIGNER)
    assert is_verified(data, KEY.public) == (True, True)
    assert is_verified(data, OTHER.verifier.public) == (False, False)
    assert message_of(data, KEY.public).payload == found.event
    assert root_of(found.event, 360, index, found.hashes) == found.note.checkpoint.root
    proven = check_statement("a file", data, KEY)
    assert (proven.index, proven.size, proven.origin) == (index, 360, ORIGIN)
    assert (proven.root, proven.signature) == (found.note.checkpoint.root.hex(), "signed")


def test_the_numbers_are_those_of_the_rfc(statement: bytes, proof: Proof) -> None:
    outer, inner = opened(statement)
    assert statement[0] == 0xC0 + 18
    assert cbor2.loads(outer[0]) == {
        1: -8,
        3: "application/json",
        4: KEY.key_id,
        15: {1: ORIGIN, 2: f"event {INDEX}"},
    }
    assert cbor2.loads(inner[0]) == {
        1: -8,
        4: KEY.key_id,
        15: {1: ORIGIN, 2: proof.note.checkpoint.text()},
        395: 1,
    }
    assert inner[2] is None
    ((encoded,),) = inner[1][396].values()
    assert [*inner[1][396]] == [-1]
    assert cbor2.loads(encoded) == [360, INDEX, [*proof.hashes]]


# --- what is refused ---


def opened(data: bytes) -> tuple[list[Any], list[Any]]:
    """The four parts of a statement, and those of its receipt."""
    outer = cbor2.loads(data).value
    return [*outer], [*cbor2.loads(outer[1][394][0]).value]


def closed(outer: list[Any], inner: list[Any]) -> bytes:
    outer[1] = {394: [cbor2.dumps(cbor2.CBORTag(18, inner))]}
    return bytes(cbor2.dumps(cbor2.CBORTag(18, outer)))


def path_of(inner: list[Any]) -> list[Any]:
    return list(cbor2.loads(inner[1][396][-1][0]))


def with_path(inner: list[Any], size: object, index: object, hashes: object) -> None:
    inner[1] = {396: {-1: [cbor2.dumps([size, index, hashes])]}}


def with_subject(message: list[Any], subject: str) -> None:
    header = cbor2.loads(message[0])
    message[0] = cbor2.dumps({**header, 15: {1: ORIGIN, 2: subject}})


def at_place(outer: list[Any], inner: list[Any], size: int, index: int) -> None:
    """Say everywhere that the tree has another size, and that the event is at another place in it."""
    (_, _, hashes), root = path_of(inner), cbor2.loads(inner[0])[15][2].split("\n")[2]
    with_path(inner, size, index, hashes)
    with_subject(outer, f"event {index}")
    with_subject(inner, f"{ORIGIN}\n{size}\n{root}\n")


def flipped(data: bytes, at: int = 5) -> bytes:
    return data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]


def _event(outer: list[Any], _: list[Any]) -> None:
    outer[2] = flipped(outer[2])


def _of_event(outer: list[Any], _: list[Any]) -> None:
    outer[3] = flipped(outer[3])


def _of_root(_: list[Any], inner: list[Any]) -> None:
    inner[3] = flipped(inner[3])


def _signatures_swapped(outer: list[Any], inner: list[Any]) -> None:
    outer[3], inner[3] = inner[3], outer[3]


def _hash(_: list[Any], inner: list[Any]) -> None:
    size, index, hashes = path_of(inner)
    with_path(inner, size, index, [*hashes[:-1], flipped(hashes[-1])])


def _short_path(_: list[Any], inner: list[Any]) -> None:
    size, index, hashes = path_of(inner)
    with_path(inner, size, index, hashes[:-1])


def _no_path(_: list[Any], inner: list[Any]) -> None:
    with_path(inner, 360, INDEX, [])


def _index(outer: list[Any], inner: list[Any]) -> None:
    at_place(outer, inner, 360, INDEX + 1)


def _index_in_the_path(_: list[Any], inner: list[Any]) -> None:
    with_path(inner, 360, INDEX + 1, path_of(inner)[2])


def _size(outer: list[Any], inner: list[Any]) -> None:
    at_place(outer, inner, 200, INDEX)


def _size_of_the_same_path(outer: list[Any], inner: list[Any]) -> None:
    at_place(outer, inner, 361, INDEX)  # the hashes lead to the same root


def _size_in_the_path(_: list[Any], inner: list[Any]) -> None:
    with_path(inner, 361, INDEX, path_of(inner)[2])


def _root(_: list[Any], inner: list[Any]) -> None:
    with_subject(inner, Checkpoint(ORIGIN, 360, b"r" * 32).text())


def _no_checkpoint(_: list[Any], inner: list[Any]) -> None:
    with_subject(inner, "a tree")


def _key_id(outer: list[Any], inner: list[Any]) -> None:
    for message in (outer, inner):
        message[0] = cbor2.dumps({**cbor2.loads(message[0]), 4: OTHER.verifier.key_id})


def _algorithm(_: list[Any], inner: list[Any]) -> None:
    inner[0] = cbor2.dumps({**cbor2.loads(inner[0]), 1: -7})


def _structure(_: list[Any], inner: list[Any]) -> None:
    inner[0] = cbor2.dumps({**cbor2.loads(inner[0]), 395: 2})


def _attached_root(_: list[Any], inner: list[Any]) -> None:
    inner[2] = b"r" * 32


def _text_of_event(outer: list[Any], _: list[Any]) -> None:
    outer[2] = outer[2].decode()


def _text_as_hash(_: list[Any], inner: list[Any]) -> None:
    size, index, hashes = path_of(inner)
    with_path(inner, size, index, [*hashes[:-1], "h" * 32])


def _huge_index(_: list[Any], inner: list[Any]) -> None:
    with_path(inner, 360, 10**5_000, path_of(inner)[2])


def _true_as_index(outer: list[Any], inner: list[Any]) -> None:
    at_place(outer, inner, 360, 1)
    with_path(inner, 360, True, path_of(inner)[2])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (_event, "found a way to root"),
        (_hash, "found a way to root"),
        (_root, "found a way to root"),
        (_index, "found a way to root"),
        (_short_path, "8 hashes for event 200 of 360, which lead nowhere"),
        (_size, "9 hashes for event 200 of 200, which lead nowhere"),
        (_size_of_the_same_path, OF_ROOT),
        (_of_event, OF_EVENT),
        (_of_root, OF_ROOT),
        (_signatures_swapped, OF_EVENT),
        (_key_id, f"found a receipt of {OTHER.verifier.key}, expected one of {KEY.key}, the trusted key"),
        (_no_checkpoint, "expected a C2SP checkpoint"),
        (_no_path, ANOTHER_FORM),
        (_index_in_the_path, ANOTHER_FORM),
        (_size_in_the_path, ANOTHER_FORM),
        (_algorithm, ANOTHER_FORM),
        (_structure, ANOTHER_FORM),
        (_attached_root, ANOTHER_FORM),
        (_text_of_event, ANOTHER_FORM),
        (_text_as_hash, ANOTHER_FORM),
        (_huge_index, ANOTHER_FORM),
        (_true_as_index, ANOTHER_FORM),
    ],
)
def test_a_changed_part_is_refused_for_what_it_is(
    statement: bytes, change: Callable[[list[Any], list[Any]], None], said: str
) -> None:
    outer, inner = opened(statement)
    assert closed(outer, inner) == statement
    change(outer, inner)
    assert said in refused(closed(outer, inner))


def test_every_flipped_byte_is_refused(statement: bytes) -> None:
    for at in range(2, len(statement)):  # the first two say that it is COSE
        for bit in (1, 128):
            refused(statement[:at] + bytes([statement[at] ^ bit]) + statement[at + 1 :])


def test_a_cut_or_longer_statement_is_refused(statement: bytes) -> None:
    for end in range(2, len(statement)):
        assert ANOTHER_FORM in refused(statement[:end])
    assert ANOTHER_FORM in refused(statement + b"\x00")


def test_another_encoding_of_the_same_values_is_refused(statement: bytes) -> None:
    outer, _ = opened(statement)
    in_two_bytes = b"\xd8\x12" + statement[1:]  # tag 18
    assert cbor2.loads(in_two_bytes) == cbor2.loads(statement)
    assert not is_statement(in_two_bytes)
    assert ANOTHER_FORM in refused(in_two_bytes)
    outer[1] = {**outer[1], 99: 1}
    assert ANOTHER_FORM in refused(cbor2.dumps(cbor2.CBORTag(18, outer)))


def test_a_receipt_of_another_event_or_tree_is_refused(intact: Path, statement: bytes, tmp_path: Path) -> None:
    outer, _ = opened(statement)
    _, of_next = opened(signed_statement("a ledger", prove(open_ledger(intact), INDEX + 1), SIGNER))
    assert ANOTHER_FORM in refused(closed(outer, of_next))
    append_all(tmp_path / "other", made_up_batches(3, runs=2, size=61), signer=SIGNER)
    _, of_other = opened(signed_statement("a ledger", prove(open_ledger(tmp_path / "other"), INDEX), SIGNER))
    assert "found a way to root" in refused(closed(opened(statement)[0], of_other))


def test_a_key_that_says_it_is_the_trusted_one_is_refused(proof: Proof, statement: bytes) -> None:
    tree = proof.note.checkpoint
    outer, inner = opened(signed_statement("x", Proof(proof.event, INDEX, proof.hashes, _note(OTHER, tree)), OTHER))
    assert "found a receipt of" in refused(closed(outer, inner))
    for message, own in zip((outer, inner), opened(statement), strict=True):
        message[0] = own[0]
    assert OF_EVENT in refused(closed(outer, inner))


@given(st.binary(max_size=200))
def test_any_bytes_behind_the_first_are_refused(rest: bytes) -> None:
    assert "expected" in refused(b"\xd2\x84" + rest)


@pytest.mark.parametrize(
    "data",
    [
        b"\x9b" + b"\xff" * 8,  # an array of 2**64 - 1
        b"\x5b" + b"\x7f" * 8,  # as many bytes
        b"\x81" * 100_000,
        b"\xd8\x1c" * 10_000 + b"\xd8\x1d\x00",
        b"\xa1\xa0\x00",  # a map as a key
    ],
)
def test_cbor_that_asks_for_much_is_refused(data: bytes) -> None:
    assert ANOTHER_FORM in refused(b"\xd2\x84" + data)
    assert ANOTHER_FORM in refused(data)


# --- without a key, and who may sign ---


def test_without_a_key_the_signer_is_only_told(statement: bytes) -> None:
    proven = check_statement("a file", statement)
    assert (proven.signature, proven.signer) == ("signer not checked", KEY.key)
    outer, inner = opened(statement)
    _of_event(outer, inner)
    assert check_statement("a file", closed(outer, inner)) == proven
    _hash(outer, inner)
    with pytest.raises(LedgerCorrupted, match="a way to root"):
        check_statement("a file", closed(outer, inner))


def _note(signer: Signer, tree: Checkpoint) -> Note:
    return Note(tree, (signer.sign(tree),))


def test_only_the_key_that_signed_the_checkpoint_signs_a_receipt(proof: Proof) -> None:
    with pytest.raises(UsageError, match=r"a ledger: found a signature of .* on the newest checkpoint"):
        signed_statement("a ledger", proof, OTHER)
    unsigned = Proof(proof.event, INDEX, proof.hashes, Note(proof.note.checkpoint))
    with pytest.raises(UsageError, match="a ledger: found no signature on the newest checkpoint, expected one of"):
        signed_statement("a ledger", unsigned, SIGNER)


def test_the_only_event_of_a_ledger_has_no_receipt(proof: Proof) -> None:
    tree = Checkpoint(ORIGIN, 1, hashlib.sha256(b"\x00" + proof.event).digest())
    with pytest.raises(UsageError, match="found a ledger of one event"):
        signed_statement("a ledger", Proof(proof.event, 0, (), _note(SIGNER, tree)), SIGNER)
