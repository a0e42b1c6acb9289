"""Files that grow, or change at a place: the chain, the journal and the pack of a ledger of format 2.

Every change is a plain call of `os`, as in `disk`.
"""

import errno
import os
from contextlib import suppress
from pathlib import Path

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.store import disk


def size_of(path: Path | str) -> int:
    """Return the bytes of this file; 0 if there is none. Raises: OSError."""
    try:
        return os.lstat(path).st_size
    except FileNotFoundError:
        return 0


def inode_of(path: Path | str) -> int:
    """Return the number of this file on its disk; 0 if there is none. Raises: OSError."""
    try:
        return os.lstat(path).st_ino
    except FileNotFoundError:
        return 0


def read_at(path: Path | str, place: int, most: int) -> bytes:
    """Read at most so many bytes at this place of a file; none if there is no file. Raises: OSError."""
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except FileNotFoundError:
        return b""
    try:
        return os.pread(handle, most, place)
    finally:
        disk.close(handle)


def read_whole(path: Path, most: int) -> bytes:
    """Read a file of a ledger; nothing if there is none. Raises: LedgerCorrupted if it cannot be read, or is longer."""
    try:
        return disk.read_large(path, most)
    except FileNotFoundError:
        return b""
    except OSError as error:
        raise LedgerCorrupted(
            f"{path}: it cannot be read ({error.strerror or error}); permit reading or restore it"
        ) from error


def append_durably(path: Path, data: bytes, end: int) -> None:
    """Append these bytes to a file that ends there, and sync them, once; make the file if it is new.

    When that fails, the file is cut off again where it ended, if the disk allows it. Raises: OSError.
    """
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    try:
        try:
            write_at(handle, data, end)
            os.fdatasync(handle)
            if not end:
                disk.sync_folder(path.parent)
        except BaseException:
            with suppress(OSError):
                os.ftruncate(handle, end)
            raise
    finally:
        os.close(handle)


def write_again(path: Path, start: int, end: int, *, cuts: bool = False) -> None:
    """Write these bytes of a file over themselves, cut off what follows if asked to, and sync the file, once.

    Its writer may have ended before it synced them, or after that had failed. Syncing alone would not do: the kernel
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


def write_at(handle: int, data: bytes | memoryview, place: int) -> None:
    """Write all these bytes at this place of an open file. Raises: OSError."""
    rest = memoryview(data).cast("B")
    while rest:
        written = os.pwrite(handle, rest, place)
        if written == 0:
            raise OSError(errno.EIO, "the disk took no more bytes")
        rest, place = rest[written:], place + written
