"""The painted screen: an unsigned ledger or proof makes a terminal claim that it was signed."""

from pathlib import Path

import pytest

from fsar_ledger.constants import Constants
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.proof import prove
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from tests.attacks.conftest import Attack
from tests.cli.conftest import Called
from tests.ledger.hostile import relabelled, stage_anything
from tests.terminal import CLAIM, painted, screen_of

PAINT = f"\x1b[2J\x1b[H{CLAIM}\x1b[8m\x9b31m\u202e\r\n{CLAIM}\n"


@pytest.fixture(scope="module")
def junk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make an unsigned ledger whose names paint on a terminal."""
    path = tmp_path_factory.mktemp("junk") / "ledger"
    run = simulate_run(RunSpec(5, "fsar", "full", "failure-recovery-chain", 4, 0), Constants())
    with Writer(path, "example.org/fleet") as writer:
        writer.append(stage_anything(path, [relabelled(run, lambda text: text + PAINT)]))
    return path


def nothing_is_painted(called: Called) -> None:
    """Assert that on a wide screen every line is what was written, and none begins with the claim."""
    for stream in (called.out, called.err):
        assert painted(stream) == []
    lines = screen_of(called.out + called.err).display
    assert any("\\x1b[2J" in line for line in lines), "what was to paint is not there"
    assert not any(line.startswith(CLAIM) for line in lines)


def test_an_unsigned_proof_does_not_show_that_it_is_signed(junk: Path, command: Attack, tmp_path: Path) -> None:
    proof = tmp_path / "event.tlog-proof"
    proof.write_text(str(prove(open_ledger(junk), 3)))
    called = command("verify-proof", proof)
    nothing_is_painted(called)
    assert (called.code, "unsigned" in called.out) == (0, True)


@pytest.mark.slow
def test_an_account_is_told_in_the_order_of_its_events(junk: Path, command: Attack) -> None:
    nothing_is_painted(command("explain", junk))


@pytest.mark.slow
def test_a_replay_that_fails_does_not_show_that_all_is_well(junk: Path, command: Attack) -> None:
    called = command("verify", junk, "--replay", "--workers", 1)
    nothing_is_painted(called)
    assert called.code == 3


@pytest.mark.slow
def test_recovery_says_what_it_found_and_nothing_else(junk: Path, command: Attack) -> None:
    nothing_is_painted(command("recover", junk, "--workers", 1))


@pytest.mark.slow
def test_an_answer_of_sql_is_its_rows(junk: Path, command: Attack) -> None:
    nothing_is_painted(command("sql", junk, "SELECT DISTINCT run_id, robot FROM events WHERE robot IS NOT NULL"))


@pytest.mark.slow
def test_an_error_quotes_and_does_not_obey(junk: Path, command: Attack) -> None:
    nothing_is_painted(command("sql", junk, "SELECT CAST(run_id AS INTEGER) FROM events"))
