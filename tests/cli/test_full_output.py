"""An answer that does not fit where it is sent is one message and exit code 1, whoever writes it."""

import subprocess
import sys
from pathlib import Path

import pytest

FULL = Path("/dev/full")

pytestmark = pytest.mark.skipif(not FULL.is_char_device(), reason="no device here that is always full")


@pytest.mark.parametrize("call", ["info LEDGER", "metrics LEDGER --csv", "sql LEDGER 'SELECT 1'", "verify --help", "--version"])
def test_an_answer_that_does_not_fit_is_one_message(ledger: Path, call: str) -> None:
    arguments = [str(ledger) if word == "LEDGER" else word.strip("'") for word in call.replace("SELECT 1", "SELECT+1").split()]
    arguments = [word.replace("+", " ") for word in arguments]
    with FULL.open("w") as full:
        done = subprocess.run([sys.executable, "-m", "fsar_ledger", *arguments], stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    assert "No space left on device" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_a_message_that_does_not_fit_changes_no_exit_code(ledger: Path) -> None:
    with FULL.open("w") as full:
        done = subprocess.run([sys.executable, "-m", "fsar_ledger", "info", str(ledger / "nothing")], stdout=subprocess.PIPE, stderr=full, check=False)
    assert (done.returncode, done.stdout) == (2, b"")
