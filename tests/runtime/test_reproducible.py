"""The same simulation gives the same ledger, byte for byte, whatever the machine is doing."""

import hashlib
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from fsar_ledger.ledger.verify import verify
from tests.quick import few
from tests.running import ran

SEED = ["--seed", "9"]
PINNED = "0f72de10a7d493f22d43c6a5065e9f6b0329514d725e13214a35b785a9c750fd"
"""The root of the default experiment. Only a new fit, or a new version of the model, may change it."""


def command(out: Path, *options: str, runs: int = 5) -> list[str]:
    return [sys.executable, "-m", "fsar_ledger", "simulate", str(out), "--runs", str(runs), *SEED, *options]


def simulate(out: Path, *options: str, **environment: str) -> None:
    subprocess.run(
        command(out, *options), check=True, env={**os.environ, **environment}, capture_output=True, timeout=120
    )


def fingerprint(ledger: Path) -> dict[str, str]:
    """Every file of the ledger and the hash of its bytes."""
    files = sorted(path for path in ledger.rglob("*") if path.is_file() and "staging" not in path.parts)
    return {str(path.relative_to(ledger)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("expected") / "ledger"
    simulate(out, "--workers", "1", PYTHONHASHSEED="0", TZ="UTC", LC_ALL="C")
    assert verify(out).ok
    return out


@pytest.fixture(scope="module")
def expected(made: Path) -> dict[str, str]:
    return fingerprint(made)


@pytest.mark.parametrize(
    ("workers", "environment"),
    [
        pytest.param(
            "2", {"PYTHONHASHSEED": "4294967295", "TZ": "America/St_Johns", "LC_ALL": "POSIX"}, marks=pytest.mark.soak
        ),
        pytest.param("4", {"PYTHONHASHSEED": "1", "TZ": "Asia/Kathmandu", "LC_ALL": "C.UTF-8"}, marks=pytest.mark.slow),
    ],
)
def test_the_bytes_do_not_depend_on_hash_seed_time_zone_locale_or_workers(
    tmp_path: Path, expected: dict[str, str], workers: str, environment: dict[str, str]
) -> None:
    simulate(tmp_path / "ledger", "--workers", workers, **environment)
    assert fingerprint(tmp_path / "ledger") == expected


@pytest.mark.slow
def test_another_seed_gives_another_ledger(tmp_path: Path, expected: dict[str, str]) -> None:
    subprocess.run(
        [sys.executable, "-m", "fsar_ledger", "simulate", str(tmp_path / "ledger"), "--runs", "5", "--seed", "10"],
        check=True,
        capture_output=True,
    )
    assert fingerprint(tmp_path / "ledger") != expected


# that an interrupted simulation continues to the same root is tested in tests/cli/test_interruption.py
@pytest.mark.slow
@pytest.mark.parametrize("workers", few(["1", "2"], [], ["2"]))
def test_a_killed_simulation_resumes_to_the_same_bytes(tmp_path: Path, expected: dict[str, str], workers: str) -> None:
    out = tmp_path / "ledger"
    kills = 0
    for commits in (2, 3):  # the first is the plan
        process = subprocess.Popen(
            command(out, "--workers", workers),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        deadline = time.monotonic() + 60
        while process.poll() is None and time.monotonic() < deadline:
            if len(list(out.glob("segments/*.parquet"))) >= commits:
                os.killpg(process.pid, signal.SIGKILL)
                kills += 1
                break
            time.sleep(0.001)  # a core that only looks is not there for what is looked at
        process.wait()
    simulate(out, "--workers", workers)
    assert kills >= 1
    assert fingerprint(out) == expected
    assert verify(out).ok


@pytest.mark.parametrize("workers", few(["1", "2"], [], ["2"]))
def test_a_killed_enlargement_resumes_to_the_bytes_of_one_that_nobody_killed(tmp_path: Path, workers: str) -> None:
    options = ["--architecture", "fsar", "--scenario", "door-relay"]
    for name in ("straight", "killed"):
        subprocess.run(command(tmp_path / name, *options, runs=30), check=True, capture_output=True)
    kills = 0
    for commits in range(4, 8):  # two plans and two batches are there; each call is killed after one commit more
        arguments = command(tmp_path / "killed", "--workers", workers, *options, runs=130)
        process = subprocess.Popen(
            arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )
        while process.poll() is None and len(list(tmp_path.glob("killed/segments/*.parquet"))) < commits:
            time.sleep(0.001)
        kills += process.poll() is None
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    assert kills >= 2
    for name in ("straight", "killed"):
        subprocess.run(command(tmp_path / name, *options, runs=130), check=True, capture_output=True)
    assert fingerprint(tmp_path / "killed") == fingerprint(tmp_path / "straight")
    assert verify(tmp_path / "killed").ok


@pytest.mark.slow
def test_the_default_experiment_has_the_root_that_is_pinned(tmp_path: Path) -> None:
    done = ran(
        [sys.executable, "-m", "fsar_ledger", "simulate", str(tmp_path / "ledger"), "--runs", "20", "--seed", "42"],
        check=True,
    )
    assert done.stdout.splitlines()[1] == f"root {PINNED}"
