"""The pack of a ledger's tree on disk: the file `nodes`, derived from the events that segments hold."""

import os
from pathlib import Path

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.chain.paths import NODES
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


def append_nodes(ledger: Path, before: int, nodes: bytes) -> None:
    """Write these hashes, durably, after those of the tree of this many events.

    What is there already beyond them is replaced. Raises: OSError.
    """
    start = pack.count(before) * HASH_BYTES
    handle = os.open(ledger / NODES, os.O_WRONLY | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    try:
        size = os.fstat(handle).st_size
        if size < start:
            raise OSError(0, f"it has {size} bytes, and needs {start} before the next ones")
        growing.write_at(handle, nodes, start)
        os.ftruncate(handle, start + len(nodes))
        os.fdatasync(handle)
    finally:
        os.close(handle)


def nodes_size(ledger: Path) -> int:
    """Return the bytes of the pack; 0 if there is none. Raises: OSError."""
    try:
        return os.lstat(ledger / NODES).st_size
    except FileNotFoundError:
        return 0
