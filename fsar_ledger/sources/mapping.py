"""An adapter from a file: which record of a format of one's own means which event, and where its fields are.

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
A record that lacks a value, or has it of another kind than the field, is not understood: nothing is derived from it.
"""

import re
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, Literal

import msgspec

from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import did_you_mean, value
from fsar_ledger.designs.registered import Field, at_line, decoded
from fsar_ledger.events import CONCERN_OF

from .adapter import Derived, Input, Record, known, objects, shown, utc_us
from .columns import LAYOUT_OF, OUTCOMES, declared, laid_out

_IN_TEXT = re.compile(r"\{(/[^{}]*)\}")
_POINTER = re.compile(r"/([^~]|~[01])*")
_INDEX = re.compile(r"0|[1-9][0-9]{0,8}")
_MISSING = object()
US_OF = {"s": 1e6, "ms": 1e3, "us": 1.0, "ns": 1e-3}
LAST_US = 253_402_214_400_000_000
"""Units: microseconds since 1970; the last day of the year 9999. A time beyond it is none."""
Plain = str | int | bool


class MappedEvent(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One kind of record, and the event that follows from it."""

    type: str
    fields: dict[str, Plain | list[str]]
    match: dict[str, Plain | list[Plain]] = {}
    key: str | None = None
    cause: str | None = None


class Mapping(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A format of one's own: lines of JSON objects. `unit` is that of times which are numbers."""

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
    """Reads what a mapping describes."""

    version = "1"

    def __init__(self, mapping: Mapping) -> None:
        self._mapping, self.format = mapping, mapping.format
        self.name = mapping.format.partition("/")[0]
        self.clock, self.is_sampled = mapping.clock, mapping.is_sampled

    def declares(self) -> Iterable[str]:
        """Name what the mapping says that its source records."""
        return self._mapping.observes

    def read(self, inputs: Iterable[Input]) -> Iterator[Record]:
        """Yield every line. Raises: UsageError if none of the first holds a JSON object."""
        files = list(inputs)
        found = (one if isinstance(one, Record) else self._record(*one) for one in objects(files))
        return known(found, files, lambda one: one.data is not None, "one JSON object a line")

    def _record(self, raw: bytes, data: dict[str, Any]) -> Record:
        mapping = self._mapping
        kind = _filled(mapping.kind, data)
        about: dict[str, str] = {}
        for pointer, part in mapping.objects.items():
            if (found := _at(pointer, data)) is not _MISSING and found is not None:
                name = shown(found)
                about[name] = f"{about[name]}, {part}" if name in about else part
        values = {name: shown(one) for name, one in data.items()}
        told_us, arrival_us = (
            None if pointer is None else _time_us(_at(pointer, data), mapping.unit)
            for pointer in (mapping.time, mapping.arrival)
        )
        is_told = kind is not _MISSING and kind not in ("", None)
        return Record(shown(kind) if is_told else "record", raw, data, values, about, told_us, arrival_us)

    def derive(self, record: Record) -> Iterable[Derived] | None:
        """Return the event of each rule that the record matches; None where it matches none, or lacks what one needs.

        What a record says is derived whole or not at all, so that a part of it cannot be missing unseen.
        """
        if record.data is None:
            return None
        made = [_derived(rule, record.data) for rule in self._mapping.event if _matches(rule, record.data)]
        events = [one for one in made if one is not None]
        return events if events and len(events) == len(made) else None


def mapped(path: Path, data: bytes) -> Mapped:
    """Return the adapter that a mapping file describes.

    Raises: UsageError for a file that is none; it names the line and the field.
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
    """Yield what is wrong with a mapping: the field, what was found there, and what was expected."""
    if not mapping.format.partition("/")[0]:
        yield ("format",), mapping.format, "a name and a version, such as acme/2"
    kinds: frozenset[str] = frozenset()
    for at, name in enumerate(mapping.observes):
        try:
            kinds |= declared([name]).kinds
        except UsageError as error:
            yield ("observes", at), name, f"{error}".partition("expected ")[2]
    pointers = (("time",), mapping.time), (("arrival",), mapping.arrival)
    for field, pointer in (*pointers, *((("objects", one), one) for one in mapping.objects)):
        if pointer is not None and not _is_pointer(pointer):
            yield field, pointer, A_POINTER
    yield from _flaws_of_text(("kind",), mapping.kind)
    for at, rule in enumerate(mapping.event):
        yield from _flaws_of_rule(("event", at), rule, kinds)


def _flaws_of_rule(where: Field, rule: MappedEvent, kinds: frozenset[str]) -> Iterator[tuple[Field, str, str]]:
    """Yield what is wrong with a rule of a mapping that declares these event types."""
    if rule.type not in CONCERN_OF or rule.type not in LAYOUT_OF:
        known = CONCERN_OF.keys() & LAYOUT_OF.keys()
        yield (*where, "type"), rule.type, f"an event type{did_you_mean(rule.type, known)}"
        return
    if rule.type not in kinds:
        yield (*where, "type"), rule.type, f"a type that `observes` names ({', '.join(sorted(kinds)) or 'none'})"
    if (outcome := OUTCOMES.get(rule.type, "")) not in {"", *rule.fields}:
        yield (*where, "type"), rule.type, f"its {outcome} among `fields`, since how it ended is never assumed"
    columns = {field.name: field for field in LAYOUT_OF[rule.type].fields}
    for name, text in rule.fields.items():
        if name not in columns:
            expected = f"a field of {rule.type} ({', '.join(sorted(columns))}){did_you_mean(name, columns)}"
            yield (*where, "fields", name), name, expected
        for one in text if isinstance(text, list) else [text]:
            yield from _flaws_of_text((*where, "fields", name), one)
    for pointer in rule.match:
        if not _is_pointer(pointer):
            yield (*where, "match", pointer), pointer, A_POINTER
    for name, told in (("key", rule.key), ("cause", rule.cause)):
        yield from _flaws_of_text((*where, name), told)


def _flaws_of_text(field: Field, text: Plain | None) -> Iterator[tuple[Field, str, str]]:
    if not isinstance(text, str):
        return
    if text.startswith("/"):
        if not _is_pointer(text):
            yield field, text, A_POINTER
        return
    wrong = [one for one in _IN_TEXT.findall(text) if not _is_pointer(one)]
    if wrong or set("{}") & set(_IN_TEXT.sub("", text)):
        yield field, text, "a text in which braces hold a JSON pointer (RFC 6901), such as robot/{/robot/id}"


A_POINTER = "a JSON pointer (RFC 6901), such as /robot/id"


def _is_pointer(text: str) -> bool:
    return _POINTER.fullmatch(text) is not None


def _at(pointer: str, data: Any) -> Any:
    """Return the value at a JSON pointer, `_MISSING` where there is none."""
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
    """Return the names of a JSON pointer. A mapping has few; what a record says is never one."""
    return tuple(part.replace("~1", "/").replace("~0", "~") for part in pointer.split("/")[1:])


def _filled(text: Plain | list[str], data: Any) -> Any:
    """Return what a field of a mapping means for a record; `_MISSING` where the record lacks a part of it."""
    if isinstance(text, list):
        found = [_filled(one, data) for one in text]
        return _MISSING if any(one is _MISSING or one is None for one in found) else [shown(one) for one in found]
    if not isinstance(text, str):
        return text
    if text.startswith("/"):
        return _at(text, data)
    pieces = list(_pieces(text))
    for at in range(1, len(pieces), 2):
        found = _at(pieces[at], data)
        if found is _MISSING or found is None:
            return _MISSING
        pieces[at] = shown(found)
    return "".join(pieces)


@cache
def _pieces(text: str) -> tuple[str, ...]:
    """Return the pieces of a text of the mapping: every other one is a pointer."""
    return tuple(_IN_TEXT.split(text))


def _matches(rule: MappedEvent, data: Any) -> bool:
    for pointer, wanted in rule.match.items():
        found = _at(pointer, data)
        if not any(_is_same(found, one) for one in (wanted if isinstance(wanted, list) else [wanted])):
            return False
    return True


def _is_same(found: object, wanted: Plain) -> bool:
    """Return whether two values of JSON are equal; to Python, `true` is 1."""
    return found == wanted and isinstance(found, bool) == isinstance(wanted, bool)


def _derived(rule: MappedEvent, data: Any) -> Derived | None:
    """Return the event of a rule; None where the record lacks a field that it must have, or has it of another kind."""
    filled = {name: _filled(text, data) for name, text in rule.fields.items()}
    given = {name: one for name, one in filled.items() if one is not _MISSING}
    if OUTCOMES.get(rule.type) in filled.keys() - given.keys():
        return None
    try:
        event = laid_out(LAYOUT_OF[rule.type], given)
    except UsageError:
        return None
    key, cause = (None if text is None else _filled(text, data) for text in (rule.key, rule.cause))
    return Derived(event, *(None if one is None or one is _MISSING else shown(one) for one in (key, cause)))


def _time_us(found: object, unit: str) -> int | None:
    if not isinstance(found, int | float) or isinstance(found, bool):
        return utc_us(found)
    if not 0 <= found < LAST_US * 1000:  # no float holds an integer of any size
        return None
    us = found // 1000 if unit == "ns" and isinstance(found, int) else found * US_OF[unit]
    return round(us) if us < LAST_US else None
