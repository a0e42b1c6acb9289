"""The pool of worker processes: answers in order, errors that arrive, and deaths that fail the waiting calls."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Future
from importlib import import_module
from multiprocessing import spawn
from pathlib import Path
from typing import Any

import pytest

from fsar_ledger.base.errors import LedgerCorrupted, WorkerDied
from fsar_ledger.base.parameters import BadParameters, read_parameters
from fsar_ledger.base.workers import WorkerPool
from fsar_ledger.designs.constants import Constants, read_constants
from tests.running import ran


class Untransportable(Exception):
    def __init__(self, one: str, other: str) -> None:
        super().__init__(f"{one} and {other}")


def unmade() -> None:
    raise ValueError("it cannot be made again")


class Unreadable:
    def __reduce__(self) -> tuple[Any, ...]:
        return (unmade, ())


def squared(number: int) -> int:
    time.sleep(0.01 * (number % 3))
    return number * number


def failing(kind: str) -> None:
    if kind == "ours":
        raise LedgerCorrupted("found a, expected b")
    raise Untransportable("this", "that")


def large(size: int) -> bytes:
    return os.urandom(1) * size


def killed(after: Path | None) -> None:
    """End this process without a word, once this file exists."""
    while after is not None and not after.exists():
        time.sleep(0.01)
    os.kill(os.getpid(), signal.SIGKILL)


def killed_halfway_through_its_answer() -> None:
    pipe = sys._getframe(2).f_locals["pipe"]  # the loop that calls `_answer`, which calls this
    os.write(pipe.fileno(), (1000).to_bytes(4, "big") + b"x" * 10)
    os.kill(os.getpid(), signal.SIGKILL)


def interrupted() -> bool:
    """Return whether Ctrl-C is ignored."""
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.05)
    return True


def test_answers_come_in_order_from_as_many_processes_as_were_asked_for() -> None:
    with WorkerPool(2) as pool:
        assert list(pool.map(squared, range(20))) == [number * number for number in range(20)]
        assert {pool.submit(os.getpid).result() for _ in range(8)}.isdisjoint({os.getpid()})
        assert len(pool.submit(large, 3_000_000).result()) == 3_000_000
        assert pool.submit(interrupted).result()
        with pytest.raises(LedgerCorrupted, match="found a, expected b") as raised:
            pool.submit(failing, "ours").result()
        assert any("in worker process" in note for note in raised.value.__notes__)
        with pytest.raises(RuntimeError, match="Untransportable: this and that"):
            pool.submit(failing, "other").result()
        with pytest.raises(TypeError, match="pickle"):
            pool.submit(os.scandir).result()
        with pytest.raises(ValueError, match="it cannot be made again"):
            pool.submit(Unreadable).result()
        assert pool.submit(squared, 5).result() == 25


def test_a_killed_worker_fails_its_call_and_those_queued_behind_it(tmp_path: Path) -> None:
    with WorkerPool(2) as pool:
        calls: list[Future[Any]] = [
            pool.submit(killed, tmp_path / "now"),
            pool.submit(time.sleep, 60),
            pool.submit(squared, 3),
        ]
        (tmp_path / "now").touch()
        for call in calls:
            with pytest.raises(
                WorkerDied, match=r"worker process \d+: found ended by signal 9, expected it to finish its work"
            ):
                call.result(timeout=30)
        with pytest.raises(WorkerDied, match="signal 9"):
            pool.submit(squared, 3)


def test_a_worker_killed_halfway_through_its_answer_does_not_hang_the_pool() -> None:
    with WorkerPool(2) as pool:
        waiting = pool.submit(time.sleep, 60)
        with pytest.raises(WorkerDied, match="signal 9"):
            pool.submit(killed_halfway_through_its_answer).result(timeout=30)
        with pytest.raises(WorkerDied, match="signal 9"):
            waiting.result(timeout=30)


def test_a_worker_loads_no_pandas_whoever_asks_for_it() -> None:
    with WorkerPool(1) as pool, pytest.raises(ImportError, match="no command uses it"):
        pool.submit(import_module, "pandas").result()


def test_a_process_that_cannot_be_started_is_reported() -> None:
    before = spawn.get_executable()
    spawn.set_executable("/nonexistent/python")
    try:
        with WorkerPool(1) as pool, pytest.raises(WorkerDied, match="worker process"):
            pool.submit(squared, 3).result(timeout=30)
    finally:
        spawn.set_executable(before)


def test_a_pool_that_is_left_drops_what_has_not_begun() -> None:
    before = time.monotonic()
    with WorkerPool(1) as pool:
        calls = [pool.submit(time.sleep, 0.2) for _ in range(100)]
        calls[0].result()
    assert time.monotonic() - before < 15
    assert sum(call.cancelled() for call in calls) > 90
    with WorkerPool(3):
        pass  # nothing was ever asked


ORPHANED = """
import os, time
from fsar_ledger.base.workers import WorkerPool
from tests.test_workers import squared

pool = WorkerPool(2)
print(*{pool.submit(os.getpid).result() for _ in range(20)}, flush=True)
for _ in range(4):
    pool.submit(time.sleep, 300)
print("begun", flush=True)
time.sleep(300)
"""


@pytest.mark.parametrize("end", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_workers_do_not_outlive_the_process_that_started_them(tmp_path: Path, end: signal.Signals) -> None:
    script = tmp_path / "orphaned.py"
    script.write_text(ORPHANED)
    call = [sys.executable, str(script)]
    with subprocess.Popen(
        call, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    ) as process:
        assert process.stdout is not None
        workers = [int(number) for number in process.stdout.readline().split()]
        assert process.stdout.readline() == "begun\n"
        process.send_signal(end)
    assert workers
    deadline = time.monotonic() + 10
    while any(is_alive(number) for number in workers) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not any(is_alive(number) for number in workers)


def is_alive(number: int) -> bool:
    with contextlib.suppress(ProcessLookupError):
        os.kill(number, 0)
        listed = ran(["ps", "-o", "stat=", "-p", str(number)]).stdout.strip()
        return bool(listed) and not listed.startswith("Z")
    return False


# --- parameters ---

BAD = {
    "no JSON": "no JSON",
    "nothing": "",
    "a list": "[1]",
    "a list without end": "[" * 100_000,
    "levels without end": '{"a":' * 5_000 + "1" + "}" * 5_000,
    "too many levels": '{"a":' * 20 + "1" + "}" * 20,
    "too many levels of lists": '{"a":' + "[" * 20 + "]" * 20 + "}",
    "a number of 6,000 digits": '{"a":' + "9" * 6_000 + "}",
    "a number of 30 digits": '{"a":[{"b":' + "9" * 30 + "}]}",
    "a number beyond all": '{"a":1e999}',
    "half of a character": '{"a":"\\ud800"}',
}


@pytest.mark.parametrize("name", list(BAD))
def test_what_no_run_records_as_its_parameters_is_one_kind_of_error(name: str) -> None:
    with pytest.raises(BadParameters, match=r"^found .*, expected constants as a JSON object"):
        read_parameters(BAD[name])
    with contextlib.suppress(BadParameters):  # this model's reader skips what it does not know
        assert read_constants(BAD[name]) == Constants()


def test_parameters_of_any_model_are_read_and_those_of_this_one_are_its_constants() -> None:
    assert read_parameters('{"a":{"b":[1,2.5,"c",null,true]}}') == {"a": {"b": [1, 2.5, "c", None, True]}}
    assert read_parameters("{}") == {}
    assert read_constants("{}") == Constants()
