"""Which worlds the runs of a ledger met: replay makes every run again under the constants that the run itself records.

Whoever makes a ledger may record other constants than this version's, for all of its runs or for some. Such a run is as its world
and its handlers make it, so replay does not doubt it; but a world without obstructions says little of one with them, and two runs of
one seed that met different worlds are no pair. So a reader is told.
"""

from collections import Counter
from collections.abc import Iterable, Iterator
from itertools import combinations

import msgspec

from fsar_ledger.constants import Constants, read_constants
from fsar_ledger.events.fleet import RunStarted

MAX_NAMED = 5
"""A remark names so many constants or groups of runs, and counts the others."""

KINDS = {"other constants": "met a world or a structure that is not this version's", "another load": "had other work than by default"}

World = tuple[int | None, str | None, int | None, int | None]  # seed, scenario, fleet size, run


class Played(msgspec.Struct, frozen=True):
    """The worlds that runs of one kind met under the same constants; `parameters` as `RunStarted` holds them."""

    parameters: str
    architecture: str
    configuration: str
    worlds: tuple[World, ...]


def played(starts: Iterable[RunStarted]) -> tuple[Played, ...]:
    """What these runs met, in the order in which it was first met."""
    groups: dict[tuple[str, str, str], list[World]] = {}
    for one in starts:
        kind = (one.parameters or "", one.architecture or "", one.configuration or "")  # all there of a run that was replayed
        groups.setdefault(kind, []).append((one.seed, one.scenario, one.fleet_size, one.run))
    return tuple(Played(*kind, tuple(worlds)) for kind, worlds in groups.items())


def remarks_on(found: Iterable[Played]) -> tuple[str, ...]:
    """A line for each set of constants that is not this version's, and one if a world has no pair of two architectures under the same set."""
    runs: dict[str, Counter[str]] = {}
    met: dict[World, dict[str, set[int]]] = {}
    numbers: dict[str, int] = {}
    for one in found:
        who = one.architecture if one.configuration == "full" else f"{one.architecture} {one.configuration}"
        runs.setdefault(one.parameters, Counter())[who] += len(one.worlds)
        number = numbers.setdefault(one.parameters, len(numbers))
        for world in one.worlds:
            met.setdefault(world, {}).setdefault(who, set()).add(number)
    total = sum(count.total() for count in runs.values())
    lines = [
        f"{_kind(differences)}: {counts.total():,} of {total:,} runs ({_some(f'{count:,} of {who}' for who, count in counts.items())}) "
        f"{KINDS[_kind(differences)]}: {_some(differences)}"
        for parameters, counts in runs.items()
        if (differences := list(_differences(parameters)))
    ]
    if len(lines) > MAX_NAMED:
        lines[MAX_NAMED:] = [f"other constants: {len(lines) - MAX_NAMED:,} sets more"]
    unlike = [world for world, sides in met.items() if any(one.isdisjoint(other) for one, other in combinations(sides.values(), 2))]
    if unlike:
        seed, scenario, fleet_size, run = unlike[0]
        lines.append(
            f"no pairs: under {len(unlike):,} of {len(met):,} combinations of seed, scenario, fleet size and run "
            f"two architectures or configurations met no constants in common, first under {seed}, {scenario}, {fleet_size}, {run}; "
            "`statistics` does not compare those two there"
        )
    return tuple(lines)


def _kind(differences: Iterable[str]) -> str:
    return "another load" if all(one.startswith("load.") for one in differences) else "other constants"


def _differences(parameters: str) -> Iterator[str]:
    """The constants that are not this version's."""
    constants = read_constants(parameters)
    for part in Constants.__struct_fields__:
        actual = getattr(constants, part)
        for name in actual.__struct_fields__ if actual is not None else ():  # a group that may be absent is by default as one of its defaults
            own = getattr(getattr(Constants(), part) or type(actual)(), name)
            if getattr(actual, name) != own:
                yield f"{part}.{name} {_short(getattr(actual, name))} (here {_short(own)})"


def _short(value: object) -> str:
    if isinstance(value, msgspec.Struct):
        return " to ".join(repr(one) for one in msgspec.structs.astuple(value))
    return f"{value!a:.60}"


def _some(parts: Iterable[str]) -> str:
    """The first few of them, and how many more there are."""
    named = list(parts)
    return ", ".join(named[:MAX_NAMED]) + (f" and {len(named) - MAX_NAMED:,} more" if len(named) > MAX_NAMED else "")
