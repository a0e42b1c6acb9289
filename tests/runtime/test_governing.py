"""One process at a time governs a live run: the second is refused, or told at its next decision."""

import signal
import subprocess
import sys
from itertools import count
from pathlib import Path
from typing import Any

import pytest

import fsar_ledger
from fsar_ledger.base.errors import SequenceConflict
from fsar_ledger.runtime.federation import Federation
from tests.sources.test_recorder import COMMAND

TICKS = count(1_772_359_200)
TASK: dict[str, Any] = {"robot": "robot/A1", "steps": ("A navigate.indoor",), "budget_us": 600_000_000}


def federate(ledger: Path, run: str = "day") -> Federation:
    return fsar_ledger.federate(ledger, run=run, clock=lambda: next(TICKS) * 10**9)


def test_a_second_process_is_refused_until_the_first_has_ended_or_was_killed(tmp_path: Path) -> None:
    program = (
        "import sys, fsar_ledger\n"
        "one = fsar_ledger.federate(sys.argv[1], run='day')\n"
        "print('governs', flush=True)\n"
        "sys.stdin.read()\n"
    )
    arguments = [sys.executable, "-c", program, str(tmp_path / "ledger")]
    second = [*COMMAND, "federate", str(tmp_path / "ledger"), "day"]
    with subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "governs\n"
        refused = subprocess.run(second, input=b"", capture_output=True, check=False)
        assert refused.returncode == 2
        assert b"run day: found that another process governs it, expected none; stop that one first" in refused.stderr
        federate(tmp_path / "ledger", "night").close()
        process.send_signal(signal.SIGKILL)
    assert subprocess.run(second, input=b"", check=False).returncode == 0


def test_who_was_overtaken_says_that_another_process_wrote_the_run_and_writes_nothing(tmp_path: Path) -> None:
    with federate(tmp_path / "ledger") as first, federate(tmp_path / "ledger") as second:
        second.give("SubmitTask", "robot/A1", task_id="t1", **TASK)
        size = len(fsar_ledger.Ledger(tmp_path / "ledger").record("day").events)
        for _ in range(2):
            with pytest.raises(SequenceConflict, match="another process has written this run meanwhile: stop one of"):
                first.give("SubmitTask", "robot/A1", task_id="t2", **TASK)
        assert len(fsar_ledger.Ledger(tmp_path / "ledger").record("day").events) == size
    assert fsar_ledger.Ledger(tmp_path / "ledger").verify(replay=True).ok


def test_where_there_is_no_place_for_a_lock_the_run_is_governed_without(tmp_path: Path) -> None:
    (tmp_path / "ledger.snapshots").write_text("a file in its place")
    federate(tmp_path / "ledger").close()
