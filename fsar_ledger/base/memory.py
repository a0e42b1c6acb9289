"""Limit the memory of this process, so that a command that needs more ends with a message; pause its collector.

Also prevents the import of a large library that another one would load without need.

The limit counts the memory of this process and its children, without shared libraries. Address space is not memory: the
libraries reserve ten times what they use. So the operating system's limit is only a safety net, set far higher, for
growth between two checks.
"""

import gc
import os
import resource
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.machinery import ModuleSpec
from pathlib import Path
from typing import Any, NoReturn

from fsar_ledger.base.errors import WriteFailed

CHECK_S = 0.02
"""Seconds between two checks: memory fills at some GiB per second."""

NET_BYTES = 4 << 30
"""Bytes beyond the limit and existing reservations that the operating system lets a process reserve."""

MOST_MIB = 1 << 24
"""The largest allowed limit, more than any machine has."""

_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
_PEAK_UNIT = 1024 if os.uname().sysname == "Linux" else 1  # of ru_maxrss

unfinished: set[Path] = set()
"""Files and folders to remove when the process is ended from outside, or for exceeding its limit."""

_limit: int | None = None


def limit() -> int | None:
    """Return the memory limit of this process in bytes, or None without a limit."""
    return _limit


@contextmanager
def folder_for_spilling() -> Iterator[str]:
    """Yield the name of an empty private folder for data that does not fit into memory; remove it at the end.

    The name is empty if no folder can be made.
    """
    from tempfile import TemporaryDirectory

    try:
        folder = TemporaryDirectory(prefix="fsar-ledger-", ignore_cleanup_errors=True)
    except OSError:
        yield ""
        return
    unfinished.add(Path(folder.name))
    try:
        with folder:
            yield folder.name
    finally:
        unfinished.discard(Path(folder.name))


@contextmanager
def temporary_files() -> Iterator[None]:
    """Turn an OSError inside, which writes temporary files alone, into WriteFailed."""
    try:
        yield
    except OSError as error:
        import tempfile

        place = "" if tempfile.tempdir is None else f"{tempfile.tempdir}: "  # None: no folder can be written
        raise WriteFailed(
            f"{place}temporary files cannot be written: {error.strerror}. Nothing was changed; free space or set "
            "TMPDIR."
        ) from error


def remove_unfinished() -> None:
    """Remove the files and folders of unfinished work, before the process ends in the middle of it."""
    from shutil import rmtree

    for path in tuple(unfinished):
        with suppress(OSError):
            path.unlink()
        rmtree(path, ignore_errors=True)


def exceeded_message() -> str:
    """Return the message for when the limit is exceeded."""
    return (
        f"memory: this needs more than {(_limit or 0) >> 20:,} MiB, the limit; "
        "if you trust this ledger, raise the limit with --memory MIB"
    )


@contextmanager
def limited(most: int, excess: Callable[[], None]) -> Iterator[None]:
    """Limit the additional memory of the process to `most` bytes.

    Beyond that, `excess` is called once, in a separate thread, and must end the process. If the operating system does
    not report a process's memory (macOS), its peak so far counts, without its children.
    """
    global _limit
    previous, _limit = _limit, most
    stopped = threading.Event()
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    # Start the thread first: without room for its stack it would never signal its start, and `start` would hang.
    threading.Thread(target=_watch, args=(bytes_held() + most, excess, stopped), name="memory", daemon=True).start()
    net = min([bytes_reserved() + most + NET_BYTES, *(cap for cap in (soft, hard) if cap != resource.RLIM_INFINITY)])
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_DATA, (net, hard))
    try:
        yield
    finally:
        stopped.set()
        _limit = previous
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def _watch(most: int, excess: Callable[[], None], stopped: threading.Event) -> None:
    while not stopped.wait(CHECK_S):
        if bytes_held() > most:
            excess()
            return


def bytes_held() -> int:
    """Return the memory of this process and its children in bytes."""
    own = _held_by("self")
    if own is None:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _PEAK_UNIT
    return own + sum(_held_by(child) or 0 for child in children() if _has_begun(child))


def bytes_reserved() -> int:
    """Return the bytes of this process that RLIMIT_DATA counts, 0 if the system does not report them."""
    with suppress(OSError), open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[5]) * _PAGE_BYTES
    return 0


def children() -> list[str]:
    """Return the ids of this process's children, if the system lists them."""
    ids: list[str] = []
    with suppress(OSError):
        for thread in os.listdir("/proc/self/task"):
            with suppress(OSError), open(f"/proc/self/task/{thread}/children", encoding="ascii") as file:
                ids += file.read().split()
    return ids


def _has_begun(child: str) -> bool:
    """Return whether a child already runs its own program; until then it shares the memory of this process."""
    return _command(child) != _command("self")


def _command(process: str) -> bytes | None:
    with suppress(OSError), open(f"/proc/{process}/cmdline", "rb") as file:
        return file.read()
    return None


def _held_by(process: str) -> int | None:
    try:
        with open(f"/proc/{process}/statm", encoding="ascii") as file:
            _, resident, shared, *_ = map(int, file.read().split())
    except (OSError, ValueError):
        return None
    return (resident - shared) * _PAGE_BYTES


def bytes_installed() -> int:
    """Return the memory of the machine in bytes."""
    return os.sysconf("SC_PHYS_PAGES") * _PAGE_BYTES


@contextmanager
def without_collection() -> Iterator[None]:
    """Disable the cyclic garbage collector for code that creates no cycles."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


class _NoPandas:
    """An import finder that makes importing pandas fail."""

    @classmethod
    def find_spec(cls, name: str, *_: object) -> ModuleSpec | None:
        loader: Any = cls
        return ModuleSpec(name, loader) if name == "pandas" else None

    @staticmethod
    def create_module(spec: ModuleSpec) -> NoReturn:
        raise ImportError("found pandas, expected none: no command uses it", name=spec.name)

    exec_module = create_module


def leave_out_pandas() -> None:
    """Prevent pyarrow from importing pandas, if installed, for its first list of values.

    The import takes as long as all others of a command together. Call this only in our own processes: no command and no
    worker uses pandas.
    """
    sys.meta_path.insert(0, _NoPandas)
