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


@settings(max_examples=150, deadline=None)
@given(st.lists(st.integers(0, 40), max_size=8))
def test_growing_in_batches_of_any_size_gives_the_same_frontier(sizes: list[int]) -> None:
    frontier, at = Frontier(), 0
    for size in sizes:
        frontier = frontier.extend(b"".join(LEAVES[at : at + size]))
        at += min(size, len(LEAVES) - at)
    assert frontier == Frontier().extend(b"".join(LEAVES[:at]))


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
