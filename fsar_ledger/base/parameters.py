"""The recorded parameters of runs, of this or any other model: JSON with names and values."""

from typing import Any, TypeVar

import msgspec

_T = TypeVar("_T")
MAX_LEVELS = 16
"""The maximum nesting of recorded parameters; those of this model have five levels."""


class BadParameters(ValueError):
    """The text is not valid as the parameters of a run; the message says what was found and expected."""


def read_parameters(parameters: str) -> dict[str, Any]:
    """Parse the parameters of a run of any model: names and values, up to `MAX_LEVELS` deep. Raises: BadParameters."""
    parsed: dict[str, Any] = decode_parameters(parameters, dict[str, Any])
    level: list[Any] = [parsed]
    for _ in range(MAX_LEVELS):
        values = [
            value for container in level for value in (container.values() if isinstance(container, dict) else container)
        ]
        if any(isinstance(value, int) and not -(2**63) <= value < 2**63 for value in values):
            raise _bad(parameters, "an integer beyond 64 bits")
        level = [value for value in values if isinstance(value, dict | list)]
        if not level:
            return parsed
    raise _bad(parameters, f"more than {MAX_LEVELS} levels")


def decode_parameters(parameters: str, kind: type[_T]) -> _T:
    """Decode the parameters into this type. Raises: BadParameters."""
    try:
        return msgspec.json.decode(parameters, type=kind)
    except (msgspec.MsgspecError, RecursionError, ValueError) as error:  # ValueError: a number of thousands of digits
        raise _bad(parameters, str(error)) from error


def _bad(parameters: str, why: str) -> BadParameters:
    return BadParameters(f"found {parameters!r:.80}, expected constants as a JSON object ({why:.200})")
