"""Files that grow or change in place: the chain, the journal and the pack of a ledger.

Every change is a plain call of `os`, as in `disk`.
"""

import errno
import os
from collections.abc import Sequence
from pathlib import Path

from fsar_ledger.ledger.store import disk

_ZEROS_AT_ONCE = 1 << 16


def size_of(path: Path | str) -> int:
    """Return the size of this file in bytes; 0 if there is none. Raises: OSError."""
    try:
        return os.lstat(path).st_size
    except FileNotFoundError:
        return 0


def inode_of(path: Path | str) -> int:
    """Return the inode number of this file; 0 if there is none. Raises: OSError."""
    try:
        return os.lstat(path).st_ino
    except FileNotFoundError:
        return 0


def read_at(path: Path | str, place: int, most: int) -> bytes:
    """Read at most `most` bytes at offset `place` of a file; none if there is no file. Raises: OSError."""
    try:
        handle = disk.open_to_read(path)
    except FileNotFoundError:
        return b""
    try:
        return os.pread(handle, min(most, max(0, os.fstat(handle).st_size - place)), place)
    finally:
        disk.close(handle)


def read_whole(path: Path, most: int, start: int = 0, count: int | None = None) -> bytes:
    """Read a file of a ledger, from `start` on, or `count` bytes from there; b"" if there is none.

    Raises: LedgerCorrupted if it cannot be read, or is longer than `most`.
    """
    try:
        return disk.read_large(path, most, start, count)
    except FileNotFoundError:
        return b""
    except OSError as error:
        raise disk.unreadable(path, error) from error


class OpenFile:
    """A file polled for its size, opened once it exists."""

    def __init__(self, path: Path) -> None:
        self._path = str(path)
        self._handle = -1

    def size(self) -> int:
        """Return the size of the file in bytes; 0 if there is none yet. Raises: OSError."""
        if self._handle < 0:
            if not os.access(self._path, os.F_OK):
                return 0
            self._handle = os.open(self._path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        return os.lseek(self._handle, 0, os.SEEK_END)

    def close(self) -> None:
        """Close the file, if it is open."""
        if self._handle >= 0:
            disk.close(self._handle)
            self._handle = -1


def append_durably(path: Path, data: bytes, end: int) -> None:
    """Append these lines to a file that ends at `end`, and sync them; create the file if it is new.

    Until all is on disk, a NUL replaces the last line feed. So any line that readers see as whole is durable. That line
    feed is on disk after `sync`, or with the next append.

    If the disk refuses, the file is truncated back to `end`.

    Raises: OSError; Uncertain if it refuses that, too, or only to close the file.
    """
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    try:
        try:
            write_at(handle, data[:-1] + b"\0", end)
            os.fdatasync(handle)
            if not end:
                disk.sync_folder(path.parent)
            write_at(handle, memoryview(data)[-1:], end + len(data) - 1)
        except BaseException as error:
            take_back(handle, end, end + len(data) - 1, error)
            raise
    except BaseException:
        disk.close(handle)  # what it refuses says nothing of the commit
        raise
    try:
        os.close(handle)
    except OSError as error:  # the data are visible, and the file cannot be truncated any more
        raise disk.Uncertain(error.errno, error.strerror) from error


def take_back(handle: int, end: int, shown: int, error: BaseException) -> None:
    """Truncate an open file to `end` because of this error, unless the byte at `shown` already makes the data visible.

    It is not synced: if a sync failed before, the file is given up, and the next writer truncates it durably.

    Raises: Uncertain if the error is an OSError, and the file is not truncated.
    """
    try:
        if os.pread(handle, 1, shown) not in (b"", b"\0"):
            raise OSError(errno.EIO, "it is visible already")
        os.ftruncate(handle, end)
    except OSError as truncate_error:
        if isinstance(error, OSError):
            raise disk.Uncertain(error.errno, error.strerror or str(error)) from truncate_error


def show(path: Path, places: Sequence[int], byte: bytes) -> None:
    """Write this byte at these offsets of a file, durably, which makes the data there visible. Raises: OSError."""
    handle = os.open(path, os.O_RDWR | os.O_NOFOLLOW)
    try:
        for offset in places:
            write_at(handle, byte, offset)
        os.fdatasync(handle)
    finally:
        os.close(handle)


def sync(path: Path) -> None:
    """Sync a file to the disk, whichever process wrote it; do nothing if there is none. Raises: OSError."""
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except FileNotFoundError:
        return
    try:
        os.fsync(handle)
    finally:
        disk.close(handle)


# See docs/decisions/writers-rewrite-the-last-append.md.
def write_again(path: Path, start: int, end: int, *, cuts: bool) -> None:
    """Rewrite these bytes of a file in place, truncate the file after them if `cuts`, and sync it, once.

    Its writer may have ended before it synced them, or after a sync failed. Syncing alone is not enough: the kernel
    may have dropped what it could not write, and would report success the second time.

    Raises: OSError.
    """
    if start >= end and not cuts:
        return
    handle = os.open(path, os.O_RDWR | os.O_NOFOLLOW)
    try:
        data = b""
        while len(data) < end - start and (part := os.pread(handle, end - start - len(data), start + len(data))):
            data += part
        if cuts:
            os.ftruncate(handle, end)
        write_at(handle, data, start)
        os.fdatasync(handle)
    finally:
        os.close(handle)


def write_zeros(handle: int, place: int, end: int) -> None:
    """Fill an open file with NUL bytes from `place` to `end`. Raises: OSError.

    In pieces: a file system keeps what is written at once together in memory, and scans all of it whenever a few bytes
    of it are written later.
    """
    while place < end:
        size = min(end - place, _ZEROS_AT_ONCE)
        write_at(handle, bytes(size), place)
        place += size


def write_at(handle: int, data: bytes | memoryview, place: int) -> None:
    """Write all these bytes at offset `place` of an open file. Raises: OSError."""
    while data:
        written = os.pwrite(handle, data, place)
        if written == 0:
            raise OSError(errno.EIO, "the disk took no more bytes")
        data, place = data[written:], place + written
