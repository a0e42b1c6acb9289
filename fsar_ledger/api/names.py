"""Names that users give, of runs, robots and scenarios. An error about an unknown one suggests the nearest."""

import re
from collections.abc import Sequence
from decimal import Decimal
from math import isfinite
from os import PathLike
from typing import Literal

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError, option

Place = str | PathLike[str]
Pool = Literal["seeds"] | None
By = Literal["scenario"] | None
KindOfReport = Literal["paper", "audit"] | None
Names = str | Sequence[str] | None
"""One name, several, or None for all."""
Run = str | int
"""A run: its name, its number (as a number or as text), or a part of its name that no other run has."""
Time = float | str | None
"""A time of a run, in seconds, or as text: `46.6`, `46.6s`, `46600ms`."""

MAX_DIGITS = 16
MAX_SECONDS = 9_007_199_254

_KINDS = {
    "robot": "a robot",
    "supervisor": "a supervisor",
    "coordinator": "the coordinator",
    "service": "a service",
    "agent": "an agent of a robot",
}
"""The kind of a principal by the first word of its name."""

_TIME = re.compile(r"([0-9]{1,16}(?:\.[0-9]{0,16})?|\.[0-9]{1,16})\s*(s|ms)?")


def run_to_write(name: str) -> str:
    """Return the name of a run that is to be written. Raises: UsageError if it is empty, or stands for every run."""
    if not name:
        raise UsageError("run: found an empty name, expected a name")
    if name == "all":
        raise UsageError("run: found all, by which queries mean every run; expected another name")
    return name


def by_scenario(asked: str | None) -> bool:
    """Return whether to divide the rows by scenario. Raises: UsageError for another division."""
    if asked not in (None, "scenario"):
        raise UsageError(f"{option('by', asked)}: expected {option('by', 'scenario')}, or no {option('by')}")
    return asked is not None


def pools_seeds(asked: str | None) -> bool:
    """Return whether to pool the runs of all seeds. Raises: UsageError for another pool."""
    if asked not in (None, "seeds"):
        raise UsageError(
            f"{option('pool', asked)}: expected {option('pool', 'seeds')}, or no {option('pool')}; runs of "
            "other constants, models or fleet sizes are never pooled"
        )
    return asked is not None


def run_named(
    asked: object, names: Sequence[str], others: Sequence[str] = (), way: str = "the query `runs` lists them"
) -> str:
    """Return the run of this name or number, or the only one whose name contains the text.

    Args:
        asked: A `Run`; numbers are from 1, in the order of the ledger.
        names: The runs in the order of the ledger. Digits alone are always a number.
        others: Other names that have no number, such as plans.
        way: Where users find the names.

    Raises:
        UsageError: No run matches, or several do, or it is neither text nor a whole number.
    """
    if isinstance(asked, int) and not isinstance(asked, bool):
        return _numbered(f"{asked}", names, way)
    if not isinstance(asked, str):
        raise UsageError(
            f"run: found {printable.value(repr(asked), 80)}, expected the name of a run, a part of it, or its number"
        )
    known_names = (*names, *others)
    if asked in known_names:
        return asked
    if asked.isascii() and asked.removeprefix("-").isdecimal():
        return _numbered(asked, names, way)
    is_part = asked != "" and not asked.startswith(
        "-"
    )  # hashes follow a "-", so a negative number would be part of one
    runs = sorted(name for name in known_names if is_part and asked in name)
    if len(runs) == 1:
        return runs[0]
    if runs:
        numbers = {name: number for number, name in enumerate(names, start=1)}
        listed = printable.list_few(
            printable.value(name) + (f" (number {numbers[name]:,})" if name in numbers else "") for name in runs
        )
        raise UsageError(
            f"run {printable.value(asked)}: found {len(runs):,} runs whose names contain this, expected one of {listed}"
        )
    parts = {part for name in known_names for part in name.split(".")}
    hint = printable.did_you_mean(asked, known_names) or printable.did_you_mean(asked, parts)
    raise UsageError(f"run {printable.value(asked)}: there is no such run{hint or ';'} {way}")


def _numbered(text: str, names: Sequence[str], way: str) -> str:
    """Return the run of this number, from 1. Raises: UsageError if there is none."""
    number = int(text) if len(text) <= MAX_DIGITS else len(names) + 1
    if not 1 <= number <= len(names):
        expected = f"a number from 1 to {len(names)}" if names else "no number: there is no run"
        raise UsageError(f"run {text:.80}: there is no run of this number, expected {expected}; {way}")
    return names[number - 1]


def principal_named(what: str, asked: str, names: Sequence[str]) -> str:
    """Return the principal of a robot or supervisor (`what`) that is given as `B1` or in full, as `robot/B1`.

    Case does not matter if only one name matches.

    Raises: UsageError if there is none.
    """
    prefix = f"{what}/"
    short = asked[len(prefix) :] if asked.casefold().startswith(prefix) else asked
    matches = [name for name in names if name.casefold() == f"{prefix}{short}".casefold()]
    if f"{prefix}{short}" in matches:
        return f"{prefix}{short}"
    if len(matches) == 1:
        return matches[0]
    kind = _KINDS.get(asked.partition("/")[0])
    if kind is not None and not asked.startswith(prefix):
        raise UsageError(f"{what} {printable.value(asked)}: found {kind}, expected {_one_of(what, names)}")
    near = printable.nearest(short, [name.removeprefix(prefix) for name in names])
    hint = ";" if near is None else f"; did you mean {printable.value(prefix + near)}?"
    raise _unknown(what, asked, hint, names)


def known_name(what: str, asked: str, names: Sequence[str]) -> str:
    """Return the name if it is one of `names`. Raises: UsageError, with the nearest."""
    if asked in names:
        return asked
    raise _unknown(what, asked, printable.did_you_mean(asked, names) or ";", names)


def _unknown(what: str, name: str, hint: str, names: Sequence[str]) -> UsageError:
    return UsageError(f"{what} {printable.value(name)}: there is no such {what}{hint} expected {_one_of(what, names)}")


def _one_of(what: str, names: Sequence[str]) -> str:
    few = printable.list_few(map(printable.value, sorted(names)))
    return f"one of {few}" if few else f"none: no {what} is on record"


def names_of(asked: str | Sequence[str] | None) -> list[str] | None:
    """Return one name or several as a list; None stays None."""
    return [asked] if isinstance(asked, str) else None if asked is None else list(asked)


def separated(asked: str | Sequence[str] | None) -> list[str]:
    """Return the words of one text or several, in which commas separate them; none for None."""
    return [word.strip() for text in names_of(asked) or () for word in text.split(",")]


def require_whole(**given: object) -> None:
    """Require that each of these parameters is a whole number, or None. Raises: UsageError, which names it."""
    for name, value in given.items():
        if value is not None and type(value) is not int:
            raise UsageError(f"{option(name)}: found {value!r:.80}, expected a whole number")


def microseconds(what: str, asked: Time) -> int | None:
    """Convert a time to whole microseconds; None stays None.

    A time is a number of seconds, or text: `46.6`, `46.6s` or `46600ms`.

    Raises:
        UsageError: It is not a time.
    """
    if asked is None:
        return None
    seconds = _seconds(asked)
    if seconds is None or not 0 <= seconds <= MAX_SECONDS:
        text = printable.value(asked, 80) if isinstance(asked, str) else f"{asked!r:.80}"
        raise UsageError(f"{what}: found {text}, expected seconds of run time, 0 or more, as 46.6, 46.6s or 46600ms")
    return round(seconds * 1_000_000)


def _seconds(value: object) -> Decimal | None:
    """Return the exact seconds of a number or text; None if it is not a finite time."""
    if isinstance(value, str):
        match = _TIME.fullmatch(value.strip())
        return None if match is None else Decimal(match[1]) / (1_000 if match[2] == "ms" else 1)
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        return None
    return Decimal(repr(value))
