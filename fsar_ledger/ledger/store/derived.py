"""The files of a ledger that are derived from the events that segments hold, and grow with these.

`nodes` is the pack of the tree, `index.jsonl` the index.
"""

import os
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

from fsar_ledger.base.errors import LedgerCorrupted
from fsar_ledger.ledger.log import merkle, pack
from fsar_ledger.ledger.log.hashing import HASH_BYTES, leaves_of
from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.store import disk, growing
from fsar_ledger.ledger.store.links import Chain
from fsar_ledger.ledger.store.paths import INDEX, NODES

_READ = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK


def read_node(ledger: Path, place: int) -> bytes:
    """Return the hash at this place of the pack. Raises: LedgerCorrupted if it is not there."""
    path = ledger / NODES
    try:
        handle = os.open(path, _READ)
        try:
            node = os.pread(handle, HASH_BYTES, place * HASH_BYTES)
        finally:
            disk.close(handle)
    except OSError as error:
        raise LedgerCorrupted(
            f"{path}: it cannot be read ({error.strerror}); run fsar-ledger maintain recover, which derives it again"
        ) from error
    if len(node) != HASH_BYTES:
        raise LedgerCorrupted(
            f"{path}: found no hash {place}, expected {HASH_BYTES} bytes there; run fsar-ledger maintain recover, "
            "which derives it again"
        )
    return node


def holds_nodes(ledger: Path, leaves: int) -> bool:
    """Return whether the pack is as long as that of the tree of this many leaves."""
    try:
        return growing.size_of(ledger / NODES) >= pack.count(leaves) * HASH_BYTES
    except OSError:  # whoever reads a node says why
        return False


def node_reader(ledger: Path, tree: Frontier, others: bytes, rows: Callable[[int, int], list[bytes]]) -> merkle.Node:
    """Return a function that gives the complete subtrees of a ledger's tree, and so of each smaller one.

    `tree` is that of the events whose nodes the pack holds, `others` the packed leaves of those after them, and `rows`
    gives the canonical bytes of the events between two indexes. It raises LedgerCorrupted where the pack is too short.
    """
    start, size = pack.count(tree.size), tree.size + len(others) // HASH_BYTES
    _, more = pack.grow(tree, others)

    def read(place: int) -> bytes:
        at = (place - start) * HASH_BYTES
        return more[at : at + HASH_BYTES] if at >= 0 else read_node(ledger, place)

    @lru_cache(maxsize=4)
    def leaf_hashes(first: int, end: int) -> bytes:
        return leaves_of(rows(first, end))

    def some(first: int, end: int) -> bytes:
        block = first >> pack.BASE << pack.BASE  # read and hash a block once
        nodes = leaf_hashes(block, min(block + (1 << pack.BASE), size))
        return nodes[(first - block) * HASH_BYTES : (end - block) * HASH_BYTES]

    edge = tree.nodes()
    stored = pack.node_of(read, some)
    return lambda height, number: edge.get((height, number)) or stored(height, number)


def append_derived(ledger: Path, name: str, data: bytes, start: int) -> None:
    """Write these bytes, durably, to a derived file after the first so many, which are there.

    What is there already beyond is replaced. Of a new file the name is durable, too: a checkpoint must never be there
    without it. Raises: OSError.
    """
    is_new = not os.path.lexists(ledger / name)
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
    if is_new:
        disk.sync_folder(ledger)


def derived_sizes(chain: Chain) -> dict[str, int]:
    """Return the bytes that each derived file has when it has all."""
    return {NODES: pack.count(chain.placed_size) * HASH_BYTES, INDEX: chain.index_bytes}
