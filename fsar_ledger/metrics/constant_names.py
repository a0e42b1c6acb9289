"""Name the constants of a run.

Queries, `info`, the report and replay all use this to name the constants in which runs differ.
"""

import re
from collections.abc import Iterator
from functools import cache
from typing import Any

import msgspec

from fsar_ledger.base.parameters import BadParameters, read_parameters
from fsar_ledger.designs.constants import DESIGNS, Constants, read_constants, with_all_groups, write_constants

MAX_PARAMETERS = 65_536
"""Maximum characters of parameters that are read constant by constant; those of the model have 2,000.

Longer ones are only compared as a whole.
"""

MAX_SHOWN = 60
"""Maximum characters shown of a name or value; no constant of the model has more."""

DEFAULT = "default"
"""Stands for the value of a constant that is not set and has no value by default."""

_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")


def constants_of(parameters: str | None) -> list[dict[str, str]] | None:
    """Return the constants by name, with their values as JSON, without nulls.

    Names are `world.message.high_s` or `world.durations["carry.heavy"].low_s`. Equal numbers are the same text, however
    they were written. None if the text is not the parameters of a run, or too long.
    """
    if parameters is None or len(parameters) > MAX_PARAMETERS:
        return None
    try:
        by_name = dict(_constants("", read_parameters(parameters)))
    except (BadParameters, UnicodeError):
        return None
    return [{"name": name, "value": by_name[name]} for name in sorted(by_name)]


def _constants(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """Yield the leaves below a value: of objects by key, of lists of [name, value] by name, of others by index."""
    if value is None:
        return
    parts: list[tuple[str, Any]]
    if isinstance(value, dict) and value:
        dot = "." if name else ""
        parts = [
            (f"{dot}{key}" if _PLAIN.fullmatch(key) else f"{dot}{_json(key)}", inner) for key, inner in value.items()
        ]
    elif isinstance(value, list) and value:
        named = all(isinstance(item, list) and len(item) == 2 and isinstance(item[0], str) for item in value) and len(
            {item[0] for item in value}
        ) == len(value)
        parts = (
            [(f"[{_json(item[0])}]", item[1]) for item in value]
            if named
            else [(f"[{index}]", inner) for index, inner in enumerate(value)]
        )
    else:
        yield (
            name,
            _json(int(value) if isinstance(value, float) and value.is_integer() and abs(value) < 2**53 else value),
        )
        return
    for part, inner in parts:
        yield from _constants(name + part, inner)


def _json(value: Any) -> str:
    return msgspec.json.encode(value).decode()


def default_of(name: str) -> str | None:
    """Return the value of a constant in a run of this model version that does not record it.

    None if there is no such constant.
    """
    return _package_defaults().get(name)


def unlike_ours(parameters: str) -> list[str]:
    """Return the constants of a run of this model that differ from this version's, as `NAME=VALUE (here VALUE)`.

    Raises: BadParameters.
    """
    actual, ours = _all_values(read_constants(parameters)), _package_defaults()
    return [
        f"{name:.{MAX_SHOWN}}={actual.get(name, 'absent'):.{MAX_SHOWN}} (here {ours.get(name, 'absent'):.{MAX_SHOWN}})"
        for name in sorted({*actual, *ours})
        if actual.get(name) != ours.get(name)
    ]


@cache
def names_of_constants() -> tuple[str, ...]:
    """Return the names of all constants that can be set, in order, including groups that are absent by default."""
    return tuple(sorted(_package_defaults()))


@cache
def _package_defaults() -> dict[str, str]:
    return _all_values(Constants())


def _all_values(constants: Constants) -> dict[str, str]:
    """Return every constant by name, with the groups that may be absent at their defaults.

    A registered design is represented by its name alone.
    """
    groups = msgspec.structs.replace(with_all_groups(constants), scenario=None, fleet=None)
    designs = {name: getattr(constants, name) for name in DESIGNS}
    named = {name: _json(design.name) for name, design in designs.items() if design is not None}
    unset = {
        f"{group}.{name}": DEFAULT
        for group in groups.__struct_fields__
        if group not in designs
        for name in getattr(groups, group).__struct_fields__
    }
    filled = {constant["name"]: constant["value"] for constant in constants_of(write_constants(groups)) or ()}
    return (
        {name: value for name, value in unset.items() if not any(known.startswith(name) for known in filled)}
        | filled
        | named
    )
