"""Some hashes of a Merkle tree in one file that only grows: the pack.

It holds the roots of the complete subtrees of 2^4, 2^6, 2^8, ... leaves, each as soon as it is complete, smaller ones
first: 2.7 bytes per leaf. Four subtrees of one level make one of the next, so any other complete subtree of at least 16
leaves is hashed from two of the pack, and smaller ones from at most 16 leaves.
"""

from collections.abc import Callable

import numpy as np

from fsar_ledger.ledger.log.hashing import HASH_BYTES, parents
from fsar_ledger.ledger.log.merkle import Frontier, Node, node_hash

# See docs/decisions/no-leaf-hashes-are-kept.md.
BASE = 4
"""The height of the smallest subtrees of a pack: 16 leaves. Roots of smaller ones would take more than the events."""
STEP = 2
"""Heights between one level of a pack and the next."""


def count(leaves: int) -> int:
    """Return how many hashes the pack of a tree of this many leaves holds."""
    hashes, blocks = 0, leaves >> BASE
    while blocks:
        hashes += blocks
        blocks >>= STEP
    return hashes


def position(level: int, number: int) -> int:
    """Return where in the pack, counted in hashes, the root of this subtree is: of 2^(4 + 2 level) leaves."""
    blocks = (number + 1 << STEP * level) - 1  # complete before the one that completes it
    return count(blocks << BASE) + level


def grow(frontier: Frontier, leaves: bytes) -> tuple[Frontier, bytes]:
    """Return the tree after appending these packed leaf hashes, and what its pack has more than that before, in order.

    Costs one hash per leaf.
    """
    kept = list(frontier.subtrees)  # smallest last
    subtrees: list[bytes] = []  # smallest first
    complete: list[tuple[int, int, bytes]] = []  # level of the pack, number of the first subtree, their roots
    size, nodes, height = frontier.size, leaves, 0
    while nodes:
        if height >= BASE and (height - BASE) % STEP == 0:
            complete.append(((height - BASE) // STEP, size, nodes))
        if size & 1:
            nodes = kept.pop() + nodes
        pairs = len(nodes) // (2 * HASH_BYTES) * 2 * HASH_BYTES
        if pairs < len(nodes):
            subtrees.append(nodes[pairs:])
        nodes = parents(nodes[:pairs])
        size, height = size >> 1, height + 1
    after = Frontier(frontier.size + len(leaves) // HASH_BYTES, b"".join([*kept, *reversed(subtrees)]))
    return after, _in_order(complete, count(frontier.size), count(after.size))


def _in_order(complete: list[tuple[int, int, bytes]], start: int, end: int) -> bytes:
    """Put the roots of each level at their positions in the pack, of which they are `start` to `end`."""
    pack = np.empty((end - start, HASH_BYTES), np.uint8)
    for level, first, roots in complete:
        numbers = np.arange(first, first + len(roots) // HASH_BYTES)
        blocks = (numbers + 1 << STEP * level) - 1
        places = np.full(len(numbers), level - start)
        while blocks.any():
            places += blocks
            blocks >>= STEP
        pack[places] = np.frombuffer(roots, np.uint8).reshape(-1, HASH_BYTES)
    return pack.tobytes()


def node_of(read: Callable[[int], bytes], leaf_hashes: Callable[[int, int], bytes]) -> Node:
    """Return a function that reads complete subtrees (see `merkle.Node`) of a tree from its pack.

    Args:
        read: Returns the hash at this position of the pack.
        leaf_hashes: Returns the packed leaf hashes from this index to that; at most 16 are asked for.
    """

    def node(height: int, number: int) -> bytes:
        if height < BASE:
            nodes = leaf_hashes(number << height, number + 1 << height)
            while len(nodes) > HASH_BYTES:
                nodes = parents(nodes)
            return nodes
        level, above = divmod(height - BASE, STEP)
        if not above:
            return read(position(level, number))
        return node_hash(node(height - 1, 2 * number), node(height - 1, 2 * number + 1))

    return node
