"""The records of long work, the fit and the predictions: refused before it begins where they cannot be written, and whole or not there."""

import os
from pathlib import Path
from typing import Any

import msgspec

from fsar_ledger.errors import UsageError, WriteFailed


def require_writable(out: Path) -> None:
    """Minutes of work should not end in a refusal. Nothing is left behind. Raises: WriteFailed."""
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
    """Writing `out` would not replace `other`; messages call them as the user did. Raises: UsageError."""
    if os.path.realpath(out) == os.path.realpath(other):
        raise UsageError(
            f"{what}: found the same file as {other_what}, which it would replace; expected two files, choose another for one of them"
        )


def write_record(out: Path, record: Any) -> None:
    """Write the record as JSON, whole or not at all. Raises: WriteFailed."""
    data = msgspec.json.format(msgspec.json.encode(record), indent=2) + b"\n"
    try:
        temporary = out.with_name(out.name + ".tmp")
        temporary.write_bytes(data)
        temporary.replace(out)
    except OSError as error:
        raise WriteFailed(f"{out}: cannot be written ({error.strerror}); free space or give another path") from error
