"""`log`: a run event by event, as lines for people and for programs, and as the ledger grows."""

import json
import os
import pty
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from fsar_ledger import Ledger
from tests.cli.conftest import SMALL, Call, in_a_process, one_message

RUN = "fsar.full.door-relay.n4.s7.r0000"
LINE = re.compile(r" *(?P<seq>\d+) +(?P<time>\d+\.\d{3}) s  (?P<words>\S.*|  +\S.*)")
COMMAND = [sys.executable, "-m", "fsar_ledger"]


@pytest.fixture
def growing(ledger: Path, tmp_path: Path) -> Path:
    """A copy of the ledger, to be continued."""
    return Path(shutil.copytree(ledger, tmp_path / "growing"))


@contextmanager
def following(ledger: Path, *options: str) -> Iterator[subprocess.Popen[str]]:
    """A process that follows the ledger."""
    process = subprocess.Popen(
        [*COMMAND, "log", str(ledger), "--follow", *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate(timeout=60)


def read(process: subprocess.Popen[str], count: int) -> list[dict[str, Any]]:
    """The next lines of the process."""
    assert process.stdout is not None
    return [json.loads(process.stdout.readline()) for _ in range(count)]


def test_a_run_is_told_a_line_an_event_under_its_name(call: Call, ledger: Path) -> None:
    called = call("log", ledger, "--run", RUN)
    assert called.code == 0, called.err
    name, empty, *lines = called.out.splitlines()
    assert (name.startswith(f"run 1, {RUN}"), empty) == (True, "")
    told = Ledger(ledger).log(RUN).rows()
    for line, row in zip(lines, told, strict=True):
        found = LINE.fullmatch(line)
        assert found is not None, line
        assert int(found["seq"]) == row["seq"]
        assert found["time"] == f"{row['time_s']:.3f}"
        for part in (row["action_id"], row["sender"], row["receiver"], row["message"], row["note"]):
            assert part is None or part in line
    assert len({line.index("robot/") for line in lines if "robot/" in line[:40]}) == 1


@pytest.mark.slow
def test_between_two_times_the_lines_of_a_robot_about_requests(call: Call, ledger: Path) -> None:
    asked = ("--run", RUN, "--from", "10s", "--to", "30000ms", "--robot", "B1", "--about", "requests,policy")
    found = [json.loads(line) for line in call("log", ledger, *asked, "--json").out.splitlines()]
    assert found == Ledger(ledger).log(RUN, 10, 30, "robot/B1", ["request", "policy"]).rows() != []
    repeated = (*asked[:-2], "--about", "request", "--about", "policies")
    assert call("log", ledger, *repeated).out == call("log", ledger, *asked).out


@pytest.mark.slow
def test_json_is_an_object_a_line_for_every_event_of_every_run(call: Call, ledger: Path) -> None:
    called = call("log", ledger, "--run", "all", "--json")
    found = [json.loads(line) for line in called.out.splitlines()]
    assert found == Ledger(ledger).log("all").rows()
    assert (len(found), called.err) == (Ledger(ledger).head.size, "")


@pytest.mark.slow
def test_each_run_has_its_name_above_its_lines(call: Call, ledger: Path) -> None:
    names = [line for line in call("log", ledger, "--run", "all").out.splitlines() if line.startswith("run ")]
    numbers = Ledger(ledger).numbers()
    told = [row["run_id"] for row in Ledger(ledger).log("all") if row["seq"] == 0]
    assert names == [f"run {numbers[run]}, {run}" if run in numbers else f"run {run}" for run in told]
    assert len(numbers) == len(told) - 1  # a plan has none


def test_it_says_that_nothing_happened(call: Call, ledger: Path) -> None:
    asked = ("--run", RUN, "--from", "0.5", "--to", "0.6")
    assert call("log", ledger, *asked).out == "no matching events\n"
    assert call("log", ledger, *asked, "--json").out == ""


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (("--about", "reqests"), ["unknown concern", "did you mean request?"]),
        (("--about", "requests,"), ["unknown concern ''", "expected one of fleet, registry"]),
        (("--robot", "B9"), ["there is no such robot", "robot/B1"]),
        (("--run", "r9999"), ["there is no such run"]),
        (("--run", RUN, "--from", "9000s"), [f"--from 9000s: run {RUN}", "ends at", "expected an earlier time"]),
        (("--from", "soon"), ["--from: found soon, expected seconds of run time"]),
        (("--to", "10min"), ["--to: found 10min, expected seconds of run time"]),
        (("--from", "30", "--to", "10"), ["--from 30 and --to 10: expected an earlier time first"]),
        (("--follow", "--run", RUN), [f"--follow and --run {RUN}", "shows the events of all runs as they come"]),
        (("--follow", "--verified"), ["--follow and --verified", "expected one of them"]),
    ],
)
def test_a_wrong_call_is_one_message(call: Call, ledger: Path, options: tuple[str, ...], parts: list[str]) -> None:
    one_message(call("log", ledger, *options), 2, *parts)


@pytest.mark.slow
def test_a_reader_may_stop_early(ledger: Path) -> None:
    process = subprocess.Popen(
        [*COMMAND, "log", str(ledger), "--run", "all", "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert read(process, 1)[0]["seq"] == 0
    assert process.stdout is not None
    process.stdout.close()
    assert process.wait(timeout=60) == 0
    assert process.stderr is not None
    assert process.stderr.read() == ""
    process.stderr.close()


@pytest.mark.slow
def test_follow_shows_what_another_process_commits(growing: Path) -> None:
    before = Ledger(growing).head.size
    with following(growing, "--json") as process:
        told = read(process, before)
        assert in_a_process("simulate", growing, *SMALL[:4], "--runs", "3", "--seed", "7", "--workers", "1").code == 0
        after = Ledger(growing).head.size
        assert after > before
        told += read(process, after - before)
        process.send_signal(signal.SIGINT)
        rest, err = process.communicate(timeout=60)
    assert told == Ledger(growing).log("all").rows()
    assert (process.returncode, rest) == (130, "")
    assert err.splitlines()[-1].startswith("fsar-ledger: interrupted; ")


@pytest.mark.slow
def test_follow_ends_when_its_reader_has_gone(growing: Path) -> None:
    with following(growing, "--json") as process:
        read(process, Ledger(growing).head.size)
        assert process.stdout is not None
        process.stdout.close()
        assert process.wait(timeout=60) == 0


@pytest.mark.slow
def test_follow_ends_with_the_error_of_a_damaged_ledger(growing: Path) -> None:
    with following(growing, "--json") as process:
        read(process, Ledger(growing).head.size)
        (growing / "chain.jsonl").unlink()
        rest, err = process.communicate(timeout=60)
    assert (process.returncode, rest, "Traceback" in err) == (3, "", False)
    assert "commits were removed" in err.splitlines()[-1]


@pytest.mark.slow
def test_a_terminal_sees_the_same_lines_and_follow_waits_there(ledger: Path) -> None:
    terminal, child = pty.openpty()
    process = subprocess.Popen([*COMMAND, "log", str(ledger), "--follow"], stdout=child, stderr=subprocess.DEVNULL)
    os.close(child)
    seen = b""
    while b"run 1, fsar" not in seen:
        seen += os.read(terminal, 4096)
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    while True:
        try:
            os.read(terminal, 4096)
        except OSError:
            break
    os.close(terminal)
    assert process.wait(timeout=60) == 130
