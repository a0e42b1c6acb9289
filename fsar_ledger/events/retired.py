"""Retired versions of event types. Ledgers keep rows of them for ever, so they are never edited or removed.

An event type that changes by more than a new optional field gets the next version: `class StepBegan(Event, frozen=True,
tag="StepBegan.v2")`. The old struct moves here as `class StepBeganV1(Event, frozen=True, tag="StepBegan.v1")`, with an
upcaster to the next version: `adding` if that only has more fields, which SQL does in place for any number of rows,
else a function from event to event. Rows stay stored, checked and hashed as they are; readers of events see only the
newest version.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Generic, Literal, NamedTuple, TypeAlias, TypeVar, Union, get_args, get_origin

import msgspec

from . import EVENT_TYPES
from .envelope import Event
from .fleet import RunStarted

_Before = TypeVar("_Before", bound=Event)
_After = TypeVar("_After", bound=Event)

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


def adding(before: type[_Before], after: type[_After], **added: Value) -> Upcaster[_Before, _After]:
    """Return the step to a next version that only adds these fields, with the same values in every event.

    Every field of the previous version is kept. A new field that is not named here gets its default, also in SQL.

    Raises:
        TypeError: `after` needs a field that neither the previous version nor this step provides, lacks one of them,
            or cannot hold a value.
    """
    fields = {field.name: field for field in msgspec.structs.fields(after)}
    provided = {*before.__struct_fields__, *added}
    lacking = sorted({name for name, field in fields.items() if field.required} - provided)
    if lacking or not provided <= fields.keys() or not added.keys().isdisjoint(before.__struct_fields__):
        available = sorted(fields.keys() - set(before.__struct_fields__))
        raise TypeError(
            f"upcaster of {_tag(before)}: found that it adds {sorted(added)} and lacks {lacking}, "
            f"expected of {available}; write a change instead"
        )
    added = {
        name: field.default for name, field in fields.items() if name not in provided and field.default is not None
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


def _takes(kind: Any, previous: Any) -> bool:
    """Return whether a field of this type takes every value of the previous type.

    It does if it is the same type, has a wider choice of words, or takes None as well.
    """
    if kind == previous:
        return True
    if get_origin(previous) in _UNIONS:
        return all(_takes(kind, option) for option in get_args(previous))
    if get_origin(kind) in _UNIONS:
        return any(_takes(option, previous) for option in get_args(kind))
    if get_origin(previous) is Literal:
        words = get_args(previous)
        if get_origin(kind) is Literal:
            return set(words) <= set(get_args(kind))
        return all(type(word) is kind for word in words)
    return False


def upcasters_of(
    current: Iterable[type[Event]], retired: Iterable[type[Event]], upcasters: Iterable[Upcaster[Any, Any]]
) -> Mapping[type[Event], tuple[Upcaster[Any, Any], ...]]:
    """Return the steps from each retired type to a current one, one version of the same name per step.

    Raises:
        TypeError: A tag has no version or occurs twice; a name's versions do not go from 1 to the current one without
            gaps; a retired type has no upcaster or several, or one that does not lead to its next version.
    """
    current, retired, steps = tuple(current), tuple(retired), tuple(upcasters)
    by_tag = {_tag(cls): cls for cls in (*current, *retired)}
    if len(by_tag) < len(current) + len(retired):
        raise TypeError("event types: found two with one tag, expected one; give one of them the next version")
    for cls in (*current, *retired):
        name, number = _version(cls)
        if number > 1 and by_tag.get(f"{name}.v{number - 1}") not in retired:
            raise TypeError(
                f"{_tag(cls)}: found no version {number - 1} in RETIRED_TYPES, expected all from 1; keep the old struct"
            )
        if cls in current and f"{name}.v{number + 1}" in by_tag:
            raise TypeError(f"{_tag(cls)}: found it current, expected only the newest version of {name} to be current")
    if sorted(_tag(step.before) for step in steps) != sorted(map(_tag, retired)):
        raise TypeError(
            f"upcasters: found some of {', '.join(_tag(step.before) for step in steps) or 'nothing'}, expected exactly "
            f"one of each retired type: {', '.join(map(_tag, retired)) or 'none'}; see UPCASTERS"
        )
    for step in steps:
        name, number = _version(step.before)
        if by_tag.get(f"{name}.v{number + 1}") is not step.after:
            raise TypeError(
                f"upcaster of {_tag(step.before)}: found that it leads to {_tag(step.after)}, expected "
                f"{name}.v{number + 1} as it is listed; change one version a step"
            )
    step_of = {step.before: step for step in steps}
    ways: dict[type[Event], tuple[Upcaster[Any, Any], ...]] = {}
    for cls in retired:
        way = [step_of[cls]]
        while way[-1].after in step_of:
            way.append(step_of[way[-1].after])
        ways[cls] = tuple(way)
    return ways


def additions(ways: Mapping[type[Event], tuple[Upcaster[Any, Any], ...]]) -> Mapping[type[Event], Addition]:
    """Return each retired type whose steps all only add fields, with its current type and the added fields."""
    return {
        cls: Addition(way[-1].after, {name: value for step in way for name, value in (step.added or {}).items()})
        for cls, way in ways.items()
        if all(step.added is not None for step in way)
    }


def _tag(cls: type[Event]) -> str:
    """Return the stored type of this class."""
    return str(cls.__struct_config__.tag)


def _version(cls: type[Event]) -> tuple[str, int]:
    """Return the name and version number of an event type. Raises: TypeError for a tag without a version."""
    name, _, number = _tag(cls).rpartition(".v")
    if not name or not number.isdecimal() or number != str(int(number)) or number == "0":
        raise TypeError(
            f'{_tag(cls)}: found a tag without version, expected NAME.vN with N from 1; write tag="{cls.__name__}.v1"'
        )
    return name, int(number)


# See docs/decisions/evidence-is-never-rewritten.md.
class RunStartedV1(Event, frozen=True, tag="RunStarted.v1"):
    """`RunStarted` until 0.2.0: a run of our own, simulated or live, that observes everything without saying so."""

    kind: Literal["simulated", "live"]
    seed: int
    architecture: Literal["fsar", "cfc", "dhma"]
    configuration: Literal[
        "full",
        "without-trust-evaluation",
        "without-policy-composition",
        "without-layered-recovery",
        "without-shared-registry",
    ]
    scenario: Literal[
        "door-relay",
        "collaborative-delivery",
        "failure-recovery-chain",
        "mixed-trust-inspection",
        "fleet-contention",
        "workflow-door-relay",
        "workflow-layered-recovery",
        "workflow-human-supervision",
        "live",
    ]
    fleet_size: int
    run: int
    model_version: str
    parameters: str


# The concerns of 0.2.0, listed because one that a later release adds was not observed then. Both kinds of run were made
# by our own handlers, which record everything that they decide, are told and encounter.
_OBSERVED_BY_V1 = (
    "fleet",
    "registry",
    "trust",
    "policy",
    "task",
    "request",
    "authority",
    "execution",
    "recovery",
    "supervision",
    "knowledge",
    "message",
    "command",
    "world",
)


RETIRED_TYPES: tuple[type[Event], ...] = (RunStartedV1,)
"""Every type that was current in a release and no longer is."""

UPCASTERS: tuple[Upcaster[Any, Any], ...] = (adding(RunStartedV1, RunStarted, observes=_OBSERVED_BY_V1),)
"""The step from each retired type to its next version."""

_STEPS = upcasters_of(EVENT_TYPES, RETIRED_TYPES, UPCASTERS)

UPCASTS: Mapping[type[Event], tuple[Callable[[Any], Event], ...]] = {
    cls: tuple(step.change for step in steps) for cls, steps in _STEPS.items()
}
"""The changes that turn an event of each retired type into a current one, built and checked at import."""

ADDITIONS: Mapping[type[Event], Addition] = additions(_STEPS)
"""The retired types that become current by adding fields alone, which SQL does in place."""
