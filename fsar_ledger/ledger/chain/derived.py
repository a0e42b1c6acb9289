"""The files of a ledger of format 2 that are derived from the events that segments hold, and grow with these.

`nodes` is the pack of the tree, `index.jsonl` the index.
"""

import os
from pathlib import Path

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.chain.links import Chain
from fsar_ledger.ledger.chain.paths import INDEX, NODES
from fsar_ledger.ledger.log import pack
from fsar_ledger.ledger.log.hashing import HASH_BYTES
from fsar_ledger.ledger.store import disk, growing

_READ = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK


def read_node(ledger: Path, place: int) -> bytes:
    """Return the hash at this place of the pack. Raises: LedgerCorrupted if it is not there."""
    path = ledger / NODES
    try:
        handle = os.open(path, _READ)
        try:
            found = os.pread(handle, HASH_BYTES, place * HASH_BYTES)
        finally:
            disk.close(handle)
    except OSError as error:
        raise LedgerCorrupted(
            f"{path}: it cannot be read ({error.strerror}); run fsar-ledger recover, which derives it again"
        ) from error
    if len(found) != HASH_BYTES:
        raise LedgerCorrupted(
            f"{path}: found no hash {place}, expected {HASH_BYTES} bytes there; run fsar-ledger recover, which derives "
            "it again"
        )
    return found


def append_derived(ledger: Path, name: str, data: bytes, start: int) -> None:
    """Write these bytes, durably, to a derived file after the first so many, which are there.

    What is there already beyond is replaced. Raises: OSError.
    """
    handle = os.open(ledger / name, os.O_WRONLY | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    try:
        size = os.fstat(handle).st_size
        if size < start:
            raise OSError(0, f"it has {size} bytes, and needs {start} before the next ones")
        growing.write_at(handle, data, start)
        os.ftruncate(handle, start + len(data))
        os.fdatasync(handle)
    finally:
        os.close(handle)
    if not start:
        disk.sync_folder(ledger)  # the file may be new, and the checkpoint must not be there without it


def derived_sizes(chain: Chain) -> dict[str, int]:
    """Return the bytes that each derived file has when it has all."""
    return {NODES: pack.count(chain.placed_size) * HASH_BYTES, INDEX: chain.index_bytes}
