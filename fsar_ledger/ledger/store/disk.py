"""Files that exist whole or not at all, and survive a power failure.

Every change is a plain call of `os`, so that tests can make each one fail, or stop the process there. Python itself
repeats a call that a signal interrupts. A file whose `fsync` failed is given up, never synced again: the kernel may
have dropped what it could not write, and would report success the second time.

Assumed of the file system: `link` and `rename` are atomic, also across two folders.

Locks, by which writers of a ledger take turns and readers detect an active writer, end with their process, and have no
effect where the file system has none.
"""

import errno
import fcntl
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path

from fsar_ledger.base.errors import LedgerCorrupted, WriteFailed

TEMPORARY = ".tmp"
READ = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
MAX_DOCUMENT_BYTES = 1 << 20
"""The most bytes read of a JSON file; those of a ledger are far smaller."""

MAX_NAMES = 1 << 20
"""The most names read of a folder; far more than any ledger's commits."""


def reason(error: OSError) -> str:
    """Return why the system refused, in words: of a link it says "too many levels of symbolic links"."""
    return "it is a link" if error.errno == errno.ELOOP else error.strerror or str(error)


def open_to_read(path: Path | str) -> int:
    """Open a file for reading, without waiting for a pipe's writer. Raises: OSError; also for a link."""
    try:
        return os.open(path, READ)
    except OSError as error:
        raise OSError(error.errno, reason(error), str(path)) from error


def read_document(path: Path | str) -> bytes:
    """Read a small regular file.

    Raises: OSError if it is missing, not a regular file (a link is not), too large or unreadable.
    """
    handle = open_to_read(path)
    try:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise OSError(0, "it is not a regular file")
        return _read_rest(handle)
    finally:
        close(handle)


def read_large(path: Path | str, most: int, start: int = 0, count: int | None = None) -> bytes:
    """Read a regular file of at most `most` bytes, from `start` on, or `count` bytes from there.

    Raises: OSError if it is missing, not a regular file (a link is not), larger or unreadable.
    """
    handle = open_to_read(path)
    try:
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode):
            raise OSError(0, "it is not a regular file")
        if status.st_size > most:
            raise OSError(0, f"it is larger than {most} bytes")
        parts: list[bytes] = []
        os.lseek(handle, start, os.SEEK_SET)
        rest = max(0, status.st_size - start)
        rest = rest if count is None else min(rest, count)
        while rest and (part := os.read(handle, rest)):
            parts.append(part)
            rest -= len(part)
        return b"".join(parts)
    finally:
        close(handle)


def read_given(path: Path | str) -> bytes:
    """Read a small file named by the user: a regular one, a link to one, or a pipe.

    Raises: OSError if it is missing, of another kind, too large or unreadable.
    """
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    try:
        mode = os.fstat(handle).st_mode
        if not stat.S_ISREG(mode) and not stat.S_ISFIFO(mode):
            raise OSError(0, "it is neither a regular file nor a pipe")
        os.set_blocking(handle, True)  # wait for the pipe's writer
        return _read_rest(handle)
    finally:
        close(handle)


def _read_rest(handle: int) -> bytes:
    """Read the rest of the file. Raises: OSError if it is too large or unreadable."""
    data = b""
    while part := os.read(handle, MAX_DOCUMENT_BYTES + 1 - len(data)):
        data += part
    if len(data) > MAX_DOCUMENT_BYTES:
        raise OSError(0, f"it is larger than {MAX_DOCUMENT_BYTES} bytes")
    return data


def entries(folder: Path) -> list["os.DirEntry[str]"]:
    """List the folder, sorted by name. Raises: OSError if it cannot be read or holds more than `MAX_NAMES`."""
    with os.scandir(folder) as scanned:
        names = list(islice(scanned, MAX_NAMES + 1))
    if len(names) > MAX_NAMES:
        raise OSError(0, f"it holds more than {MAX_NAMES} names", str(folder))
    return sorted(names, key=lambda entry: entry.name)


def unreadable(path: Path, error: OSError) -> LedgerCorrupted:
    """Return the error for a file or folder of a ledger that cannot be read."""
    return LedgerCorrupted(f"{path}: it cannot be read ({error.strerror or error}); permit reading or restore it")


class Uncertain(OSError):
    """The disk refused a commit and then its removal, so the commit may exist later."""


def refusal(path: Path, doing: str, error: OSError, outcome: str = "this commit was not made") -> WriteFailed:
    """Return the error for an operation that the disk refused, with its outcome."""
    why = error.strerror or str(error)
    if isinstance(error, Uncertain):
        return WriteFailed(
            f"{path}: {doing} failed: {why}; it is unknown whether the commit is there: make room or permit "
            "writing there, open the ledger again, and append what it lacks"
        )
    return WriteFailed(f"{path}: {doing} failed: {why}; {outcome}; make room or permit writing there, and run it again")


@contextmanager
def refusals(path: Path, doing: str, outcome: str = "this commit was not made") -> Iterator[None]:
    """Turn an OSError inside into WriteFailed, which says the outcome."""
    try:
        yield
    except OSError as error:
        raise refusal(path, doing, error, outcome) from error


def sync_folder(folder: Path) -> None:
    """Sync the names in this folder to the disk."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        close(handle)


def close(handle: int) -> None:
    """Close a handle through which nothing was written, ignoring errors of the disk."""
    with suppress(OSError):
        os.close(handle)


def make_folder(folder: Path) -> None:
    """Make the folder and those above it, durably.

    The lowest one that exists is synced too: a process may have been killed right after making it.

    Raises: OSError if one of them cannot be made.
    """
    folder = folder.absolute()
    missing: list[Path] = []
    while not folder.is_dir():
        missing.append(folder)
        folder = folder.parent
    with suppress(PermissionError):  # the process that made this folder could open the one above
        sync_folder(folder.parent)
    for parent in reversed(missing):
        try:
            os.mkdir(parent)
        except FileExistsError:  # another process made it first
            if not parent.is_dir():
                raise
        sync_folder(parent.parent)


def write_durably(path: Path, data: bytes | memoryview) -> None:
    """Write the file atomically and durably, replacing its content."""
    temporary = temporary_name(path)
    try:
        write_temporary(temporary, data)
        move(temporary, path)
    except BaseException:
        remove(temporary)
        raise


def temporary_name(path: Path) -> Path:
    """Return an unused name beside this one. It has no process number: containers on one volume may share these."""
    return path.with_name(f"{path.name}.{secrets.token_hex(8)}{TEMPORARY}")


def write_temporary(path: Path, data: bytes | memoryview) -> None:
    """Write a new file and sync its bytes, but not its name. Nothing is left when that fails."""
    _write_new(path, data, 0o666)


def _write_new(path: Path, data: bytes | memoryview, mode: int) -> None:
    handle = os.open(path, _NEW, mode)
    try:
        try:
            _write_all(handle, data)
            os.fsync(handle)
        finally:
            os.close(handle)
    except BaseException:
        remove(path)
        raise


def _write_all(handle: int, data: bytes | memoryview) -> None:
    rest = memoryview(data).cast("B")
    while rest:
        written = os.write(handle, rest)  # the disk may accept only a part
        if written == 0:
            raise OSError(errno.EIO, "the disk took no more bytes")
        rest = rest[written:]


def append_whole(handle: int, data: bytes) -> None:
    """Append the data to a file without other writers, whole or not at all; it is on disk when this returns.

    Raises: OSError.
    """
    size = os.fstat(handle).st_size
    try:
        _write_all(handle, data)
        os.fsync(handle)
    except OSError:
        os.ftruncate(handle, size)
        raise


# See docs/decisions/proofs-and-keys-are-never-replaced.md.
def link_new(temporary: Path, path: Path) -> None:
    """Link the temporary file to its name, and remove the temporary name in any case.

    Raises: FileExistsError if another file has the name.
    """
    try:
        os.link(temporary, path)
    except OSError as error:
        if _is_same(temporary, path):  # a network file system may link and yet report a failure
            return
        if isinstance(error, FileNotFoundError) and os.path.lexists(path):  # another process has cleaned up already
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path)) from error
        raise
    finally:
        remove(temporary)


def _is_same(first: Path, second: Path) -> bool:
    """Return whether both names exist and refer to the same file."""
    try:
        return os.path.samestat(first.lstat(), second.lstat())
    except OSError:
        return False


def move(source: Path, path: Path) -> None:
    """Rename the file, durably, unless another process has moved it already."""
    try:
        os.rename(source, path)
    except FileNotFoundError:
        if not path.exists():
            raise
    sync_folder(path.parent)
    if source.parent != path.parent:
        sync_folder(source.parent)


def remove(path: Path) -> None:
    """Remove the file, if the disk allows it."""
    with suppress(OSError):
        os.unlink(path)


def replace_durably(path: Path, data: bytes, staging: Path) -> None:
    """Write the file atomically and durably, replacing its content. Until then its bytes are in folder `staging`."""
    temporary = temporary_name(staging / "file")
    write_temporary(temporary, data)
    try:
        os.replace(temporary, path)
    except BaseException:
        remove(temporary)
        raise
    sync_folder(path.parent)


def write_secret(path: Path, data: bytes) -> None:
    """Durably write a new file that only its owner may read. Raises: FileExistsError if the name is taken."""
    _write_new(path, data, 0o600)
    sync_folder(path.parent)


def _opened(folder: Path) -> int:
    """Open this folder of a ledger. Raises: LedgerCorrupted if it cannot be opened."""
    try:
        return os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise unreadable(folder, error) from error


@contextmanager
def shared_lock(folder: Path) -> Iterator[None]:
    """Hold a lock on this folder that excludes all but shared locks.

    Has no effect where the file system has no locks. It ends with its process.

    Raises: LedgerCorrupted if the folder cannot be opened.
    """
    handle = _opened(folder)
    try:
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_SH)
        yield
    finally:
        close(handle)


@contextmanager
def lock_if_free(folder: Path) -> Iterator[bool]:
    """Hold a shared lock on this folder unless it is locked exclusively; yield whether it was free.

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
    """A reusable exclusive lock on this folder of a ledger, which is opened once in each process.

    Use it as a context manager. Raises: LedgerCorrupted if the folder cannot be opened; WriteFailed, each time, once it
    was removed: writing to files of the ledger that are open would succeed, and be lost.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._handle, self._process = folder, _opened(folder), os.getpid()

    def __enter__(self) -> None:
        if self._process != os.getpid():  # after a fork both processes hold what either holds through this handle
            self.close()
            self._handle, self._process = _opened(self._folder), os.getpid()
        if os.fstat(self._handle).st_nlink == 0:
            raise WriteFailed(
                f"{self._folder.parent}: the ledger was removed while it was open; restore it, and open it again"
            )
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
