"""Where the files of a ledger are, how to recognise its folder, and where other commands must not write."""

import os
from contextlib import suppress
from pathlib import Path

from fsar_ledger.base.errors import NotALedger, UsageError
from fsar_ledger.ledger.store import disk

MANIFEST = "ledger.json"
CHECKPOINT = "checkpoint"
COMMITS, SEGMENTS, STAGING = "commits", "segments", "staging"
CHAIN, JOURNAL = "chain.jsonl", "journal.jsonl"
SEALING = "sealing.jsonl"
"""The former journal, while its rows are put into a segment and further commits go into a new journal."""
NODES = "nodes"
INDEX = "index.jsonl"
_PARTS = (MANIFEST, SEGMENTS, COMMITS, CHAIN, JOURNAL)
"""The parts that identify a ledger, even of format 1, and even if some are lost."""


def segment_name(first: int, end: int) -> str:
    """Return the name within the ledger of the segment that holds these events, once it is in place."""
    return f"segments/{first:012d}-{end:012d}.parquet"


def staged_file(sha256: str) -> str:
    """Return the name within the ledger of the segment with this SHA-256, until it is committed and moved."""
    return f"{STAGING}/{sha256}.parquet"


def segment_bytes(ledger: Path) -> int:
    """Return the total size of segments in bytes, in place and staged; of a sparse file, only those allocated."""
    size = 0
    for folder in (SEGMENTS, STAGING):
        with suppress(OSError), os.scandir(ledger / folder) as entries:
            for entry in entries:
                with suppress(OSError):
                    status = entry.stat(follow_symlinks=False)
                    size += min(status.st_size, status.st_blocks * 512)
    return size


def staged_path(ledger: Path, sha256: str) -> Path:
    """Return the path of the segment with this SHA-256, until it is committed and moved."""
    return ledger / staged_file(sha256)


def require_created(ledger: Path) -> None:
    """Refuse a folder left by an interrupted creation. It is not damaged: creating the ledger again finishes it.

    Raises:
        NotALedger: The folder holds only some of a ledger's folders, and in them at most an unfinished ledger.json.
    """
    with suppress(OSError):
        if os.listdir(ledger) and is_unfinished(ledger):
            raise NotALedger(
                f"{ledger}: found a ledger whose creation was interrupted before anything was in it, expected one "
                f"with {MANIFEST}; "
                "run the command that creates it again"
            )


def is_unfinished(ledger: Path) -> bool:
    """Return whether this folder is empty, or holds only what an interrupted creation leaves behind.

    Raises: OSError if it cannot be read.
    """
    for entry in list(os.scandir(ledger)):
        if entry.name not in (SEGMENTS, STAGING) or not entry.is_dir(follow_symlinks=False):
            return False
        leftovers = os.listdir(entry.path)
        if any(
            entry.name != STAGING or not (name.startswith(MANIFEST) and name.endswith(disk.TEMPORARY))
            for name in leftovers
        ):
            return False
    return True


def beside(ledger: Path, suffix: str) -> Path:
    """Return the path of this suffix beside a ledger, also beside one that is given as `.`."""
    named = Path(os.path.abspath(ledger)) if ledger.name in ("", "..") else ledger
    return named.with_name(named.name + suffix)


def require_outside(out: Path, what: str) -> None:
    """Refuse an output file inside any ledger, even one that the command does not read.

    Messages call it `what`, as the user did. A folder counts as a ledger if it holds two parts of one: a damaged ledger
    is evidence, too.

    Raises:
        UsageError: The file, or what it links to, would be inside a ledger.
    """
    named, resolved = Path(os.path.realpath(out.parent)) / out.name, Path(os.path.realpath(out))
    for path in (named, resolved):
        for folder in (path, *path.parents):
            if sum(os.path.lexists(folder / part) for part in _PARTS) > 1:
                raise UsageError(
                    f"{what}: found a place inside the ledger {folder}, which holds nothing but its own files; choose "
                    "one outside"
                )
