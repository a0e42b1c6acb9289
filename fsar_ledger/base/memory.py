"""Limits the memory of this process, so that a command that needs more ends with a message; pauses its collector.

It also leaves out a large library that another one would load for nothing.

It counts the memory that this process and its children hold, without shared libraries. Address space is not memory: the
libraries reserve ten times what they use. So the operating system's limit is only a safety net, set far above, for what
grows between two checks.
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

CHECK_S = 0.02
"""Seconds between two checks: memory fills at some GiB a second."""

NET_BYTES = 4 << 30
"""How far beyond the limit and what is reserved already the operating system lets a process reserve."""

MOST_MIB = 1 << 24
"""The largest limit that can be asked for, more than any machine has."""

_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
_PEAK_UNIT = 1024 if os.uname().sysname == "Linux" else 1  # of ru_maxrss

unfinished: set[Path] = set()
"""Files and folders to remove when the process is ended because of its memory."""

_limit: int | None = None


def limit() -> int | None:
    """Return the bytes that this process may take, or None without a limit."""
    return _limit


@contextmanager
def folder_for_spilling() -> Iterator[str]:
    """Yield the name of an empty folder of this user alone for what does not fit into memory; remove it at the end.

    The name is empty where no folder can be made.
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


def exceeded_message() -> str:
    """Return the message for when the limit is exceeded."""
    return (
        f"memory: this needs more than {(_limit or 0) >> 20:,} MiB, its limit; "
        "if the ledger is what you think it is, raise the limit with --memory MIB"
    )


@contextmanager
def limited(most: int, excess: Callable[[], None]) -> Iterator[None]:
    """Limit the memory that the process takes from here on to `most` bytes.

    Beyond that, `excess` is called once, in a thread of its own, and must end the process. Where the operating system
    does not say what a process holds (macOS), its peak so far counts, without its children.
    """
    global _limit
    before, _limit = _limit, most
    stopped = threading.Event()
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    # The watch first: a thread that finds no room for its stack never says that it began, and `start` waits for ever.
    threading.Thread(target=_watch, args=(bytes_held() + most, excess, stopped), name="memory", daemon=True).start()
    net = min([bytes_reserved() + most + NET_BYTES, *(one for one in (soft, hard) if one != resource.RLIM_INFINITY)])
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_DATA, (net, hard))
    try:
        yield
    finally:
        stopped.set()
        _limit = before
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def _watch(most: int, excess: Callable[[], None], stopped: threading.Event) -> None:
    while not stopped.wait(CHECK_S):
        if bytes_held() > most:
            excess()
            return


def bytes_held() -> int:
    """Return the bytes that this process and its children hold."""
    own = _held_by("self")
    if own is None:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _PEAK_UNIT
    return own + sum(_held_by(child) or 0 for child in children() if _has_begun(child))


def bytes_reserved() -> int:
    """Return the bytes that RLIMIT_DATA counts of this process, 0 where the system does not say."""
    with suppress(OSError), open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[5]) * _PAGE_BYTES
    return 0


def children() -> list[str]:
    """Return the ids of the processes that this one started, where the system lists them."""
    found: list[str] = []
    with suppress(OSError):
        for thread in os.listdir("/proc/self/task"):
            with suppress(OSError), open(f"/proc/self/task/{thread}/children", encoding="ascii") as file:
                found += file.read().split()
    return found


def _has_begun(child: str) -> bool:
    """Return whether a child runs its own program: until then it shares the memory of this process."""
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
    """Return the bytes of memory that the machine has."""
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
    """Finds pandas, and cannot load it."""

    @classmethod
    def find_spec(cls, name: str, *_: object) -> ModuleSpec | None:
        loader: Any = cls
        return ModuleSpec(name, loader) if name == "pandas" else None

    @staticmethod
    def create_module(spec: ModuleSpec) -> NoReturn:
        raise ImportError("found pandas, expected none: no command uses it", name=spec.name)

    exec_module = create_module


def leave_out_pandas() -> None:
    """Let pyarrow do without pandas, which it loads, where there is one, to look at its first list of values.

    That takes as long as all other imports of a command together. It is for processes that are ours alone: no command
    and no worker uses pandas.
    """
    sys.meta_path.insert(0, _NoPandas)
