"""An import that is interrupted, or one of several at once, keeps every record once, in order, and can go on."""

import io
import os
import random
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest

from fsar_ledger.base.errors import UsageError
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.store.paths import MANIFEST
from fsar_ledger.sources import importing
from fsar_ledger.sources.adapter import LOOKED_AT, Input, adapter_of, opened
from fsar_ledger.sources.importing import import_files
from fsar_ledger.sources.vda5050 import Vda5050
from tests.cli.conftest import Call
from tests.running import ran
from tests.sources import vda
from tests.sources.importing import filed, imported, is_good, kinds, record_numbers, recorded
from tests.sources.vda import message, order, state

COMMAND = (sys.executable, "-m", "fsar_ledger")
ONE = message(0, "0001", "connection", connectionState="ONLINE")


class Slow(io.RawIOBase):
    """Gives a line at a time, and calls `asked` before each."""

    def __init__(self, lines: Iterable[bytes], asked: Callable[[], None] = lambda: None) -> None:
        self.lines, self.asked = iter(lines), asked

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        self.asked()
        line = next(self.lines, b"")
        buffer[: len(line)] = line
        return len(line)


def streamed(ledger: Path, format: str, lines: Iterable[bytes]) -> list[int]:
    """Import a stream, and return how many records were on file each time that it was asked for a line."""
    seen: list[int] = []
    stream = Input("stdin", None, io.BufferedReader(Slow(lines, lambda: seen.append(held(ledger)))))
    import_files(ledger, [stream], adapter_of(format, None)[0], run="night")
    return seen


def test_each_record_of_a_stream_is_on_disk_before_the_next_is_awaited(tmp_path: Path) -> None:
    lines = vda.written(vda.long_night(1)).splitlines(keepends=True)
    seen = streamed(tmp_path / "ledger", "vda5050", lines)
    assert (len(lines), seen[:9]) == (8, list(range(9)))


def test_a_stream_whose_first_record_has_no_time_keeps_the_time_of_the_others(tmp_path: Path) -> None:
    asked = b'{"type": "dispatch_task_request", "request": {"category": "delivery"}}\n'
    booked = b'{"booking": {"id": "d1", "unix_millis_request_time": 1772359200000}, "status": "queued"}\n'
    assert streamed(tmp_path / "ledger", "rmf", (asked, booked))[:3] == [0, 0, 2]
    started, *_ = recorded(tmp_path / "ledger")
    assert started["epoch"] == "2026-03-01T10:00:00Z"


def test_a_stream_that_tells_no_time_is_not_held_back_for_long(tmp_path: Path) -> None:
    lines = [b'{"type": "robot_task_request", "request": {}}\n'] * (LOOKED_AT + 5)
    seen = streamed(tmp_path / "ledger", "rmf", lines)
    assert seen[: LOOKED_AT + 6] == [0] * LOOKED_AT + list(range(LOOKED_AT, LOOKED_AT + 6))


@pytest.mark.slow
def test_a_pipe_is_read_as_standard_input_is(tmp_path: Path) -> None:
    whole = vda.written(vda.long_night(3))
    called = subprocess.run(
        [*COMMAND, "import", tmp_path / "ledger", "-", "--as", "vda5050", "--run", "night"],
        input=whole,
        capture_output=True,
        check=True,
    )
    assert b"24 records" in called.stdout
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    writer = threading.Thread(target=lambda: fifo.write_bytes(whole))
    writer.start()
    imported(tmp_path / "ledger", fifo, run="fifo")
    writer.join()
    assert record_numbers(tmp_path / "ledger", "fifo") == list(range(1, 25))


def test_a_pipe_of_the_shell_gives_a_run_no_number_for_a_name() -> None:
    for_reading, for_writing = os.pipe()
    with open(for_reading, "rb"), open(for_writing, "wb"), opened([f"/dev/fd/{for_reading}"]) as (pipe,):
        assert (pipe.name, pipe.path) == ("pipe", None)


@pytest.mark.slow
def test_two_imports_of_two_runs_at_once_are_both_whole(tmp_path: Path) -> None:
    night, failures = filed(tmp_path, vda.long_night(900)), list[BaseException]()
    imported(tmp_path / "ledger", filed(tmp_path, [ONE], "first.jsonl"), run="first")

    def one(run: str) -> None:
        try:
            imported(tmp_path / "ledger", night, run=run)
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=one, args=(run,)) for run in ("a", "b")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures
    for run in ("a", "b"):
        assert record_numbers(tmp_path / "ledger", run) == list(range(1, 7_201))
    assert is_good(tmp_path / "ledger")


def test_two_imports_of_one_run_at_once_lose_and_double_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    night = filed(tmp_path, vda.long_night(4))
    monkeypatch.setattr(importing, "COMMIT_EVENTS", 10)
    others = iter([True])

    def also(*_: object) -> None:
        if next(others, False):
            monkeypatch.undo()
            imported(tmp_path / "ledger", night)

    with pytest.raises(UsageError, match="another process adds to this run"):
        imported(tmp_path / "ledger", night, progress=also)
    assert record_numbers(tmp_path / "ledger") == list(range(1, 33))
    assert is_good(tmp_path / "ledger")


@pytest.mark.slow
def test_a_full_disk_ends_an_import_which_goes_on_later(call: Call, tmp_path: Path) -> None:
    night = filed(tmp_path, vda.long_night(900))

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (3_000_000, 3_000_000))

    arguments = ("import", str(tmp_path / "ledger"), str(night), "--as", "vda5050")
    called = ran([*COMMAND, *arguments], preexec_fn=limit)
    assert (called.returncode, called.stderr.count("\n"), "Traceback" in called.stderr) == (1, 1, False), called.stderr
    call(*arguments).good()
    assert record_numbers(tmp_path / "ledger") == list(range(1, 7_201))


def test_ctrl_c_ends_an_import_quietly_and_it_goes_on(call: Call, tmp_path: Path) -> None:
    lines = vda.written(vda.long_night(2)).splitlines(keepends=True)
    arguments = ("import", str(tmp_path / "ledger"), "-", "--as", "vda5050", "--run", "night")
    with subprocess.Popen(
        [*COMMAND, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdin is not None
        process.stdin.write(b"".join(lines[:5]))
        process.stdin.flush()
        wait_for(tmp_path / "ledger", 5)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert (process.returncode, b"Traceback" in said, b"continues from there" in said) == (130, False, True), said
    imported(tmp_path / "ledger", filed(tmp_path, b"".join(lines)))
    assert record_numbers(tmp_path / "ledger") == list(range(1, 17))


def held(ledger: Path) -> int:
    """Return how many records are on disk."""
    has_run = (ledger / MANIFEST).exists() and open_ledger(ledger).has_run("night")
    return len(record_numbers(ledger)) if has_run else 0


def wait_for(ledger: Path, records: int) -> None:
    for _ in range(300):
        if held(ledger) >= records:
            return
        time.sleep(0.1)
    raise AssertionError(f"found fewer than {records} records on disk after 30 s")


@pytest.mark.parametrize(
    "kills",
    [pytest.param(6, marks=pytest.mark.slow), pytest.param(200, marks=pytest.mark.soak)],
)
def test_an_import_that_is_killed_and_called_again_until_done_is_as_one_that_was_not(
    tmp_path: Path, kills: int
) -> None:
    night, moments = filed(tmp_path, vda.long_night(3_000)), random.Random(kills)
    imported(tmp_path / "once", night)
    command = [sys.executable, "-m", "tests.sources.killed", str(tmp_path / "ledger"), str(night)]
    code, killed = 1, 0
    while code:
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
            assert process.stdout is not None
            process.stdout.readline()  # it begins
            if killed < kills:
                try:
                    process.wait(moments.uniform(0, 0.02 + 0.5 * killed / kills))
                except subprocess.TimeoutExpired:
                    process.kill()
            _, said = process.communicate()
            code, killed = process.returncode, killed + (process.returncode == -signal.SIGKILL)
        assert code in (0, -signal.SIGKILL), said
    assert killed == kills
    assert record_numbers(tmp_path / "ledger") == list(range(1, 24_001))
    assert recorded(tmp_path / "ledger") == recorded(tmp_path / "once")
    assert is_good(tmp_path / "ledger")


def test_a_run_that_an_older_adapter_began_goes_on_without_what_that_did_not_tell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ledger = tmp_path / "ledger"
    lines = [order(0, "0001", "a", "p"), state(1, "0001", "a", p="RUNNING")]
    declares = Vda5050.declares
    with monkeypatch.context() as older:
        older.setattr(Vda5050, "declares", lambda self: [one for one in declares(self) if "Withdrawn" not in one])
        imported(ledger, filed(tmp_path, lines))
    imported(ledger, filed(tmp_path, [*lines, state(2, "0001", "a", p="FAILED")]))
    assert kinds(ledger)[-1] == "ExecutionFailed"
    assert is_good(ledger)
