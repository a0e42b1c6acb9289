import base64
import re
from pathlib import Path

import pytest

from fsar_ledger.base.errors import UsageError
from fsar_ledger.ledger.log.merkle import EMPTY_ROOT, tree_root
from fsar_ledger.ledger.log.note import Checkpoint, Note, Signer
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.verify import verify
from fsar_ledger.ledger.verify.report import Anchor, VerifyOptions, VerifyReport, read_anchor
from tests.ledger.forgery import changed, forge, forge_segment, segment_at, table_of
from tests.ledger.samples import ORIGIN, append_all, contents, made_up_batches, made_up_run

BATCHES = COMMITTED = made_up_batches(3)  # 24 events each
SIGNER = SIGNED_BY = Signer(ORIGIN, b"s" * 32)
NAMESAKE = Signer(ORIGIN, b"o" * 32)
KEY = SIGNER.verifier


def trusted(path: Path) -> VerifyReport:
    return verify(path, asked=VerifyOptions(trusted=KEY))


def the_problem(report: VerifyReport) -> str:
    assert not report.ok
    assert report.root is None
    assert report.anchored is None
    (problem,) = report.problems
    return str(problem)


# --- the trusted key ---


def test_a_ledger_that_the_key_signed_says_so(path: Path) -> None:
    report = trusted(path)
    assert (report.ok, report.signature, report.signer, report.signed) == (True, "signed", KEY.key, 3)
    report = verify(path)
    assert (report.ok, report.signature, report.signer, report.signed) == (True, "signer not checked", KEY.key, 3)


def test_an_unsigned_ledger_says_so_and_is_refused_where_a_signature_is_required(tmp_path: Path) -> None:
    append_all(tmp_path / "unsigned", BATCHES)
    report = verify(tmp_path / "unsigned")
    assert (report.ok, report.signature, report.signer, report.signed) == (True, "unsigned", None, 0)
    assert the_problem(trusted(tmp_path / "unsigned")) == (
        f"chain.jsonl: commit 2, field note: found no signature, expected one of {KEY.key}, the trusted key"
    )


def test_an_empty_ledger_has_no_signature(tmp_path: Path) -> None:
    append_all(tmp_path / "empty", [], signer=SIGNER)
    assert verify(tmp_path / "empty").signature == "unsigned"
    assert "no commit, so no note" in the_problem(trusted(tmp_path / "empty"))


def test_the_newest_signature_vouches_for_all_before_it(tmp_path: Path) -> None:
    append_all(tmp_path / "ledger", BATCHES[:2])
    append_all(tmp_path / "ledger", BATCHES[2:], signer=SIGNER)
    report = trusted(tmp_path / "ledger")
    assert (report.ok, report.signature, report.signed) == (True, "signed", 1)


def test_what_came_after_the_last_signature_is_not_vouched_for(tmp_path: Path) -> None:
    append_all(tmp_path / "ledger", BATCHES[:2], signer=SIGNER)
    append_all(tmp_path / "ledger", BATCHES[2:])
    report = verify(tmp_path / "ledger")
    assert (report.ok, report.signature, report.signer, report.signed) == (True, "unsigned", None, 2)
    assert "commit 2, field note: found no signature" in the_problem(trusted(tmp_path / "ledger"))


def test_a_key_that_follows_another_is_the_one_to_trust(tmp_path: Path) -> None:
    append_all(tmp_path / "ledger", BATCHES[:2], signer=NAMESAKE)
    append_all(tmp_path / "ledger", BATCHES[2:], signer=SIGNER)
    assert (trusted(tmp_path / "ledger").ok, trusted(tmp_path / "ledger").signed) == (True, 1)
    report = verify(tmp_path / "ledger", asked=VerifyOptions(trusted=NAMESAKE.verifier))
    assert (
        f"commit 2, field note: found a signature of {KEY.key}, expected one of {NAMESAKE.verifier.key}"
        in the_problem(report)
    )


def test_a_key_does_not_sign_on_top_of_what_it_did_not_sign_unless_it_adopts_it(tmp_path: Path) -> None:
    for name, signer, found in (
        ("unsigned", None, "no signature"),
        ("rotated", NAMESAKE, f"a signature of {NAMESAKE.verifier.key}"),
    ):
        path = tmp_path / name
        append_all(path, BATCHES[:2], signer=signer)
        before = contents(path)
        with pytest.raises(
            UsageError, match=re.escape(f"{path}: found a newest checkpoint with {found}, expected one of {KEY.key}; ")
        ):
            Writer(path, ORIGIN, SIGNER)
        assert contents(path) == before
        with Writer(path, ORIGIN, SIGNER, adopts=True) as writer:
            writer.append(stage(path, BATCHES[2]))
        Writer(path, ORIGIN, SIGNER).close()
        assert trusted(path).signed == 1


def pretend(path: Path, number: int) -> None:
    """Put the signature of another key under the name of this one."""
    forged = NAMESAKE.sign(note_of(path, number).checkpoint)
    signature = base64.b64encode(KEY.key_id + forged.data).decode()
    forge(path, "commit", number, signature=signature)
    (path / "checkpoint").write_text(str(note_of(path, 2)))


def test_a_key_does_not_sign_on_top_of_a_note_that_only_names_it(path: Path) -> None:
    pretend(path, 2)
    with pytest.raises(UsageError, match="found a newest checkpoint with a signature that this key did not make"):
        Writer(path, ORIGIN, SIGNER)


def test_another_key_of_the_same_name_is_told_apart(tmp_path: Path) -> None:
    append_all(tmp_path / "ledger", BATCHES, signer=NAMESAKE)
    assert f"found a signature of {NAMESAKE.verifier.key}" in the_problem(trusted(tmp_path / "ledger"))


@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_note_that_pretends_to_be_of_the_key_is_found_in_any_commit(path: Path, number: int) -> None:
    pretend(path, number)
    assert verify(path).ok  # nothing contradicts itself
    assert f"commit {number}, field note: found a signature that this key did not make" in the_problem(trusted(path))


# --- an anchor ---


@pytest.fixture(params=[False, True], ids=["whole", "quick"])
def is_quick(request: pytest.FixtureRequest) -> bool:
    return bool(request.param)


def anchored(path: Path, note: Note | str | bytes, *, is_quick: bool, key: Signer | None = None) -> VerifyReport:
    file = path.parent / "anchor"
    file.write_bytes(note if isinstance(note, bytes) else str(note).encode())
    return verify(path, asked=VerifyOptions(is_quick, key.verifier if key else None, read_anchor(file)))


def note_of(path: Path, number: int) -> Note:
    return open_ledger(path).commits[number].note(ORIGIN)


@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_ledger_only_grew_since_each_of_its_checkpoints(path: Path, number: int, is_quick: bool) -> None:
    for key in (None, SIGNER):
        report = anchored(path, note_of(path, number), is_quick=is_quick, key=key)
        assert (report.ok, report.anchored, report.is_quick) == (True, 24 * (number + 1), is_quick), report.problems


def test_an_anchor_may_end_within_a_commit(path: Path, is_quick: bool) -> None:
    """Another writer may have committed the same events in other batches."""
    for size in (1, 7, 23, 25, 47, 71):
        root = tree_root(open_ledger(path).node(72), size)
        assert anchored(path, Note(Checkpoint(ORIGIN, size, root)), is_quick=is_quick).anchored == size
        assert not anchored(path, Note(Checkpoint(ORIGIN, size + 1, root)), is_quick=is_quick).ok


def test_every_ledger_grew_out_of_the_empty_one(path: Path, tmp_path: Path, is_quick: bool) -> None:
    empty = Note(Checkpoint(ORIGIN, 0, EMPTY_ROOT))
    append_all(tmp_path / "empty", [])
    for ledger in (path, tmp_path / "empty"):
        assert anchored(ledger, empty, is_quick=is_quick).anchored == 0
        assert not anchored(ledger, Note(Checkpoint(ORIGIN, 0, bytes(32))), is_quick=is_quick).ok


def test_newest_commits_that_were_taken_away_are_missed(path: Path, tmp_path: Path, is_quick: bool) -> None:
    append_all(tmp_path / "shorter", BATCHES[:2], signer=SIGNER)
    assert trusted(tmp_path / "shorter").ok  # without an anchor nothing shows
    found = the_problem(anchored(tmp_path / "shorter", note_of(path, 2), is_quick=is_quick, key=SIGNER))
    assert "chain.jsonl: found 48 events, expected at least 72" in found
    assert found.endswith("the newest were removed")


@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_rewritten_history_is_found(path: Path, tmp_path: Path, number: int, is_quick: bool) -> None:
    other = [*BATCHES]
    other[number] = [made_up_run(run.run_id, len(run.events), seed=99) for run in BATCHES[number]]
    append_all(tmp_path / "rewritten", other, signer=SIGNER)
    assert trusted(tmp_path / "rewritten").ok
    for at in range(3):
        report = anchored(tmp_path / "rewritten", note_of(path, at), is_quick=is_quick)
        assert report.ok == (at < number)
        assert report.ok or "history was rewritten" in the_problem(report)


def test_an_anchor_of_another_ledger_is_refused(path: Path, is_quick: bool) -> None:
    tree = note_of(path, 1).checkpoint
    elsewhere = Note(Checkpoint("example.org/elsewhere", tree.size, tree.root))
    assert f"found a checkpoint of example.org/elsewhere, expected one of {ORIGIN}" in the_problem(
        anchored(path, elsewhere, is_quick=is_quick)
    )


def test_an_anchor_needs_the_signature_of_the_trusted_key(path: Path, is_quick: bool) -> None:
    tree = note_of(path, 1).checkpoint
    for note, why in (
        (Note(tree), "no signature"),
        (Note(tree, (NAMESAKE.sign(tree),)), f"a signature of {NAMESAKE.verifier.key}"),
    ):
        assert anchored(path, note, is_quick=is_quick).ok
        told = the_problem(anchored(path, note, is_quick=is_quick, key=SIGNER))
        assert f"found a checkpoint with {why}, expected one signed by {KEY.key}" in told
        assert told.endswith("to compare one from before the key changed, leave out trusted_key")


@pytest.mark.parametrize("data", [b"", b"monday", b"\xff", b"x" * 2_000_000, b"example.org/fsar-test\n24\nAAAA\n\n"])
def test_an_anchor_that_is_no_checkpoint_is_refused(path: Path, data: bytes, is_quick: bool) -> None:
    assert "expected a checkpoint of this ledger" in the_problem(anchored(path, data, is_quick=is_quick))


def test_every_character_of_an_anchor_counts(path: Path) -> None:
    text = str(note_of(path, 1))
    for at in range(len(text)):
        for instead in ("", "A" if text[at] != "A" else "B"):
            assert not anchored(path, text[:at] + instead + text[at + 1 :], is_quick=True, key=SIGNER).ok, at


def test_an_anchor_that_is_not_there_is_the_callers_mistake(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="found no file"):
        read_anchor(tmp_path / "none")


def test_a_quick_look_says_what_it_did_not_compare(path: Path) -> None:
    assert verify(path, asked=VerifyOptions(is_quick=True)).remarks == (
        "rows were not compared with the recorded roots",
    )
    remark = "the recorded roots only grew since the anchor's 24 events; rows were not compared with them"
    assert anchored(path, note_of(path, 0), is_quick=True).remarks == (remark,)
    assert anchored(path, note_of(path, 0), is_quick=False).remarks == ()


# --- a quick look ---


def test_a_quick_look_finds_any_flipped_byte_of_a_segment_and_says_that_it_was_quick(path: Path) -> None:
    data = segment_at(path, 1).read_bytes()
    for at in range(0, len(data), 37):
        segment_at(path, 1).write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
        report = verify(path, asked=VerifyOptions(is_quick=True))
        assert "segments/000000000024-000000000048.parquet: commit 1, field segment_sha256" in the_problem(report)
        assert report.is_quick


def test_a_quick_look_at_an_intact_ledger_gives_the_recorded_head(path: Path) -> None:
    quick, whole = verify(path, asked=VerifyOptions(is_quick=True, trusted=KEY)), trusted(path)
    assert (quick.ok, quick.root, quick.commits, quick.events, quick.signature) == (True, whole.root, 3, 72, "signed")
    assert (quick.is_quick, whole.is_quick, quick.runs) == (True, False, 0)
    assert verify(path, workers=2, asked=VerifyOptions(is_quick=True, trusted=KEY)) == quick


def test_a_quick_look_reads_no_rows(path: Path) -> None:
    """A forgery that fits the file's hash is left to the whole look."""
    forge_segment(path, 1, changed(table_of(path, 1), "time_us", 3, 1))
    assert verify(path, asked=VerifyOptions(is_quick=True)).ok
    assert not verify(path).ok


def test_verify_changes_nothing(path: Path) -> None:
    before = contents(path)
    anchored(path, note_of(path, 0), is_quick=False, key=SIGNER)
    anchored(path, note_of(path, 0), is_quick=True, key=SIGNER)
    assert contents(path) == before


# --- what witnesses show ---


def test_a_ledger_begins_with_each_checkpoint_that_witnesses_show(path: Path, tmp_path: Path, is_quick: bool) -> None:
    """With or without an anchor; each that does not fit is a problem of its own, and none counts as the anchor."""
    kept = [Anchor(f"witness w{number}", note_of(path, number)) for number in range(3)]
    false = Anchor("witness liar", Note(Checkpoint(ORIGIN, 30, bytes(32))))
    larger = Anchor("witness ahead", Note(Checkpoint(ORIGIN, 99, bytes(32))))
    none = Anchor("witness dumb", None, "nothing that can be read")
    (tmp_path / "anchor").write_text(str(note_of(path, 0)))
    for anchor, size in ((None, None), (read_anchor(tmp_path / "anchor"), 24)):
        report = verify(path, asked=VerifyOptions(is_quick, KEY, anchor, tuple(kept)))
        assert (report.ok, report.anchored) == (True, size), report.problems
        report = verify(path, asked=VerifyOptions(is_quick, None, anchor, (kept[0], false, kept[1], larger, none)))
        assert not report.ok
        assert [str(problem) for problem in report.problems if "witness w" in str(problem)] == []
        assert [
            "witness liar" in str(report.problems[0]),
            "witness ahead" in str(report.problems[1]),
            "witness dumb" in str(report.problems[2]),
        ] == [True] * 3
