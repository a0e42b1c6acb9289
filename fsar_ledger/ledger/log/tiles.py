"""The hashes of the Merkle tree as files, in the layout of C2SP tlog-tiles: `tile/<level>/<number>[.p/<width>]`.

A tile holds up to 256 hashes: leaves at level 0, and above it the roots of the full tiles one level below. Tiles are
derived from the events and can be rebuilt. With them, one event is proven without reading all others.
"""

from collections.abc import Callable

import msgspec

from fsar_ledger.ledger.log.hashing import HASH_BYTES, parents
from fsar_ledger.ledger.log.merkle import Frontier, Node

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
        groups = [digits[at : at + 3] for at in range(0, len(digits), 3)]
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
            before = self.partial[level] if level < len(self.partial) else b""
            if not added:
                partial.append(before)
            else:
                first = (self.size >> HEIGHT * level) // WIDTH
                hashes = before + added
                full = len(hashes) // _TILE_BYTES
                tiles |= {
                    Tile(level, first + at): hashes[at * _TILE_BYTES : (at + 1) * _TILE_BYTES] for at in range(full)
                }
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
            at = 0
            for height in reversed(range(HEIGHT)):
                size = HASH_BYTES << height
                if len(hashes) & size:
                    subtrees.append(_subtree_root(hashes[at : at + size]))
                    at += size
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


def node_of(read: Callable[[Tile], bytes], size: int) -> Node:
    """Return a function that reads complete subtrees (see `merkle.Node`) of a tree of this size from its tiles."""

    def node(height: int, number: int) -> bytes:
        level, above = divmod(height, HEIGHT)
        first = number << above
        count = size >> HEIGHT * level
        column, start = divmod(first, WIDTH)
        tile = Tile(level, column, min(WIDTH, count - column * WIDTH))
        return _subtree_root(read(tile)[start * HASH_BYTES : (start + (1 << above)) * HASH_BYTES])

    return node
