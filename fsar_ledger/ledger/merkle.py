"""The Merkle tree of RFC 6962 (section 2.1) as pure functions over packed hashes, 32 bytes each."""

import hashlib
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

HASH_BYTES = 32
_HASHED = np.dtype((np.void, 1 + 2 * HASH_BYTES))
_PAIRS_AT_ONCE = 512  # so that they stay in the processor's caches
EMPTY_ROOT = hashlib.sha256(b"").digest()


def leaf_hash(data: bytes) -> bytes:
    """SHA-256(0x00 || data)."""
    return hashlib.sha256(b"\x00" + data).digest()


def node_hash(left: bytes, right: bytes) -> bytes:
    """SHA-256(0x01 || left || right)."""
    return hashlib.sha256(b"\x01" + left + right).digest()


def _parents(nodes: bytes) -> bytes:
    """The hash of each pair of packed hashes, packed. What is hashed is cut out of one buffer: joining each costs a fifth more."""
    sha256 = hashlib.sha256
    pairs = np.frombuffer(nodes, np.uint8).reshape(-1, 2 * HASH_BYTES)
    found = []
    for at in range(0, len(pairs), _PAIRS_AT_ONCE):
        some = pairs[at : at + _PAIRS_AT_ONCE]
        hashed = np.ones((len(some), 1 + 2 * HASH_BYTES), np.uint8)  # the first byte of each row stays 0x01
        hashed[:, 1:] = some
        cut: list[Any] = hashed.view(_HASHED).ravel().tolist()
        found.append(b"".join([sha256(one).digest() for one in cut]))
    return b"".join(found)


class Frontier(msgspec.Struct, frozen=True):
    """What must be kept of a tree in order to append to it: the roots of its complete subtrees, largest first.

    There is one for each bit that is set in `size`; together they determine the root.
    """

    size: int = 0
    subtrees: tuple[bytes, ...] = ()

    def extend(self, leaves: bytes) -> "Frontier":
        """The frontier after these leaf hashes, packed. Costs one hash a leaf."""
        kept = list(self.subtrees)  # smallest last
        found: list[bytes] = []  # smallest first
        size, nodes = self.size, leaves
        while nodes:
            if size & 1:
                nodes = kept.pop() + nodes
            pairs = len(nodes) // (2 * HASH_BYTES) * 2 * HASH_BYTES
            if pairs < len(nodes):
                found.append(nodes[pairs:])
            nodes = _parents(nodes[:pairs])
            size >>= 1
        return Frontier(self.size + len(leaves) // HASH_BYTES, (*kept, *reversed(found)))

    def root(self) -> bytes:
        """The root hash of the tree."""
        if not self.subtrees:
            return EMPTY_ROOT
        *left, root = self.subtrees
        for subtree in reversed(left):
            root = node_hash(subtree, root)
        return root


def root(leaves: Sequence[bytes]) -> bytes:
    """The root hash of the tree over these leaf hashes."""
    return Frontier().extend(b"".join(leaves)).root()
