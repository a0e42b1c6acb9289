"""Locks by which writers of a ledger take turns, and readers see whether one of them is at work.

They end with their process, and have no effect where the file system has no locks.
"""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from fsar_ledger.ledger.store.disk import close, refusals


@contextmanager
def locked(folder: Path, is_shared: bool = False) -> Iterator[None]:
    """Hold a lock on this folder that excludes all others or, with `is_shared`, all but shared ones.

    Has no effect where the file system has no locks. It ends with its process.

    Raises: WriteFailed if the folder cannot be opened.
    """
    with refusals(folder, "locking"):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_SH if is_shared else fcntl.LOCK_EX)
        yield
    finally:
        close(handle)


@contextmanager
def lock_if_free(folder: Path) -> Iterator[bool]:
    """Hold a shared lock on this folder, as `locked`, if nobody has it alone; yield whether that is so.

    Yields True also where the file system has no locks, or the folder cannot be opened.
    """
    try:
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError:
        yield True
        return
    try:
        is_free = True
        try:
            fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            is_free = False
        except OSError:
            pass
        yield is_free
    finally:
        close(handle)


class FolderLock:
    """An exclusive lock on this folder, taken again and again; the folder is opened once.

    Use it as a context manager. Raises: WriteFailed if the folder cannot be opened.
    """

    def __init__(self, folder: Path) -> None:
        with refusals(folder, "locking"):
            self._handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)

    def __enter__(self) -> None:
        try:  # `suppress` would take as long as the call
            fcntl.flock(self._handle, fcntl.LOCK_EX)
        except OSError:
            return

    def __exit__(self, *error: object) -> None:
        try:
            fcntl.flock(self._handle, fcntl.LOCK_UN)
        except OSError:
            return

    def close(self) -> None:
        """Close the folder, if it is open."""
        if self._handle >= 0:
            close(self._handle)
            self._handle = -1
