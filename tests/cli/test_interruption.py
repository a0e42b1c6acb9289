"""Ctrl-C, a closed pipe and a full disk end a command quietly and leave whole ledgers."""

import json
import os
import pty
import resource
import select
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from threading import Timer

import pytest

from fsar_ledger.metrics.database import connect
from tests.cli.conftest import SMALL, Call, in_a_process
from tests.quick import few
from tests.running import ran

COMMAND = [sys.executable, "-m", "fsar_ledger"]
SEVERAL_COMMITS = ("--scenario", "door-relay", "--runs", "60", "--seed", "11")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    """The head of the ledger that nothing interrupted."""
    called = in_a_process(
        "simulate", tmp_path_factory.mktemp("whole") / "ledger", *SEVERAL_COMMITS, "--workers", "2", "--json"
    )
    head: dict[str, object] = json.loads(called.out)["head"]
    return head


@pytest.mark.slow
@pytest.mark.parametrize("workers", few(["1", "2"], [], ["2"]))
def test_an_interrupted_simulation_can_be_continued(
    call: Call, tmp_path: Path, workers: str, whole: dict[str, int]
) -> None:
    out = tmp_path / "stopped"
    arguments = [*COMMAND, "simulate", str(out), *SEVERAL_COMMITS, "--workers", workers]
    process = subprocess.Popen(
        arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    deadline = time.monotonic() + 60
    while (
        process.poll() is None and len(list(out.glob("segments/*.parquet"))) < 2 and time.monotonic() < deadline
    ):  # the plan, and a batch
        time.sleep(0.005)
    os.killpg(process.pid, signal.SIGINT)  # a terminal sends it to the workers too
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert err.splitlines() == [
        "fsar-ledger: interrupted; what is committed is kept, and the same command continues from there"
    ]
    assert call("verify", out).code == 0
    info = json.loads(call("info", out, "--json").out)
    assert info["head"]["size"] < whole["size"]
    [plan] = info["plans"]
    assert (info["is_complete"], plan["planned_count"]) == (False, 180)
    assert plan["there_count"] + plan["missing_count"] == 180
    assert 0 < plan["there_count"] < 180
    continued = in_a_process(*shlex.split(plan["continues_with"])[1:], "--workers", workers, "--json")
    assert json.loads(continued.out)["head"] == whole


def test_ctrl_c_before_a_command_has_begun_is_no_traceback(tmp_path: Path) -> None:
    (tmp_path / "typer.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n")
    called = in_a_process("info", tmp_path, surroundings={"PYTHONPATH": str(tmp_path)})
    assert (called.code, called.err) == (130, "fsar-ledger: interrupted; nothing was changed\n")


def test_a_closed_pipe_is_no_error(ledger: Path) -> None:
    process = subprocess.Popen(
        [*COMMAND, "sql", str(ledger), "SELECT * FROM events", "--csv"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.readline()
    process.stdout.close()
    assert process.stderr.read() == b""
    process.stderr.close()
    assert process.wait() == 0


@pytest.mark.parametrize("threads", [1, pytest.param(None, marks=pytest.mark.slow)], ids=["one thread", "all threads"])
def test_ctrl_c_in_the_midst_of_a_query_is_ctrl_c(ledger: Path, threads: int | None) -> None:
    """With several threads DuckDB at times notices it only when the query has ended, which takes seconds."""
    long = "SELECT sum(range % 7) AS rest FROM range(2000000000)"
    with connect(ledger, threads) as database:
        Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
        with pytest.raises(KeyboardInterrupt):
            database.rows(long)
        assert database.rows("SELECT 1 AS one") == [{"one": 1}]


def limited_disk(*arguments: object, file_bytes_max: int) -> subprocess.CompletedProcess[str]:
    """Runs a command whose files the kernel refuses to let grow further, as a full disk does."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes_max, file_bytes_max))

    return ran([*COMMAND, *map(str, arguments)], preexec_fn=limit)


@pytest.mark.parametrize("workers", [pytest.param("1", marks=pytest.mark.slow), "2"])
def test_a_full_disk_ends_a_simulation_without_half_a_commit(
    call: Call, ledger: Path, tmp_path: Path, workers: str
) -> None:
    small = (*SMALL[:-1], workers)
    called = limited_disk("simulate", tmp_path / "full", *small, file_bytes_max=4096)
    assert called.returncode == 1, called.stderr
    assert "Traceback" not in called.stderr
    assert called.stderr.startswith("fsar-ledger: ")
    assert len(called.stderr.splitlines()) == 1
    assert list((tmp_path / "full").glob("segments/*")) == []
    continued = call("simulate", tmp_path / "full", *small, "--json")
    assert json.loads(continued.out)["head"] == json.loads(call("info", ledger, "--json").out)["head"]


@pytest.mark.slow
def test_a_full_disk_ends_whatif_without_half_a_commit(call: Call, ledger: Path, tmp_path: Path) -> None:
    words = ("whatif", ledger, "--run", "1", "--change", "drop window:*", "--out", tmp_path / "forks")
    called = limited_disk(*words, file_bytes_max=4096)
    assert called.returncode == 1, called.stderr
    assert "this commit was not made; make room" in called.stderr
    assert len(called.stderr.splitlines()) == 1
    assert list((tmp_path / "forks").glob("segments/*")) == []
    assert call(*map(str, words)).code == 0
    assert call("verify", tmp_path / "forks", "--replay").code == 0


@pytest.mark.slow
def test_an_interrupted_whatif_keeps_whole_pairs_and_the_same_call_goes_on(call: Call, tmp_path: Path) -> None:
    ledger, out = tmp_path / "ledger", tmp_path / "forks"
    assert call("simulate", ledger, "--architecture", "fsar", "--runs", "20").code == 0
    arguments = [*COMMAND, "whatif", str(ledger), "--all-runs", "--change", "drop window:*", "--out", str(out)]
    process = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while process.poll() is None and len(list(out.glob("segments/*.parquet"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.005)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert (process.returncode, "the same command makes what is missing" in err) == (130, True), err
    held = json.loads(call("info", out, "--json").out)
    runs = {group["changes"]: group["runs"] for group in held["groups"]}
    assert 0 < runs["drop window:*"] == runs[None] < 100
    assert call("verify", out, "--replay").code == 0
    assert ran(arguments).returncode == 0
    assert json.loads(call("info", out, "--json").out)["runs"] == 200


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("events.csv", ()),
        pytest.param("events.parquet", (), marks=pytest.mark.slow),
        ("ocel.json", ("--as", "ocel")),
        pytest.param("otlp.json", ("--as", "otlp"), marks=pytest.mark.slow),
    ],
)
def test_a_full_disk_leaves_no_half_of_an_export(
    ledger: Path, tmp_path: Path, name: str, options: tuple[str, ...]
) -> None:
    called = limited_disk("export", ledger, *options, "--out", tmp_path / name, file_bytes_max=2048)
    assert called.returncode == 1
    assert called.stderr.startswith(f"fsar-ledger: {tmp_path / name}: cannot be written")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_progress_is_for_terminals(tmp_path: Path) -> None:
    assert in_a_process("simulate", tmp_path / "piped", *SMALL).err == ""
    terminal, child = pty.openpty()
    process = subprocess.Popen(
        [*COMMAND, "simulate", str(tmp_path / "watched"), *SMALL], stdout=subprocess.DEVNULL, stderr=child
    )
    os.close(child)
    seen = b""
    while select.select([terminal], [], [], 60)[0]:
        try:
            seen += os.read(terminal, 4096)
        except OSError:  # the command has closed its end
            break
    os.close(terminal)
    assert process.wait() == 0
    assert b"simulated 1 of 1 batches" in seen
