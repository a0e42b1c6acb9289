"""Write a file atomically, and check before long work that it can be written."""

import os
from contextlib import suppress
from pathlib import Path

from fsar_ledger.base.errors import UsageError, WriteFailed

ADVICE = "free space or choose another --out"


def require_place(path: Path) -> None:
    """Check, before any work is done, that the file can be written. Raises: WriteFailed if that would surely fail."""
    try:
        _require_file(path)
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
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _require_file(path)
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


def _require_file(path: Path) -> None:
    if path.is_dir():
        raise IsADirectoryError("it is a folder; expected the name of a file")


def _unwritten(path: Path, error: OSError, advice: str) -> WriteFailed:
    return WriteFailed(f"{path}: cannot be written: {error.strerror or error}. Nothing was changed; {advice}.")
