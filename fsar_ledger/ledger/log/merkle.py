"""The Merkle tree of RFC 6962 (section 2.1) as pure functions over packed hashes, 32 bytes each.

Proofs are built from any source of complete subtrees (`Node`), and checked as in RFC 9162, sections 2.1.3.2 and
2.1.4.2.
"""

import hashlib
from collections.abc import Callable, Sequence
from typing import TypeAlias

import msgspec

from fsar_ledger.ledger.log import hashing
from fsar_ledger.ledger.log.hashing import HASH_BYTES

EMPTY_ROOT = hashlib.sha256(b"").digest()

Node: TypeAlias = Callable[[int, int], bytes]
"""Returns the root of a complete subtree of 2**height leaves, given its height and its index among those of that
height.
"""


def leaf_hash(data: bytes) -> bytes:
    """Return SHA-256(0x00 || data)."""
    return hashlib.sha256(b"\x00" + data).digest()


def node_hash(left: bytes, right: bytes) -> bytes:
    """Return SHA-256(0x01 || left || right)."""
    return hashlib.sha256(b"\x01" + left + right).digest()


class Frontier(msgspec.Struct, frozen=True):
    """The state needed to append to a tree: the packed roots of its complete subtrees, largest first.

    There is one for each bit set in `size`; together they determine the root of the tree.
    """

    size: int = 0
    packed: bytes = b""

    @property
    def subtrees(self) -> tuple[bytes, ...]:
        """Return the roots of the complete subtrees, largest first."""
        return tuple([self.packed[start : start + HASH_BYTES] for start in range(0, len(self.packed), HASH_BYTES)])

    def extend(self, leaves: bytes) -> "Frontier":
        """Return the frontier after appending these packed leaf hashes. Costs one hash per leaf.

        Raises: ValueError if this frontier is not that of a tree.
        """
        return Frontier(self.size + len(leaves) // HASH_BYTES, hashing.extended(self.size, self.packed, leaves))

    def add(self, lines: bytes) -> tuple[bytes, "Frontier", bytes]:
        """Return the packed leaf hashes of these lines, the frontier after appending them, and its root.

        Each line ends with a line feed, which is not hashed. Raises: ValueError if there are none, or as `extend`.
        """
        leaves, packed, root = hashing.added(self.size, self.packed, lines)
        return leaves, Frontier(self.size + len(leaves) // HASH_BYTES, packed), root

    def nodes(self) -> dict[tuple[int, int], bytes]:
        """Return the roots of the complete subtrees by height and index among those of that height."""
        nodes: dict[tuple[int, int], bytes] = {}
        first = 0
        for subtree in self.subtrees:
            height = (self.size - first).bit_length() - 1
            nodes[height, first >> height] = subtree
            first += 1 << height
        return nodes

    def roots(self, leaves: bytes, sizes: Sequence[int]) -> list[bytes]:
        """Return the roots of the tree at each of these ascending sizes, as these packed leaf hashes are added."""
        packed = hashing.roots(self.size, self.packed, leaves, list(sizes))
        return [packed[start : start + HASH_BYTES] for start in range(0, len(packed), HASH_BYTES)]

    def root(self) -> bytes:
        """Return the root hash of the tree."""
        if not self.packed:
            return EMPTY_ROOT
        if self.size and len(self.packed) == self.size.bit_count() * HASH_BYTES:
            return hashing.roots(self.size, self.packed, b"", [self.size])
        *left, root = self.subtrees  # forged, not those of a tree
        for subtree in reversed(left):
            root = node_hash(subtree, root)
        return root


def root(leaves: Sequence[bytes]) -> bytes:
    """Return the root hash of the tree over these leaf hashes."""
    return Frontier().extend(b"".join(leaves)).root()


# --- proofs ---


def _split(size: int) -> int:
    """Return the largest power of two below the size, where RFC 6962 splits a tree."""
    return 1 << (size - 1).bit_length() - 1


def range_root(node: Node, start: int, end: int) -> bytes:
    """Return the root over leaves `start` to `end`, which must be a subtree of RFC 6962.

    `start` is a multiple of a power of two that is at least the size of the subtree.
    """
    size = end - start
    if size & (size - 1) == 0:
        return node(size.bit_length() - 1, start // size)
    middle = start + _split(size)
    return node_hash(range_root(node, start, middle), range_root(node, middle, end))


def tree_root(node: Node, size: int) -> bytes:
    """Return the root of the tree over the first `size` leaves."""
    return range_root(node, 0, size) if size else EMPTY_ROOT


def inclusion_proof(node: Node, index: int, size: int) -> tuple[bytes, ...]:
    """Return PATH(index, D[size]), RFC 6962 section 2.1.1: the hashes from the leaf's sibling to the root's child.

    Raises:
        ValueError: The tree has no such leaf.
    """
    if not 0 <= index < size:
        raise ValueError(f"found index {index}, expected one of {size} leaves")
    path: list[bytes] = []
    start, end = 0, size
    while end - start > 1:
        middle = start + _split(end - start)
        if index < middle:
            path.append(range_root(node, middle, end))
            end = middle
        else:
            path.append(range_root(node, start, middle))
            start = middle
    return tuple(reversed(path))


def consistency_proof(node: Node, old: int, new: int) -> tuple[bytes, ...]:
    """Return PROOF(old, D[new]), RFC 6962 section 2.1.2; empty if the old tree is empty or the sizes are equal.

    Raises:
        ValueError: The old tree is larger than the new one.
    """
    if not 0 <= old <= new:
        raise ValueError(f"found sizes {old} and {new}, expected an older tree that is not larger")
    if old in (0, new):
        return ()
    path: list[bytes] = []
    start, end = 0, new
    while end != old:
        middle = start + _split(end - start)
        if old <= middle:
            path.append(range_root(node, middle, end))
            end = middle
        else:
            path.append(range_root(node, start, middle))
            start = middle
    if start:  # otherwise this is the old root, which the verifier already has
        path.append(range_root(node, start, end))
    return tuple(reversed(path))


def _are_hashes(*found: bytes) -> bool:
    return all(len(entry) == HASH_BYTES for entry in found)


def root_of_inclusion(leaf: bytes, index: int, size: int, proof: Sequence[bytes]) -> bytes | None:
    """Return the root to which this proof leads from the leaf hash (RFC 9162 section 2.1.3.2).

    None if the tree has no such leaf, the proof has the wrong length, or a hash is not 32 bytes long.
    """
    if not 0 <= index < size or not _are_hashes(leaf, *proof):
        return None
    position, last, root = index, size - 1, leaf
    for sibling in proof:
        if last == 0:
            return None
        if position & 1 or position == last:
            root = node_hash(sibling, root)
            while not position & 1 and position:
                position, last = position >> 1, last >> 1
        else:
            root = node_hash(root, sibling)
        position, last = position >> 1, last >> 1
    return root if last == 0 else None


def is_consistent(old: int, old_root: bytes, new: int, new_root: bytes, proof: Sequence[bytes]) -> bool:
    """Return whether the proof shows that the new tree begins with the old one (RFC 9162 section 2.1.4.2).

    False if a hash is not 32 bytes long. Every tree begins with the empty one: then the proof must be empty, and the
    old root must be that of no leaves (C2SP tlog-witness requires this; RFC 9162 leaves it open).
    """
    if not 0 <= old <= new or not _are_hashes(old_root, new_root, *proof):
        return False
    if old == 0:
        return not proof and old_root == EMPTY_ROOT and (new > 0 or new_root == EMPTY_ROOT)
    if old == new:
        return not proof and old_root == new_root
    first, *rest = (old_root, *proof) if old & (old - 1) == 0 else proof or (b"",)
    position, last = old - 1, new - 1
    while position & 1:
        position, last = position >> 1, last >> 1
    computed_old = computed_new = first
    for sibling in rest:
        if last == 0:
            return False
        if position & 1 or position == last:
            computed_old, computed_new = node_hash(sibling, computed_old), node_hash(sibling, computed_new)
            while not position & 1 and position:
                position, last = position >> 1, last >> 1
        else:
            computed_new = node_hash(computed_new, sibling)
        position, last = position >> 1, last >> 1
    return last == 0 and computed_old == old_root and computed_new == new_root
