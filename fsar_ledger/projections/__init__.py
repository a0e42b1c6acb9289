"""Projections: state rebuilt from events. One file per concept, each with `INITIAL`, `evolve` and `HANDLES`.

State consists of mappings that never change: adding or removing an entry gives a new mapping. A small one is a dict,
which is copied. The versions of a large one share the dict of the newest, so an event costs as much in a fleet of
thousands as in one of four. Entries keep the order of a dict, so iterating over a mapping does the same in every
process.
"""

from collections.abc import ItemsView, Iterator, KeysView, Mapping, ValuesView
from typing import Generic, TypeVar

K = TypeVar("K")
V = TypeVar("V")

# See docs/decisions/large-mappings-share-one-dict.md.
_SHARED_FROM = 192  # entries from which copying a dict takes longer than changing a `SharedMap`
_SHARE = 16
"""A chain has at most a 16th as many changes as entries. With more, the changes outgrow the caches; with fewer, copying
the dict for another chain takes longer.
"""


class VersionChain(Generic[K, V]):
    """Versions of one mapping, each a change of the one before: number n is `first` after n of the `changes`.

    A change is a key and its value; without a value, the key was removed. `newest` is the last version.
    """

    __slots__ = ("changes", "first", "most", "newest")

    def __init__(self, first: dict[K, V]) -> None:
        self.first = first
        self.changes: list[tuple[K] | tuple[K, V]] = []
        self.newest = {**first}
        # The most changes before another chain begins, and so the most that an old version holds.
        self.most = max(_SHARED_FROM, len(first) // _SHARE)


class SharedMap(Mapping[K, V], Generic[K, V]):
    """One of the versions of a mapping. The newest is as quick as a dict; an older one is rebuilt when it is read.

    A chain with too many changes is abandoned: its newest dict, which none of its versions uses now, begins another.

    Not for threads that share versions of one mapping.
    """

    __slots__ = ("_line", "_number")

    def __init__(self, line: VersionChain[K, V], number: int = 0) -> None:
        self._line = line
        self._number = number

    @classmethod
    def of(cls, entries: dict[K, V]) -> "SharedMap[K, V]":
        """Return a mapping of these entries; the dict must not be changed afterwards."""
        return cls(VersionChain(entries))

    def __len__(self) -> int:
        return len(self._entries())

    def __iter__(self) -> Iterator[K]:
        return iter([*self._entries()])  # another version may be made meanwhile

    def __getitem__(self, key: K) -> V:
        return self._entries()[key]

    def __contains__(self, key: object) -> bool:
        return key in self._entries()

    def get(self, key: K, default: V | None = None) -> V | None:  # type: ignore[override]  # `Mapping` has overloads
        """Return the value of the key, or the default."""
        chain = self._line
        if self._number == len(chain.changes):
            return chain.newest.get(key, default)
        return self._entries().get(key, default)

    # `Mapping` looks each key up, which takes ten times as long as a copy.
    def items(self) -> ItemsView[K, V]:
        """Return the entries as they are now."""
        return self._entries().copy().items()

    def values(self) -> ValuesView[V]:
        """Return the values as they are now."""
        return self._entries().copy().values()

    def among(self, keys: KeysView[K]) -> set[K]:
        """Return which of these keys it has."""
        return keys & self._entries().keys()

    def put(self, key: K, value: V) -> "SharedMap[K, V]":
        """Return the mapping with this value of the key."""
        entries, chain = self._entries(), self._line
        entries[key] = value
        changes = chain.changes
        changes.append((key, value))
        return SharedMap(chain, len(changes)) if len(changes) <= chain.most else SharedMap.of(entries)

    def without(self, key: K) -> "SharedMap[K, V]":
        """Return the mapping without this key, which it has."""
        entries, chain = self._entries(), self._line
        del entries[key]
        changes = chain.changes
        changes.append((key,))
        return SharedMap(chain, len(changes)) if len(changes) <= chain.most else SharedMap.of(entries)

    def _entries(self) -> dict[K, V]:
        """Return the entries of this version, which becomes the newest of its chain; if necessary, of a new chain."""
        chain = self._line
        if self._number != len(chain.changes):
            entries = {**chain.first}
            for key, *value in chain.changes[: self._number]:
                if value:
                    entries[key] = value[0]
                else:
                    del entries[key]
            chain = self._line = VersionChain(entries)
            self._number = 0
        return chain.newest


def among(entries: Mapping[K, V], keys: KeysView[K]) -> set[K]:
    """Return which of these keys of a dict the mapping has; the smaller of the two is searched."""
    return entries.among(keys) if isinstance(entries, SharedMap) else keys & entries.keys()


def put(entries: Mapping[K, V], key: K, value: V) -> Mapping[K, V]:
    """Return the mapping with this value of the key."""
    if type(entries) is not SharedMap:  # quicker than isinstance, and most are small
        return {**entries, key: value} if len(entries) < _SHARED_FROM else SharedMap.of({**entries, key: value})
    return entries.put(key, value)


def without(entries: Mapping[K, V], key: K) -> Mapping[K, V]:
    """Return the mapping without this key; the same one if it does not have it."""
    if key not in entries:
        return entries
    if type(entries) is SharedMap:
        return entries.without(key)
    left = {**entries}
    del left[key]
    return left
