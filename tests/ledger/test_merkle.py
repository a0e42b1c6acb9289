import hashlib
import random
from collections.abc import Iterator, Sequence
from functools import cache

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsar_ledger.ledger.log.merkle import (
    EMPTY_ROOT,
    Frontier,
    consistency_proof,
    inclusion_proof,
    is_consistent,
    leaf_hash,
    node_hash,
    root,
    root_of_inclusion,
    tree_root,
)


def defined_root(leaves: list[bytes]) -> bytes:
    """Return MTH of RFC 6962, section 2.1, over leaf hashes, as it is written there."""
    if not leaves:
        return hashlib.sha256(b"").digest()
    if len(leaves) == 1:
        return leaves[0]
    k = 1
    while 2 * k < len(leaves):
        k *= 2
    return hashlib.sha256(b"\x01" + defined_root(leaves[:k]) + defined_root(leaves[k:])).digest()


LEAVES = [leaf_hash(b"%d" % number) for number in range(301)]


def test_hashes_are_those_of_the_rfc() -> None:
    assert leaf_hash(b"").hex() == "6e340b9cffb37a989ca544e6bb780a2c78901d3fb33738768511a30617afa01d"
    assert EMPTY_ROOT.hex() == "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
    assert node_hash(b"l" * 32, b"r" * 32) == hashlib.sha256(b"\x01" + b"l" * 32 + b"r" * 32).digest()


@pytest.mark.parametrize("start", range(0, 301, 50))
def test_the_root_of_every_size_is_as_defined(start: int) -> None:
    for size in range(start, min(start + 50, 301)):
        frontier = Frontier().extend(b"".join(LEAVES[:size]))
        assert frontier.root() == root(LEAVES[:size]) == defined_root(LEAVES[:size])
        assert frontier.size == size
        assert len(frontier.subtrees) == size.bit_count()


@pytest.mark.parametrize("size", [1023, 1024, 1025, 2049, 3000])
def test_the_root_of_more_leaves_than_are_hashed_at_once_is_as_defined(size: int) -> None:
    leaves = [leaf_hash(b"%d" % number) for number in range(size)]
    assert root(leaves) == defined_root(leaves)
    assert Frontier().extend(b"".join(leaves[:7])).extend(b"".join(leaves[7:])).root() == defined_root(leaves)


def test_growing_leaf_by_leaf_gives_every_root() -> None:
    frontier = Frontier()
    for size in range(301):
        assert frontier.root() == defined_root(LEAVES[:size])
        if size < 300:
            frontier = frontier.extend(LEAVES[size])


@settings(max_examples=150, deadline=None)
@given(st.lists(st.integers(0, 40), max_size=8))
def test_growing_in_batches_of_any_size_gives_the_same_frontier(sizes: list[int]) -> None:
    frontier, at = Frontier(), 0
    for size in sizes:
        frontier = frontier.extend(b"".join(LEAVES[at : at + size]))
        at += min(size, len(LEAVES) - at)
    assert frontier == Frontier().extend(b"".join(LEAVES[:at]))


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 80), st.data())
def test_any_other_leaf_gives_another_root(size: int, data: st.DataObject) -> None:
    at = data.draw(st.integers(0, size - 1))
    bit = data.draw(st.integers(0, 255))
    flipped = (int.from_bytes(LEAVES[at]) ^ 1 << bit).to_bytes(32)
    assert root([*LEAVES[:at], flipped, *LEAVES[at + 1 : size]]) != root(LEAVES[:size])


# --- proofs, compared with the definitions of RFC 6962 section 2.1.1 and 2.1.2 as they are written there ---


@cache
def range_of(start: int, end: int) -> bytes:
    """Return MTH(D[start:end])."""
    if end - start == 1:
        return LEAVES[start]
    k = start + largest_power_below(end - start)
    return hashlib.sha256(b"\x01" + range_of(start, k) + range_of(k, end)).digest()


def largest_power_below(size: int) -> int:
    k = 1
    while 2 * k < size:
        k *= 2
    return k


def defined_path(m: int, start: int, end: int) -> list[bytes]:
    """Return PATH(m, D[start:end])."""
    if end - start == 1:
        return []
    k = largest_power_below(end - start)
    if m < k:
        return [*defined_path(m, start, start + k), range_of(start + k, end)]
    return [*defined_path(m - k, start + k, end), range_of(start, start + k)]


def defined_subproof(m: int, start: int, end: int, *, is_known: bool) -> list[bytes]:
    """Return SUBPROOF(m, D[start:end], is_known)."""
    if m == end - start:
        return [] if is_known else [range_of(start, end)]
    k = largest_power_below(end - start)
    if m <= k:
        return [*defined_subproof(m, start, start + k, is_known=is_known), range_of(start + k, end)]
    return [*defined_subproof(m - k, start + k, end, is_known=False), range_of(start, start + k)]


def sides(index: int, size: int) -> list[bool]:
    """Return, from the leaf to the root, whether each node is a right child."""
    if size == 1:
        return []
    k = largest_power_below(size)
    return [*sides(index, k), False] if index < k else [*sides(index - k, size - k), True]


def node(height: int, number: int) -> bytes:
    return range_of(number << height, number + 1 << height)


def damaged(proof: Sequence[bytes], draw: random.Random) -> Iterator[tuple[bytes, ...]]:
    """Yield the proof with each hash altered, left out, doubled, replaced, or swapped with the next; and with one hash
    more."""
    for at, one in enumerate(proof):
        flipped = (int.from_bytes(one) ^ 1 << draw.randrange(256)).to_bytes(32)
        for instead in ((flipped,), (), (one, one), (bytes(32),), (one[:31],)):
            yield (*proof[:at], *instead, *proof[at + 1 :])
        if at + 1 < len(proof):
            yield (*proof[:at], proof[at + 1], one, *proof[at + 2 :])
    yield (*proof, bytes(32))
    yield (bytes(32), *proof)


@pytest.mark.parametrize("start", range(1, 301, 50))
def test_the_inclusion_proof_of_every_leaf_at_every_size_is_as_defined_and_leads_to_the_root(start: int) -> None:
    for size in range(start, start + 50):
        for index in range(size):
            proof = inclusion_proof(node, index, size)
            assert list(proof) == defined_path(index, 0, size)
            assert root_of_inclusion(LEAVES[index], index, size, proof) == range_of(0, size)


@pytest.mark.parametrize("start", range(1, 301, 50))
def test_no_damaged_inclusion_proof_leads_to_the_root_at_any_size(start: int) -> None:
    draw = random.Random(start)
    for size in range(start, start + 50):
        for index in {0, size // 2, size - 1, draw.randrange(size)}:
            proof = inclusion_proof(node, index, size)
            for other in damaged(proof, draw):
                assert root_of_inclusion(LEAVES[index], index, size, other) != range_of(0, size), (size, index)
            assert root_of_inclusion(LEAVES[index + 1], index, size, proof) != range_of(0, size)


@pytest.mark.parametrize("start", range(1, 301, 100))
def test_a_proof_leads_to_the_root_from_no_other_place(start: int) -> None:
    for size in range(start, start + 100, 3):
        for index in {0, size // 3, size - 1}:
            proof = inclusion_proof(node, index, size)
            others = [
                other
                for other in range(-2, size + 2)
                if root_of_inclusion(LEAVES[index], other, size, proof) == range_of(0, size)
            ]
            assert others == [index]


@pytest.mark.slow
def test_a_proof_fits_another_size_only_where_the_way_up_is_the_same() -> None:
    """An inclusion proof alone does not hold the size; the checkpoint does, so its signature must cover both."""
    for size in range(1, 60):
        for index in range(size):
            proof = inclusion_proof(node, index, size)
            for other in range(-1, 130):
                is_led = root_of_inclusion(LEAVES[index], index, other, proof) == range_of(0, size)
                assert is_led == (index < other and sides(index, other) == sides(index, size)), (index, size, other)


def pairs() -> list[tuple[int, int]]:
    """Return every pair of sizes up to 64, and larger sizes with a few older ones each."""
    draw = random.Random(8)
    small = [(old, new) for new in range(1, 65) for old in range(1, new + 1)]
    return small + [
        (old, new) for new in range(65, 301) for old in sorted({1, new // 2, new - 1, new, 64, draw.randrange(1, new)})
    ]


def test_the_consistency_proof_of_every_pair_of_sizes_is_as_defined_and_convinces() -> None:
    for old, new in pairs():
        proof = consistency_proof(node, old, new)
        assert list(proof) == defined_subproof(old, 0, new, is_known=True)
        assert is_consistent(old, range_of(0, old), new, range_of(0, new), proof)


def test_no_damaged_consistency_proof_convinces() -> None:
    draw = random.Random(9)
    for old, new in pairs():
        proof = consistency_proof(node, old, new)
        roots = range_of(0, old), range_of(0, new)
        for other in damaged(proof, draw):
            assert not is_consistent(old, roots[0], new, roots[1], other), (old, new)
        assert not is_consistent(old, bytes(32), new, roots[1], proof)
        assert not is_consistent(old, roots[0], new, bytes(32), proof)
        if old < new:
            assert not is_consistent(old, roots[1], new, roots[0], proof)
            assert not is_consistent(new, roots[1], old, roots[0], proof)


def test_a_rewritten_leaf_has_no_consistency_proof() -> None:
    rewritten = [*LEAVES[:5], leaf_hash(b"another past"), *LEAVES[6:]]

    def other(height: int, number: int) -> bytes:
        return defined_root(rewritten[number << height : number + 1 << height])

    for old, new in ((6, 13), (8, 13), (7, 8), (12, 13), (13, 13)):
        proof = consistency_proof(other, old, new)
        assert is_consistent(old, defined_root(rewritten[:old]), new, defined_root(rewritten[:new]), proof)
        assert not is_consistent(old, range_of(0, old), new, defined_root(rewritten[:new]), proof)


def test_an_empty_tree_is_the_beginning_of_every_tree() -> None:
    assert consistency_proof(node, 0, 7) == consistency_proof(node, 7, 7) == ()
    assert is_consistent(0, EMPTY_ROOT, 7, range_of(0, 7), ())
    assert not is_consistent(0, range_of(0, 1), 7, range_of(0, 7), ())
    assert not is_consistent(0, EMPTY_ROOT, 7, range_of(0, 7), (bytes(32),))


@pytest.mark.parametrize(("index", "size"), [(-1, 5), (5, 5), (0, 0)])
def test_what_is_not_in_the_tree_has_no_proof(index: int, size: int) -> None:
    with pytest.raises(ValueError, match=f"index {index}"):
        inclusion_proof(node, index, size)
    assert root_of_inclusion(LEAVES[0], index, size, ()) is None


def test_an_older_tree_is_not_larger() -> None:
    with pytest.raises(ValueError, match="5 and 4"):
        consistency_proof(node, 5, 4)
    assert not is_consistent(5, range_of(0, 5), 4, range_of(0, 4), ())


# --- the test vectors of certificate-transparency (merkle_tree_test.cc), which count leaves from 0 here ---

VECTORS = [
    leaf_hash(bytes.fromhex(text))
    for text in ("", "00", "10", "2021", "3031", "40414243", "5051525354555657", "606162636465666768696a6b6c6d6e6f")
]
ROOTS = (
    "6e340b9cffb37a989ca544e6bb780a2c78901d3fb33738768511a30617afa01d",
    "fac54203e7cc696cf0dfcb42c92a1d9dbaf70ad9e621f4bd8d98662f00e3c125",
    "aeb6bcfe274b70a14fb067a5e5578264db0fa9b51af5e0ba159158f329e06e77",
    "d37ee418976dd95753c1c73862b9398fa2a2cf9b4ff0fdfe8b30cd95209614b7",
    "4e3bbb1f7b478dcfe71fb631631519a3bca12c9aefca1612bfce4c13a86264d4",
    "76e67dadbcdf1e10e1b74ddc608abd2f98dfb16fbce75277b5232a127f2087ef",
    "ddb89be403809e325750d3d263cd78929c2942b7942a34b77e122c9594a74c8c",
    "5dc9da79a70659a9ad559cb701ded9a2ab9d823aad2f4960cfe370eff4604328",
)
LEAF_1 = "96a296d224f285c67bee93c30f8a309157f0daa35dc5b87e410b78630a09cfc7"
LEAF_4 = "bc1a0643b12e4d2d7c77918f44e0f4f79a838b6cf9ec5b5c283e1f4d88599e6b"
LEAVES_2_3 = "5f083f0a1a33ca076a95279832580db3e0ef4584bdff1f54c8a360f50de3031e"
LEAVES_4_5 = "0ebc5d3437fbe2db158b9f126a1d118e308181031d0a949f8dededebc558ef6a"
LEAVES_6_7 = "ca854ea128ed050b41b35ffc1b87b8eb2bde461e9e3b5596ece6b9d5975a0ae0"
LEAVES_4_7 = "6b47aaf29ee3c2af9af889bc1fb9254dabd31177f16232dd6aab035ca39bf6e4"


def vector_node(height: int, number: int) -> bytes:
    return defined_root(VECTORS[number << height : number + 1 << height])


def hexes(proof: tuple[bytes, ...]) -> list[str]:
    return [one.hex() for one in proof]


@pytest.mark.parametrize("size", range(1, 9))
def test_the_published_root_of_each_size(size: int) -> None:
    assert root(VECTORS[:size]).hex() == tree_root(vector_node, size).hex() == ROOTS[size - 1]


@pytest.mark.parametrize(
    ("index", "size", "path"),
    [
        (0, 1, []),
        (0, 8, [LEAF_1, LEAVES_2_3, LEAVES_4_7]),
        (5, 8, [LEAF_4, LEAVES_6_7, ROOTS[3]]),
        (2, 3, [ROOTS[1]]),
        (1, 5, [ROOTS[0], LEAVES_2_3, LEAF_4]),
    ],
)
def test_the_published_inclusion_proofs(index: int, size: int, path: list[str]) -> None:
    proof = inclusion_proof(vector_node, index, size)
    assert hexes(proof) == path
    assert root_of_inclusion(VECTORS[index], index, size, proof) == bytes.fromhex(ROOTS[size - 1])


@pytest.mark.parametrize(
    ("old", "new", "path"),
    [
        (1, 1, []),
        (1, 8, [LEAF_1, LEAVES_2_3, LEAVES_4_7]),
        (6, 8, [LEAVES_4_5, LEAVES_6_7, ROOTS[3]]),
        (2, 5, [LEAVES_2_3, LEAF_4]),
    ],
)
def test_the_published_consistency_proofs(old: int, new: int, path: list[str]) -> None:
    proof = consistency_proof(vector_node, old, new)
    assert hexes(proof) == path
    assert is_consistent(old, bytes.fromhex(ROOTS[old - 1]), new, bytes.fromhex(ROOTS[new - 1]), proof)
