"""An answer that does not fit where it is sent is one message and exit code 1, whoever writes it."""

import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

import fsar_ledger
from tests.quick import few
from tests.running import ran

FULL = Path("/dev/full")

pytestmark = pytest.mark.skipif(not FULL.is_char_device(), reason="no device here that is always full")


@pytest.mark.parametrize(
    "call",
    few(
        ["info LEDGER", "metrics LEDGER --csv", "sql LEDGER 'SELECT 1'", "verify --help", "--version"],
        ["sql LEDGER 'SELECT 1'", "--version"],
    ),
)
def test_an_answer_that_does_not_fit_is_one_message(ledger: Path, call: str) -> None:
    arguments = [
        str(ledger) if word == "LEDGER" else word.strip("'") for word in call.replace("SELECT 1", "SELECT+1").split()
    ]
    arguments = [word.replace("+", " ") for word in arguments]
    with FULL.open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "fsar_ledger", *arguments],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 1
    assert "No space left on device" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_a_message_that_does_not_fit_changes_no_exit_code(ledger: Path) -> None:
    with FULL.open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "fsar_ledger", "info", str(ledger / "nothing")],
            stdout=subprocess.PIPE,
            stderr=full,
            check=False,
        )
    assert (done.returncode, done.stdout) == (2, b"")


@pytest.mark.parametrize("call", ["info LEDGER", "prove LEDGER 5"])
def test_an_answer_without_any_output_to_go_to_is_one_message(ledger: Path, call: str) -> None:
    done = with_closed(ledger, call, 1)
    assert done.returncode == 1
    assert done.stderr == "fsar-ledger: stdout is closed; write the output to a file or a pipe\n"


@pytest.mark.parametrize(
    "call", few(["info LEDGER", "metrics LEDGER --csv", "verify LEDGER", "explain LEDGER"], ["info LEDGER"])
)
def test_an_answer_is_the_same_where_messages_have_nowhere_to_go(ledger: Path, call: str) -> None:
    usual, done = with_closed(ledger, call, 9), with_closed(ledger, call, 2)
    assert (usual.returncode, done.returncode) == (0, 0)
    assert done.stdout == usual.stdout != ""
    assert with_closed(ledger / "nothing", call, 2).returncode == 2


@pytest.mark.parametrize(
    "call", few(["record LEDGER --run night", "import LEDGER - --as mcap"], ["import LEDGER - --as mcap"])
)
def test_standard_input_that_is_closed_is_empty(tmp_path: Path, call: str) -> None:
    done = with_closed(tmp_path / "ledger", call, 0)
    assert (done.returncode, "Traceback" in done.stderr) == (2 if "import" in call else 0, False), done.stderr


def with_closed(ledger: Path, call: str, stream: int) -> subprocess.CompletedProcess[str]:
    """Run the command with this stream closed."""
    words = call.replace("LEDGER", f'"{ledger}"')
    command = f"{sys.executable} -m fsar_ledger {words} {stream}>&-"
    return ran(["sh", "-c", command])


@pytest.mark.slow
def test_nothing_is_left_behind_where_libraries_keep_their_files(ledger: Path, tmp_path: Path) -> None:
    (tmp_path / "scratch").mkdir()
    environment = {"HOME": "/proc/nowhere", "TMPDIR": str(tmp_path / "scratch"), "PATH": "/usr/bin:/bin"}
    done = subprocess.run(
        [sys.executable, "-m", "fsar_ledger", "report", str(ledger), "--out", str(tmp_path / "r.pdf")],
        env=environment,
        capture_output=True,
    )
    assert done.returncode == 0, done.stderr
    assert list((tmp_path / "scratch").iterdir()) == []


@pytest.mark.slow
def test_an_unbuffered_answer_that_fits_in_part_is_said_to_be_incomplete(ledger: Path, tmp_path: Path) -> None:
    call = (
        f'ulimit -f 8; exec {sys.executable} -m fsar_ledger sql "{ledger}" "SELECT * FROM events" --csv > '
        f'"{tmp_path / "part"}"'
    )
    done = ran(["sh", "-c", call], env={**os.environ, "PYTHONUNBUFFERED": "1"})
    assert (tmp_path / "part").stat().st_size > 0
    assert done.returncode == 1
    assert "the output is incomplete (File too large); write it where there is free space" in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_reader_that_is_told_to_end_leaves_no_temporary_files(tmp_path: Path, how: signal.Signals) -> None:
    (tmp_path / "scratch").mkdir()
    with fsar_ledger.record(tmp_path / "ledger") as record:
        record.observed("door/open")
    command = [sys.executable, "-m", "fsar_ledger", "log", str(tmp_path / "ledger"), "--follow", "--json"]
    environment = {**os.environ, "TMPDIR": str(tmp_path / "scratch")}
    heeds = partial(signal.signal, how, signal.SIG_DFL)  # also where the tests run under `nohup`
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment, preexec_fn=heeds
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline()
        assert [*(tmp_path / "scratch").iterdir()]
        process.send_signal(how)
        process.communicate(timeout=30)
    assert process.returncode == (130 if how == signal.SIGINT else -how)
    assert not [*(tmp_path / "scratch").iterdir()]
