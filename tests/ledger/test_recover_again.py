"""A recovery that is stopped, or that a disk refuses, loses nothing and goes on when called again."""

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from fsar_ledger.base.errors import WriteFailed
from fsar_ledger.ledger.log.hashing import sha256_hex
from fsar_ledger.ledger.verify import recover, verify
from tests.ledger.faults import Fault, FaultyOs, Killed, calls_of, in_place_of_os
from tests.ledger.power import Disk, choices
from tests.ledger.samples import append_all, contents, made_up_batches
from tests.ledger.test_recover import Files, assert_nothing_lost, write
from tests.quick import few

# --- an interrupted recovery, a disk that refuses, another process ---


class Stop(BaseException):
    """The process ends here."""


CALLS = ("rename", "replace", "fsync", "mkdir", "unlink")


@contextmanager
def stopping_at(count: int, monkeypatch: pytest.MonkeyPatch, error: BaseException) -> Iterator[list[int]]:
    """Stop before the disk call with this number; yield how many calls there were."""
    done = [0]

    def stops(call: Callable[..., object]) -> Callable[..., object]:
        def run(*arguments: object, **options: object) -> object:
            done[0] += 1
            if done[0] > count:
                raise error
            return call(*arguments, **options)

        return run

    with monkeypatch.context() as patch:
        for name in CALLS:
            patch.setattr(os, name, stops(getattr(os, name)))
        yield done


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> Files:
    """Return the files of a ledger with one commit."""
    path = tmp_path_factory.mktemp("one") / "ledger"
    append_all(path, made_up_batches(1, runs=1, size=300))
    return contents(path)


def much_to_do(one: Files) -> Files:
    """Return what a crash leaves, with damage of all kinds that can be mended."""
    files = one | {"stray": b"?", "segments/stray": b"??", "nodes": b"?" * 32, "tile/0/000": b""}
    [name] = [name for name in one if name.startswith("segments/")]
    segment = files.pop(name)
    del files["ledger.json"]
    return files | {f"staging/{sha256_hex(segment)}.parquet": segment}


@pytest.mark.slow
@pytest.mark.parametrize(("error", "step"), [(Stop(), 3), (OSError(errno.ENOSPC, "No space left on device"), 7)])
def test_stopped_at_any_call_recovery_goes_on_when_called_again(
    tmp_path: Path, one: Files, monkeypatch: pytest.MonkeyPatch, error: BaseException, step: int
) -> None:
    before = much_to_do(one)
    for count in range(0, 300, step):
        path = write(tmp_path / str(count) / "ledger", before)
        with stopping_at(count, monkeypatch, error) as done, suppress(Stop, WriteFailed):
            recover(path)
        assert_nothing_lost(before, path)
        recover(path)
        assert_nothing_lost(before, path)
        assert contents(path) == one
        if done[0] <= count:
            assert count > 15
            assert verify(path).ok
            return
    pytest.fail("recovery never came to its end")


@pytest.mark.parametrize("step", few([5, 11], [], [11]))
def test_a_power_failure_in_recovery_loses_nothing_either(tmp_path: Path, one: Files, step: int) -> None:
    before = much_to_do(one)
    counting = write(tmp_path / "counting" / "ledger", before)
    changes = [
        at
        for at, name in enumerate(calls_of(counting.parent, lambda: recover(counting)))
        if name not in ("open", "read", "close")
    ]
    assert len(changes) > 20
    for at in changes[::step]:
        path = write(tmp_path / str(at) / "ledger", before)
        disk = Disk(path.parent)
        with suppress(Killed), in_place_of_os(FaultyOs(path.parent, Fault(at, "killed"), disk)):
            recover(path)
        for number, choice in enumerate(choices(at, 1)):
            after = tmp_path / f"{at}-{number}" / "ledger"
            disk.after_power_failure(choice, after.parent)
            assert_nothing_lost(before, after)
            recover(after)
            assert_nothing_lost(before, after)
            assert contents(after) == one


def test_a_disk_that_refuses_is_named_with_what_to_do(
    tmp_path: Path, one: Files, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path / "ledger", much_to_do(one))
    with (
        stopping_at(5, monkeypatch, OSError(errno.EROFS, "Read-only file system")),
        pytest.raises(WriteFailed, match="mending failed: Read-only file system"),
    ):
        recover(path)
    whole = write(tmp_path / "whole", one)
    with stopping_at(0, monkeypatch, OSError(errno.EROFS, "Read-only file system")):
        assert recover(whole).outcome == "whole"
