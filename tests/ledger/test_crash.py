import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from fsar_ledger.errors import WriteFailed
from fsar_ledger.ledger import append, disk
from fsar_ledger.ledger.append import Writer, stage
from fsar_ledger.ledger.read import open_ledger
from fsar_ledger.ledger.verify import verify
from tests.ledger.samples import ORIGIN, append_all, contents, made_up_batches

COMMITS = 5
BATCHES = made_up_batches(COMMITS)


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    path = tmp_path_factory.mktemp("reference") / "ledger"
    append_all(path, BATCHES)
    return contents(path)


def finish_and_compare(path: Path, acknowledged: int, expected: dict[str, bytes]) -> None:
    """After any interruption: what was acknowledged is there, readers see a whole ledger, and going on gives the same bytes."""
    if (path / "ledger.json").exists():
        view = open_ledger(path)
        assert view.head.commits >= acknowledged
        assert list(view.runs()) == [run for batch in BATCHES[: view.head.commits] for run in batch]
        report = verify(path)
        assert report.ok, report.problems
    else:
        assert acknowledged == 0
    with Writer(path, ORIGIN) as writer:
        done = writer.head.commits
    append_all(path, BATCHES[max(0, done - 1) :])  # the last one once more: it may have been committed without being acknowledged
    assert contents(path) == expected


def test_killed_at_any_moment_a_writer_loses_nothing_acknowledged(tmp_path: Path, uninterrupted: dict[str, bytes]) -> None:
    moments = random.Random(7)
    seen = set()
    for trial in range(20):
        path = tmp_path / str(trial)
        with subprocess.Popen([sys.executable, "-m", "tests.ledger.crash_writer", str(path), str(COMMITS)], stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            time.sleep(moments.uniform(0, 0.12))
            os.kill(process.pid, signal.SIGKILL)
            said = process.stdout.read().split()
        seen.add(len(said))
        finish_and_compare(path, len(said), uninterrupted)
        shutil.rmtree(path)
    assert len(seen) > 1, "every kill came at the same moment; widen the range of delays"


class Stop(BaseException):
    """The process ends here."""


STEPS = ("sync_folder", "write_temporary", "link_new", "move", "remove")


@contextmanager
def stopping_at(count: int, monkeypatch: pytest.MonkeyPatch, error: BaseException) -> Iterator[Callable[[], bool]]:
    """The step on the disk with this number does not happen, nor any after it."""
    done = [0]

    def stops(step: Callable[..., object]) -> Callable[..., object]:
        def run(*arguments: object) -> object:
            done[0] += 1
            if done[0] > count:
                raise error
            return step(*arguments)

        return run

    with monkeypatch.context() as patch:
        for name in STEPS:
            patch.setattr(disk, name, stops(getattr(disk, name)))
        yield lambda: done[0] > count


def test_stopped_before_every_single_step_on_the_disk_a_writer_can_go_on(
    tmp_path: Path, uninterrupted: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    for count in range(200):
        path = tmp_path / str(count)
        acknowledged = 0
        with stopping_at(count, monkeypatch, Stop()) as was_stopped:
            try:
                with Writer(path, ORIGIN) as writer:
                    for batch in BATCHES[:2]:
                        acknowledged = writer.append(stage(path, batch)).commits
            except Stop:
                pass
        finish_and_compare(path, acknowledged, uninterrupted)
        if not was_stopped():
            assert count > 20
            return
    pytest.fail("the writer never came to its end")


def test_a_disk_that_refuses_any_single_step_gives_one_clear_error(tmp_path: Path, uninterrupted: dict[str, bytes], monkeypatch: pytest.MonkeyPatch) -> None:
    messages: list[str] = []
    for count in range(200):
        path = tmp_path / str(count)
        acknowledged = 0
        with stopping_at(count, monkeypatch, OSError(28, "No space left on device")) as was_stopped:
            try:
                with Writer(path, ORIGIN) as writer:
                    for batch in BATCHES[:2]:
                        acknowledged = writer.append(stage(path, batch)).commits
            except WriteFailed as error:
                messages.append(str(error))
        finish_and_compare(path, acknowledged, uninterrupted)
        if not was_stopped():
            assert len(messages) == count > 20
            assert all("No space left on device" in message for message in messages)
            return
    pytest.fail("the writer never came to its end")


@contextmanager
def files_of_at_most(size_bytes: int) -> Iterator[None]:
    """The kernel refuses to write a file beyond this size (EFBIG)."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_segment_that_the_disk_has_no_room_for_leaves_nothing_behind(tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    append_all(path, BATCHES[:1])
    before = contents(path)
    with Writer(path, ORIGIN):
        with files_of_at_most(4096), pytest.raises(WriteFailed, match="writing a segment failed: File too large"):
            stage(path, BATCHES[1])
        assert contents(path) == before


def test_a_record_that_the_disk_has_no_room_for_commits_nothing(tmp_path: Path, uninterrupted: dict[str, bytes]) -> None:
    path = tmp_path / "ledger"
    append_all(path, BATCHES[:1])
    before = contents(path)
    with Writer(path, ORIGIN) as writer:
        staged = stage(path, BATCHES[1])
        with files_of_at_most(100), pytest.raises(WriteFailed, match="writing a commit record failed: File too large"):
            writer.append(staged)
        with pytest.raises(WriteFailed, match="broken"):
            writer.append(staged)
    assert {name: data for name, data in contents(path).items() if not name.startswith("staging/")} == before
    finish_and_compare(path, 1, uninterrupted)


def test_a_ledger_that_the_disk_has_no_room_for_can_be_created_later(tmp_path: Path, uninterrupted: dict[str, bytes]) -> None:
    path = tmp_path / "ledger"
    with files_of_at_most(10), pytest.raises(WriteFailed, match="creating a ledger failed: File too large"):
        append.Writer(path, ORIGIN)
    assert contents(path) == {}
    finish_and_compare(path, 0, uninterrupted)
