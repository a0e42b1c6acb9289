"""The harness itself: it sees every change of the disk, and loses what a power failure may lose."""

import os
import random
import sys
from collections import Counter
from pathlib import Path

import pytest

from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.append import Writer
from tests.ledger.crash_trials import write_with
from tests.ledger.faults import Fault, FaultyOs, in_place_of_os, is_free, one_fault_a_call
from tests.ledger.power import Choice
from tests.ledger.samples import ORIGIN, contents

ALL_LOST, ALL_KEPT = Choice("lost", "lost", random.Random(1)), Choice("kept", "kept", random.Random(1))
CHANGES = {"os.rename": "rename", "os.link": "link", "os.remove": "unlink", "os.mkdir": "mkdir", "os.rmdir": "rmdir"}
NEVER = (
    *("os.symlink", "os.truncate", "os.chmod", "os.chown", "os.utime"),
    *("os.setxattr", "shutil.move", "shutil.copyfile", "shutil.rmtree"),
)

_watched: list[Path] = []
_changes: list[str] = []


def _note(event: str, arguments: tuple[object, ...]) -> None:
    """Record every change that Python reports below the watched folder, by any module."""
    if not _watched or not arguments or not str(arguments[0]).startswith(str(_watched[0])):
        return
    assert event not in NEVER, f"{event} changes the disk unseen by the harness"
    if event in CHANGES:
        _changes.append(CHANGES[event])
    elif (
        event == "open"
        and isinstance(arguments[2], int)
        and arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC)
    ):
        _changes.append("open to write")


def test_the_harness_sees_every_change_of_the_disk(tmp_path: Path) -> None:
    opened_to_write = 0

    class Counting(FaultyOs):
        def _do(self, name, arguments, options):  # type: ignore[no-untyped-def]
            nonlocal opened_to_write
            opened_to_write += name == "open" and bool(arguments[1] & (os.O_WRONLY | os.O_RDWR))
            return super()._do(name, arguments, options)

    sys.addaudithook(_note)  # cannot be removed; it ignores everything while nothing is watched
    faulty = Counting(tmp_path)
    _watched.append(tmp_path)
    try:
        write_with(faulty, tmp_path / "out" / "ledger")
    finally:
        _watched.clear()
    seen = Counter(name.replace("replace", "rename") for name in faulty.calls if name in ("replace", *CHANGES.values()))
    assert Counter(_changes) == seen + Counter({"open to write": opened_to_write})
    assert opened_to_write >= 5
    assert {"open", "read", "write", "fsync", "link", "rename", "replace", "unlink", "mkdir", "close"} <= set(
        faulty.calls
    )


def test_a_call_that_the_harness_does_not_know_is_refused(tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match=r"os\.truncate is not known"):
        FaultyOs(tmp_path).truncate(tmp_path / "x", 0)


@pytest.mark.slow
def test_where_the_power_takes_nothing_the_model_holds_what_the_disk_holds(tmp_path: Path) -> None:
    root = tmp_path / "whole"
    root.mkdir()
    faulty = FaultyOs(root)
    write_with(faulty, root / "out" / "ledger")
    for number, fault in enumerate([Fault(10**9, "killed"), *list(one_fault_a_call(faulty.calls))[::40]]):
        root = tmp_path / str(number)
        root.mkdir()
        again = FaultyOs(root, fault)
        write_with(again, root / "out" / "ledger")
        again.disk.after_power_failure(ALL_KEPT, tmp_path / f"{number}-restarted")
        assert contents(tmp_path / f"{number}-restarted") == contents(root)


def test_the_power_takes_what_was_not_synced(tmp_path: Path) -> None:
    root = tmp_path / "root"
    root.mkdir()
    (root / "old").write_bytes(b"old")
    with in_place_of_os(FaultyOs(root)) as faulty:
        disk.write_temporary(root / "synced content, lost name", b"1")
        disk.write_durably(root / "durable", b"2")
        handle = faulty.open(root / "durable name, lost content", os.O_WRONLY | os.O_CREAT)
        faulty.write(handle, b"3")
        disk.sync_folder(root)
        faulty.rename(root / "old", root / "new")
    faulty.disk.after_power_failure(ALL_LOST, tmp_path / "restarted")
    assert contents(tmp_path / "restarted") == {
        "durable": b"2",
        "durable name, lost content": b"",
        "old": b"old",
        "synced content, lost name": b"1",  # the later sync of the folder saved it
    }
    assert contents(root)["new"] == b"old"


def test_what_was_written_before_a_failed_sync_is_lost_and_never_synced_again(tmp_path: Path) -> None:
    faulty = FaultyOs(tmp_path, Fault(2, "io-error"))
    handle = faulty.open(tmp_path / "file", os.O_WRONLY | os.O_CREAT)
    faulty.write(handle, b"data")
    with pytest.raises(OSError, match="Input/output error"):
        faulty.fsync(handle)
    with pytest.raises(AssertionError, match="given up"):
        faulty.fsync(handle)
    faulty.close(handle)


def test_a_dead_process_does_nothing_more_and_leaves_no_lock(tmp_path: Path) -> None:
    path = tmp_path / "out" / "ledger"
    Writer(path, ORIGIN).close()
    before = len(os.listdir("/proc/self/fd"))
    for at in range(20):
        killed = FaultyOs(tmp_path, Fault(at, "killed"))
        assert write_with(killed, path, 1).was_killed
        assert len(killed.calls) == at + 1
        assert len(os.listdir("/proc/self/fd")) == before
        assert [name for name in contents(path) if not name.startswith("staging/")] == ["ledger.json"]
        assert is_free(path)


def test_a_writer_that_the_disk_refuses_leaves_nothing_open(tmp_path: Path) -> None:
    path = tmp_path / "out" / "ledger"
    Writer(path, ORIGIN).close()
    for fault in (Fault(at, kind) for at in range(50) for kind in ("io-error", "disk-gone")):
        faulty = FaultyOs(tmp_path, fault)
        write_with(faulty, path, 1)
        assert faulty.left_open == 0, fault


def test_each_file_is_synced_with_its_folder_and_one_that_cannot_be_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    staging = tmp_path / "staging"
    staging.mkdir()
    files = {tmp_path / "tile" / f"{number % 7}" / f"{number:03d}": b"%d" % number for number in range(300)}
    synced: list[int] = []
    monkeypatch.setattr(os, "fsync", synced.append)

    def write_all() -> None:
        for path, data in files.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            disk.replace_durably(path, data, staging)

    write_all()
    assert {path: path.read_bytes() for path in files} == files
    assert len(synced) >= len(files) + 7
    assert list(staging.iterdir()) == []

    def refuses(_: int) -> None:
        synced.append(0)
        if len(synced) % 50 == 0:
            raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fsync", refuses)
    with pytest.raises(OSError, match="Input/output error"):
        write_all()
    assert list(staging.iterdir()) == []
