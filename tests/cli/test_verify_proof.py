"""`verify-proof` compares the root with one that was kept, reads pipes, and says what a cut proof lacks."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import fsar_ledger
from fsar_ledger.base.errors import LedgerCorrupted, UsageError

from .conftest import Call, one_message

ROOT = "the root is that of"


@pytest.fixture
def proof(call: Call, ledger: Path, tmp_path: Path) -> Path:
    file = tmp_path / "event.tlog-proof"
    assert call("prove", ledger, "5", "--out", file).code == 0
    return file


def test_the_root_is_compared_with_a_checkpoint_that_was_kept(call: Call, ledger: Path, proof: Path) -> None:
    called = call("verify-proof", proof, "--anchor", ledger / "checkpoint")
    assert (called.code, called.err) == (0, "")
    assert f"{ROOT} --anchor\n" in called.out
    assert "compare the root" not in called.out
    answer = json.loads(call("verify-proof", proof, "--anchor", ledger / "checkpoint", "--json").out)
    assert answer["compared"] == ["--anchor"]


def test_the_root_is_compared_with_one_in_hex(call: Call, proof: Path) -> None:
    root = fsar_ledger.verify_proof(proof).root
    assert f"{ROOT} --root\n" in call("verify-proof", proof, "--root", root.upper()).out
    one_message(call("verify-proof", proof, "--root", "ab" * 32), 3, root, "ab" * 32, "--root", "is not proven")
    one_message(call("verify-proof", proof, "--root", "abc"), 2, "64 hexadecimal digits")
    with pytest.raises(LedgerCorrupted, match="leads to root"):
        fsar_ledger.verify_proof(proof, root="ab" * 32)


def test_a_checkpoint_of_another_size_or_ledger_or_none_is_refused(
    call: Call, ledger: Path, proof: Path, tmp_path: Path
) -> None:
    checkpoint = (ledger / "checkpoint").read_text()
    origin, size, root, *rest = checkpoint.split("\n")
    other = tmp_path / "other"
    for lines, code, said in (
        ((origin, str(int(size) + 1), root), 2, "compare checkpoints of one size"),
        ((origin, size, f"A{root[1:]}" if root[0] != "A" else f"B{root[1:]}"), 3, "leads to root"),
        (("elsewhere", size, root), 3, "expected one of elsewhere"),
    ):
        other.write_text("\n".join((*lines, *rest)))
        one_message(call("verify-proof", proof, "--anchor", other), code, said)
    other.write_text("monday")
    one_message(call("verify-proof", proof, "--anchor", other), 2, "found no checkpoint")
    with pytest.raises(UsageError, match="found no file"):
        fsar_ledger.verify_proof(proof, anchor=tmp_path / "missing")


@pytest.mark.parametrize("name", ["-", "/dev/stdin"])
def test_a_proof_is_read_from_a_pipe(proof: Path, name: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "fsar_ledger", "verify-proof", name],
        input=proof.read_bytes(),
        capture_output=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"proven: event 5 of" in done.stdout


def test_lines_may_end_as_on_windows(call: Call, proof: Path) -> None:
    as_it_was = call("verify-proof", proof).out
    proof.write_bytes(proof.read_bytes().replace(b"\n", b"\r\n"))
    assert call("verify-proof", proof).out == as_it_was


def test_an_empty_or_cut_proof_is_said_to_be_so(call: Call, proof: Path, tmp_path: Path) -> None:
    whole, cut = proof.read_text(), tmp_path / "cut"
    for text, said in (
        ("", "an empty file"),
        (whole[:30], "a part of one"),
        (whole.partition("\n\n")[0], "a part of one"),
        (whole.replace("index ", "index x"), "an index that is not a number"),
    ):
        cut.write_text(text)
        one_message(call("verify-proof", cut), 3, said, "expected what `fsar-ledger prove` wrote")
    one_message(call("verify-proof", tmp_path), 3, "neither a regular file nor a pipe")
    one_message(call("verify-proof", tmp_path / "missing"), 2, "found no file")


@pytest.mark.parametrize("quick", [(), ("--quick",)])
def test_an_anchor_that_is_the_checkpoint_of_the_ledger_itself_is_said_to_show_nothing(
    call: Call, ledger: Path, tmp_path: Path, quick: tuple[str, ...]
) -> None:
    own, link = ledger / "checkpoint", tmp_path / "monday"
    link.symlink_to(own)
    for anchor in (own, link):
        called = call("verify", ledger, "--anchor", anchor, *quick)
        assert (called.code, "the anchor is this ledger's own checkpoint" in called.out) == (0, True)
        remarks = json.loads(call("verify", ledger, "--anchor", anchor, "--json", *quick).out)["remarks"]
        assert "it proves nothing about the past" in remarks[0]
    kept = shutil.copy(own, tmp_path / "kept")
    assert "own checkpoint" not in call("verify", ledger, "--anchor", kept, *quick).out
