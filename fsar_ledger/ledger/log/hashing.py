"""Hash many rows, and many pairs of hashes, in one call.

In C where that was built (`_hashing.c`), else with hashlib. Both give the same hashes.
"""

import hashlib
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np

HASH_BYTES = 32
_HASHED = np.dtype((np.void, 1 + 2 * HASH_BYTES))
_PAIRS_AT_ONCE = 512  # few enough to stay in the CPU caches

Hash: TypeAlias = Callable[[bytes], bytes]


def leaves_plainly(lines: bytes) -> bytes:
    """As `leaves`, with hashlib."""
    sha256 = hashlib.sha256
    rows = (b"\x00" + lines[:-1].replace(b"\n", b"\n\x00")).split(b"\n") if lines else []
    return b"".join([sha256(row).digest() for row in rows])


def parents_plainly(nodes: bytes) -> bytes:
    """As `parents`, with hashlib.

    Inputs are cut from one buffer, because joining each pair costs a fifth more.
    """
    sha256 = hashlib.sha256
    pairs = np.frombuffer(nodes, np.uint8).reshape(-1, 2 * HASH_BYTES)
    found = []
    for at in range(0, len(pairs), _PAIRS_AT_ONCE):
        some = pairs[at : at + _PAIRS_AT_ONCE]
        hashed = np.ones((len(some), 1 + 2 * HASH_BYTES), np.uint8)  # the first byte of each row stays 0x01
        hashed[:, 1:] = some
        cut: list[Any] = hashed.view(_HASHED).ravel().tolist()
        found.append(b"".join([sha256(one).digest() for one in cut]))
    return b"".join(found)


def leaves(lines: bytes) -> bytes:
    """Return the packed RFC 6962 leaf hashes of these lines, each ended by a line feed, which is not hashed."""
    return _leaves(lines)


def leaves_of(rows: Sequence[bytes]) -> bytes:
    """Return the packed RFC 6962 leaf hashes of these rows, which hold no line feed."""
    return _leaves(b"\n".join((*rows, b"")))


def parents(nodes: bytes) -> bytes:
    """Return the packed RFC 6962 hashes of each pair of packed hashes."""
    return _parents(nodes)


def _compiled() -> tuple[Hash, Hash] | None:
    try:
        from fsar_ledger.ledger.log import _hashing
    except ImportError:  # it was not built, as without a compiler
        return None
    return _hashing.leaves, _hashing.parents


_found = _compiled()
IS_COMPILED = _found is not None
"""Whether the hashes are made in C."""
_leaves, _parents = _found or (leaves_plainly, parents_plainly)
