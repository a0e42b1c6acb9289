"""Designs as TOML files: read with types, errors with line and field; and those of the package, by name.

The package has fleets, scenarios and workflows, one file each. Adding a file, named after its design, registers another
one; nothing else changes. Each is read once, when first used. An error about an unknown name suggests the nearest.
"""

import json
import re
import tomllib
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import InvalidExperiment, UsageError

from . import Fleet, OutsideCommand, Scenario, Workflow

_T = TypeVar("_T")
Field = tuple[str | int, ...]
"""The path of a value: keys, and indices of elements from 0."""

MAX_BYTES = 40_000
"""The largest file, whose content goes into event 0 of each of its runs; the package's own have at most 2,000."""

ALL_IF_LEFT_OUT = (("capabilities", "visible_to", "roles"), ("off_shift", "robots", "robots"))
"""Lists of a fleet that mean all when they are left out: an empty one would mean the opposite of what it says."""

_TABLE = re.compile(r"\s*(\[\[?)\s*([^\[\]]+?)\s*\]")
_KEY = re.compile(r"""\s*([\w-]+|"[^"]*"|'[^']*')((?:\s*\.\s*[\w-]+)*)\s*=""")
_AT = re.compile(r"^(?P<what>.*?)(?: - at `\$(?P<at>.*)`)?$", re.DOTALL)
_MANY_DIGITS = re.compile(r"\d(?:_?\d){4300}")
_UNREADABLE = "a whole number of thousands of digits"
_TWICE = re.compile(r"Cannot declare \('(\w+)',\) twice")
_NAMED = re.compile(r"(?:unknown|required) field `([^`]*)`")


def read_design(path: Path, kind: type[_T]) -> tuple[_T, str]:
    """Return the design in the file and the file's text. Raises: UsageError, with line and field."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UsageError(
            f"{path}: {error.strerror or error}, expected a TOML file with a {_what(kind)}; check the path"
        ) from error
    if len(data) > MAX_BYTES:
        raise UsageError(f"{path}: found {len(data):,} bytes, expected a {_what(kind)} in at most {MAX_BYTES:,}")
    try:
        text = data.decode()
        return decoded(text, kind, str(path)), text
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise UsageError(f"{path}:{line}: found bytes that are not UTF-8, expected TOML") from error


def decoded(text: str, kind: type[_T], where: str) -> _T:
    """Return the design in this text. Raises: UsageError, with line and field."""
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        message = str(error)
        position = re.search(r" \(at line (\d+), column \d+\)$", message)
        line = int(position[1]) if position else text.count("\n") + 1
        words = message[: position.start()] if position else message.removesuffix(" (at end of document)")
        if twice := _TWICE.fullmatch(words):
            expected = _entries(twice[1]) if _has_entries(kind, twice[1]) else "it once"
            raise UsageError(f"{where}:{line}: found [{twice[1]}] again, expected {expected}") from error
        raise UsageError(f"{where}:{line}: {printable.value(words)}; expected TOML") from error
    except RecursionError as error:
        raise UsageError(f"{where}: found brackets nested too deeply, expected TOML of a {_what(kind)}") from error
    except ValueError as error:  # the only other thing that Python refuses to read
        position = _MANY_DIGITS.search(text)
        line = text.count("\n", 0, position.start() if position else 0) + 1
        raise UsageError(f"{where}:{line}: found {_UNREADABLE}, expected TOML of a {_what(kind)}") from error
    if kind is Scenario:
        content = _with_parameters(content, text, where)
    try:
        design = msgspec.convert(content, kind)
    except msgspec.ValidationError as error:
        field, value, expected = fault(str(error), kind, content)
        about = at_line(where, text, field) if field else where
        if len(field) == 1 and isinstance(content.get(name := field_name(field)), dict) and _has_entries(kind, name):
            value, expected = f"one table [{name}]", _entries(name)
        raise UsageError(f"{about}: found {value}, expected {expected}") from error
    for table, key, who in ALL_IF_LEFT_OUT if kind is Fleet else ():
        for number, entry in enumerate(content.get(table, ())):
            if entry.get(key) == []:
                about = at_line(where, text, (table, number, key))
                raise UsageError(f"{about}: found an empty list, expected some {who}, or no such field, for all")
    return design


def _has_entries(kind: Any, name: str) -> bool:
    """Return whether the field is a list of tables."""
    parts: tuple[Any, ...] = getattr(_inside(kind, (name,)), "__args__", ())
    return bool(parts) and isinstance(parts[0], type) and issubclass(parts[0], msgspec.Struct)


def _entries(name: str) -> str:
    return f"[[{name}]] before each of its entries"


def _with_parameters(content: dict[str, Any], text: str, where: str) -> dict[str, Any]:
    """Return the scenario with the fields of each command as JSON, as in an event."""
    commands = content.get("commands")
    if not isinstance(commands, list):
        return content
    common = OutsideCommand.__struct_fields__[:-1]
    folded: list[Any] = []
    for number, command in enumerate(commands):
        if isinstance(command, dict):
            fields = {name: value for name, value in command.items() if name not in common}
            try:
                parameters = json.dumps(fields, ensure_ascii=False, default=str)
            except ValueError as error:  # the only thing that Python refuses to write
                about = at_line(where, text, ("commands", number))
                raise UsageError(f"{about}: found {_UNREADABLE}, expected fields of a command") from error
            command = {name: value for name, value in command.items() if name in common} | {"parameters": parameters}
        folded.append(command)
    return {**content, "commands": folded}


def at_line(where: str, text: str, field: Field) -> str:
    """Return the beginning of a message about the field: `my.toml:12: tasks[2].steps[0]`."""
    return f"{where}:{line_of(text, field)}: {field_name(field)}"


def field_name(field: Field) -> str:
    """Return the field as it is written in messages: `tasks[2].steps[0]`, elements from 0."""
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in field).removeprefix(".")


def line_of(text: str, field: Field) -> int:
    """Return the line, from 1, of the field, or of its table if the field is missing.

    The text is TOML that `tomllib` has read. A triple-quoted string that looks like TOML may mislead it.
    """
    counts: dict[tuple[str, ...], int] = {}
    table: Field = ()
    best, line = 0, 1
    for number, written in enumerate(text.splitlines(), start=1):
        if header := _TABLE.match(written):
            keys = tuple(part.strip().strip("\"'") for part in header[2].split("."))
            if header[1] == "[[":
                counts[keys] = counts.get(keys, -1) + 1
            table = _numbered(keys, counts)
            path = table
        elif key := _KEY.match(written):
            path = (*table, *(part.strip().strip("\"'") for part in (key[1] + key[2]).split(".")))
        else:
            continue
        if path == field[: len(path)] and len(path) > best:
            best, line = len(path), number
    rest = field[best:]
    return line + _lines_before(text.splitlines()[line - 1 :], rest[0]) if rest and isinstance(rest[0], int) else line


def _numbered(keys: tuple[str, ...], counts: dict[tuple[str, ...], int]) -> Field:
    """Return the path of a table, with the index of the newest element after each key of an array of tables."""
    path: list[str | int] = []
    for end in range(1, len(keys) + 1):
        path.append(keys[end - 1])
        if keys[:end] in counts:
            path.append(counts[keys[:end]])
    return tuple(path)


def _lines_before(lines: list[str], element: int) -> int:
    """Return how many lines after its key's line this element of an array begins."""
    depth = passed = 0
    quote = ""
    for number, line in enumerate(lines):
        index = line.index("=") + 1 if number == 0 and "=" in line else 0
        while index < len(line):
            character = line[index]
            if quote:
                if character == "\\" and quote == '"':
                    index += 1
                elif character == quote:
                    quote = ""
            elif character == "#":
                break
            elif character in "]}":
                depth -= 1
                if depth == 0:
                    return 0
            elif character == "," and depth == 1:
                passed += 1
            elif not character.isspace():
                if depth == 1 and passed == element:
                    return number
                if character in "[{":
                    depth += 1
                elif character in "\"'":
                    quote = character
            index += 1
    return 0


def fault(message: str, kind: type[Any], found: Any) -> tuple[Field, str, str]:
    """Return the subject of a msgspec message: the field, what was found there, and what was expected."""
    parsed = _AT.match(message)
    assert parsed is not None
    what = parsed["what"]
    field: Field = tuple(
        int(number) if number else key for number, key in re.findall(r"\[(\d+)\]|\.?([^.\[\]]+)", parsed["at"] or "")
    )
    if named := _NAMED.search(what):
        field = (*field, named[1])
        if "unknown" in what:
            names = _fields(kind, field)
            return field, "an unknown field", f"one of {', '.join(names)}{printable.did_you_mean(named[1], names)}"
        return field, "nothing", "a value: this field has no default"
    value: Any = found
    for part in field:
        value = value[part]
    expected = (
        what.partition(", got ")[0].removeprefix("Expected ").removeprefix("Invalid enum value ").replace("`", "")
    )
    if what.startswith("Invalid enum value"):
        expected = f"one of {', '.join(_choices(kind, field))}"
        expected += printable.did_you_mean(str(value), _choices(kind, field))
    try:
        text = printable.named(str(value).lower() if isinstance(value, bool) else str(value))
    except ValueError:  # TOML writes numbers of other bases, too, which Python reads but does not write
        text = _UNREADABLE
    if isinstance(value, str) and not what.startswith("Invalid enum value"):
        text = f'"{printable.value(value)}"'  # a text where another type is expected
    return field, text, _type(expected)


_TYPES = {
    "str": "text in quotes",
    "int": "a whole number",
    "float": "a number",
    "bool": "true or false",
    "array": "a list in [ ]",
    "object": "a table",
}


def _type(expected: str) -> str:
    kinds = [name.strip() for name in expected.split("|") if name.strip() != "null"]
    return " or ".join(_TYPES.get(name, name.replace("array", "a list")) for name in kinds)


def _inside(kind: Any, field: Field) -> Any:
    """Return the type of the field's value."""
    for part in field:
        kind = _without_none(kind)
        kind = (
            kind.__args__[0]
            if isinstance(part, int)
            else next((member.type for member in msgspec.structs.fields(kind) if member.encode_name == part), Any)
        )
    return _without_none(kind)


def _without_none(kind: Any) -> Any:
    options = [option for option in getattr(kind, "__args__", ()) if option is not type(None)]
    return options[0] if type(None) in getattr(kind, "__args__", ()) else kind


def _choices(kind: Any, field: Field) -> tuple[str, ...]:
    return tuple(map(str, _inside(kind, field).__args__))


def _fields(kind: Any, field: Field) -> tuple[str, ...]:
    return tuple(_inside(kind, field[:-1]).__struct_fields__)


def _what(kind: type[Any]) -> str:
    return kind.__name__.lower()


_Design = TypeVar("_Design", Fleet, Scenario, Workflow)
_Name = TypeVar("_Name", bound=str)

PAPER_FLEET = "paper"
PAPER_SCENARIOS = (
    "door-relay",
    "collaborative-delivery",
    "failure-recovery-chain",
    "mixed-trust-inspection",
    "fleet-contention",
)
"""The paper's five, in its order; other registered ones follow. Paper: sec:evaluation:scenarios."""
PAPER_WORKFLOWS = ("workflow-door-relay", "workflow-layered-recovery", "workflow-human-supervision")


@cache
def fleets() -> tuple[str, ...]:
    """Return the names of the registered fleets, the paper's first."""
    return _names("fleets", (PAPER_FLEET,))


@cache
def scenarios() -> tuple[str, ...]:
    """Return the names of the registered scenarios, the paper's first."""
    return _names("scenarios", PAPER_SCENARIOS)


@cache
def workflows() -> tuple[str, ...]:
    """Return the names of the registered workflows, the paper's first."""
    return _names("workflows", PAPER_WORKFLOWS)


@cache
def fleet(name: str = PAPER_FLEET) -> Fleet:
    """Return the registered fleet of this name."""
    return _read("fleets", name, Fleet)


@cache
def scenario(name: str) -> Scenario:
    """Return the registered scenario of this name."""
    return _read("scenarios", name, Scenario)


@cache
def workflow(name: str) -> Workflow:
    """Return the registered workflow of this name."""
    return _read("workflows", name, Workflow)


def design_location(design: Fleet | Scenario | Workflow, field: Field) -> str:
    """Return the file, the line and the field of a registered design, for the beginning of a message."""
    file = _folder(f"{type(design).__name__.lower()}s") / f"{design.name}.toml"
    return at_line(str(file), file.read_text("utf-8"), field)


def _names(folder: str, first: tuple[str, ...]) -> tuple[str, ...]:
    names = {file.stem for file in _folder(folder).glob("*.toml")}
    return (*first, *sorted(names.difference(first)))


def _read(folder: str, name: str, kind: type[_Design]) -> _Design:
    file = _folder(folder) / f"{name}.toml"
    text = file.read_text("utf-8")
    design = decoded(text, kind, str(file))
    if design.name != name:
        where = at_line(str(file), text, ("name",))
        raise UsageError(f"{where}: found {printable.value(design.name)}, expected the name of the file, {name}")
    return design


def _folder(name: str) -> Path:
    return Path(__file__).parents[1] / "runtime" / "world" / name


def known_names(what: str, asked: Sequence[str] | None, names: tuple[_Name, ...]) -> tuple[_Name, ...]:
    """Return the requested names, each once, in the order of `names`.

    Raises:
        InvalidExperiment: A name is unknown; the message suggests the nearest.
    """
    for name in asked or ():
        if name not in names:
            hint = printable.did_you_mean(name.lower(), names)
            raise InvalidExperiment(f"unknown {what} {name!r}{hint or ';'} expected one of {', '.join(names)}")
    return tuple(name for name in names if name in (asked or ()))
