"""Names that users give, of runs, robots and scenarios. An error about an unknown one suggests the nearest."""

from collections.abc import Sequence
from os import PathLike
from typing import Literal, TypeVar

from fsar_ledger import printable
from fsar_ledger.errors import InvalidExperiment, UsageError, option

_Name = TypeVar("_Name", bound=str)

Place = str | PathLike[str]
Pool = Literal["seeds"] | None
By = Literal["scenario"] | None


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


def run_named(asked: str, names: Sequence[str]) -> str:
    """Return the run of this name, or the only one whose name contains it.

    Raises:
        UsageError: No run matches, or several do.
    """
    if asked in names:
        return asked
    found = sorted(name for name in names if asked and asked in name)
    if len(found) == 1:
        return found[0]
    if found:
        shown = printable.some(map(printable.value, found))
        raise UsageError(
            f"run {printable.value(asked)}: found {len(found):,} runs whose names contain this, expected one of {shown}"
        )
    hint = printable.did_you_mean(asked, names)
    raise UsageError(f"run {printable.value(asked)}: there is no such run{hint or ';'} the query `runs` lists them")


def robot_named(asked: str, names: Sequence[str]) -> str:
    """Return the principal of a robot that is given as `B1` or `robot/B1`. Raises: UsageError if there is none."""
    name = asked if asked.startswith("robot/") else f"robot/{asked}"
    if name in names:
        return name
    hint = printable.did_you_mean(name, names)
    raise UsageError(
        f"robot {printable.value(asked)}: there is no such robot{hint or ';'} expected one of "
        f"{printable.some(map(printable.value, sorted(names))) or 'none: no robot is on record'}"
    )


def names_of(asked: str | Sequence[str] | None) -> list[str] | None:
    """Return one name or several as a list; None stays None."""
    return [asked] if isinstance(asked, str) else None if asked is None else list(asked)


def microseconds(what: str, seconds: float | None) -> int | None:
    """Convert seconds to whole microseconds; None stays None. Raises: UsageError if it is not a time."""
    if seconds is None:
        return None
    if isinstance(seconds, bool) or not isinstance(seconds, int | float) or not 0 <= seconds <= 9_007_199_254:
        raise UsageError(f"{what}: found {seconds!r:.80}, expected seconds of run time, 0 or more")
    return round(seconds * 1_000_000)
