import base64
import os
import pickle
import stat
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsar_ledger.base.errors import LedgerCorrupted, UsageError, WriteFailed
from fsar_ledger.ledger.log.merkle import Frontier, leaf_hash
from fsar_ledger.ledger.log.note import Checkpoint, Note, Signature, Signer, checkpoint_of, parse_note
from fsar_ledger.ledger.store.keys import new_key, read_signer, read_verifier
from tests.ledger.samples import ORIGIN

# --- RFC 8032, section 7.1: secret, public, message, signature ---

MESSAGE_1024 = (
    "08b8b2b733424243760fe426a4b54908632110a66c2f6591eabd3345e3e4eb98fa6e264bf09efe12ee50f8f54e9f77b1e355f6c50544e23fb1433ddf73be84d879de7c0046dc4996"
    "d9e773f4bc9efe5738829adb26c81b37c93a1b270b20329d658675fc6ea534e0810a4432826bf58c941efb65d57a338bbd2e26640f89ffbc1a858efcb8550ee3a5e1998bd177e93a"
    "7363c344fe6b199ee5d02e82d522c4feba15452f80288a821a579116ec6dad2b3b310da903401aa62100ab5d1a36553e06203b33890cc9b832f79ef80560ccb9a39ce767967ed628"
    "c6ad573cb116dbefefd75499da96bd68a8a97b928a8bbc103b6621fcde2beca1231d206be6cd9ec7aff6f6c94fcd7204ed3455c68c83f4a41da4af2b74ef5c53f1d8ac70bdcb7ed1"
    "85ce81bd84359d44254d95629e9855a94a7c1958d1f8ada5d0532ed8a5aa3fb2d17ba70eb6248e594e1a2297acbbb39d502f1a8c6eb6f1ce22b3de1a1f40cc24554119a831a9aad6"
    "079cad88425de6bde1a9187ebb6092cf67bf2b13fd65f27088d78b7e883c8759d2c4f5c65adb7553878ad575f9fad878e80a0c9ba63bcbcc2732e69485bbc9c90bfbd62481d9089b"
    "eccf80cfe2df16a2cf65bd92dd597b0707e0917af48bbb75fed413d238f5555a7a569d80c3414a8d0859dc65a46128bab27af87a71314f318c782b23ebfe808b82b0ce26401d2e22"
    "f04d83d1255dc51addd3b75a2b1ae0784504df543af8969be3ea7082ff7fc9888c144da2af58429ec96031dbcad3dad9af0dcbaaaf268cb8fcffead94f3c7ca495e056a9b47acdb7"
    "51fb73e666c6c655ade8297297d07ad1ba5e43f1bca32301651339e22904cc8c42f58c30c04aafdb038dda0847dd988dcda6f3bfd15c4b4c4525004aa06eeff8ca61783aacec57fb"
    "3d1f92b0fe2fd1a85f6724517b65e614ad6808d6f6ee34dff7310fdc82aebfd904b01e1dc54b2927094b2db68d6f903b68401adebf5a7e08d78ff4ef5d63653a65040cf9bfd4aca7"
    "984a74d37145986780fc0b16ac451649de6188a7dbdf191f64b5fc5e2ab47b57f7f7276cd419c17a3ca8e1b939ae49e488acba6b965610b5480109c8b17b80e1b7b750dfc7598d5d"
    "5011fd2dcc5600a32ef5b52a1ecc820e308aa342721aac0943bf6686b64b2579376504ccc493d97e6aed3fb0f9cd71a43dd497f01f17c0e2cb3797aa2a2f256656168e6c496afc5f"
    "b93246f6b1116398a346f1a641f3b041e989f7914f90cc2c7fff357876e506b50d334ba77c225bc307ba537152f3f1610e4eafe595f6d9d90d11faa933a15ef1369546868a7f3a45"
    "a96768d40fd9d03412c091c6315cf4fde7cb68606937380db2eaaa707b4c4185c32eddcdd306705e4dc1ffc872eeee475a64dfac86aba41c0618983f8741c5ef68d3a101e8a3b8ca"
    "c60c905c15fc910840b94c00a0b9d0"
)
RFC_8032 = {
    "TEST 1": (
        "9d61b19deffd5a60ba844af492ec2cc44449c5697b326919703bac031cae7f60",
        "d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a",
        "",
        "e5564300c360ac729086e2cc806e828a84877f1eb8e5d974d873e065224901555fb8821590a33bacc61e39701cf9b46bd25bf5f0595bbe24655141438e7a100b",
    ),
    "TEST 2": (
        "4ccd089b28ff96da9db6c346ec114e0f5b8a319f35aba624da8cf6ed4fb8a6fb",
        "3d4017c3e843895a92b70aa74d1b7ebc9c982ccf2ec4968cc0cd55f12af4660c",
        "72",
        "92a009a9f0d4cab8720e820b5f642540a2b27b5416503f8fb3762223ebdb69da085ac1e43e15996e458f3613d0f11d8c387b2eaeb4302aeeb00d291612bb0c00",
    ),
    "TEST 3": (
        "c5aa8df43f9f837bedb7442f31dcb7b166d38535076f094b85ce3a2e0b4458f7",
        "fc51cd8e6218a1a38da47ed00230f0580816ed13ba3303ac5deb911548908025",
        "af82",
        "6291d657deec24024827e69c3abe01a30ce548a284743a445e3680d7db5ac3ac18ff9b538d16f290ae67f760984dc6594a7c15e9716ed28dc027beceea1ec40a",
    ),
    "TEST 1024": (
        "f5e5767cf153319517630f226876b86c8160cc583bc013744c6bf255f5cc0ee5",
        "278117fc144c72340f67d0f2316e8386ceffbf2b2428c9c51fef7c597f1d426e",
        MESSAGE_1024,
        "0aab4c900501b3e24d7cdf4663326a3a87df5e4843b2cbdb67cbf6e460fec350aa5371b1508f9f4528ecea23c436d94b5e8fcd4f681e30a6ac00a9704a188a03",
    ),
    "TEST SHA(abc)": (
        "833fe62409237b9d62ec77587520911e9a759cec1d19755b7da901b96dca3d42",
        "ec172b93ad5e563bf4932c70e1245034c35467ef2efd4d64ebf819683467e2bf",
        "ddaf35a193617abacc417349ae20413112e6fa4e89a97ea20a9eeee64b55d39a2192992a274fc1a836ba3c23a3feebbd454d4423643ce80e2a9ac94fa54ca49f",
        "dc2a4459e7369633a52b1bf277839a00201009a3efbf3ecb69bea2186c26b58909351fc9ac90b3ecfdfbc7c66431e0303dca179c138ac17ad9bef1177331a704",
    ),
}


@pytest.mark.parametrize("name", RFC_8032)
def test_keys_and_signatures_are_those_of_rfc_8032(name: str) -> None:
    secret, public, message, signature = map(bytes.fromhex, RFC_8032[name])
    signer = Signer("rfc-8032", secret)
    assert signer.verifier.public == public
    assert signer.signature_of(message) == signature
    assert signer.verifier.verifies(signature, message)
    for at in range(0, 64, 7):
        assert not signer.verifier.verifies(signature[:at] + bytes([signature[at] ^ 1]) + signature[at + 1 :], message)
    assert not signer.verifier.verifies(signature, message + b"\x00")
    assert not signer.verifier.verifies(signature[:63], message)


def test_the_key_and_signature_that_go_publishes_as_an_example_are_right() -> None:
    """Package note of Go's sumdb."""
    key = read_verifier("PeterNeumann+c74f20a3+ARpc2QcUPDhMQegwxbzhKqiBfsVkmqq/LDE4izWy10TW")
    assert (key.name, key.key_id.hex(), key.key) == ("PeterNeumann", "c74f20a3", "PeterNeumann+c74f20a3")
    assert str(key) == "PeterNeumann+c74f20a3+ARpc2QcUPDhMQegwxbzhKqiBfsVkmqq/LDE4izWy10TW"
    text = b"If you think cryptography is the answer to your problem,\nthen you don't know what your problem is.\n"
    line = "x08go/ZJkuBS9UG/SffcvIAQxVBtiFupLLr8pAcElZInNIuGUgYN1FFYC2pZSNXgKvqfqdngotpRZb6KE6RyyBwJnAM="
    data = base64.b64decode(line)
    assert data[:4] == key.key_id
    assert Signature("PeterNeumann", data[:4], data[4:]).line() == f"— PeterNeumann {line}\n"
    assert key.verifies(data[4:], text)
    assert not key.verifies(data[4:], text[:-1])


# --- notes ---

SIGNER = Signer(ORIGIN, b"s" * 32)
OTHER = Signer(ORIGIN, b"o" * 32)
CHECKPOINT = checkpoint_of(ORIGIN, Frontier().extend(leaf_hash(b"an event")))
SIGNED = Note(CHECKPOINT, (SIGNER.sign(CHECKPOINT),))


def is_vouched_for(text: str) -> bool:
    try:
        note = parse_note("note", text)
    except LedgerCorrupted:
        return False
    return SIGNER.verifier.has_signed(note)


def test_a_note_has_the_lines_that_the_specification_asks_for() -> None:
    first, root, empty, signature = str(SIGNED).split("\n", 1)[1].split("\n")[:4]
    assert str(SIGNED).startswith(f"{ORIGIN}\n1\n")
    assert (first, base64.b64decode(root), empty) == ("1", leaf_hash(b"an event"), "")
    assert signature.startswith(f"— {ORIGIN} ")
    assert str(Note(CHECKPOINT)) == CHECKPOINT.text() + "\n"


def test_a_note_comes_back_from_its_text() -> None:
    for note in (
        Note(CHECKPOINT),
        SIGNED,
        Note(CHECKPOINT, (SIGNER.sign(CHECKPOINT), OTHER.sign(CHECKPOINT))),
        Note(Checkpoint("x", 0, bytes(32))),
    ):
        assert parse_note("note", str(note)) == note


def test_a_note_with_any_character_changed_left_out_or_added_is_not_vouched_for() -> None:
    text = str(SIGNED)
    assert is_vouched_for(text)
    for at in range(len(text)):
        for instead in (
            "",
            "A" if text[at] != "A" else "B",
            text[at] + "\n",
            text[at] * 2,
            "\r\n",
            "\0",
            "é",
            text[at].swapcase() if text[at].isalpha() else "1",
        ):
            other = text[:at] + instead + text[at + 1 :]
            assert other == text or not is_vouched_for(other), (at, instead)
    for cut in range(len(text)):
        assert not is_vouched_for(text[:cut])


@pytest.mark.parametrize(
    "text",
    [
        "",
        "\n",
        "\n\n",
        "x\n1\n",
        f"x\n1\n{'A' * 43}=",
        "x\n1\nAAAA\n\n",
        f"x\n01\n{'A' * 43}=\n\n",
        f"x\n-1\n{'A' * 43}=\n\n",
        f"x\n１\n{'A' * 43}=\n\n",
        f"x\n{'9' * 5000}\n{'A' * 43}=\n\n",
        f"x\n1\n{'A' * 42}B=\n\n",
        f"x\n1\n{'A' * 43}=\nan extension\n\n",
        f"two words\n1\n{'A' * 43}=\n\n",
        f"a+b\n1\n{'A' * 43}=\n\n",
        f"x\n1\n{'A' * 43}=\n\n- x AAAAAAAA\n",
        f"x\n1\n{'A' * 43}=\n\n— x AAAA\n",
        f"x\n1\n{'A' * 43}=\n\n— x AAAAAAAA",
        f"x\n1\n{'A' * 43}=\n\n— x AAAAAAAA\u2028",
        f"x\n1\n{'A' * 43}=\n\n—  AAAAAAAA\n",
        f"x\n1\n{'A' * 43}=\n\n{'— x AAAAAAAA' + chr(10)}" * 2,
    ],
)
def test_what_is_written_otherwise_is_no_note(text: str) -> None:
    with pytest.raises(LedgerCorrupted, match=r"^here: found "):
        parse_note("here", text)


def test_a_note_carries_64_signatures_and_no_more() -> None:
    signature = SIGNER.sign(CHECKPOINT)
    assert len(parse_note("note", str(Note(CHECKPOINT, (signature,) * 64))).signatures) == 64
    with pytest.raises(LedgerCorrupted, match="found 65 signatures, expected at most 64"):
        parse_note("note", str(Note(CHECKPOINT, (signature,) * 65)))


def test_a_key_of_the_same_name_does_not_sign_for_another() -> None:
    note = Note(CHECKPOINT, (OTHER.sign(CHECKPOINT),))
    assert OTHER.verifier.has_signed(note)
    assert not SIGNER.verifier.has_signed(note)
    posing = Note(CHECKPOINT, (Signature(ORIGIN, SIGNER.verifier.key_id, OTHER.sign(CHECKPOINT).data),))
    assert not SIGNER.verifier.has_signed(posing)


def test_every_signature_of_a_key_must_be_right_and_those_of_others_are_not_looked_at() -> None:
    right = SIGNER.sign(CHECKPOINT)
    wrong = Signature(right.name, right.key_id, bytes(64))
    witness = Signature("witness.example", b"abcd", b"not even the right length")
    assert SIGNER.verifier.has_signed(Note(CHECKPOINT, (witness, right)))
    assert not SIGNER.verifier.has_signed(Note(CHECKPOINT, (right, wrong)))
    assert not SIGNER.verifier.has_signed(Note(CHECKPOINT))


def test_a_key_speaks_for_the_log_of_its_name_only() -> None:
    elsewhere = Checkpoint("example.org/elsewhere", CHECKPOINT.size, CHECKPOINT.root)
    assert not SIGNER.verifier.has_signed(Note(elsewhere, (SIGNER.sign(elsewhere),)))


# --- keys ---


def test_a_new_key_signs_and_its_public_half_verifies(tmp_path: Path) -> None:
    path = tmp_path / "keys" / "fleet.key"
    verifier = new_key(path, ORIGIN)
    signer = read_signer(path)
    assert signer.verifier == verifier == read_verifier(str(path) + ".pub") == read_verifier(str(verifier))
    assert verifier.has_signed(Note(CHECKPOINT, (signer.sign(CHECKPOINT),)))
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert sorted(os.listdir(path.parent)) == ["fleet.key", "fleet.key.pub"]
    assert path.read_text().startswith(f"PRIVATE+KEY+{verifier.key}+")


def test_two_keys_are_never_the_same(tmp_path: Path) -> None:
    assert new_key(tmp_path / "a", ORIGIN).public != new_key(tmp_path / "b", ORIGIN).public


@pytest.mark.parametrize("taken", ["fleet.key", "fleet.key.pub"])
def test_a_key_is_never_overwritten(tmp_path: Path, taken: str) -> None:
    (tmp_path / taken).write_text("precious")
    with pytest.raises(UsageError, match=r"never overwritten"):
        new_key(tmp_path / "fleet.key", ORIGIN)
    assert {file.name: file.read_text() for file in tmp_path.iterdir()} == {taken: "precious"}


@pytest.mark.parametrize("name", ["", "two words", "a+b", "tab\there", "line\nfeed", "no\u00a0break"])
def test_a_name_that_no_note_can_hold_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError, match=r"^name="):
        new_key(tmp_path / "fleet.key", name)
    assert not list(tmp_path.iterdir())


def test_a_key_that_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(WriteFailed, match=r"fleet\.key: writing a key failed: .*; no key was made; make room"):
        new_key(tmp_path / "file" / "fleet.key", ORIGIN)
    with pytest.raises(UsageError, match="never overwritten"):
        new_key(tmp_path, ORIGIN)


@pytest.mark.parametrize("mode", [0o644, 0o640, 0o604, 0o660, 0o700 | 0o001])
def test_a_secret_key_that_others_may_touch_is_refused(tmp_path: Path, mode: int) -> None:
    path = tmp_path / "fleet.key"
    new_key(path, ORIGIN)
    path.chmod(mode)
    with pytest.raises(UsageError, match=f"mode {mode:o}, .* expected 600"):
        read_signer(path)
    path.chmod(0o400)
    read_signer(path)


def test_a_key_with_any_character_changed_or_cut_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "fleet.key"
    verifier = new_key(path, ORIGIN)
    for file, read in (
        (path, lambda: read_signer(path)),
        (tmp_path / "fleet.key.pub", lambda: read_verifier(f"{path}.pub")),
    ):
        text = file.read_text()
        others = [text[:at] + ("A" if text[at] != "A" else "B") + text[at + 1 :] for at in range(len(text))]
        others += [text[:cut] for cut in range(len(text) - 1)] + [
            text + "\n",
            "\n" + text,
            text * 2,
            text.replace("=", "") + "x",
            "\udcff",
        ]
        for other in others:
            file.write_bytes(other.encode("utf-8", "surrogateescape"))
            with pytest.raises(UsageError):
                read()
        file.write_text(text)
        read()
    with pytest.raises(UsageError, match=f"found key id 00000000, expected {verifier.key_id.hex()}"):
        read_verifier(str(verifier).replace(verifier.key_id.hex(), "00000000"))


def test_the_halves_are_not_taken_for_each_other_and_the_secret_one_is_not_shown(tmp_path: Path) -> None:
    path = tmp_path / "fleet.key"
    new_key(path, ORIGIN)
    with pytest.raises(UsageError, match="no secret key"):
        read_signer(tmp_path / "fleet.key.pub")
    for given_key in (str(path), path.read_text().strip()):
        with pytest.raises(UsageError, match=r"trusted_key.* found no public key") as caught:
            read_verifier(given_key)
        assert path.read_text().strip()[-40:] not in str(caught.value)


def test_a_key_that_is_not_there_is_named(tmp_path: Path) -> None:
    for read in (
        lambda: read_signer(tmp_path / "none"),
        lambda: read_verifier(str(tmp_path / "none")),
        lambda: read_signer(tmp_path),
    ):
        with pytest.raises(UsageError, match=str(tmp_path)):
            read()


def test_a_key_may_be_reached_by_a_link(tmp_path: Path) -> None:
    new_key(tmp_path / "fleet.key", ORIGIN)
    (tmp_path / "link").symlink_to("fleet.key")
    (tmp_path / "link.pub").symlink_to("fleet.key.pub")
    assert read_signer(tmp_path / "link").verifier == read_verifier(str(tmp_path / "link.pub"))


def test_a_signer_does_not_leave_its_process() -> None:
    with pytest.raises(TypeError):
        pickle.dumps(SIGNER)
    assert (b"s" * 32).hex() not in repr(vars(SIGNER))


@settings(max_examples=200, deadline=None)
@given(
    st.text(max_size=120)
    | st.sampled_from([str(SIGNED), str(SIGNER.verifier)]).flatmap(
        lambda text: st.permutations(text.split("\n")).map("\n".join)
    )
)
def test_any_text_is_read_or_refused_without_an_accident(text: str) -> None:
    with suppress(LedgerCorrupted):
        assert str(parse_note("note", text)) == text
    with suppress(UsageError):
        assert str(read_verifier(text)) == text
