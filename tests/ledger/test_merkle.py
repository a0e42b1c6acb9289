import hashlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsar_ledger.ledger.merkle import EMPTY_ROOT, Frontier, leaf_hash, node_hash, root


def defined_root(leaves: list[bytes]) -> bytes:
    """MTH of RFC 6962, section 2.1, over leaf hashes, as it is written there."""
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


def test_the_known_roots_of_certificate_transparency() -> None:
    inputs = ["", "00", "10", "2021", "3031", "40414243", "5051525354555657", "606162636465666768696a6b6c6d6e6f"]
    leaves = [leaf_hash(bytes.fromhex(text)) for text in inputs]
    assert root(leaves[:3]).hex() == "aeb6bcfe274b70a14fb067a5e5578264db0fa9b51af5e0ba159158f329e06e77"
    assert root(leaves).hex() == "5dc9da79a70659a9ad559cb701ded9a2ab9d823aad2f4960cfe370eff4604328"


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
