"""A disk that fails: a replacement of `os` for the ledger's writing modules, with a fault at one numbered call.

Every call that opens, reads, closes or changes something on the disk is counted; what the harness does not know is
refused, so that no change escapes it. A call fails before it has an effect, after it, or in the middle (a write), or
the process ends there. A model of the disk is told of each change, and knows what a power failure could undo.
"""

import errno
import fcntl
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.ledger.power import Disk, Node

WRITES, SYNCS = ("write", "pwrite"), ("fsync", "fdatasync")
COUNTED = (
    *("open", "read", "pread", *WRITES, *SYNCS, "ftruncate"),
    *("link", "rename", "replace", "unlink", "mkdir", "rmdir", "close"),
)
HARMLESS = frozenset(
    [
        *("path", "listdir", "scandir", "stat", "lstat", "fstat", "lseek", "access"),
        *("F_OK", "fspath", "strerror", "getpid", "DirEntry", "PathLike", "SEEK_SET"),
        *("SEEK_END", "error"),
    ]
)
NEED_ROOM = (*WRITES, "link", "rename", "replace", "mkdir", *SYNCS)
"""What a full disk refuses, apart from creating a file."""

ONLY_READS = (
    "fsar_ledger.ledger.store.segments",
    *(f"fsar_ledger.ledger.verify.{name}" for name in ("verify", "notes", "segment", "chain")),
)

REFUSED = {"no-space": errno.ENOSPC, "io-error": errno.EIO, "quota": errno.EDQUOT}
KINDS = (
    *REFUSED,
    "disk-full",
    "disk-gone",
    "io-error-after",
    "short-write",
    "short-write-no-space",
    "killed",
    "killed-in-write",
)
"""
no-space, io-error, quota     this one call is refused
disk-full                     from here on every call that needs room is refused with ENOSPC
disk-gone                     from here on every call is refused with EIO
io-error-after                the call has its effect, and EIO is reported
short-write                   the disk takes half, which is no error
short-write-no-space          the disk takes half, then has no room left
killed, killed-in-write       the process ends before the call, or with half of it written
"""
OF_WRITES = frozenset(("short-write", "short-write-no-space", "killed-in-write"))


class Killed(BaseException):
    """The process ends here: nothing that it would do afterwards happens."""


@dataclass(frozen=True)
class Fault:
    """What happens at the call with this number, counted from 0."""

    at: int
    kind: str

    @property
    def ends_the_process(self) -> bool:
        return self.kind.startswith("killed")


class FaultyOs:
    """A stand-in for the module `os`.

    `calls` are the names of the counted calls so far, `disk` is the model of what is durable, `was_hit` tells whether
    the fault happened, `left_open` how many handles the process had open at its end.
    """

    def __init__(self, root: Path, fault: Fault | None = None, disk: Disk | None = None, really_kills: bool = False):
        self.calls: list[str] = []
        self.disk = disk or Disk(root)
        self.was_hit = False
        self.left_open = 0
        self._fault = fault
        self._really_kills = really_kills
        self._is_dead = False
        self._handles: dict[int, Node | None] = {}

    def __getattr__(self, name: str) -> Any:
        if name in COUNTED:
            return lambda *arguments, **options: self._call(name, arguments, options)
        if name in HARMLESS or name.startswith(("O_", "S_", "sched_", "cpu_")):
            return getattr(os, name)
        raise AssertionError(f"os.{name} is not known to the harness; add it to tests/ledger/faults.py")

    def _call(self, name: str, arguments: tuple[Any, ...], options: dict[str, Any]) -> Any:
        if self._is_dead:
            if name == "close":  # the kernel closes what a dead process had open
                return self._do(name, arguments, options)
            raise Killed
        number, fault = len(self.calls), self._fault
        self.calls.append(name)
        if fault is None or number < fault.at:
            return self._do(name, arguments, options)
        if number == fault.at:
            return self._fail(fault, name, arguments, options)
        needs_room = name in NEED_ROOM or (name == "open" and arguments[1] & os.O_CREAT)
        if fault.kind == "disk-gone" or (fault.kind in ("disk-full", "short-write-no-space") and needs_room):
            self._refuse(errno.EIO if fault.kind == "disk-gone" else errno.ENOSPC, name, arguments, options)
        return self._do(name, arguments, options)

    def _fail(self, fault: Fault, name: str, arguments: tuple[Any, ...], options: dict[str, Any]) -> Any:
        if fault.kind in OF_WRITES and name not in WRITES:
            return self._do(name, arguments, options)
        self.was_hit = True
        if fault.kind in OF_WRITES:
            handle, data, *place = arguments
            written = self._do(name, (handle, bytes(data)[: (len(data) + 1) // 2], *place), {})
            if not fault.ends_the_process:
                return written
        if fault.ends_the_process:
            if self._really_kills:
                os.kill(os.getpid(), signal.SIGKILL)
            self._is_dead = True
            raise Killed
        if fault.kind == "io-error-after":
            self._do(name, arguments, options)
        code = REFUSED.get(fault.kind) or (errno.ENOSPC if fault.kind == "disk-full" else errno.EIO)
        return self._refuse(code, name, arguments, options)

    def _refuse(self, code: int, name: str, arguments: tuple[Any, ...], options: dict[str, Any]) -> None:
        if name in SYNCS:
            self.disk.sync_failed(self._handles.get(arguments[0]))
        if name == "close" and arguments[0] in self._handles:  # a handle is gone even when closing it reports an error
            self._do(name, arguments, options)
        raise OSError(code, os.strerror(code))

    def _do(self, name: str, arguments: tuple[Any, ...], options: dict[str, Any]) -> Any:
        """Make the call and tell the model.

        Nothing is really synced; the model keeps track of that.
        """
        result = None if name in SYNCS else getattr(os, name)(*arguments, **options)
        match name:
            case "open":
                assert result is not None
                self._handles[result] = self.disk.opened(
                    Path(arguments[0]), bool(arguments[1] & os.O_CREAT), bool(arguments[1] & os.O_TRUNC)
                )
            case "write":
                self.disk.written(self._handles.get(arguments[0]), bytes(arguments[1])[:result])
            case "pwrite":
                self.disk.written(self._handles.get(arguments[0]), bytes(arguments[1])[:result], arguments[2])
            case "ftruncate":
                self.disk.cut(self._handles.get(arguments[0]), arguments[1])
            case "fsync" | "fdatasync":
                self.disk.synced(self._handles.get(arguments[0]))
            case "close":
                self._handles.pop(arguments[0], None)
            case "mkdir":
                self.disk.made(Path(arguments[0]))
            case "link":
                self.disk.linked(Path(arguments[0]), Path(arguments[1]))
            case "rename" | "replace":
                self.disk.renamed(Path(arguments[0]), Path(arguments[1]))
            case "unlink" | "rmdir":
                self.disk.unlinked(Path(arguments[0]))
        return result

    def end(self) -> None:
        """End the process: close what it had open, which releases its locks."""
        self._is_dead = True
        self.left_open = len(self._handles)
        for handle in list(self._handles):
            self._do("close", (handle,), {})


@contextmanager
def in_place_of_os(faulty: FaultyOs) -> Iterator[FaultyOs]:
    """Give every module of the ledger that writes and uses `os` the faulty one, inside the block."""
    with pytest.MonkeyPatch.context() as patch:
        for name, module in list(sys.modules.items()):
            if (
                name.startswith("fsar_ledger.ledger.")
                and not name.startswith(ONLY_READS)
                and getattr(module, "os", None) is os
            ):
                patch.setattr(module, "os", faulty)
        try:
            yield faulty
        finally:
            faulty.end()


def faults_at(calls: list[str]) -> Iterator[Fault]:
    """Yield every kind of fault at every one of these calls."""
    for at, name in enumerate(calls):
        for kind in KINDS:
            if name in WRITES or kind not in OF_WRITES:
                yield Fault(at, kind)


def one_fault_a_call(calls: list[str]) -> Iterator[Fault]:
    """Yield, for each call, a kill or another kind of fault in turn."""
    for at, name in enumerate(calls):
        kinds = [kind for kind in KINDS if name in WRITES or kind not in OF_WRITES]
        yield Fault(at, kinds[at // 2 % len(kinds)] if at % 2 else "killed")


def calls_of(root: Path, work: Callable[[], object]) -> list[str]:
    """Return the counted calls of this work when nothing fails."""
    with in_place_of_os(FaultyOs(root)) as faulty:
        work()
    return faulty.calls


def is_free(path: Path) -> bool:
    """Return whether nobody holds a lock on this folder."""
    handle = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    finally:
        os.close(handle)
    return True
