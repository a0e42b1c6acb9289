"""Writes the records of long work (the fit, the predictions): checks the path first, then writes all or nothing."""

import os
from pathlib import Path
from typing import Any

import msgspec

from fsar_ledger.errors import UsageError, WriteFailed


def require_writable(out: Path) -> None:
    """Check that the record can be written, before minutes of work; leave nothing behind. Raises: WriteFailed."""
    probe = out.with_name(out.name + ".tmp")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        if out.is_dir():
            raise IsADirectoryError(None, "it is a folder")
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise WriteFailed(f"{out}: cannot be written ({error.strerror}); expected a path for the record") from error


def require_another(out: Path, what: str, other: Path, other_what: str) -> None:
    """Check that writing `out` would not replace `other`; `what` and `other_what` name them. Raises: UsageError."""
    if os.path.realpath(out) == os.path.realpath(other):
        raise UsageError(
            f"{what}: found the same file as {other_what}, which it would replace; "
            "expected two files; choose another path for one of them"
        )


def write_record(out: Path, record: Any) -> None:
    """Write the record as JSON, all or nothing. Raises: WriteFailed."""
    data = msgspec.json.format(msgspec.json.encode(record), indent=2) + b"\n"
    try:
        temporary = out.with_name(out.name + ".tmp")
        temporary.write_bytes(data)
        temporary.replace(out)
    except OSError as error:
        raise WriteFailed(f"{out}: cannot be written ({error.strerror}); free space or give another path") from error
