"""Reads: what a decision looked up in the state, key by key, and which event last wrote it.

An observed decision gets a state that looks like the real one, notes what is read and returns plain values.
Structures, mappings and sets are walked; everything else is read whole. So a path names the smallest thing that a
decision can have depended on: a field of one action, the entry under one key, whether one robot is among those that
are off. Looking up a missing key reads its absence; iterating over a mapping reads all its keys.
"""

from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence, Set
from enum import Enum
from typing import Any, Literal, NamedTuple

import msgspec

from fsar_ledger.events import Event
from fsar_ledger.events.knowledge import CopySynced
from fsar_ledger.projections import SharedMap, fold
from fsar_ledger.projections.fold import ENDS, ROUTES, State, apply


class Absent(Enum):
    """The value of a read that finds nothing."""

    ABSENT = "absent"


ABSENT = Absent.ABSENT

Kind = Literal["field", "key", "has", "any", "keys", "size"]


class Step(NamedTuple):
    """A step into the state.

    `field`: to the field of this name; `key`: to the value under this key; `has`: to whether the key, or the member, is
    there; `any`: to whether anything is; `keys`: to all keys, in order, or all members; `size`: to how many there are.
    Only after the first two can another step follow.
    """

    kind: Kind
    name: Any = None


Path = tuple[Step, ...]
"""The way to a value; the first step is to a slot of the state."""
ReadValues = dict[Path, object]
"""What was read: each path, in order, with its value."""


class Reads:
    """What was read, in order: each path with its value."""

    def __init__(self) -> None:
        self.values: dict[Path, object] = {}

    def state(self, state: State) -> State:
        """Return the state as an observed decision sees it."""
        observed = State.__new__(State)
        for slot in State.__slots__:
            setattr(observed, slot, self.wrap_value(getattr(state, slot), (Step("field", slot),)))
        return observed

    def wrap_value(self, value: Any, path: Path) -> Any:
        """Return the value as a decision sees it, with its reads noted; a value without parts is itself noted."""
        match value:
            case dict() | SharedMap():
                return _Mapping(self, value, path)
            case frozenset():
                return _Set(self, value, path)
            case _ if is_walked(value):
                return _Structure(self, value, path)
            case _:
                return self.note(path, value)

    def note(self, path: Path, value: Any) -> Any:
        """Note a read, and return what was read."""
        self.values.setdefault(path, value)
        return value


def is_walked(value: object) -> bool:
    """Return whether a value is read field by field: a part of the state, and not an event or a constant in it."""
    return (type(value).__module__.startswith(_PROJECTIONS) and isinstance(value, msgspec.Struct)) or isinstance(
        value, CopySynced
    )


_PROJECTIONS = fold.__name__.rpartition(".")[0] + "."


class _Structure:
    """A structure, whose fields are read one by one."""

    __slots__ = ("_changes", "_path", "_reads", "_value")

    def __init__(self, reads: Reads, value: Any, path: Path, changes: Mapping[str, object] | None = None) -> None:
        self._reads, self._value, self._path, self._changes = reads, value, path, changes or {}

    def __getattr__(self, name: str) -> Any:
        if name in self._changes:
            return self._changes[name]
        member = getattr(type(self._value), name, None)
        if isinstance(member, property) and member.fget is not None:
            return member.fget(self)
        return self._reads.wrap_value(getattr(self._value, name), (*self._path, Step("field", name)))

    def __replace__(self, **changes: object) -> "_Structure":
        return _Structure(self._reads, self._value, self._path, {**self._changes, **changes})

    def __eq__(self, other: object) -> bool:
        return _plain_value(self) == _plain_value(other)

    __hash__ = None  # type: ignore[assignment]


def _plain_value(value: object) -> object:
    """Return the plain value, which is read as a whole."""
    if not isinstance(value, _Structure):
        return value
    return msgspec.structs.replace(value._reads.note(value._path, value._value), **value._changes)


class _Members:
    """A container whose keys or members are looked up one by one."""

    __slots__ = ("_path", "_reads", "_value")

    def __init__(self, reads: Reads, value: Any, path: Path) -> None:
        self._reads, self._value, self._path = reads, value, path

    def _note(self, step: Step, value: Any) -> Any:
        return self._reads.note((*self._path, step), value)

    def __contains__(self, key: object) -> bool:
        return bool(self._note(Step("has", key), key in self._value))

    def __len__(self) -> int:
        return int(self._note(Step("size"), len(self._value)))

    def __bool__(self) -> bool:
        return bool(self._note(Step("any"), bool(self._value)))


class _Mapping(_Members, Mapping[Any, Any]):
    """A mapping, whose entries are read one by one."""

    __slots__ = ()

    def __getitem__(self, key: Hashable) -> Any:
        path = (*self._path, Step("key", key))
        if key not in self._value:
            self._reads.note(path, ABSENT)
            raise KeyError(key)
        value = self._reads.wrap_value(self._value[key], path)
        if isinstance(value, _Structure | _Members):
            _ = key in self
        return value

    def __iter__(self) -> Iterator[Any]:
        return iter(self._note(Step("keys"), tuple(self._value)))


class _Set(_Members, Set[Any]):
    """A set, whose members are looked up one by one."""

    __slots__ = ()

    def __iter__(self) -> Iterator[Any]:
        return iter(self._note(Step("keys"), self._value))

    @classmethod
    def _from_iterable(cls, members: Iterable[Any]) -> Any:
        return frozenset(members)


def read_step(value: Any, step: Step) -> Any:
    """Return what this step of a read finds; nothing where the path ends early."""
    match step:
        case Step("field", name):
            return ABSENT if value is ABSENT else getattr(value, name)
        case Step("key", name):
            return ABSENT if value is ABSENT else value.get(name, ABSENT)
        case Step("has", name):
            return value is not ABSENT and name in value
        case Step("any"):
            return value is not ABSENT and bool(value)
        case Step("size"):
            return 0 if value is ABSENT else len(value)
        case _:
            return () if value is ABSENT else tuple(value) if isinstance(value, dict | SharedMap) else value


class LastWrite(NamedTuple):
    """The last write to a path: the seq of the event that wrote its value, and of those that wrote its elements.

    `by` is None for what was there before the first event. `elements` are the events since which each element of a
    list, a set or a mapping's keys has been there; empty for anything else.
    """

    by: int | None
    elements: tuple[int, ...] = ()


class _WatchedPath:
    """A path in the state, the paths watched below it, and the changes of its value if it is itself read.

    A change is the seq of an event, and the seqs since which the elements of the new value have been there.
    """

    __slots__ = ("below", "changes", "since")

    def __init__(self) -> None:
        self.below: dict[Step, _WatchedPath] = {}
        self.changes: list[tuple[int, tuple[int, ...]]] | None = None
        self.since: dict[Any, int] = {}

    def watch_path(self, path: Path) -> "_WatchedPath":
        """Return the node at the path from here, and watch all nodes on the way."""
        node = self
        for step in path:
            node = node.below.setdefault(step, _WatchedPath())
        return node

    def look(self, before: object, after: object, seq: int) -> None:
        """Note what the event with this seq changed here and below; what it did not change is the same object."""
        if before is after:
            return
        if self.changes is not None and before != after:
            members: Iterable[Any] = after if isinstance(after, tuple | frozenset) else ()
            self.since = {member: self.since.get(member, seq) for member in members}
            self.changes.append((seq, tuple(sorted(set(self.since.values())))))
        for step, below in self.below.items():
            below.look(read_step(before, step), read_step(after, step), seq)

    def before(self, seq: int) -> LastWrite:
        """Return the last write before the event with this seq."""
        changes = [change for change in self.changes or () if change[0] < seq]
        return LastWrite(*changes[-1]) if changes else LastWrite(None)


def last_writes(events: Sequence[Event], asked: Iterable[tuple[Path, int]]) -> dict[tuple[Path, int], LastWrite]:
    """Return, for each path and seq, which events had written its value before the event with that seq."""
    queries = list(asked)
    root = _WatchedPath()
    for path, _ in queries:
        root.watch_path(path).changes = []
    state = State()
    for seq in range(max((seq for _, seq in queries), default=0)):
        kind = type(events[seq])
        names = State.__slots__ if kind in ENDS else [slot for slot, _ in ROUTES.get(kind, ())]
        slots = [(slot, getattr(state, slot)) for slot in names]
        apply(state, events[seq])
        for slot, previous in slots:
            root.watch_path((Step("field", slot),)).look(previous, getattr(state, slot), seq)
    return {(path, seq): root.watch_path(path).before(seq) for path, seq in queries}


class Read(msgspec.Struct, frozen=True):
    """What a decision read at one place of the state, and which event wrote it.

    Attributes:
        place: Where: a slot of the state, and the fields and keys that lead on, as `world.local` or
            `request[A1-1/2.1]`.
        name: What of it: a field, the value under a `[key]`, `has KEY` (or member), `any`, all `keys` (or members), or
            the `size`; for a key of several parts, `*` stands for all.
        value: What was found there, as JSON types; None if `is_absent`.
        is_absent: Whether nothing was found.
        written_by: The seq of the event that last wrote it; None if it is unchanged since before the first event.
        elements: Of a list, a set or keys, the seqs of the events since which each element is there.
    """

    place: str
    name: str
    value: Any
    is_absent: bool
    written_by: int | None
    elements: tuple[int, ...]


def described(values: ReadValues, seq: int, writers: Mapping[tuple[Path, int], LastWrite]) -> Iterator[Read]:
    """Yield what was read just before the event with this seq, each with the event that last wrote it."""
    for path, value in values.items():
        path_text, name = _words(path)
        write = writers[path, seq]
        ordered = sorted(value) if isinstance(value, frozenset) else value
        plain = None if ordered is ABSENT else msgspec.to_builtins(ordered, str_keys=True, enc_hook=str)
        yield Read(path_text, name, plain, value is ABSENT, write.by, write.elements)


def _words(path: Path) -> tuple[str, str]:
    """Return the place that the path leads to, and what is read of it."""
    text = path[0].name
    for step in path[1:-1]:
        text += f".{step.name}" if step.kind == "field" else f"[{_key(step.name)}]"
    if len(path) == 1:
        return text, "whole"
    kind, name = path[-1]
    match kind:
        case "field":
            return text, name
        case "key":
            return text, f"[{_key(name)}]"
        case "has":
            return text, f"has {_key(name)}"
        case _:
            return text, kind


def _key(key: object) -> str:
    """Return the key as text; a key of several parts has `*` for None, which stands for all."""
    parts = key if isinstance(key, tuple) else (key,)
    return ", ".join("*" if part is None else str(part) or '""' for part in parts)
