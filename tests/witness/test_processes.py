"""What an auditor is told, with witnesses as processes and a ledger whose writer cheats."""

import json
import shutil
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack
from functools import cached_property
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from threading import Thread

import pytest

from fsar_ledger.ledger.log.note import parse_note
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.witness import parse_cosigned, parse_secret
from fsar_ledger.witness.state import new_state, open_state
from tests.cli.conftest import Call, Called, in_a_process, one_message
from tests.ledger.damage import SIGNER, write_ledger
from tests.ledger.samples import ORIGIN, made_up_run
from tests.witness import conftest as log_of
from tests.witness.processes import Running, honest, lying

SIZES = (300, 40, 250, 7)
TOTALS = (300, 340, 590, 597)


class Place:
    """A folder with the ledger after each commit (`1` to `4`), two honest witnesses and a liar.

    Each witness is a process, started when it is first named.
    """

    def __init__(self, folder: Path, stack: ExitStack, run: Call) -> None:
        self.folder, self._stack, self._run = folder, stack, run

    @cached_property
    def first(self) -> Running:
        return self._witness("w1")

    @cached_property
    def second(self) -> Running:
        return self._witness("w2")

    @cached_property
    def liar(self) -> Running:
        return self._stack.enter_context(lying())

    def _witness(self, name: str) -> Running:
        new_state(self.folder / name, f"example.org/{name}")
        return self._stack.enter_context(honest(self.folder / name, [self.folder / "log.pub"]))

    def ledger(self, commits: int) -> Path:
        return self.folder / str(commits)

    def policy(self, threshold: object, *lines: str) -> Path:
        names = " ".join(line.split()[1] for line in lines)
        path = self.folder / "policy"
        path.write_text(f"log {SIGNER.verifier}\n{''.join(lines)}group enough {threshold} {names}\nquorum enough\n")
        return path

    def ask(self, ledger: Path, policy: Path, *options: object) -> Called:
        return self._run("witness", "ask", ledger, "--policy", policy, *options)

    def verify(self, ledger: Path, policy: Path, *options: object) -> Called:
        return self._run("verify", ledger, "--witness-policy", policy, "--workers", 1, *options)


@pytest.fixture(scope="module")
def ledgers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("ledgers")
    write_ledger(folder / "whole", SIZES, folder)
    (folder / "log.pub").write_text(f"{SIGNER.verifier}\n")
    return folder


@pytest.fixture
def place(ledgers: Path, tmp_path: Path, call: Call) -> Iterator[Place]:
    with ExitStack() as stack:
        yield Place(Path(shutil.copytree(ledgers, tmp_path / "place")), stack, call)


def rewritten(path: Path, kept: Path, size: int) -> Path:
    """Return a ledger that begins like the kept one and continues differently, signed with the same key."""
    shutil.copytree(kept, path)
    with Writer(path, ORIGIN, SIGNER) as writer:
        writer.append(stage(path, [made_up_run("run-9999", size, seed=99)]))
    return path


@pytest.mark.slow
def test_two_witnesses_follow_a_ledger_and_find_what_its_writer_does_to_it(place: Place) -> None:
    both = place.policy("all", place.first.line("w1"), place.second.line("w2"))
    out = place.folder / "cosigned"
    for commits, total in enumerate(TOTALS, 1):  # as it grows
        called = place.ask(place.ledger(commits), both, "--out", out)
        assert (called.code, called.err) == (0, "")
        assert f"{total:,} events, cosigned by w1 (20" in called.out
        assert place.verify(place.ledger(commits), both).code == 0
    note = parse_cosigned("note", out.read_bytes())
    assert [one.name for one in note.signatures] == [ORIGIN, "example.org/w1", "example.org/w2"]
    assert str(note).startswith((place.ledger(4) / "checkpoint").read_text())
    called = place.verify(place.ledger(4), both, "--json")
    assert json.loads(called.out)["witnessed"]["size"] == 597
    assert "signed by example.org/fsar-test" in place.verify(place.ledger(4), both).out

    for quick in ((), ("--quick",)):  # the newest commits were dropped with their notes
        called = place.verify(place.ledger(2), both, "--trusted-key", place.folder / "log.pub", *quick)
        assert called.code == 3
        assert "found 340 events, expected at least 597" in called.err
        assert "the newest were removed" in called.err
        assert "witness w1 (http://127.0.0.1:" in called.err

    other = rewritten(place.folder / "other", place.ledger(2), 300)  # rewritten with the same key, and longer
    assert in_a_process("verify", other, "--trusted-key", place.folder / "log.pub").code == 0
    for quick in ((), ("--quick",)):
        called = place.verify(other, both, *quick)
        assert called.code == 3
        assert "history was rewritten" in called.err
    called = place.ask(other, both, "--out", place.folder / "never")
    one_message(called, 1, "refused with 422", "history was rewritten", "nothing was written")
    same = rewritten(place.folder / "same", place.ledger(3), 7)  # rewritten with the same length
    one_message(place.ask(same, both), 1, "refused with 409", "another root of the same size")
    one_message(place.ask(place.ledger(3), both), 1, "it knows 597 events of this log, the ledger has 590")
    assert not (place.folder / "never").exists()


@pytest.mark.slow
def test_one_that_lies_and_one_that_is_behind_do_not_hide_what_the_third_saw(place: Place) -> None:
    lines = [place.first.line("ahead"), place.second.line("behind"), place.liar.line("liar", "/stale")]
    assert place.ask(place.ledger(1), place.policy(3, *lines[:2], place.liar.line("liar", "/forgets"))).code == 0
    assert place.ask(place.ledger(4), place.policy(1, lines[0])).code == 0
    for lie in ("/stale", "/future", "/other-key", "/other-root", "/other-log", "/garbage", "/forgets"):
        lies = place.policy(2, lines[0], lines[1], place.liar.line("liar", lie))
        called = place.verify(place.ledger(4), lies, "--quick")
        assert called.code == 0, called.err
        assert "witnessed: 300 of 597 events, by ahead (20" in called.out
        assert "fewer saw the newest 297" in called.out
        assert ("witness liar: its answer does not count: " in called.out) == (lie != "/forgets")
        # The newest commits were dropped. One witness that saw them is enough, since the log signed what it saw.
        called = place.verify(place.ledger(2), lies, "--quick")
        assert called.code == 3
        assert "at least 597, as witness ahead (http://127.0.0.1:" in called.err
    lies = place.policy(2, lines[0], place.liar.line("liar", "/other-key"))
    one_message(
        place.verify(place.ledger(4), lies),
        3,
        "liar: witness liar (",
        "a cosignature that its key did not make",
        "expected 2 of",
    )
    document = place.verify(place.ledger(4), lies, "--json")
    answer = json.loads(document.out)
    assert (document.code, answer["ok"], answer["problems"], answer["witnessed"]["ok"]) == (3, False, [], False)


def test_a_liar_that_forgets_cosigns_the_rewritten_ledger_and_the_honest_one_finds_it(place: Place) -> None:
    lines = [place.first.line("w1"), place.liar.line("liar", "/forgets")]
    assert place.ask(place.ledger(4), place.policy("all", *lines)).code == 0
    other = rewritten(place.folder / "other", place.ledger(2), 500)
    called = place.ask(other, place.policy("any", *lines), "--out", place.folder / "false")
    assert called.code == 0
    assert "w1: http://127.0.0.1:" in called.err
    assert "history was rewritten" in called.err
    called = place.verify(other, place.policy("any", *lines))
    assert called.code == 3
    assert "as witness w1 (" in called.err
    assert "history was rewritten" in called.err
    called = place.verify(place.ledger(4), place.policy("any", *lines))  # the log signed another tree as well
    assert called.code == 3
    assert "as witness liar (" in called.err


def test_the_same_witness_twice_counts_once(place: Place) -> None:
    out, first = place.folder / "cosigned", place.first.line("w1")
    second = f"witness w2 {new_state(place.folder / 'w2', 'example.org/w2')}\n"
    assert place.ask(place.ledger(4), place.policy(1, first), "--out", out).code == 0
    cosigner = parse_secret((place.folder / "w1" / "witness.key").read_text())
    assert cosigner is not None
    note = parse_cosigned("note", out.read_bytes())
    again = cosigner.cosign(note.checkpoint, 1_795_000_000)
    out.write_text(f"{note}{again.line()}")  # one note with two cosignatures of one witness
    called = place.verify(place.ledger(4), place.policy(2, first, second), "--cosigned", out, "--cosigned", out)
    one_message(called, 3, "found w1 (20", f"w2: {out}: no cosignature of it", "expected 2 of w1, w2")
    assert place.verify(place.ledger(4), place.policy(1, first, second), "--cosigned", out).code == 0


@pytest.mark.slow
def test_a_silent_witness_counts_as_missing_and_costs_seconds(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fsar_ledger.witness.cosign.ANSWER_S", 0.7)
    lines = [place.first.line("w1"), place.liar.line("liar", "/drips"), place.second.line("gone")]
    assert place.ask(place.ledger(4), place.policy(1, lines[0])).code == 0
    place.second.process.kill()
    assert place.ask(place.ledger(4), place.policy(1, place.liar.line("liar", "/forgets"))).code == 0
    began = time.monotonic()
    called = place.verify(place.ledger(4), place.policy(1, *lines))
    assert called.code == 0
    assert "witness liar: its answer does not count: no answer within 1 s" in called.out
    assert "gone: its answer does not count: http://127.0.0.1:" in called.out
    called = place.verify(place.ledger(4), place.policy(2, place.first.line("w1"), place.liar.line("liar", "/silent")))
    assert called.code == 3
    assert time.monotonic() - began < 30  # although the liar never answers


@pytest.mark.slow
def test_a_witness_that_is_killed_again_and_again_never_forgets_what_it_answered(tmp_path: Path) -> None:
    log = log_of.Log(2_000)
    new_state(tmp_path / "w", "example.org/w")
    answered = [0]
    for _ in range(3):
        with honest(tmp_path / "w", [str(log_of.LOG.verifier)]) as running:
            before = len(answered)
            sender = Thread(target=grow, args=(running.url, log, answered))
            sender.start()
            while len(answered) < before + 3 and sender.is_alive():
                time.sleep(0.01)
            time.sleep(0.05)
            running.process.send_signal(signal.SIGKILL)
            sender.join()
        with open_state(tmp_path / "w") as state:
            note = state.newest(log_of.ORIGIN)
        assert note is not None
        assert note.checkpoint == log.checkpoint(note.checkpoint.size)
        assert note.checkpoint.size >= answered[-1]
        answered.append(note.checkpoint.size)
    assert len(answered) > 6


def grow(url: str, log: log_of.Log, answered: list[int]) -> None:
    """Ask the witness to cosign one size after the other until it dies, and note each that it answered."""
    host, _, port = url.removeprefix("http://").partition(":")
    connection = HTTPConnection(host, int(port), timeout=5)
    size = answered[-1]
    try:
        while size < len(log.leaves):
            connection.request("POST", "/add-checkpoint", str(log.request(size, size + 1)).encode())
            response = connection.getresponse()
            response.read()
            assert response.status == 200
            size += 1
            answered.append(size)
    except (OSError, HTTPException):  # no answer, or only part of one
        connection.close()


@pytest.mark.slow
def test_a_witness_has_one_process_and_ends_when_it_is_told_to(place: Place) -> None:
    assert place.first.url.startswith("http://127.0.0.1:")
    second = in_a_process("witness", "serve", place.folder / "w1", "--log", place.folder / "log.pub")
    one_message(second, 2, "another process that serves this witness")
    for running, sign in ((place.first, signal.SIGTERM), (place.second, signal.SIGINT)):
        running.process.send_signal(sign)
        out, err = running.process.communicate(timeout=5)
        assert (running.process.returncode, out, err) == (0, "", "fsar-ledger: ended\n")


def test_a_wrong_call_of_a_witness_is_explained(ledgers: Path, tmp_path: Path, call: Call) -> None:
    key = ledgers / "log.pub"
    one_message(call("witness", "new", tmp_path / "w"), 2, "--name")
    one_message(call("witness", "new", ledgers / "1" / "w", "--name", "w"), 2, "inside the ledger")
    assert call("witness", "new", tmp_path / "w", "--name", "example.org/w").code == 0
    one_message(call("witness", "serve", tmp_path / "w"), 2, "--log")
    one_message(call("witness", "serve", tmp_path / "none", "--log", key), 2, "found no witness there")
    one_message(
        call("witness", "serve", tmp_path / "w", "--log", tmp_path / "w" / "witness.key.pub"), 2, "the key of a witness"
    )
    one_message(
        call("witness", "serve", tmp_path / "w", "--log", tmp_path / "none.pub"), 2, "none.pub", "cannot be read"
    )
    one_message(call("witness", "serve", tmp_path / "w", "--log", key, "--port", "70000"), 2, "--port")
    one_message(
        call("witness", "serve", tmp_path / "w", "--log", key, "--host", "192.0.2.7"), 2, "no way to listen there"
    )


def test_a_witness_policy_that_names_no_witness_to_ask_is_explained(ledgers: Path, tmp_path: Path, call: Call) -> None:
    policy, log = tmp_path / "policy", f"log {SIGNER.verifier}\n"
    line = f"witness w {new_state(tmp_path / 'w', 'example.org/w')}"
    one_message(call("verify", ledgers / "1", "--cosigned", tmp_path / "x"), 2, "found no --witness-policy")
    one_message(call("verify", ledgers / "1", "--witness-policy", policy), 2, "expected a C2SP tlog-policy")
    for text, parts in (
        ("quorum none\n", "without one nothing is proven"),
        (f"{line}\nquorum w\n", "found no log"),
        (f"{log}{line}\nquorum w\n", "found no witness with a URL"),
        (f"log {log_of.LOG.verifier}\n{line}\nquorum w\n", "--trusted-key: found"),
    ):
        policy.write_text(text)
        trusted = ("--trusted-key", ledgers / "log.pub") if "--trusted-key" in parts else ()
        one_message(call("verify", ledgers / "1", "--witness-policy", policy, *trusted), 2, parts)
    one_message(
        call("verify", ledgers / "1", "--witness-policy", policy),
        3,
        f"found a ledger of {ORIGIN}, expected one of a log that",
    )


def test_what_a_witness_cannot_answer_is_explained(ledgers: Path, tmp_path: Path, call: Call) -> None:
    policy = tmp_path / "policy"
    line = f"witness w {new_state(tmp_path / 'w', 'example.org/w')}"
    policy.write_text(f"log {SIGNER.verifier}\n{line} ftp://127.0.0.1\nquorum w\n")
    one_message(call("verify", ledgers / "1", "--witness-policy", policy), 3, "not a witness URL")
    one_message(
        call("witness", "ask", ledgers / "1", "--policy", policy), 1, "not a witness URL", "nothing was written"
    )
    one_message(
        call("witness", "ask", ledgers / "1", "--policy", policy, "--out", ledgers / "1" / "x"), 2, "inside the ledger"
    )
    (tmp_path / "x").write_text("nonsense")
    one_message(
        call("verify", ledgers / "1", "--witness-policy", policy, "--cosigned", tmp_path / "x"),
        2,
        "--cosigned",
        "expected a C2SP checkpoint",
    )
    one_message(
        call("verify", ledgers / "1", "--witness-policy", policy, "--cosigned", tmp_path / "none"),
        2,
        "it cannot be read",
    )
    shutil.copy(ledgers / "1" / "checkpoint", tmp_path / "x")
    one_message(
        call("verify", ledgers / "1", "--witness-policy", policy, "--cosigned", tmp_path / "x"),
        3,
        "no cosignature of it",
    )
    unsigned = tmp_path / "unsigned"
    with Writer(unsigned, ORIGIN) as writer:
        writer.append(stage(unsigned, [made_up_run("run", 9, seed=1)]))
    one_message(call("witness", "ask", unsigned, "--policy", policy), 2, "an unsigned checkpoint")
    assert parse_note("x", (tmp_path / "x").read_text()).checkpoint.size == 300


def test_help_names_every_command_of_a_witness() -> None:
    text = in_a_process("witness", "--help").out
    assert all(name in text for name in ("new", "serve", "ask"))
