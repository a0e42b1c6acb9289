"""Files that are there whole or not at all, and stay there after a power failure."""

import os
import stat
from collections.abc import Iterator
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
