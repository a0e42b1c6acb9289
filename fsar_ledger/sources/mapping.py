"""An adapter from a file: which record of a format of one's own means which event, and where its fields are.

```toml
format = "acme/2"
observes = ["ExecutionStarted", "ExecutionStarted.executed_by"]
time = "/when"                         # ISO 8601, or seconds since 1970
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
"""

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Literal

import msgspec

from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import did_you_mean, value
from fsar_ledger.designs.files import Field, at_line, decoded

from .adapter import Derived, Input, Record
from .declared import declared
from .json_lines import objects, shown, utc_us
from .telling import LAYOUT_OF, event_of

_IN_TEXT = re.compile(r"\{(/[^{}]*)\}")
_POINTER = re.compile(r"(/([^~]|~[01])*)*")
_MISSING = object()
Plain = str | int | bool


class MappedEvent(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One kind of record, and the event that follows from it."""

    type: str
    fields: dict[str, Plain | list[str]]
    match: dict[str, Plain | list[Plain]] = {}
    key: str | None = None
    cause: str | None = None


class Mapping(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A format of one's own: lines of JSON objects."""

    format: str
    observes: list[str] = []
    time: str | None = None
    arrival: str | None = None
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
        """Yield every line."""
        for one in objects(inputs):
            yield one if isinstance(one, Record) else self._record(*one)

    def _record(self, raw: bytes, data: dict[str, Any]) -> Record:
        mapping = self._mapping
        kind = _filled(mapping.kind, data)
        about = {
            shown(found): part
            for pointer, part in mapping.objects.items()
            if (found := _at(pointer, data)) is not _MISSING
        }
        values = {name: shown(one) for name, one in data.items()}
        times = (
            None if pointer is None else _time_us(_at(pointer, data)) for pointer in (mapping.time, mapping.arrival)
        )
        return Record(shown(kind) if kind not in ("", _MISSING) else "record", raw, data, values, about, *times)

    def derive(self, record: Record) -> Iterable[Derived] | None:
        """Return the event of each rule that the record matches; None where it matches none."""
        if record.data is None:
            return None
        rules = [rule for rule in self._mapping.event if _matches(rule, record.data)]
        made = [_derived(rule, record.data) for rule in rules]
        return [one for one in made if one is not None] or None


def mapped(path: Path, data: bytes) -> Mapped:
    """Return the adapter that a mapping file describes.

    Raises: UsageError for a file that is none; it names the line and the field.
    """
    try:
        text = data.decode()
    except UnicodeDecodeError as error:
        raise UsageError(f"{value(str(path))}: {error}; expected TOML in UTF-8") from error
    mapping = decoded(text, Mapping, str(path))
    declared(mapping.observes)
    pointers: list[tuple[Field, str | None]] = [(("time",), mapping.time), (("arrival",), mapping.arrival)]
    pointers += [(("objects", pointer), pointer) for pointer in mapping.objects]
    for at, rule in enumerate(mapping.event):
        layout = LAYOUT_OF.get(rule.type)
        if layout is None:
            expected = f"an event type{did_you_mean(rule.type, LAYOUT_OF)}"
            raise _wrong(path, text, ("event", at, "type"), rule.type, expected)
        known = {field.name for field in layout.fields}
        for name in rule.fields:
            if name not in known:
                expected = f"a field of {rule.type} ({', '.join(sorted(known))}){did_you_mean(name, known)}"
                raise _wrong(path, text, ("event", at, "fields", name), name, expected)
        pointers += [(("event", at, "match", pointer), pointer) for pointer in rule.match]
        texts = [*rule.fields.values(), rule.key, rule.cause]
        pointers += [(("event", at, "fields"), one) for one in texts if isinstance(one, str) and one.startswith("/")]
    for field, pointer in pointers:
        if pointer is not None and not (pointer.startswith("/") and _POINTER.fullmatch(pointer)):
            raise _wrong(path, text, field, pointer, "a JSON pointer (RFC 6901), such as /robot/id")
    return Mapped(mapping)


def _wrong(path: Path, text: str, field: Field, found: str, expected: str) -> UsageError:
    return UsageError(f"{at_line(str(path), text, field)}: found {value(found)}, expected {expected}")


def _at(pointer: str, data: Any) -> Any:
    """Return the value at a JSON pointer, `_MISSING` where there is none."""
    for part in pointer.split("/")[1:]:
        name = part.replace("~1", "/").replace("~0", "~")
        if isinstance(data, dict) and name in data:
            data = data[name]
        elif isinstance(data, list) and name.isdecimal() and int(name) < len(data):
            data = data[int(name)]
        else:
            return _MISSING
    return data


def _filled(text: Plain | list[str], data: Any) -> Any:
    """Return what a field of a mapping means for a record; `_MISSING` where the record lacks a part of it."""
    if isinstance(text, list):
        found = [_filled(one, data) for one in text]
        return _MISSING if _MISSING in found else [shown(one) for one in found]
    if not isinstance(text, str):
        return text
    if text.startswith("/"):
        return _at(text, data)
    parts = {pointer: _at(pointer, data) for pointer in _IN_TEXT.findall(text)}
    if any(one is _MISSING for one in parts.values()):
        return _MISSING
    return _IN_TEXT.sub(lambda found: shown(parts[found[1]]), text)


def _matches(rule: MappedEvent, data: Any) -> bool:
    return all(
        _at(pointer, data) in (wanted if isinstance(wanted, list) else [wanted])
        for pointer, wanted in rule.match.items()
    )


def _derived(rule: MappedEvent, data: Any) -> Derived | None:
    """Return the event of a rule; None where the record lacks a field that it must have, or has it of another kind."""
    filled = {name: _filled(text, data) for name, text in rule.fields.items()}
    given = {name: one for name, one in filled.items() if one is not _MISSING}
    try:
        event = event_of(LAYOUT_OF[rule.type], given)
    except UsageError:
        return None
    key, cause = (None if text is None else _filled(text, data) for text in (rule.key, rule.cause))
    return Derived(event, *(None if one in (None, _MISSING) else shown(one) for one in (key, cause)))


def _time_us(found: object) -> int | None:
    if isinstance(found, int | float) and not isinstance(found, bool):
        return round(found * 1_000_000)
    return utc_us(found)
