"""Files that are there whole or not at all, and stay there after a power failure."""

import fcntl
import os
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from fsar_ledger.errors import WriteFailed

TEMPORARY = ".tmp"
MAX_DOCUMENT_BYTES = 1 << 20
"""No JSON file of a ledger comes near this size; what is larger is not one."""


def read_document(path: Path) -> bytes:
    """The bytes of a small regular file. Raises: OSError if it is missing, not a regular file (a link is not), too large or unreadable."""
    handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    with open(handle, "rb") as file:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise OSError(0, "it is not a regular file")
        data = file.read(MAX_DOCUMENT_BYTES + 1)
    if len(data) > MAX_DOCUMENT_BYTES:
        raise OSError(0, f"it is larger than {MAX_DOCUMENT_BYTES} bytes")
    return data


@contextmanager
def refusals(path: Path, doing: str) -> Iterator[None]:
    """What the disk refuses inside becomes WriteFailed."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise WriteFailed(f"{path}: {doing} failed: {reason}; nothing was committed; make room or permit writing there and run it again") from error


def sync_folder(folder: Path) -> None:
    """The names in this folder are on the disk."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_durably(path: Path, data: bytes | memoryview) -> None:
    """The file holds these bytes, whole and on the disk, whatever it held before."""
    temporary = temporary_name(path)
    try:
        write_temporary(temporary, data)
        move(temporary, path)
    except BaseException:
        remove(temporary)
        raise


def temporary_name(path: Path) -> Path:
    """A name beside this one that no other process uses."""
    return path.with_name(f"{path.name}.{os.getpid()}{TEMPORARY}")


def write_temporary(path: Path, data: bytes | memoryview) -> None:
    """The file holds these bytes and they are on the disk, its name not yet. Left out again when that fails."""
    try:
        with path.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
    except BaseException:
        remove(path)
        raise


def link_new(temporary: Path, path: Path) -> None:
    """The file has its name; the temporary one is gone in any case. Raises: FileExistsError if the name was taken."""
    try:
        os.link(temporary, path)
    finally:
        remove(temporary)


def move(source: Path, path: Path) -> None:
    """The file has changed its name, durably. That somebody else has moved it already is as good."""
    try:
        source.rename(path)
    except FileNotFoundError:
        if not path.exists():
            raise
    sync_folder(path.parent)
    if source.parent != path.parent:
        sync_folder(source.parent)


def remove(path: Path) -> None:
    """The file is not there, if the disk lets us."""
    with suppress(OSError):
        path.unlink()


def remove_folder(path: Path) -> None:
    """The folder and the files in it are not there, if the disk lets us."""
    with suppress(OSError):
        for name in os.listdir(path):
            os.unlink(path / name)
        os.rmdir(path)


def write_files(files: Mapping[Path, bytes], staging: Path) -> None:
    """Each file holds its bytes, whole and on the disk, and so do the folders made for it. Each folder is made durable once.

    Args:
        files: What each path shall hold.
        staging: A folder on the same disk, for files on their way.
    """
    folders: set[Path] = set()
    temporary = temporary_name(staging / "file")
    for path, data in files.items():
        if path.parent not in folders:
            folders.update(_make_folder(path.parent))
        write_temporary(temporary, data)
        os.replace(temporary, path)
    for folder in folders:
        sync_folder(folder)


def _make_folder(path: Path) -> list[Path]:
    """The folder is there; it and every folder whose names changed for it."""
    changed = [path]
    while not os.path.isdir(changed[-1]):
        changed.append(changed[-1].parent)
    for folder in reversed(changed[:-1]):
        with suppress(FileExistsError):
            os.mkdir(folder)
    return changed


def write_secret(path: Path, data: bytes) -> None:
    """The new file holds these bytes, and only its owner may read it. Raises: FileExistsError if the name is taken."""
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o600)
    with open(handle, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(handle)
    sync_folder(path.parent)


@contextmanager
def turn(folder: Path) -> Iterator[None]:
    """Nobody else is in a turn on this folder, where the file system has locks. A process that dies ends its turn."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)
