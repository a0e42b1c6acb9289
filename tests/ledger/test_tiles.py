from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsar_ledger.ledger.log.hashing import HASH_BYTES, parents
from fsar_ledger.ledger.log.merkle import Frontier, Node, inclusion_proof, leaf_hash, root_of_inclusion, tree_root
from fsar_ledger.ledger.log.pack import HEIGHT, WIDTH, Edge, Tile, partial_tiles

LEAVES = b"".join(leaf_hash(b"%d" % number) for number in range(1000))


def hashes(leaves: bytes, height: int) -> bytes:
    """Return the roots of the complete subtrees of this height, packed."""
    for _ in range(height):
        leaves = parents(leaves[: len(leaves) // (2 * HASH_BYTES) * 2 * HASH_BYTES])
    return leaves


def tiles_of(leaves: bytes) -> dict[str, bytes]:
    """Return every tile of the tree by its name, as the specification defines them."""
    found = {}
    level, width = 0, WIDTH * HASH_BYTES
    while row := hashes(leaves, HEIGHT * level):
        for number, at in enumerate(range(0, len(row), width)):
            data = row[at : at + width]
            found[Tile(level, number, len(data) // HASH_BYTES).name] = data
        level += 1
    return found


def node_of(read: Callable[[Tile], bytes], size: int) -> Node:
    """Return a function that reads complete subtrees (see `merkle.Node`) of a tree of this size from its tiles."""

    def node(height: int, number: int) -> bytes:
        level, above = divmod(height, HEIGHT)
        first = number << above
        count = size >> HEIGHT * level
        column, start = divmod(first, WIDTH)
        tile = Tile(level, column, min(WIDTH, count - column * WIDTH))
        return hashes(read(tile)[start * HASH_BYTES : (start + (1 << above)) * HASH_BYTES], above)

    return node


@pytest.mark.parametrize(
    ("tile", "name"),
    [
        (Tile(0, 1234067), "tile/0/x001/x234/067"),  # the example of the specification
        (Tile(0, 0), "tile/0/000"),
        (Tile(0, 999), "tile/0/999"),
        (Tile(1, 1000), "tile/1/x001/000"),
        (Tile(2, 999_999, 17), "tile/2/x999/999.p/17"),
        (Tile(0, 1_000_000, 255), "tile/0/x001/x000/000.p/255"),
    ],
)
def test_a_tile_has_the_name_that_the_specification_gives_it(tile: Tile, name: str) -> None:
    assert tile.name == name


def test_a_tree_of_70_000_leaves_has_the_tiles_that_the_specification_counts() -> None:
    leaves = b"".join(leaf_hash(b"%d" % number) for number in range(70_000))
    edge, made = Edge().extend(leaves)
    full = [tile for tile in made if tile.width == WIDTH]
    assert (
        sorted(set(made) - set(full))
        == [Tile(0, 273, 112), Tile(1, 1, 17), Tile(2, 0, 1)]
        == list(partial_tiles(70_000))
    )
    assert [sum(1 for tile in full if tile.level == level) for level in (0, 1, 2)] == [273, 1, 0]
    assert edge.frontier() == Frontier().extend(leaves)


def test_a_tree_of_256_leaves_has_a_full_tile_and_one_hash_above_it() -> None:
    _, made = Edge().extend(LEAVES[: 256 * HASH_BYTES])
    assert {tile.name for tile in made} == {"tile/0/000", "tile/1/000.p/1"}
    assert partial_tiles(256) == (Tile(1, 0, 1),)
    assert partial_tiles(0) == ()


@pytest.mark.parametrize("size", [0, 1, 2, 255, 256, 257, 511, 512, 513, 1000])
def test_tiles_are_as_defined(size: int) -> None:
    leaves = LEAVES[: size * HASH_BYTES]
    edge, made = Edge().extend(leaves)
    assert {tile.name: data for tile, data in made.items()} == tiles_of(leaves)
    assert edge.frontier() == Frontier().extend(leaves)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(0, 400), max_size=8))
def test_batches_of_any_sizes_give_the_same_files_as_all_at_once(sizes: list[int]) -> None:
    edge, at, files = Edge(), 0, dict[str, bytes]()
    for size in sizes:
        batch = LEAVES[at * HASH_BYTES : (at + size) * HASH_BYTES]
        at += len(batch) // HASH_BYTES
        edge, made = edge.extend(batch)
        assert not [
            tile for tile, data in made.items() if tile.name in files and files[tile.name] != data
        ]  # a file never changes
        files |= {tile.name: data for tile, data in made.items()}
    once, expected = Edge().extend(LEAVES[: at * HASH_BYTES])
    assert edge == once
    kept = {name for name in files if ".p/" not in name or name in {tile.name for tile in partial_tiles(at)}}
    assert {name: files[name] for name in kept} == {tile.name: data for tile, data in expected.items()}


@pytest.mark.parametrize("size", [1, 255, 256, 257, 700, 1000])
def test_roots_and_proofs_come_out_of_tiles(size: int) -> None:
    tiles = tiles_of(LEAVES[: size * HASH_BYTES])
    node = node_of(lambda tile: tiles[tile.name], size)
    root = Frontier().extend(LEAVES[: size * HASH_BYTES]).root()
    assert tree_root(node, size) == root
    for index in {0, size // 2, size - 1}:
        leaf = LEAVES[index * HASH_BYTES : (index + 1) * HASH_BYTES]
        assert node(0, index) == leaf
        assert root_of_inclusion(leaf, index, size, inclusion_proof(node, index, size)) == root
