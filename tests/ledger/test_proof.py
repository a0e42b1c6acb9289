from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsar_ledger.base.errors import LedgerCorrupted, UsageError
from fsar_ledger.ledger.log.hashing import sha256_hex
from fsar_ledger.ledger.log.merkle import leaf_hash
from fsar_ledger.ledger.log.note import Checkpoint, Note, Signer
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows import canonical, codec
from fsar_ledger.ledger.store.derived import RunNames
from fsar_ledger.ledger.store.locations import place_of
from fsar_ledger.ledger.store.proof import (
    Proof,
    Value,
    check_proof,
    parse_proof,
    proof_of,
    prove,
    prove_inclusion,
    read_given,
)
from tests.ledger.forgery import changed, forge_segment, segment_at, table_of
from tests.ledger.samples import ORIGIN, append_all, made_up_batches

BATCHES = COMMITTED = made_up_batches(3, runs=2, size=60)  # 360 events: a full tile, and a level above it
SIGNER = SIGNED_BY = Signer(ORIGIN, b"s" * 32)
KEY = SIGNER.verifier


@pytest.fixture(scope="module")
def proof(intact: Path) -> Proof:
    return prove(open_ledger(intact), 200)


def signed(size: int, root: bytes) -> Note:
    tree = Checkpoint(ORIGIN, size, root)
    return Note(tree, (SIGNER.sign(tree),))


def alone(event: bytes) -> Proof:
    """Return the proof of the only event of a tree."""
    return Proof(event, 0, (), signed(1, leaf_hash(event)))


def refused(proof: Proof) -> str:
    with pytest.raises(LedgerCorrupted) as caught:
        check_proof("a proof", proof, KEY)
    assert str(caught.value).startswith("a proof: found ")
    return str(caught.value)


# --- what is proven ---


def test_any_event_has_a_proof_that_says_which_event_it_is(intact: Path) -> None:
    view = open_ledger(intact)
    rows = [row for batch in BATCHES for row in canonical.from_table(codec.encode(batch))]
    for index, row in [*[*enumerate(rows)][::13], (359, rows[359])]:
        found = prove(view, index)
        proven = check_proof("a proof", parse_proof("a proof", str(found)), KEY)
        assert found.event == row
        assert proven.event == msgspec.json.decode(row)
        assert (proven.index, proven.size, proven.root, proven.origin) == (index, 360, view.head.root, ORIGIN)
        assert (proven.signature, proven.signer) == ("signed", KEY.key)
    assert len(rows) == 360


def test_the_lines_of_a_proof_are_those_of_the_specification(proof: Proof) -> None:
    title, extra, index, *hashes = str(proof).partition("\n\n")[0].split("\n")
    assert (title, extra[:6], index) == ("c2sp.org/tlog-proof@v1", "extra ", "index 200")
    assert [len(line) for line in hashes] == [44] * 9
    assert str(proof).partition("\n\n")[2] == str(proof.note)


def test_without_a_trusted_key_the_signature_is_only_told(intact: Path, tmp_path: Path, proof: Proof) -> None:
    proven = check_proof("a proof", proof)
    assert (proven.signature, proven.signer) == ("signer not checked", KEY.key)
    append_all(tmp_path / "unsigned", BATCHES)
    proven = check_proof("a proof", prove(open_ledger(tmp_path / "unsigned"), 200))
    assert (proven.signature, proven.signer) == ("unsigned", None)


def test_runs_are_found_where_they_are(intact: Path) -> None:
    view = open_ledger(intact)
    runs = [f"run-{number:04d}" for number in range(6)]
    assert view.run_names == RunNames(tuple(runs))
    assert [place_of(view, run, 59) for run in runs] == [60 * number + 59 for number in range(6)]
    assert [view.parts(run)[0].block.rows for run in runs] == [60] * 6
    assert view.parts("run-9999") == []


def test_what_is_not_there_has_no_proof(intact: Path, tmp_path: Path) -> None:
    for index in (-1, 360):
        with pytest.raises(ValueError, match=f"index {index}, expected one of 360"):
            prove(open_ledger(intact), index)
    append_all(tmp_path / "empty", [])
    with pytest.raises(ValueError, match="one of 0"):
        prove(open_ledger(tmp_path / "empty"), 0)


def test_a_proof_of_an_older_checkpoint_still_holds(path: Path, tmp_path: Path) -> None:
    append_all(tmp_path / "older", BATCHES[:2], signer=SIGNER)
    older = prove(open_ledger(tmp_path / "older"), 200)
    assert check_proof("a proof", older, KEY).size == 240
    tree = older.note.checkpoint
    node = open_ledger(path).node(tree.size)
    assert prove_inclusion(path, node, tree, 200)[1] == older.hashes  # the grown ledger still gives it


# --- what is not a proof ---


def test_a_proof_with_any_character_changed_left_out_or_added_is_refused(proof: Proof) -> None:
    text = str(proof)
    check_proof("a proof", parse_proof("a proof", text), KEY)
    for at in range(len(text)):
        for instead in ("", "A" if text[at] != "A" else "B", text[at] * 2, "\n"):
            other = text[:at] + instead + text[at + 1 :]
            if other != text:
                with pytest.raises(LedgerCorrupted, match=r"^a proof: found "):
                    check_proof("a proof", parse_proof("a proof", other), KEY)
    for cut in range(len(text)):
        with pytest.raises(LedgerCorrupted, match=r"^a proof: found "):
            check_proof("a proof", parse_proof("a proof", text[:cut]), KEY)


def test_a_proof_is_of_one_event_in_one_place_of_one_tree(intact: Path, tmp_path: Path, proof: Proof) -> None:
    other = prove(open_ledger(intact), 201)
    append_all(tmp_path / "other", made_up_batches(3, runs=2, size=61), signer=SIGNER)
    elsewhere = prove(open_ledger(tmp_path / "other"), 200)
    append_all(tmp_path / "older", BATCHES[:2], signer=SIGNER)
    older = prove(open_ledger(tmp_path / "older"), 200)
    for change in (
        {"event": other.event},
        {"index": 201},
        {"hashes": other.hashes},
        {"note": elsewhere.note},
        {"note": older.note},
        {"hashes": older.hashes},
        {"index": 360},
        {"index": 10**15},
    ):
        assert "expected one to" in refused(msgspec.structs.replace(proof, **change))


def test_the_signature_must_be_the_trusted_keys(proof: Proof) -> None:
    tree = proof.note.checkpoint
    namesake = Signer(ORIGIN, b"o" * 32)
    assert "found no signature" in refused(msgspec.structs.replace(proof, note=Note(tree)))
    assert f"found a signature of {namesake.verifier.key}" in refused(
        msgspec.structs.replace(proof, note=Note(tree, (namesake.sign(tree),)))
    )
    posing = msgspec.structs.replace(namesake.sign(tree), key_id=KEY.key_id)
    assert "that this key did not make" in refused(msgspec.structs.replace(proof, note=Note(tree, (posing,))))
    elsewhere = Checkpoint("example.org/elsewhere", tree.size, tree.root)
    assert "a checkpoint of example.org/elsewhere" in refused(
        msgspec.structs.replace(proof, note=Note(elsewhere, (SIGNER.sign(elsewhere),)))
    )


def test_an_index_below_zero_and_hashes_of_another_length_are_not_even_read(proof: Proof) -> None:
    assert parse_proof("a proof", str(proof)) == proof
    for change in (
        {"index": -1},
        {"hashes": (*proof.hashes[:-1], proof.hashes[-1][:-1])},
        {"hashes": (*proof.hashes, bytes(33))},
    ):
        with pytest.raises(LedgerCorrupted, match="expected a C2SP tlog-proof"):
            parse_proof("a proof", str(msgspec.structs.replace(proof, **change)))


GOOD = b'{"run_id":"r","seq":0,"type":"RunStarted.v1"}'


def test_an_event_needs_its_run_seq_and_type_and_no_more() -> None:
    assert check_proof("a proof", alone(GOOD), KEY).event == {"run_id": "r", "seq": 0, "type": "RunStarted.v1"}


@pytest.mark.parametrize(
    "event",
    [
        b"",
        b"null",
        b"[]",
        b"{}",
        b'"run_id"',
        b"\xff",
        b'{"run_id":"r","seq":0}',
        b'{"run_id":7,"seq":0,"type":"x"}',
        b'{"run_id":"r","seq":"0","type":"x"}',
        b'{"run_id":"r","seq":true,"type":"x"}',
        b'{"run_id":"r","seq":0.0,"type":"x"}',
        b'{"run_id":"r","seq":0,"type":null}',
        b'{"run_id":"r","seq":0,"type":"x","z":null}',
        b'{"run_id":"r","seq":0,"type":"x","z":1.5}',
        b'{"run_id":"r","seq":0,"type":"x","z":{}}',
        b'{"run_id":"r","seq":0,"type":"x","z":[1]}',
        b'{"run_id":"r","seq":0,"type":"x","z":9007199254740993}',
        b'{"run_id":"r","seq":0,"type":"x","z":99999999999999999999}',
        b'{"run_id":"r","seq":0,"type":"x" }',
        b'{"seq":0,"run_id":"r","type":"x"}',
        b'{"run_id":"r","seq":0,"seq":0,"type":"x"}',
        b'{"run_id":"r","seq":0,"type":"\\u0078"}',
        b'{"run_id":"r","seq":0,"type":"\\ud800"}',
        '{"run_id":"r","seq":0,"type":"x","é":1}'.encode(),
        b'{"a":' + b"[" * 100_000,
        GOOD + b"\n",
    ],
)
def test_a_leaf_that_is_no_canonical_event_is_refused_even_if_it_is_in_the_tree(event: bytes) -> None:
    refused(parse_proof("a proof", str(alone(event))))


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=300))
def test_any_bytes_as_an_event_are_refused_or_a_row(event: bytes) -> None:
    try:
        row = check_proof("a proof", alone(event), KEY).event
    except LedgerCorrupted:
        row = dict[str, Value]()
    assert not row or canonical.document(row) == event


def test_a_file_that_is_no_proof_is_refused(tmp_path: Path, intact: Path) -> None:
    with pytest.raises(UsageError, match="found no file"):
        read_given(tmp_path / "none")
    for data in (
        b"",
        b"\n\n",
        b"\xff\xfe",
        b"x" * 2_000_000,
        (intact / "checkpoint").read_bytes(),
        (intact / "ledger.json").read_bytes(),
    ):
        (tmp_path / "file").write_bytes(data)
        with pytest.raises(LedgerCorrupted, match=str(tmp_path / "file")):
            proof_of(str(tmp_path / "file"), read_given(tmp_path / "file"))
    with pytest.raises(LedgerCorrupted, match="cannot be read"):
        read_given(tmp_path)


# --- a ledger that cannot prove ---


def test_a_damaged_ledger_gives_no_proof(path: Path) -> None:
    def why(index: int) -> str:
        with pytest.raises(LedgerCorrupted) as caught:
            prove(open_ledger(path), index)
        return str(caught.value)

    nodes = path / "nodes"
    data = nodes.read_bytes()
    nodes.write_bytes(bytes(len(data)))
    assert "the stored hashes lead from event 300 to the root" in why(300)
    nodes.write_bytes(data)
    segment = segment_at(path, 2).read_bytes()
    forge_segment(path, 2, changed(table_of(path, 2), "time_us", 5, 1))
    assert "the stored hashes lead from event 245" in why(245)
    assert sha256_hex(segment) != sha256_hex(segment_at(path, 2).read_bytes())
    forge_segment(path, 2, table_of(path, 2).slice(0, 50))
    assert "found 50 rows, expected 120" in why(350)
    segment_at(path, 2).unlink()
    assert "found no segment" in why(300)
    prove(open_ledger(path), 20)
