"""Hashes made in C and with hashlib are the same."""

import hashlib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsar_ledger.ledger.log import hashing
from fsar_ledger.ledger.log.hashing import (
    HASH_BYTES,
    Added,
    Extended,
    Roots,
    added,
    added_plainly,
    digests,
    digests_plainly,
    extended,
    extended_plainly,
    leaves,
    leaves_of,
    leaves_plainly,
    parents,
    parents_plainly,
    roots,
    roots_plainly,
)
from fsar_ledger.ledger.log.merkle import Frontier, root
from fsar_ledger.ledger.verify import verify
from tests.ledger.samples import append_all, contents, made_up_batches

ROWS = st.lists(st.binary(max_size=300).map(lambda row: row.replace(b"\n", b" ")), max_size=20)
"""SHA-256 takes blocks of 64 bytes, the last one with 9 bytes more: 300 bytes pass every border four times."""


@given(ROWS)
def test_a_leaf_is_the_hash_of_a_zero_byte_and_the_row(rows: list[bytes]) -> None:
    expected = b"".join(hashlib.sha256(b"\x00" + row).digest() for row in rows)
    lines = b"".join(row + b"\n" for row in rows)
    assert leaves(lines) == leaves_plainly(lines) == leaves_of(rows) == expected


def test_rows_of_every_length_are_hashed_alike() -> None:
    for size in range(400):
        lines = b"x" * size + b"\n" + b"\x80" * size + b"\n"
        assert leaves(lines) == leaves_plainly(lines), size


@given(st.integers(0, 40).flatmap(lambda pairs: st.binary(min_size=64 * pairs, max_size=64 * pairs)))
def test_a_node_is_the_hash_of_a_one_byte_and_its_children(nodes: bytes) -> None:
    pairs = [nodes[at : at + 2 * HASH_BYTES] for at in range(0, len(nodes), 2 * HASH_BYTES)]
    expected = b"".join(hashlib.sha256(b"\x01" + pair).digest() for pair in pairs)
    assert parents(nodes) == parents_plainly(nodes) == expected


@given(st.lists(st.binary(max_size=300), max_size=20))
def test_a_digest_is_the_hash_of_the_text_alone(texts: list[bytes]) -> None:
    expected = [hashlib.sha256(text).hexdigest() for text in texts]
    assert digests(texts) == expected == [one.hex() for one in cut(digests_plainly(texts))]


def test_texts_of_every_length_have_their_digest() -> None:
    texts = [b"\x80" * size for size in range(400)]
    assert digests(texts) == [hashlib.sha256(text).hexdigest() for text in texts]


def cut(packed: bytes) -> list[bytes]:
    return [packed[at : at + HASH_BYTES] for at in range(0, len(packed), HASH_BYTES)]


def hashes(count: int) -> list[bytes]:
    return [hashlib.sha256(bytes([number % 256, number // 256])).digest() for number in range(count)]


@given(st.integers(0, 70), st.lists(st.integers(0, 90), max_size=8))
def test_the_root_at_each_size_is_that_of_the_tree_with_so_many_leaves(size: int, more: list[int]) -> None:
    found = hashes(size + max(more, default=0))
    sizes = sorted({size + some for some in more} - {0})
    tree = Frontier().extend(b"".join(found[:size]))
    given_before = size, b"".join(tree.subtrees), b"".join(found[size:]), sizes
    expected = [root(found[:one]) for one in sizes]
    assert tree.roots(given_before[2], sizes) == expected
    assert roots(*given_before) == roots_plainly(*given_before) == b"".join(expected)


@given(st.integers(0, 70), st.integers(0, 90))
def test_a_tree_grows_by_many_leaves_as_by_one_after_the_other(size: int, more: int) -> None:
    found = hashes(size + more)
    tree = Frontier()
    for leaf in found[:size]:
        tree = tree.extend(leaf)
    before = size, b"".join(tree.subtrees), b"".join(found[size:])
    for leaf in found[size:]:
        tree = tree.extend(leaf)
    assert extended(*before) == extended_plainly(*before) == b"".join(tree.subtrees)
    assert tree.root() == root(found)


@given(st.integers(0, 70), ROWS.filter(len))
def test_lines_are_hashed_and_added_to_a_tree_at_once(size: int, rows: list[bytes]) -> None:
    before = Frontier().extend(b"".join(hashes(size)))
    lines = b"".join(row + b"\n" for row in rows)
    after = before.extend(leaves(lines))
    assert before.add(lines) == (leaves(lines), after, after.root())
    given_all = size, before.packed, lines
    assert added(*given_all) == added_plainly(*given_all) == (leaves(lines), after.packed, after.root())


@pytest.mark.parametrize("rows", [1, 100, 2_000])
def test_many_lines_are_hashed_and_added_while_other_threads_run(rows: int) -> None:
    lines = b"".join(b"%d\n" % number * (number % 7 + 1) for number in range(rows))
    assert added(3, bytes(64), lines) == added_plainly(3, bytes(64), lines)


@pytest.mark.parametrize("added_of", [added, added_plainly])
@pytest.mark.parametrize(("size", "subtrees", "lines"), [(0, b"", b""), (0, b"", b"a\nb"), (2, b"", b"a\n")])
def test_lines_that_do_not_end_and_trees_of_no_such_size_are_refused(
    added_of: Added, size: int, subtrees: bytes, lines: bytes
) -> None:
    with pytest.raises(ValueError, match=r"found no lines|does not end|those of a tree"):
        added_of(size, subtrees, lines)


@pytest.mark.parametrize("extended_of", [extended, extended_plainly])
@pytest.mark.parametrize(("size", "subtrees", "leaves_"), [(3, 1, 4), (3, 3, 4), (0, 1, 0), (3, 2.5, 4), (3, 2, 1.5)])
def test_a_tree_of_no_such_size_does_not_grow(
    extended_of: Extended, size: int, subtrees: float, leaves_: float
) -> None:
    with pytest.raises(ValueError, match="those of a tree"):
        extended_of(size, bytes(int(subtrees * HASH_BYTES)), bytes(int(leaves_ * HASH_BYTES)))


@pytest.mark.parametrize("roots_of", [roots, roots_plainly])
@pytest.mark.parametrize(
    ("size", "subtrees", "leaves_", "sizes"),
    [
        (3, 1, 4, [5]),
        (3, 3, 4, [5]),
        (3, 2, 4, [2]),
        (3, 2, 4, [5, 4]),
        (3, 2, 4, [8]),
        (0, 0, 4, [0]),
        (3, 2.5, 4, []),
    ],
)
def test_sizes_and_hashes_of_no_tree_are_refused(
    roots_of: Roots, size: int, subtrees: float, leaves_: int, sizes: list[int]
) -> None:
    with pytest.raises(ValueError, match=r"those of a tree|expected more, and leaves for it"):
        roots_of(size, bytes(int(subtrees * HASH_BYTES)), bytes(leaves_ * HASH_BYTES), sizes)


@pytest.mark.skipif(not hashing.IS_COMPILED, reason="the hashes are not made in C here: no compiler when it was set up")
def test_what_is_no_bytes_or_no_whole_input_is_refused_by_the_compiled_functions() -> None:
    with pytest.raises(TypeError):
        leaves("text")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="the last line does not end"):
        leaves(b"a\nb")
    with pytest.raises(ValueError, match="found 65 bytes, expected pairs of hashes"):
        parents(b"x" * 65)
    with pytest.raises(TypeError):
        digests([b"bytes", "text"])  # type: ignore[list-item]
    with pytest.raises(TypeError, match="found no list"):
        digests((b"bytes",))  # type: ignore[arg-type]


def test_a_ledger_is_the_same_without_the_compiled_functions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    append_all(tmp_path / "one", made_up_batches(2, size=200))
    monkeypatch.setattr(hashing, "_leaves", leaves_plainly)
    monkeypatch.setattr(hashing, "_digests", digests_plainly)
    monkeypatch.setattr(hashing, "_parents", parents_plainly)
    monkeypatch.setattr(hashing, "_extended", extended_plainly)
    monkeypatch.setattr(hashing, "_roots", roots_plainly)
    append_all(tmp_path / "other", made_up_batches(2, size=200))
    assert contents(tmp_path / "one") == contents(tmp_path / "other")
    assert verify(tmp_path / "one").ok
