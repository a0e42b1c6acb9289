"""Write a file atomically, and check before long work that it can be written."""

import os
import secrets
from contextlib import suppress
from pathlib import Path

from fsar_ledger.base.errors import UsageError, WriteFailed

ADVICE = "free space or choose another --out"


def require_place(path: Path) -> None:
    """Check, before any work is done, that the file can be written. Raises: WriteFailed if that would surely fail."""
    try:
        require_file(path)
        above = next(folder for folder in path.absolute().parents if folder.exists())
        if not above.is_dir():
            raise NotADirectoryError(f"{above} is a file; expected a folder")
        if not os.access(above, os.W_OK):
            raise PermissionError(f"{above} may not be written to")
    except OSError as error:
        raise _unwritten(path, error, ADVICE) from error


def require_another(out: Path, what: str, other: Path, other_what: str) -> None:
    """Check that writing `out` would not replace `other`; `what` and `other_what` name them. Raises: UsageError."""
    if os.path.realpath(out) == os.path.realpath(other):
        raise UsageError(
            f"{what}: found the same file as {other_what}, which it would replace; "
            "expected two files; choose another path for one of them"
        )


def publish(path: Path, content: bytes, advice: str = ADVICE) -> None:
    """Replace the file's content atomically: written beside it, made durable, renamed.

    Raises: WriteFailed, with the advice, if the disk refuses (the folder cannot be made, read-only, full) or the path
        is a folder.
    """
    partial = unfinished_name(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        require_file(path)
        with partial.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError as error:
        raise _unwritten(path, error, advice) from error
    finally:
        with suppress(OSError):  # the folder may not allow it
            partial.unlink()


def unfinished_name(path: Path) -> Path:
    """Return an unused name beside this file: another thread, or another container, may write the same one."""
    return path.with_name(f".{path.name}.{secrets.token_hex(8)}.part")


def require_file(path: Path) -> None:
    """Check that the path is free, or that of a file. Raises: OSError for a folder, or what a file would not replace.

    Nobody who names a pipe or a device, such as /dev/null, wants a file in its place.
    """
    if path.is_dir():
        raise IsADirectoryError("it is a folder; expected the name of a file")
    if path.exists() and not path.is_file():
        raise OSError("it is a pipe or a device; expected the name of a file")


def _unwritten(path: Path, error: OSError, advice: str) -> WriteFailed:
    return WriteFailed(f"{path}: cannot be written: {error.strerror or error}. Nothing was changed; {advice}.")
