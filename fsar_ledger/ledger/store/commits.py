"""The commits of a chain, the older ones packed: a live ledger has one for each command, a million in a year."""

from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from typing import overload

import msgspec
import pyarrow as pa

from .record import Commit

_PACKED = 4096
"""So many commits are packed together, and unpacked when one of them is asked for."""
_ENCODER, _DECODER = msgspec.msgpack.Encoder(), msgspec.msgpack.Decoder(list[Commit])


# See docs/decisions/commits-are-packed.md.
class Commits(Sequence[Commit]):
    """Commits in their order. `sizes` are the events of the tree after each of them."""

    def __init__(self) -> None:
        self.sizes = array("q")
        self._packs: list[tuple[int, bytes]] = []  # what each has unpacked, in bytes, and packed
        self._recent: list[Commit] = []
        self._unpacked: tuple[int, list[Commit]] = -1, []  # the number of a pack, and what it holds

    def __len__(self) -> int:
        return len(self.sizes)

    @overload
    def __getitem__(self, at: int) -> Commit: ...
    @overload
    def __getitem__(self, at: slice) -> list[Commit]: ...
    def __getitem__(self, at: int | slice) -> Commit | list[Commit]:
        if isinstance(at, slice):
            return [self[number] for number in range(*at.indices(len(self)))]
        number = at + len(self) if at < 0 else at
        if not 0 <= number < len(self):
            raise IndexError(f"commit {at} of {len(self)}")
        recent = number - len(self._packs) * _PACKED
        return self._recent[recent] if recent >= 0 else self._pack(number // _PACKED)[number % _PACKED]

    def __iter__(self) -> Iterator[Commit]:
        return chain(chain.from_iterable(map(self._pack, range(len(self._packs)))), self._recent)

    def up_to(self, size: int) -> int:
        """Return how many of these commits are of the first so many events."""
        return bisect_right(self.sizes, size)

    def ending_at(self, size: int) -> Commit | None:
        """Return the commit after which the tree has so many events; None if there is none."""
        at = bisect_left(self.sizes, size)
        return self[at] if at < len(self) and self.sizes[at] == size else None

    def within(self, first: int, end: int) -> list[Commit]:
        """Return the commits that end after the first of these events, and no later than the last."""
        return self[self.up_to(first) : self.up_to(end)]

    def extend(self, commits: Iterable[Commit]) -> None:
        """Add these after the others."""
        added = list(commits)
        self._recent += added
        self.sizes.extend([commit.tree_size for commit in added])

    def cut(self, count: int) -> None:
        """Keep the first so many."""
        while count < len(self._packs) * _PACKED:
            self._recent[:0] = self._pack(len(self._packs) - 1)
            self._packs.pop()
            self._unpacked = -1, []
        del self._recent[count - len(self._packs) * _PACKED :], self.sizes[count:]

    def let_go(self, count: int) -> None:
        """Forget the first so many; the others are counted from 0 then."""
        self._recent, self.sizes = self[count:], self.sizes[count:]
        self._packs, self._unpacked = [], (-1, [])

    def pack(self, count: int) -> None:
        """Pack what is old among the first so many."""
        while count - len(self._packs) * _PACKED >= 2 * _PACKED:
            data = _ENCODER.encode(self._recent[:_PACKED])
            self._packs.append((len(data), pa.compress(data, codec="zstd", asbytes=True)))
            del self._recent[:_PACKED]

    def _pack(self, number: int) -> list[Commit]:
        if self._unpacked[0] != number:
            size, data = self._packs[number]
            self._unpacked = number, _DECODER.decode(pa.decompress(data, size, codec="zstd", asbytes=True))
        return self._unpacked[1]
