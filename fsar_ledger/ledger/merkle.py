"""The Merkle tree of RFC 6962 (section 2.1) as pure functions over packed hashes, 32 bytes each."""

import hashlib
from collections.abc import Sequence

import msgspec

HASH_BYTES = 32
EMPTY_ROOT = hashlib.sha256(b"").digest()


def leaf_hash(data: bytes) -> bytes:
    """SHA-256(0x00 || data)."""
    return hashlib.sha256(b"\x00" + data).digest()


def node_hash(left: bytes, right: bytes) -> bytes:
    """SHA-256(0x01 || left || right)."""
    return hashlib.sha256(b"\x01" + left + right).digest()


class Frontier(msgspec.Struct, frozen=True):
    """What must be kept of a tree in order to append to it: the roots of its complete subtrees, largest first.

    There is one for each bit that is set in `size`; together they determine the root.
    """

    size: int = 0
    subtrees: tuple[bytes, ...] = ()

    def extend(self, leaves: bytes) -> "Frontier":
        """The frontier after these leaf hashes, packed. Costs one hash a leaf."""
        sha256 = hashlib.sha256
        kept = list(self.subtrees)  # smallest last
        found: list[bytes] = []  # smallest first
        size, nodes = self.size, leaves
        while nodes:
            if size & 1:
                nodes = kept.pop() + nodes
            pairs = len(nodes) // (2 * HASH_BYTES) * 2 * HASH_BYTES
            if pairs < len(nodes):
                found.append(nodes[pairs:])
            nodes = b"".join([sha256(b"\x01" + nodes[at : at + 64]).digest() for at in range(0, pairs, 64)])
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
