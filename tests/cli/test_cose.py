"""`prove --as cose` writes a transparent statement, and `verify-proof` says what it shows."""

import json
import os
import re
import shutil
import sys
from pathlib import Path

import pytest

import fsar_ledger
from fsar_ledger import Ledger
from fsar_ledger.base.errors import UsageError
from fsar_ledger.cli import app
from fsar_ledger.ledger.store.keys import read_verifier
from tests.cli.conftest import SMALL, Call, in_a_process, one_message
from tests.ledger.samples import contents
from tests.running import ran

TRUST = Path(__file__).parents[2] / "docs" / "trust.md"
NOT_INSTALLED = "found no library cbor2, expected it for COSE; install it (`pip install cbor2`"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a key and a ledger that it signed."""
    path = tmp_path_factory.mktemp("cose")
    for command in (
        ("key", "new", path / "fleet.key"),
        ("simulate", path / "ledger", *SMALL, "--key", path / "fleet.key"),
        ("verify", path / "ledger"),
    ):
        assert app.run([*map(str, command)]) == 0
    return path


@pytest.fixture(scope="module")
def statement(folder: Path) -> Path:
    pytest.importorskip("cbor2", reason="make test-all installs it")
    file, key = folder / "event.cose", folder / "fleet.key"
    assert (
        app.run(["prove", str(folder / "ledger"), "1:12", "--as", "cose", "--key", str(key), "--out", str(file)]) == 0
    )
    return file


def test_a_statement_shows_the_same_as_the_text(call: Call, folder: Path, statement: Path) -> None:
    text = folder / "event.tlog-proof"
    call("prove", folder / "ledger", "1:12", "--out", text).good()
    for options in ((), ("--trusted-key", folder / "fleet.key.pub"), ("--anchor", folder / "ledger" / "checkpoint")):
        told = call("verify-proof", text, *options).good()
        assert call("verify-proof", statement, *options).good().out == told.out.replace(str(text), str(statement))
        as_json = json.loads(call("verify-proof", text, *options, "--json").good().out)
        found = json.loads(call("verify-proof", statement, *options, "--json").good().out)
        assert found == {**as_json, "file": str(statement)}
    assert found["compared"] == ["--anchor"]


def test_a_statement_with_another_key_root_or_byte_is_refused(
    call: Call, folder: Path, statement: Path, tmp_path: Path
) -> None:
    call("key", "new", tmp_path / "other.key").good()
    one_message(call("verify-proof", statement, "--trusted-key", tmp_path / "other.key.pub"), 3, "found a receipt of")
    one_message(call("verify-proof", statement, "--root", "ab" * 32), 3, "leads to root", "is not proven")
    data = statement.read_bytes()
    (tmp_path / "flipped").write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    called = call("verify-proof", tmp_path / "flipped", "--trusted-key", folder / "fleet.key.pub")
    one_message(called, 3, "found a signature of the event that this key did not make")
    (tmp_path / "cut").write_bytes(data[:-1])
    one_message(call("verify-proof", tmp_path / "cut"), 3, "found COSE of another form, or a part of it")


def test_a_statement_needs_no_ledger_and_comes_through_a_pipe(folder: Path, statement: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "fsar_ledger", "verify-proof", "-", "--trusted-key", str(folder / "fleet.key.pub")]
    done = ran(["sh", "-c", 'exec "$@" < event.cose', "sh", *command], cwd=shutil.copytree(folder, tmp_path / "copy"))
    assert (done.returncode, done.stderr) == (0, "")
    assert "-: proven: event " in done.stdout


def test_python_takes_the_same_parameters(folder: Path, statement: Path, tmp_path: Path) -> None:
    ledger, out = Ledger(folder / "ledger"), tmp_path / "event.cose"
    proof = ledger.prove("1:12", out, format="cose", key=folder / "fleet.key")
    assert str(proof) == str(ledger.prove("1:12"))
    assert out.read_bytes() == statement.read_bytes()  # Ed25519 is deterministic
    proven = fsar_ledger.verify_proof(out, (folder / "fleet.key.pub").read_text().strip())
    assert (proven.signature, proven.index) == ("signed", proof.index)
    with pytest.raises(UsageError, match=r"^format=cose: found no out, expected a new file"):
        ledger.prove("1:12", format="cose", key=folder / "fleet.key")
    with pytest.raises(UsageError, match="found a key for a tlog-proof, which is not signed, expected none"):
        ledger.prove("1:12", key=folder / "fleet.key")


def test_a_statement_leaves_the_ledger_as_it_is_and_replaces_nothing(
    call: Call, folder: Path, statement: Path, tmp_path: Path
) -> None:
    before, written = contents(folder / "ledger"), statement.read_bytes()
    options = ("--as", "cose", "--key", folder / "fleet.key", "--out")
    call("prove", folder / "ledger", "7", *options, tmp_path / "7.cose").good()
    one_message(call("prove", folder / "ledger", "8", *options, statement), 2, "never overwritten")
    one_message(call("prove", folder / "ledger", "8", *options, folder / "ledger" / "8.cose"), 2, "inside the ledger")
    assert contents(folder / "ledger") == before
    assert statement.read_bytes() == written


def test_the_key_may_stand_in_the_environment(folder: Path, statement: Path, tmp_path: Path) -> None:
    called = in_a_process(
        *("prove", folder / "ledger", "1:12", "--as", "cose", "--out", tmp_path / "event.cose"),
        surroundings={"FSAR_LEDGER_KEY": str(folder / "fleet.key")},
    ).good()
    assert called.out.startswith(f"{tmp_path / 'event.cose'}: event ")
    assert (tmp_path / "event.cose").read_bytes() == statement.read_bytes()


def test_what_a_statement_lacks_is_said_before_anything_is_read(call: Call, folder: Path, tmp_path: Path) -> None:
    pytest.importorskip("cbor2", reason="make test-all installs it")
    nowhere, out, key = tmp_path / "nowhere", ("--out", tmp_path / "x.cose"), ("--key", folder / "fleet.key")
    one_message(call("prove", nowhere, "1", "--as", "cose", *key), 2, "--as cose: found no --out, expected a new file")
    one_message(call("prove", nowhere, "1", "--as", "cose", *out), 2, "--as cose: found no --key, expected the secret")
    one_message(call("prove", nowhere, "1", "--as", "jws", *out), 2, "--as jws: expected tlog-proof or cose")
    one_message(call("prove", nowhere, "1", "--as", "cose", *out, "--key", nowhere), 2, "the key cannot be read")
    assert os.listdir(tmp_path) == []


def test_a_ledger_that_this_key_did_not_sign_gets_no_statement(
    call: Call, folder: Path, ledger: Path, tmp_path: Path
) -> None:
    pytest.importorskip("cbor2", reason="make test-all installs it")
    call("key", "new", tmp_path / "other.key").good()
    out = tmp_path / "x.cose"
    for place, key, found in (
        (ledger, folder / "fleet.key", "found no signature on the newest checkpoint, expected one of"),
        (folder / "ledger", tmp_path / "other.key", "found a signature of fsar-ledger/simulated+"),
    ):
        called = call("prove", place, "1:12", "--as", "cose", "--key", key, "--out", out)
        one_message(called, 2, str(place), found, read_verifier(f"{key}.pub").key, "sign the next commit with this one")
    assert not out.exists()


def test_a_key_signs_receipts_of_each_ledger_that_it_signed_under_another_name(call: Call, tmp_path: Path) -> None:
    pytest.importorskip("cbor2", reason="make test-all installs it")
    key, renamed = tmp_path / "arm.key", tmp_path / "same.key"
    call("key", "new", key, "--name", "example.org/arm").good()
    place = tmp_path / "ledger"
    once = ("--scenario", "door-relay", "--architecture", "fsar", "--runs", "1", "--workers", "1")
    call("simulate", place, *once, "--origin", "example.org/arm", "--key", key).good()
    secret = key.read_text().strip().split("+", 4)[4]
    public = call("key", "public", f"{key}.pub", "--name", "example.org/fleet").good().out.strip()
    renamed.write_text("+".join(["PRIVATE", "KEY", *public.split("+")[:2], secret]) + "\n")
    renamed.chmod(0o600)
    call("prove", place, "0", "--as", "cose", "--key", renamed, "--out", tmp_path / "0.cose").good()
    assert "signed by example.org/arm+" in call("verify-proof", tmp_path / "0.cose", "--trusted-key", f"{key}.pub").out


def test_without_the_library_both_verbs_say_what_to_install(
    call: Call, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "cbor2", None)
    out, file = tmp_path / "x.cose", tmp_path / "file"
    called = call("prove", folder / "ledger", "1:12", "--as", "cose", "--key", folder / "fleet.key", "--out", out)
    one_message(called, 2, f"--as cose: {NOT_INSTALLED}")
    assert not out.exists()
    file.write_bytes(b"\xd2\x84")
    one_message(call("verify-proof", file), 2, f"{file}: {NOT_INSTALLED}")
    call("prove", folder / "ledger", "1:12").good()


@pytest.mark.slow
def test_only_a_statement_loads_the_library(folder: Path, tmp_path: Path) -> None:
    pytest.importorskip("cbor2", reason="make test-all installs it")
    code = (
        "import sys; from fsar_ledger.cli.app import run; code = run(sys.argv[1:]); print(code, 'cbor2' in sys.modules)"
    )
    out = ("--as", "cose", "--key", str(folder / "fleet.key"), "--out", str(tmp_path / "x.cose"))
    for options, loaded in (((), "0 False"), (out, "0 True")):
        done = ran([sys.executable, "-c", code, "prove", str(folder / "ledger"), "7", *options], check=True)
        assert done.stdout.splitlines()[-1] == loaded


@pytest.mark.slow
def test_the_commands_in_the_page_about_trust_run(folder: Path, tmp_path: Path) -> None:
    pytest.importorskip("cbor2", reason="make test-all installs it")
    section = TRUST.read_text("utf-8").partition("\n## COSE receipts\n")[2].partition("\n## ")[0]
    (commands,) = re.findall(r"```sh\n(.*?)```", section, flags=re.DOTALL)
    shutil.copytree(folder / "ledger", tmp_path / "out" / "ledger")
    for name in ("fleet.key", "fleet.key.pub"):
        shutil.copy(folder / name, tmp_path)
    surroundings = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    for line in commands.splitlines():
        done = ran(["sh", "-c", line], cwd=tmp_path, env=surroundings)
        assert (done.returncode, done.stderr) == (0, ""), line
    assert f"signed by {read_verifier(str(folder / 'fleet.key.pub')).key}" in done.stdout
