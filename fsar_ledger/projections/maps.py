"""Mappings that never change: with one more entry, or without one, there is a new mapping.

A small one is a dict, which is copied. A large one shares all but a few entries with the one that it came from, so an
event costs as much in a fleet of thousands as in one of four. Entries are in the order in which a dict has them, so
what iterates over a mapping does the same in every process.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import Generic, TypeVar

K = TypeVar("K")
V = TypeVar("V")

_LARGE = 192  # entries: from here on, copying a dict takes longer than a change of a `Large`


class Large(Mapping[K, V], Generic[K, V]):
    """A mapping in parts, of which a change copies one. Entries hold the serial of their key."""

    __slots__ = ("_next", "_parts", "_size")

    def __init__(self, parts: tuple[dict[K, tuple[int, V]], ...], size: int, after: int) -> None:
        self._parts = parts
        self._size = size
        self._next = after

    @classmethod
    def of(cls, entries: Mapping[K, V]) -> "Large[K, V]":
        """Return a mapping of these entries, in their order, in about as many parts as each has entries."""
        count = 1 << len(entries).bit_length() // 2
        parts: tuple[dict[K, tuple[int, V]], ...] = tuple({} for _ in range(count))
        for serial, (key, value) in enumerate(entries.items()):
            parts[hash(key) & count - 1][key] = serial, value
        return cls(parts, len(entries), len(entries))

    def __len__(self) -> int:
        return self._size

    def __iter__(self) -> Iterator[K]:
        found = [(serial, key) for part in self._parts for key, (serial, _) in part.items()]
        found.sort(key=lambda one: one[0])
        return iter([key for _, key in found])

    def __getitem__(self, key: K) -> V:
        parts = self._parts
        return parts[hash(key) & len(parts) - 1][key][1]

    def __contains__(self, key: object) -> bool:
        parts = self._parts
        return key in parts[hash(key) & len(parts) - 1]

    def get(self, key: K, default: V | None = None) -> V | None:  # type: ignore[override]  # `Mapping` has overloads
        """Return the value of the key, or the default."""
        parts = self._parts
        found = parts[hash(key) & len(parts) - 1].get(key)
        return default if found is None else found[1]

    def among(self, keys: Iterable[K]) -> set[K]:
        """Return those of these keys that it has."""
        parts, mask = self._parts, len(self._parts) - 1
        return {key for key in keys if key in parts[hash(key) & mask]}

    def put(self, key: K, value: V) -> "Large[K, V]":
        """Return the mapping with this value of the key."""
        parts = self._parts
        at = hash(key) & len(parts) - 1
        known = parts[at].get(key)
        part = {**parts[at], key: (self._next if known is None else known[0], value)}
        if known is not None:
            return Large((*parts[:at], part, *parts[at + 1 :]), self._size, self._next)
        grown = Large((*parts[:at], part, *parts[at + 1 :]), self._size + 1, self._next + 1)
        return Large.of(grown) if grown._size > 8 * len(parts) ** 2 else grown

    def without(self, key: K) -> "Large[K, V]":
        """Return the mapping without this key, which it has."""
        parts = self._parts
        at = hash(key) & len(parts) - 1
        part = {**parts[at]}
        del part[key]
        return Large((*parts[:at], part, *parts[at + 1 :]), self._size - 1, self._next)


def among(entries: Mapping[K, V], keys: Iterable[K]) -> set[K]:
    """Return those of these keys that the mapping has."""
    return entries.among(keys) if isinstance(entries, Large) else {key for key in keys if key in entries}


def put(entries: Mapping[K, V], key: K, value: V) -> Mapping[K, V]:
    """Return the mapping with this value of the key."""
    if type(entries) is not Large:  # quicker than isinstance, and most are small
        return {**entries, key: value} if len(entries) < _LARGE else Large.of({**entries, key: value})
    return entries.put(key, value)


def without(entries: Mapping[K, V], key: K) -> Mapping[K, V]:
    """Return the mapping without this key; the same one if it does not have it."""
    if key not in entries:
        return entries
    if type(entries) is Large:
        return entries.without(key)
    left = {**entries}
    del left[key]
    return left
