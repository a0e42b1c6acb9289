"""Hashes of a Merkle tree in files: the pack, one file that only grows, and tiles, the format of other systems.

The pack holds the roots of the complete subtrees of 2^4, 2^6, 2^8, ... leaves, in order of completion, smaller
ones first: 2.7 bytes per leaf. Four subtrees of one level make one of the next, so any other complete subtree of at
least 16 leaves is hashed from two in the pack, and smaller ones from at most 16 leaves.

Tiles have the layout of C2SP tlog-tiles: `tile/<level>/<number>[.p/<width>]`. A tile holds up to 256 hashes: leaves at
level 0, and above it the roots of the full tiles one level below. Tiles are derived from the events and can be rebuilt.
With them, one event can be proven without reading all others.
"""

from collections.abc import Callable

import msgspec
import numpy as np

from fsar_ledger.ledger.log.hashing import HASH_BYTES, parents
from fsar_ledger.ledger.log.merkle import Frontier, Node, node_hash

# See docs/decisions/no-leaf-hashes-are-kept.md.
BASE = 4
"""The height of a pack's smallest subtrees: 16 leaves. Roots of smaller ones would take more space than the events."""
STEP = 2
"""The number of heights from one level of a pack to the next."""


def count(leaves: int) -> int:
    """Return the number of hashes in the pack of a tree of this many leaves."""
    hashes, blocks = 0, leaves >> BASE
    while blocks:
        hashes += blocks
        blocks >>= STEP
    return hashes


def position(level: int, number: int) -> int:
    """Return the position in the pack, in hashes, of the root of this subtree of 2^(4 + 2 level) leaves."""
    blocks = (number + 1 << STEP * level) - 1  # complete blocks before the one that completes it
    return count(blocks << BASE) + level


def grow(frontier: Frontier, leaves: bytes) -> tuple[Frontier, bytes]:
    """Return the tree after appending these packed leaf hashes, and the hashes to append to its pack.

    Costs one hash per leaf.
    """
    old_subtrees = list(frontier.subtrees)  # smallest last
    subtrees: list[bytes] = []  # smallest first
    complete: list[tuple[int, int, bytes]] = []  # level of the pack, number of the first subtree, their roots
    size, nodes, height = frontier.size, leaves, 0
    while nodes:
        if height >= BASE and (height - BASE) % STEP == 0:
            complete.append(((height - BASE) // STEP, size, nodes))
        if size & 1:
            nodes = old_subtrees.pop() + nodes
        pairs = len(nodes) // (2 * HASH_BYTES) * 2 * HASH_BYTES
        if pairs < len(nodes):
            subtrees.append(nodes[pairs:])
        nodes = parents(nodes[:pairs])
        size, height = size >> 1, height + 1
    extended = Frontier(frontier.size + len(leaves) // HASH_BYTES, b"".join([*old_subtrees, *reversed(subtrees)]))
    return extended, _in_order(complete, count(frontier.size), count(extended.size))


def _in_order(complete: list[tuple[int, int, bytes]], start: int, end: int) -> bytes:
    """Return positions `start` to `end` of the pack, from the roots of each level."""
    pack = np.empty((end - start, HASH_BYTES), np.uint8)
    for level, first, roots in complete:
        numbers = np.arange(first, first + len(roots) // HASH_BYTES)
        blocks = (numbers + 1 << STEP * level) - 1
        positions = np.full(len(numbers), level - start)
        while blocks.any():
            positions += blocks
            blocks >>= STEP
        pack[positions] = np.frombuffer(roots, np.uint8).reshape(-1, HASH_BYTES)
    return pack.tobytes()


def node_of(read: Callable[[int], bytes], leaf_hashes: Callable[[int, int], bytes]) -> Node:
    """Return a function that reads complete subtrees (see `merkle.Node`) of a tree from its pack.

    Args:
        read: Returns the hash at this position of the pack.
        leaf_hashes: Returns the packed leaf hashes from one index to another; at most 16 are requested.
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


TILE = "tile"
HEIGHT = 8
WIDTH = 1 << HEIGHT
_TILE_BYTES = WIDTH * HASH_BYTES


class Tile(msgspec.Struct, frozen=True, order=True):
    """One tile of a tree: its level, its number within the level, and how many hashes it holds (256 if full)."""

    level: int
    number: int
    width: int = WIDTH

    @property
    def name(self) -> str:
        """Return the file of the tile within the ledger, as in C2SP tlog-tiles.

        The number is split into groups of three digits; all but the last begin with an x.
        """
        digits = f"{self.number:03d}"
        digits = digits.zfill(-len(digits) // 3 * -3)
        groups = [digits[start : start + 3] for start in range(0, len(digits), 3)]
        number = "/".join([*("x" + group for group in groups[:-1]), groups[-1]])
        return f"{TILE}/{self.level}/{number}" + ("" if self.width == WIDTH else f".p/{self.width}")


def partial_tiles(size: int) -> tuple[Tile, ...]:
    """Return the partial tiles of a tree of this size, at most one per level."""
    widths = ((level, size >> HEIGHT * level) for level in range((size.bit_length() + HEIGHT - 1) // HEIGHT))
    return tuple(Tile(level, count // WIDTH, count % WIDTH) for level, count in widths if count % WIDTH)


class Edge(msgspec.Struct, frozen=True):
    """The state needed to append to the tiles of a tree: the hashes in the partial tile of each level.

    `partial` holds them packed, leaves first; empty for a level without a partial tile.
    """

    size: int = 0
    partial: tuple[bytes, ...] = ()

    def extend(self, leaves: bytes) -> tuple["Edge", dict[Tile, bytes]]:
        """Return the edge after appending these packed leaf hashes, and every new tile, full or partial.

        Costs one hash per leaf.
        """
        tiles: dict[Tile, bytes] = {}
        partial: list[bytes] = []
        added, level = leaves, 0
        while added or level < len(self.partial):
            tail = self.partial[level] if level < len(self.partial) else b""
            if not added:
                partial.append(tail)
            else:
                first = (self.size >> HEIGHT * level) // WIDTH
                hashes = tail + added
                full = len(hashes) // _TILE_BYTES
                tiles |= {Tile(level, first + i): hashes[i * _TILE_BYTES : (i + 1) * _TILE_BYTES] for i in range(full)}
                rest = hashes[full * _TILE_BYTES :]
                if rest:
                    tiles[Tile(level, first + full, len(rest) // HASH_BYTES)] = rest
                partial.append(rest)
                added = _tile_roots(hashes[: full * _TILE_BYTES])
            level += 1
        return Edge(self.size + len(leaves) // HASH_BYTES, tuple(partial)), tiles

    def frontier(self) -> Frontier:
        """Return the roots of the tree's complete subtrees, largest first."""
        subtrees: list[bytes] = []
        for hashes in reversed(self.partial):
            offset = 0
            for height in reversed(range(HEIGHT)):
                size = HASH_BYTES << height
                if len(hashes) & size:
                    subtrees.append(_subtree_root(hashes[offset : offset + size]))
                    offset += size
        return Frontier(self.size, b"".join(subtrees))


def _tile_roots(hashes: bytes) -> bytes:
    """Return the root of each full tile, packed."""
    for _ in range(HEIGHT):
        hashes = parents(hashes)
    return hashes


def _subtree_root(hashes: bytes) -> bytes:
    """Return the root of a complete subtree over these hashes."""
    while len(hashes) > HASH_BYTES:
        hashes = parents(hashes)
    return hashes
