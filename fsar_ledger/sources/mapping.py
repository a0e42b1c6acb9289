"""An adapter from a file: which record of a custom format means which event, and where its fields are.

```toml
format = "acme/2"
observes = ["ExecutionStarted", "ExecutionStarted.executed_by"]
time = "/when"                         # ISO 8601, or a number of `unit` since 1970
kind = "/event"
objects = { "/robot" = "robot" }       # what a record is about, each with its part

[[event]]
match = { "/event" = "started" }       # all must be equal; a list: one of them
type = "ExecutionStarted"
key = "{/job}"                         # by which a later event names it as its cause
cause = "asked/{/job}"
fields = { task_id = "/job", action_id = "{/job}/1", robot = "robot/{/robot}", capability = "/skill" }
```

A text that begins with a slash is a JSON pointer (RFC 6901) to the value; in any other each `{/pointer}` is replaced.
A record that lacks a value, or has one of another kind than the field, is not understood: nothing is derived from it.
"""

import re
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, Literal

import msgspec

from fsar_ledger.base import utc
from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import did_you_mean, value
from fsar_ledger.designs.registered import Field, at_line, decoded
from fsar_ledger.events import CONCERN_OF

from .adapter import Derived, Input, Record, json_text, objects, require_format
from .columns import LAYOUT_OF, OUTCOMES, declared, laid_out

_IN_TEXT = re.compile(r"\{(/[^{}]*)\}")
_POINTER = re.compile(r"/([^~]|~[01])*")
_INDEX = re.compile(r"0|[1-9][0-9]{0,8}")
_MISSING = object()
US_OF = {"s": 1e6, "ms": 1e3, "us": 1.0, "ns": 1e-3}
LAST_US = 253_402_214_400_000_000
"""Units: microseconds since 1970; the last day of the year 9999. A time beyond it is ignored."""
Plain = str | int | bool


class MappedEvent(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One kind of record, and the event that follows from it."""

    type: str
    fields: dict[str, Plain | list[str]]
    match: dict[str, Plain | list[Plain]] = {}
    key: str | None = None
    cause: str | None = None


class Mapping(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A custom format: lines of JSON objects. `unit` is the unit of times that are numbers."""

    format: str
    observes: list[str] = []
    time: str | None = None
    arrival: str | None = None
    unit: Literal["s", "ms", "us", "ns"] = "s"
    kind: str = ""
    objects: dict[str, str] = {}
    clock: Literal["arrival", "source"] = "source"
    is_sampled: bool = False
    event: list[MappedEvent] = []


class Mapped:
    """A reader of the format that a mapping describes."""

    version = "1"

    def __init__(self, mapping: Mapping) -> None:
        self._mapping, self.format = mapping, mapping.format
        self.name = mapping.format.partition("/")[0]
        self.clock, self.is_sampled = mapping.clock, mapping.is_sampled

    def declares(self) -> Iterable[str]:
        """Name what the source records according to the mapping."""
        return self._mapping.observes

    def read(self, inputs: Iterable[Input]) -> Iterator[Record]:
        """Yield every line. Raises: UsageError if none of the first holds a JSON object."""
        files = list(inputs)
        records = (item if isinstance(item, Record) else self._record(*item) for item in objects(files))
        return require_format(records, files, lambda item: item.data is not None, "one JSON object per line")

    def _record(self, raw: bytes, data: dict[str, Any]) -> Record:
        mapping = self._mapping
        kind = _filled(mapping.kind, data)
        about: dict[str, str] = {}
        for pointer, part in mapping.objects.items():
            if (item := _value_at(pointer, data)) is not _MISSING and item is not None:
                name = json_text(item)
                about[name] = f"{about[name]}, {part}" if name in about else part
        values = {name: json_text(item) for name, item in data.items()}
        source_us, arrival_us = (
            None if pointer is None else _time_us(_value_at(pointer, data), mapping.unit)
            for pointer in (mapping.time, mapping.arrival)
        )
        has_kind = kind is not _MISSING and kind not in ("", None)
        return Record(json_text(kind) if has_kind else "record", raw, data, values, about, source_us, arrival_us)

    def derive(self, record: Record) -> Iterable[Derived] | None:
        """Return the event of each rule that the record matches; None if it matches none, or lacks what one needs.

        A record is derived whole or not at all, so that no part of it can be missing unnoticed.
        """
        if record.data is None:
            return None
        results = [_derived(rule, record.data) for rule in self._mapping.event if _matches(rule, record.data)]
        events = [event for event in results if event is not None]
        return events if events and len(events) == len(results) else None


def mapped(path: Path, data: bytes) -> Mapped:
    """Return the adapter that a mapping file describes.

    Raises: UsageError for an invalid file; it names the line and the field.
    """
    try:
        text = data.decode()
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise UsageError(f"{path}:{line}: found bytes that are not UTF-8, expected TOML of a mapping") from error
    mapping = decoded(text, Mapping, str(path))
    for field, found, expected in _flaws(mapping):
        raise UsageError(f"{at_line(str(path), text, field)}: found {value(found)}, expected {expected}")
    return Mapped(mapping)


def _flaws(mapping: Mapping) -> Iterator[tuple[Field, str, str]]:
    """Yield the flaws of a mapping: the field, what was found there, and what was expected."""
    if not mapping.format.partition("/")[0]:
        yield ("format",), mapping.format, "a name and a version, such as acme/2"
    kinds: frozenset[str] = frozenset()
    for index, name in enumerate(mapping.observes):
        try:
            kinds |= declared([name]).kinds
        except UsageError as error:
            yield ("observes", index), name, f"{error}".partition("expected ")[2]
    pointers = (("time",), mapping.time), (("arrival",), mapping.arrival)
    for field, pointer in (*pointers, *((("objects", pointer), pointer) for pointer in mapping.objects)):
        if pointer is not None and not _is_pointer(pointer):
            yield field, pointer, A_POINTER
    yield from _flaws_of_text(("kind",), mapping.kind)
    for index, rule in enumerate(mapping.event):
        yield from _flaws_of_rule(("event", index), rule, kinds)


def _flaws_of_rule(prefix: Field, rule: MappedEvent, kinds: frozenset[str]) -> Iterator[tuple[Field, str, str]]:
    """Yield the flaws of a rule of a mapping that declares these event types."""
    if rule.type not in CONCERN_OF or rule.type not in LAYOUT_OF:
        known = CONCERN_OF.keys() & LAYOUT_OF.keys()
        yield (*prefix, "type"), rule.type, f"an event type{did_you_mean(rule.type, known)}"
        return
    if rule.type not in kinds:
        yield (*prefix, "type"), rule.type, f"a type that `observes` names ({', '.join(sorted(kinds)) or 'none'})"
    if (outcome := OUTCOMES.get(rule.type, "")) not in {"", *rule.fields}:
        yield (*prefix, "type"), rule.type, f"its {outcome} among `fields`, since how it ended is never assumed"
    columns = {field.name: field for field in LAYOUT_OF[rule.type].fields}
    for name, text in rule.fields.items():
        if name not in columns:
            expected = f"a field of {rule.type} ({', '.join(sorted(columns))}){did_you_mean(name, columns)}"
            yield (*prefix, "fields", name), name, expected
        for part in text if isinstance(text, list) else [text]:
            yield from _flaws_of_text((*prefix, "fields", name), part)
    for pointer in rule.match:
        if not _is_pointer(pointer):
            yield (*prefix, "match", pointer), pointer, A_POINTER
    for name, reference in (("key", rule.key), ("cause", rule.cause)):
        yield from _flaws_of_text((*prefix, name), reference)


def _flaws_of_text(field: Field, text: Plain | None) -> Iterator[tuple[Field, str, str]]:
    if not isinstance(text, str):
        return
    if text.startswith("/"):
        if not _is_pointer(text):
            yield field, text, A_POINTER
        return
    wrong = [pointer for pointer in _IN_TEXT.findall(text) if not _is_pointer(pointer)]
    if wrong or set("{}") & set(_IN_TEXT.sub("", text)):
        yield field, text, "a text in which braces hold a JSON pointer (RFC 6901), such as robot/{/robot/id}"


A_POINTER = "a JSON pointer (RFC 6901), such as /robot/id"


def _is_pointer(text: str) -> bool:
    return _POINTER.fullmatch(text) is not None


def _value_at(pointer: str, data: Any) -> Any:
    """Return the value at a JSON pointer, `_MISSING` if there is none."""
    for name in _names(pointer):
        if isinstance(data, dict) and name in data:
            data = data[name]
        elif isinstance(data, list) and _INDEX.fullmatch(name) and int(name) < len(data):
            data = data[int(name)]
        else:
            return _MISSING
    return data


@cache
def _names(pointer: str) -> tuple[str, ...]:
    """Return the names of a JSON pointer. A mapping has few; records contain none."""
    return tuple(part.replace("~1", "/").replace("~0", "~") for part in pointer.split("/")[1:])


def _filled(text: Plain | list[str], data: Any) -> Any:
    """Return the value of a mapping's field for a record; `_MISSING` if the record lacks a part of it."""
    if isinstance(text, list):
        filled = [_filled(part, data) for part in text]
        return (
            _MISSING
            if any(part is _MISSING or part is None for part in filled)
            else [json_text(part) for part in filled]
        )
    if not isinstance(text, str):
        return text
    if text.startswith("/"):
        return _value_at(text, data)
    pieces = list(_pieces(text))
    for index in range(1, len(pieces), 2):
        filled = _value_at(pieces[index], data)
        if filled is _MISSING or filled is None:
            return _MISSING
        pieces[index] = json_text(filled)
    return "".join(pieces)


@cache
def _pieces(text: str) -> tuple[str, ...]:
    """Return the pieces of a text of the mapping: every other one is a pointer."""
    return tuple(_IN_TEXT.split(text))


def _matches(rule: MappedEvent, data: Any) -> bool:
    for pointer, expected in rule.match.items():
        actual = _value_at(pointer, data)
        if not any(_is_same(actual, option) for option in (expected if isinstance(expected, list) else [expected])):
            return False
    return True


def _is_same(actual: object, expected: Plain) -> bool:
    """Return whether two values of JSON are equal; to Python, `true` is 1."""
    return actual == expected and isinstance(actual, bool) == isinstance(expected, bool)


def _derived(rule: MappedEvent, data: Any) -> Derived | None:
    """Return the event of a rule; None if the record lacks a required field, or has one of another kind."""
    filled = {name: _filled(text, data) for name, text in rule.fields.items()}
    present = {name: item for name, item in filled.items() if item is not _MISSING}
    if OUTCOMES.get(rule.type) in filled.keys() - present.keys():
        return None
    try:
        event = laid_out(LAYOUT_OF[rule.type], present)
    except UsageError:
        return None
    key, cause = (None if text is None else _filled(text, data) for text in (rule.key, rule.cause))
    return Derived(event, *(None if item is None or item is _MISSING else json_text(item) for item in (key, cause)))


def _time_us(time: object, unit: str) -> int | None:
    if not isinstance(time, int | float) or isinstance(time, bool):
        return utc.read_us(time)
    if not 0 <= time < LAST_US * 1000:  # no float holds an integer of any size
        return None
    us = time // 1000 if unit == "ns" and isinstance(time, int) else time * US_OF[unit]
    return round(us) if us < LAST_US else None
