"""States in which only what was read is left: a decision that read nothing else decides the same on them."""

from typing import Any, NoReturn

from fsar_ledger.analysis.reads import Path, Step, is_walked
from fsar_ledger.projections.fold import State


class Unread:
    """What stands in the place of what was not read; whoever looks at it fails."""

    def _fail(self, *_: object) -> NoReturn:
        raise AssertionError("found a look at what was not read")

    __eq__ = __lt__ = __gt__ = __le__ = __ge__ = __add__ = __radd__ = __sub__ = __rsub__ = __call__ = _fail
    __bool__ = __hash__ = __iter__ = __len__ = __contains__ = __getitem__ = __str__ = __getattr__ = _fail


UNREAD = Unread()
STRANGER = "nobody"
"""A key and a member that nobody asks for."""


def emptied(state: State, read: dict[Path, object]) -> State:
    """The state without what was not read, and with strangers wherever nobody looked."""
    ways = {path[:length] for path in read for length in range(1, len(path) + 1)}
    left = State.__new__(State)
    for slot in State.__slots__:
        setattr(left, slot, _left(getattr(state, slot), (Step("field", slot),), ways, read))
    return left


def _left(value: Any, path: Path, ways: set[Path], read: dict[Path, object]) -> Any:
    if path in read:
        return value
    is_counted = {(*path, Step("keys")), (*path, Step("size"))} & read.keys()
    is_known_empty = read.get((*path, Step("any"))) is False
    if isinstance(value, dict):
        kept = {
            key: _left(below, (*path, Step("key", key)), ways, read)
            for key, below in value.items()
            if is_counted or {(*path, Step("has", key)), (*path, Step("key", key))} & ways
        }
        return kept if is_counted or is_known_empty else {**kept, STRANGER: UNREAD}
    if isinstance(value, frozenset):
        if is_counted:
            return value
        members = frozenset(one for one in value if (*path, Step("has", one)) in read)
        return members if is_known_empty else members | {STRANGER}
    if is_walked(value):
        fields = {
            name: _left(getattr(value, name), (*path, Step("field", name)), ways, read)
            for name in value.__struct_fields__
        }
        left = type(value)(**fields)
        for step in {way[-1] for way in ways if way[:-1] == path and way[-1].kind == "field"}:
            if step.name not in fields:  # a cached property, read as it was
                left.__dict__[step.name] = _left(getattr(value, step.name), (*path, step), ways, read)
        return left
    return UNREAD
