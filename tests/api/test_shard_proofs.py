"""A proof of an event of a federation has two steps, which two verifiers check; each can fail."""

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

import fsar_ledger
from fsar_ledger.base.errors import LedgerCorrupted, UsageError
from fsar_ledger.cli.app import run
from fsar_ledger.ledger.log.merkle import leaf_hash
from fsar_ledger.ledger.log.note import Checkpoint, Note, Signer, parse_note
from fsar_ledger.ledger.opening import open_checked, open_for_answers, open_ledger
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.proof import Proof, check_proof, parse_proof, prove
from fsar_ledger.ledger.store.shards import heads_of, record_of_head
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.witness import Cosigner
from tests.api.sites import origin
from tests.ledger import agreement
from tests.ledger.agreement import independent
from tests.ledger.keep_release import LEDGERS
from tests.quick import few


def test_the_same_is_proven_of_an_event_as_in_its_shard(site: Path) -> None:
    federation, south = fsar_ledger.open_ledger(site / "log"), fsar_ledger.open_ledger(site / "south")
    found, own = federation.prove("12:5"), south.prove("4:5")
    assert found.log is not None
    assert msgspec.structs.replace(found, log=None) == own
    assert found.log.note == open_checked(site / "log").note()


KEY = Signer("example.org/federation", b"f" * 32)


@pytest.fixture(scope="module")
def proof(site: Path, tmp_path_factory: pytest.TempPathFactory) -> Proof:
    """An event of the shard in the south, in a log that is signed."""
    log = tmp_path_factory.mktemp("signed") / "log"
    with Writer(log, KEY.verifier.name, KEY) as writer:
        for head in heads_of(open_ledger(site / "log")):
            folder = os.path.relpath(site / "log" / head.folder, log)
            writer.add([record_of_head(msgspec.structs.replace(head, folder=folder))])
    return prove(open_for_answers(log), 8_000)


def judged(proof: Proof) -> str:
    """Return what is wrong with a proof, after the independent verifier has found something, too; or nothing."""
    by_another: str | None = None
    text = str(proof)
    try:
        independent("independent_proof").verify(text, str(KEY.verifier))
    except ValueError as error:
        by_another = str(error)
    try:
        check_proof("it", parse_proof("it", text), KEY.verifier)
    except LedgerCorrupted as error:
        assert by_another
        return str(error)
    assert by_another is None
    return ""


def test_both_steps_are_proven_and_told(proof: Proof, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert judged(proof) == ""
    proven = check_proof("it", parse_proof("it", str(proof)), KEY.verifier)
    assert (proven.origin, proven.signature) == (origin("south"), "unsigned")
    assert proven.log is not None
    assert (proven.log.origin, proven.log.signature, proven.log.index) == (KEY.verifier.name, "signed", 2)
    (tmp_path / "proof").write_text(str(proof))
    assert run(["verify-proof", str(tmp_path / "proof"), "--root", proven.log.root]) == 0
    told = capsys.readouterr().out
    assert "proven in two steps" in told
    assert f"2: this root is head 2 of 3 in the log of {KEY.verifier.name}" in told
    assert run(["verify-proof", str(tmp_path / "proof"), "--root", proven.root]) == 3


def other_leaf(proof: Proof) -> Proof:
    return msgspec.structs.replace(proof, event=proof.event.replace(b'"seq":', b'"seq":1'))


def of_other(proof: Proof, **changes: Any) -> Proof:
    """Let the first step be about a tree of one event with another origin, size or root, in which it is right."""
    tree = msgspec.structs.replace(Checkpoint(origin("south"), 1, leaf_hash(proof.event)), **changes)
    return msgspec.structs.replace(proof, index=0, hashes=(), note=Note(tree))


def in_log(proof: Proof, event: bytes) -> Proof:
    """Let the second step be about this event, alone in a log that the key signed."""
    tree = Checkpoint(KEY.verifier.name, 1, leaf_hash(event))
    return msgspec.structs.replace(proof, log=Proof(event, 0, (), Note(tree, (KEY.sign(tree),))))


def second(proof: Proof, **changes: Any) -> Proof:
    """Change the second step."""
    assert proof.log is not None
    return msgspec.structs.replace(proof, log=msgspec.structs.replace(proof.log, **changes))


def unsigned(proof: Proof) -> Proof:
    assert proof.log is not None
    return second(proof, note=Note(proof.log.note.checkpoint))


def head_with(proof: Proof, **changes: object) -> bytes:
    assert proof.log is not None
    return canonical.document(msgspec.json.decode(proof.log.event) | changes)


FAILING: dict[str, tuple[Callable[[Proof], Proof], str]] = {
    "another event": (other_leaf, "step 1 .*expected one to"),
    "another place": (lambda one: msgspec.structs.replace(one, index=one.index - 1), "step 1 .*expected one to"),
    "another tree of the shard": (of_other, "found step 1 in a tree of shard_events 1, expected"),
    "another place in the log": (lambda one: second(one, index=1), "step 2 .*expected one to"),
    "an event that is no head": (lambda one: in_log(one, one.event), "step 2 .*expected the head of a shard"),
    "another root of the shard": (
        lambda one: in_log(one, head_with(one, shard_root="0" * 64)),
        "found step 1 in a tree of shard_root .*, expected 0000",
    ),
    "another size of the shard": (
        lambda one: in_log(one, head_with(one, shard_events=7)),
        "found step 1 in a tree of shard_events .*, expected 7",
    ),
    "the head of another shard": (
        lambda one: in_log(one, head_with(one, origin=origin("west"))),
        r"found step 1 in a tree of origin example\.org/south, expected example\.org/west",
    ),
    "a log that the key did not sign": (unsigned, "step 2 .*found no signature"),
}


@pytest.mark.parametrize("name", FAILING)
def test_a_step_that_fails_is_named_and_the_independent_verifier_agrees(proof: Proof, name: str) -> None:
    change, expected = FAILING[name]
    assert re.search(expected, judged(change(proof)))


def test_the_right_head_alone_in_a_log_is_proven_too(proof: Proof) -> None:
    assert judged(in_log(proof, head_with(proof))) == ""


def test_a_third_step_is_refused(proof: Proof) -> None:
    assert proof.log is not None
    three = msgspec.structs.replace(proof, log=msgspec.structs.replace(proof.log, log=proof.log))
    assert "no third step" in judged(three)


def test_a_proof_of_thousands_of_steps_is_refused_like_any_other(proof: Proof) -> None:
    for text in ("c2sp.org/tlog-proof@v1\n\n" * 5_000, "\n".join([str(proof)] * 500)):
        with pytest.raises(LedgerCorrupted, match=r"found more than two steps, .*no third step"):
            parse_proof("it", text)


def test_an_event_of_another_shard_does_not_lead_to_this_one(proof: Proof, site: Path) -> None:
    west = prove(open_for_answers(site / "west"), 3)
    assert "found step 1 in a tree of origin" in judged(msgspec.structs.replace(west, log=proof.log))


def test_a_receipt_has_one_step(site: Path, tmp_path: Path) -> None:
    pytest.importorskip("cbor2", reason="make test-all installs it")
    assert run(["key", "new", str(tmp_path / "key"), "--name", "fsar-ledger/federation"]) == 0
    with pytest.raises(UsageError, match="a receipt has one step"):
        fsar_ledger.open_ledger(site / "log").prove(3, tmp_path / "proof.cose", format="cose", key=tmp_path / "key")


@pytest.mark.slow
def test_a_log_is_witnessed_and_verified_by_others_as_any_ledger(site: Path, tmp_path: Path) -> None:
    log, cosigner = tmp_path / "log", Cosigner("example.org/w1", bytes(32))
    with Writer(log, KEY.verifier.name, KEY) as writer:
        for head in heads_of(open_ledger(site / "log")):
            folder = os.path.relpath(site / "log" / head.folder, log)
            writer.append(stage(log, [record_of_head(msgspec.structs.replace(head, folder=folder))]))
    note = parse_note("note", (log / "checkpoint").read_text())
    (tmp_path / "cosigned").write_text(f"{note}{cosigner.cosign(note.checkpoint, 1_795_000_000).line()}")
    (tmp_path / "policy").write_text(f"log {KEY.verifier}\nwitness w1 {cosigner.key}\nquorum w1\n")
    found = fsar_ledger.Ledger(log).verify(
        witness_policy=tmp_path / "policy", cosigned=[tmp_path / "cosigned"], now_s=1_795_000_001
    )
    assert found.ok
    assert found.witnessed is not None
    assert found.witnessed.is_enough
    assert agreement.judged(agreement.Case("log", log, True, KEY.verifier)).difference == ""


LOGS = sorted(LEDGERS.glob("*/log"), key=lambda log: [int(part) for part in log.parent.name.split(".")])
"""The logs of the releases, the oldest first."""


@pytest.mark.parametrize("log", few(LOGS, [LOGS[0]]), ids=lambda log: log.parent.name)
def test_a_kept_log_answers_as_the_ledger_whose_head_it_records(log: Path) -> None:
    whole, of_shards = fsar_ledger.open_ledger(log.parent / "ledger"), fsar_ledger.open_ledger(log)
    assert of_shards.verify().ok
    for name in ("staging/runs", "metrics/run_metrics", "facts/executions", "audit/requests"):
        assert of_shards.query(name).rows() == whole.query(name).rows()
