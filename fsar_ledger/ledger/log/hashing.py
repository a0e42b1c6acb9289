"""Hash many texts, or many pairs of hashes, in one call.

In C if that was built (`_hashing.c`), otherwise with hashlib. Both give the same hashes.
"""

import hashlib
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np

HASH_BYTES = 32
_HASHED = np.dtype((np.void, 1 + 2 * HASH_BYTES))
_PAIRS_AT_ONCE = 512  # few enough to stay in the CPU caches

Hash: TypeAlias = Callable[[bytes], bytes]
Digests: TypeAlias = Callable[[list[bytes]], bytes]
Extended: TypeAlias = Callable[[int, bytes, bytes], bytes]
Added: TypeAlias = Callable[[int, bytes, bytes], tuple[bytes, bytes, bytes]]
Roots: TypeAlias = Callable[[int, bytes, bytes, list[int]], bytes]


def sha256_hex(data: bytes) -> str:
    """Return the SHA-256 in hex."""
    return hashlib.sha256(data).hexdigest()


def leaves_plainly(lines: bytes) -> bytes:
    """Return the result of `leaves`, with hashlib."""
    sha256 = hashlib.sha256
    rows = (b"\x00" + lines[:-1].replace(b"\n", b"\n\x00")).split(b"\n") if lines else []
    return b"".join([sha256(row).digest() for row in rows])


def digests_plainly(texts: list[bytes]) -> bytes:
    """Return the packed SHA-256 of each of these texts, with hashlib."""
    sha256 = hashlib.sha256
    return b"".join([sha256(text).digest() for text in texts])


def parents_plainly(nodes: bytes) -> bytes:
    """Return the result of `parents`, with hashlib.

    Inputs are cut from one buffer, because joining each pair costs a fifth more.
    """
    sha256 = hashlib.sha256
    pairs = np.frombuffer(nodes, np.uint8).reshape(-1, 2 * HASH_BYTES)
    levels = []
    for start in range(0, len(pairs), _PAIRS_AT_ONCE):
        batch = pairs[start : start + _PAIRS_AT_ONCE]
        hashed = np.ones((len(batch), 1 + 2 * HASH_BYTES), np.uint8)  # the first byte of each row stays 0x01
        hashed[:, 1:] = batch
        cut: list[Any] = hashed.view(_HASHED).ravel().tolist()
        levels.append(b"".join([sha256(pair).digest() for pair in cut]))
    return b"".join(levels)


def _subtrees_of(size: int, subtrees: bytes, leaves: bytes) -> list[bytes]:
    """Split these packed subtrees, largest first. Raises: ValueError if they do not fit a tree of this size."""
    if len(subtrees) != size.bit_count() * HASH_BYTES or len(leaves) % HASH_BYTES:
        raise ValueError("found subtrees or leaves that are not those of a tree")
    return [subtrees[start : start + HASH_BYTES] for start in range(0, len(subtrees), HASH_BYTES)]


def _add_leaf(stack: list[bytes], size: int, leaf: bytes) -> None:
    """Add a leaf to a tree of `size` leaves, given by its complete subtrees, largest first."""
    node = leaf
    while size & 1:
        node, size = hashlib.sha256(b"\x01" + stack.pop() + node).digest(), size >> 1
    stack.append(node)


def extended_plainly(size: int, subtrees: bytes, leaves: bytes) -> bytes:
    """Return the result of `extended`, with hashlib."""
    stack = _subtrees_of(size, subtrees, leaves)
    for offset, start in enumerate(range(0, len(leaves), HASH_BYTES)):
        _add_leaf(stack, size + offset, leaves[start : start + HASH_BYTES])
    return b"".join(stack)


def added_plainly(size: int, subtrees: bytes, lines: bytes) -> tuple[bytes, bytes, bytes]:
    """Return the result of `added`, with hashlib."""
    added = leaves_plainly(lines)
    if not added or lines[-1:] != b"\n":
        raise ValueError("found no lines, or a last one that does not end; expected at least one")
    new_size = size + len(added) // HASH_BYTES
    return added, extended_plainly(size, subtrees, added), roots_plainly(size, subtrees, added, [new_size])


def roots_plainly(size: int, subtrees: bytes, leaves: bytes, sizes: list[int]) -> bytes:
    """Return the result of `roots`, with hashlib."""
    stack = _subtrees_of(size, subtrees, leaves)
    roots = []
    offset = 0
    for target in sizes:
        if target < max(size, 1) or (target - size) * HASH_BYTES > len(leaves) - offset:
            raise ValueError(f"found size {target}, expected more, and leaves for it")
        while size < target:
            _add_leaf(stack, size, leaves[offset : offset + HASH_BYTES])
            size, offset = size + 1, offset + HASH_BYTES
        root = stack[-1]
        for subtree in reversed(stack[:-1]):
            root = hashlib.sha256(b"\x01" + subtree + root).digest()
        roots.append(root)
    return b"".join(roots)


def leaves(lines: bytes) -> bytes:
    """Return the packed RFC 6962 leaf hashes of these lines, each ended by a line feed, which is not hashed."""
    return _leaves(lines)


def leaves_of(rows: Sequence[bytes]) -> bytes:
    """Return the packed RFC 6962 leaf hashes of these rows, which hold no line feed."""
    return _leaves(b"\n".join((*rows, b"")))


def digests(texts: list[bytes]) -> list[str]:
    """Return the SHA-256 of each of these texts, in hex."""
    packed = _digests(texts).hex()
    return [packed[start : start + 2 * HASH_BYTES] for start in range(0, len(packed), 2 * HASH_BYTES)]


def parents(nodes: bytes) -> bytes:
    """Return the packed RFC 6962 hashes of each pair of packed hashes."""
    return _parents(nodes)


def extended(size: int, subtrees: bytes, leaves: bytes) -> bytes:
    """Return the packed complete subtrees, largest first, of a tree after these packed leaf hashes are added.

    Before, it has `size` leaves and these packed complete subtrees. Costs one hash per leaf.

    Raises: ValueError if they are not those of a tree.
    """
    return _extended(size, subtrees, leaves)


def added(size: int, subtrees: bytes, lines: bytes) -> tuple[bytes, bytes, bytes]:
    """Return the packed leaf hashes of these lines, and the packed subtrees and root of the tree after adding them.

    Before, it has `size` leaves and these subtrees.

    Raises: ValueError as `extended`, and if there are no lines, or the last one lacks its line feed.
    """
    return _added(size, subtrees, lines)


def roots(size: int, subtrees: bytes, leaves: bytes, sizes: list[int]) -> bytes:
    """Return the packed roots of a tree at each of these ascending sizes, as these packed leaf hashes are added.

    Before, it has `size` leaves and these packed complete subtrees, largest first.

    Raises: ValueError for a size below the one before, and if leaves are missing.
    """
    return _roots(size, subtrees, leaves, sizes)


# See docs/decisions/c-is-optional.md.
def _compiled() -> tuple[Hash, Digests, Hash, Extended, Added, Roots] | None:
    try:
        from fsar_ledger.ledger.log import _hashing
    except ImportError:  # it was not built, for example without a compiler
        return None
    return _hashing.leaves, _hashing.digests, _hashing.parents, _hashing.extended, _hashing.added, _hashing.roots


_found = _compiled()
IS_COMPILED = _found is not None
"""Whether hashes are computed in C."""
_leaves, _digests, _parents, _extended, _added, _roots = _found or (
    leaves_plainly,
    digests_plainly,
    parents_plainly,
    extended_plainly,
    added_plainly,
    roots_plainly,
)
