"""Turns events of retired types into current ones, by one pure function a version, checked at import."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Generic, Literal, NamedTuple, TypeAlias, TypeVar, Union, get_args, get_origin

import msgspec

from .envelope import Event

_Before = TypeVar("_Before", bound=Event)
_After = TypeVar("_After", bound=Event)

Change: TypeAlias = Callable[[Any], Event]
Value: TypeAlias = str | int | bool | tuple[str, ...] | None

_UNIONS = (Union, get_origin(int | None))


class Upcaster(msgspec.Struct, Generic[_Before, _After], frozen=True):
    """One step: `change` turns an event of the retired type `before` into one of the next version, `after`."""

    before: type[_Before]
    after: type[_After]
    change: Callable[[_Before], _After]
    added: Mapping[str, Value] | None = None
    """The fields that `change` adds to every event, if it does nothing else (`adding`); None for any other change."""


class Addition(NamedTuple):
    """A whole chain of changes that only add fields: rows become rows of `after` by column, none of them read."""

    after: type[Event]
    added: Mapping[str, Value]


Chains: TypeAlias = Mapping[type[Event], tuple[Change, ...]]
"""For each retired type the changes, in order, that lead to a current type."""


def adding(before: type[_Before], after: type[_After], **added: Value) -> Upcaster[_Before, _After]:
    """Return the step to a next version that only adds these fields, with the same values in every event.

    Every field of the version before is kept. A new field that is not named here gets its default, also in SQL.

    Raises:
        TypeError: `after` needs a field that neither the version before nor this step gives, lacks one of them, or
            cannot hold a value.
    """
    fields = {field.name: field for field in msgspec.structs.fields(after)}
    given = {*before.__struct_fields__, *added}
    lacking = sorted({name for name, field in fields.items() if field.required} - given)
    if lacking or not given <= fields.keys() or not added.keys().isdisjoint(before.__struct_fields__):
        own = sorted(fields.keys() - set(before.__struct_fields__))
        raise TypeError(
            f"upcaster of {_tag(before)}: found that it adds {sorted(added)} and lacks {lacking}, "
            f"expected of {own}; write a change instead"
        )
    added = {
        name: field.default for name, field in fields.items() if name not in given and field.default is not None
    } | added
    for field in msgspec.structs.fields(before):
        if not _takes(fields[field.name].type, field.type):
            kinds = f"found {field.type} turned into {fields[field.name].type}"
            raise TypeError(
                f"upcaster of {_tag(before)}: field {field.name}: {kinds}, "
                "expected a type that takes every value; write a change instead"
            )
    for name, value in added.items():
        try:
            msgspec.convert(value, fields[name].type)
        except msgspec.ValidationError as error:
            raise TypeError(f"upcaster of {_tag(before)}: field {name}: {error}") from error

    def change(event: _Before) -> _After:
        return after(**{name: getattr(event, name) for name in before.__struct_fields__}, **added)

    return Upcaster(before, after, change, added)


def _takes(kind: Any, before: Any) -> bool:
    """Return whether a field of this type takes every value of the type before.

    It does if it is the same type, has a wider choice of words, or takes None as well.
    """
    if kind == before:
        return True
    if get_origin(before) in _UNIONS:
        return all(_takes(kind, one) for one in get_args(before))
    if get_origin(kind) in _UNIONS:
        return any(_takes(one, before) for one in get_args(kind))
    if get_origin(before) is Literal:
        words = get_args(before)
        return (
            set(words) <= set(get_args(kind))
            if get_origin(kind) is Literal
            else all(type(word) is kind for word in words)
        )
    return False


def additions(
    retired: Iterable[type[Event]], upcasters: Iterable[Upcaster[Any, Any]]
) -> Mapping[type[Event], Addition]:
    """Return each retired type whose whole chain only adds fields, with its current type and what is added.

    The steps must be those that `chains` accepts.
    """
    steps = {step.before: step for step in upcasters}
    found: dict[type[Event], Addition] = {}
    for cls in retired:
        way = [step := steps[cls]]
        while step.after in steps:
            way.append(step := steps[step.after])
        if all(step.added is not None for step in way):
            found[cls] = Addition(
                way[-1].after, {name: value for step in way for name, value in (step.added or {}).items()}
            )
    return found


def chains(
    current: Iterable[type[Event]], retired: Iterable[type[Event]], upcasters: Iterable[Upcaster[Any, Any]]
) -> Chains:
    """Return the changes from each retired type to a current one, one version of the same name a step.

    Raises:
        TypeError: A tag has no version or occurs twice; a name's versions do not go from 1 to the current one without
            gaps; a retired type has no upcaster or several; an upcaster is for other types, forms a cycle or skips a
            version.
    """
    current, retired, upcasters = tuple(current), tuple(retired), tuple(upcasters)
    _check_versions(current, retired)
    for step in upcasters:
        if step.before not in retired:
            raise TypeError(
                f"upcaster of {_tag(step.before)}: found a type that is not retired; "
                "list it in RETIRED_TYPES or remove the upcaster"
            )
        if step.after not in (*current, *retired):
            raise TypeError(
                f"upcaster of {_tag(step.before)}: found that it leads to {_tag(step.after)}, "
                "expected a type that is listed; list it"
            )
    steps: dict[type[Event], Upcaster[Any, Any]] = {}
    for cls in retired:
        own = [step for step in upcasters if step.before is cls]
        if len(own) != 1:
            raise TypeError(
                f"{_tag(cls)}: found {len(own)} upcasters, expected exactly one for each retired type; see UPCASTERS"
            )
        steps[cls] = own[0]
    ways = {cls: _way(cls, steps) for cls in retired}
    for step in upcasters:
        name, number = _version(step.before)
        if _version(step.after) != (name, number + 1):
            raise TypeError(
                f"upcaster of {_tag(step.before)}: found that it leads to {_tag(step.after)}, "
                f"expected {name}.v{number + 1}; change one version a step"
            )
    return ways


def _way(cls: type[Event], steps: Mapping[type[Event], Upcaster[Any, Any]]) -> tuple[Change, ...]:
    """Return the changes from this type on. Raises: TypeError for a cycle."""
    passed, changes = [cls], []
    while (step := steps.get(passed[-1])) is not None:
        changes.append(step.change)
        if step.after in passed:
            raise TypeError(
                f"upcasters: found the cycle {' -> '.join(map(_tag, [*passed, step.after]))}, "
                "expected a chain that ends at a current type; remove one step"
            )
        passed.append(step.after)
    return tuple(changes)


def _check_versions(current: tuple[type[Event], ...], retired: tuple[type[Event], ...]) -> None:
    """Check the versions of each name.

    Raises: TypeError unless they are numbered from 1, the last of them current and the others retired.
    """
    found: dict[str, dict[int, type[Event]]] = {}
    for cls in (*current, *retired):
        name, number = _version(cls)
        if number in found.setdefault(name, {}):
            raise TypeError(
                f"{_tag(cls)}: found two event types with this tag, expected one; give one of them the next version"
            )
        found[name][number] = cls
    for name, versions in found.items():
        newest = max(versions)
        if missing := sorted(set(range(1, newest)) - versions.keys()):
            raise TypeError(
                f"{name}: found version {newest} without version {missing[0]}, "
                "expected all from 1; keep the old struct in RETIRED_TYPES"
            )
        for number, cls in versions.items():
            if (cls in current) != (number == newest):
                raise TypeError(
                    f"{_tag(cls)}: found it {'current' if cls in current else 'retired'}, "
                    f"expected only version {newest} of {name} to be current"
                )


def _tag(cls: type[Event]) -> str:
    """Return the stored type of this class."""
    return str(cls.__struct_config__.tag)


def _version(cls: type[Event]) -> tuple[str, int]:
    """Return name and version number of an event type. Raises: TypeError for a tag that has none."""
    name, _, number = _tag(cls).rpartition(".v")
    if not name or not number.isdecimal() or number != str(int(number)) or number == "0":
        raise TypeError(
            f'{_tag(cls)}: found a tag without version, expected NAME.vN with N from 1; write tag="{cls.__name__}.v1"'
        )
    return name, int(number)
