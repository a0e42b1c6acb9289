"""Killed processes, full disks and malformed parameters: each ends in one message, and the next command continues."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from fsar_ledger.designs.constants import Constants
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.runtime.experiment import ORIGIN, Experiment
from fsar_ledger.runtime.simulation import RunSpec, plan_record, simulate_run
from tests.attacks.conftest import Attack
from tests.cli.conftest import one_message
from tests.ledger.hostile import stage_anything
from tests.quick import few
from tests.running import ran
from tests.runtime.forgeries import changed, renamed

SOME = ("--scenario", "door-relay", "--seed", "3", "--workers", "2", "--runs", "60")
MANY = (*SOME[:-1], "180")
EXPERIMENT = Experiment(PAPER_ARCHITECTURES, ("door-relay",), 60, 3)  # the plan, and three commits


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make the ledger of `SOME`, and a copy of it after its plan and one commit."""
    path = tmp_path_factory.mktemp("deaths") / "ledger"
    with Writer(path, ORIGIN) as writer:
        writer.append(stage(path, [plan_record(EXPERIMENT.plan())]))
        for number, batch in enumerate(EXPERIMENT.batches()):
            writer.append(stage(path, [simulate_run(spec, Constants()) for spec in batch]))
            if number == 0:
                shutil.copytree(path, path.with_name("one"))
    return path


def children(parent: int) -> list[tuple[int, str]]:
    """Return number and command line of the living descendants of this process."""
    listed = ran(["ps", "-A", "-ww", "-o", "pid=,ppid=,stat=,args="], check=True).stdout
    rows = [line.split(None, 3) for line in listed.splitlines()]
    return [
        (int(row[0]), row[3]) for row in rows if len(row) == 4 and int(row[1]) == parent and not row[2].startswith("Z")
    ]


def until(moment: float, seconds: float) -> Iterator[None]:
    """Yield again and again for this many seconds."""
    while time.monotonic() < moment + seconds:
        yield
        time.sleep(0.02)


def begun(*arguments: object) -> subprocess.Popen[str]:
    """Start a command without waiting for it."""
    call = [sys.executable, "-m", "fsar_ledger", *map(str, arguments)]
    return subprocess.Popen(call, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def workers_of(process: subprocess.Popen[str], count: int = 2) -> list[int]:
    """Return the worker processes of the command, once there are `count`."""
    for _ in until(time.monotonic(), 60):
        found = [number for number, line in children(process.pid) if "spawn_main" in line]
        if len(found) >= count or process.poll() is not None:
            return found
    return []


def is_alive(number: int) -> bool:
    listed = ran(["ps", "-o", "stat=", "-p", str(number)]).stdout.strip()
    return bool(listed) and not listed.startswith("Z")


def test_the_workers_of_a_simulation_that_was_killed_die_with_it(tmp_path: Path, command: Attack) -> None:
    ledger = tmp_path / "ledger"
    with begun("simulate", ledger, *MANY) as process:
        for _ in until(time.monotonic(), 60):
            segments = len(list(ledger.glob("segments/*.parquet")))
            if segments > 1 or process.poll() is not None:  # the workers start after the plan is committed
                break
        left = children(process.pid)
        process.kill()
    try:
        assert len([line for _, line in left if "spawn_main" in line]) == 2
        for _ in until(time.monotonic(), 10):
            if not any(is_alive(number) for number, _ in left):
                break
        assert [line for number, line in left if is_alive(number)] == []
    finally:
        end([number for number, _ in left])
    assert command("verify", ledger, "--quick").code == 0


def end(processes: list[int]) -> None:
    for number in processes:
        if is_alive(number):
            os.kill(number, signal.SIGKILL)


def ended_with_a_killed_worker(*arguments: object) -> tuple[int, str, str]:
    """Return exit code, output and message of the command; -9 if it never ends."""
    with begun(*arguments) as process:
        for number in workers_of(process)[-1:]:
            os.kill(number, signal.SIGKILL)
        try:
            out, err = process.communicate(timeout=30)
        except subprocess.TimeoutExpired:
            left = [number for number, _ in children(process.pid)]
            process.kill()
            end(left)
            return -9, "", ""
    return process.returncode, out, err


@pytest.mark.slow
def test_a_simulation_whose_worker_is_killed_says_so_and_continues_when_it_is_called_again(
    tmp_path: Path, command: Attack, whole: Path
) -> None:
    ledger = tmp_path / "ledger"
    code, out, err = ended_with_a_killed_worker("simulate", ledger, *SOME)
    assert (code, out, len(err.splitlines())) == (1, "", 1), err
    for part in ("fsar-ledger: worker process ", "signal 9", "what is committed is kept", "run the same command again"):
        assert part in err
    assert command("simulate", ledger, *SOME).code == 0
    assert (ledger / "checkpoint").read_bytes() == (whole / "checkpoint").read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["verify", "maintain recover"])
def test_a_verification_that_could_not_finish_calls_a_ledger_neither_good_nor_bad(
    tmp_path: Path, whole: Path, verb: str
) -> None:
    ledger = shutil.copytree(whole, tmp_path / "ledger")
    code, out, err = ended_with_a_killed_worker(*verb.split(), ledger, "--workers", "2")
    assert (code, out, len(err.splitlines())) == (1, "", 1), err
    assert err.startswith("fsar-ledger: worker process ")
    assert "no verdict on what was not checked" in err
    assert not any(word in err for word in ("consistent", "damaged", "do not rely"))


BAD = {"nested without end": '{"world":' + "[" * 100_000, "a number of 6,000 digits": '{"world":' + "9" * 6000 + "}"}


@pytest.mark.parametrize("name", few(BAD, ["nested without end"]))
def test_a_report_on_malformed_parameters_ends_with_one_message(tmp_path: Path, command: Attack, name: str) -> None:
    honest = simulate_run(RunSpec(7, "fsar", "full", "door-relay", 4, 0), Constants())
    record = renamed(changed(honest, 0, msgspec.structs.replace(honest.events[0], parameters=BAD[name])))
    ledger = tmp_path / "ledger"
    with Writer(ledger, ORIGIN) as writer:
        writer.append(stage_anything(ledger, [record]))
    one_message(
        command("report", ledger, "--out", tmp_path / "report.pdf"),
        3,
        record.run_id,
        "field parameters",
        "expected constants as a JSON object",
    )
    assert not (tmp_path / "report.pdf").exists()
