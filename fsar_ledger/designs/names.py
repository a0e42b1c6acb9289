"""Names of what there is: an error about an unknown one suggests the nearest."""

from collections.abc import Sequence
from typing import TypeVar

from fsar_ledger.base import printable
from fsar_ledger.base.errors import InvalidExperiment

_Name = TypeVar("_Name", bound=str)


def known(what: str, asked: Sequence[str] | None, names: tuple[_Name, ...]) -> tuple[_Name, ...]:
    """Return the names asked for, each once, in the order of `names`.

    Raises:
        InvalidExperiment: A name is unknown; the message suggests the nearest.
    """
    for name in asked or ():
        if name not in names:
            hint = printable.did_you_mean(name.lower(), names)
            raise InvalidExperiment(f"unknown {what} {name!r}{hint or ';'} expected one of {', '.join(names)}")
    return tuple(name for name in names if name in (asked or ()))
