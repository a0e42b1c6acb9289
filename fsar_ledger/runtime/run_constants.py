"""Remarks on the worlds of a ledger's runs: replay makes every run under the constants that the run itself records.

The maker of a ledger may record constants other than this version's, for some or all of its runs. Such a run is what
its world and its handlers make, so replay does not doubt it. But a world without obstructions says little about one
with them, and two runs of one seed that met different worlds are no pair. So the reader is told.
"""

from collections import Counter
from collections.abc import Iterable
from itertools import combinations

import msgspec

from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.metrics.constant_names import unlike_ours
from fsar_ledger.printable import NAMED, some

KINDS = {
    "other constants": "met a world or a structure that is not this version's",
    "another load": "had a non-default load",
}

World = tuple[int | None, str | None, int | None, int | None]  # seed, scenario, fleet size, run


class WorldConstantsUsed(msgspec.Struct, frozen=True):
    """The worlds that runs of one kind met under the same constants; `parameters` as `RunStarted` holds them."""

    parameters: str
    architecture: str
    configuration: str
    worlds: tuple[World, ...]


def constants_used(starts: Iterable[RunStarted]) -> tuple[WorldConstantsUsed, ...]:
    """Return the worlds that these runs met, in the order in which they were first met."""
    groups: dict[tuple[str, str, str], list[World]] = {}
    for one in starts:
        kind = (
            one.parameters or "",
            one.architecture or "",
            one.configuration or "",
        )  # none is missing in a replayed run
        groups.setdefault(kind, []).append((one.seed, one.scenario, one.fleet_size, one.run))
    return tuple(WorldConstantsUsed(*kind, tuple(worlds)) for kind, worlds in groups.items())


def remarks_on(found: Iterable[WorldConstantsUsed]) -> tuple[str, ...]:
    """Return a line for each set of constants that is not this version's.

    A last line says if two architectures or configurations met a world under no set of constants in common.
    """
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
        f"{_kind(differences)}: {counts.total():,} of {total:,} runs "
        f"({some(f'{count:,} of {who}' for who, count in counts.items())}) "
        f"{KINDS[_kind(differences)]}: {some(differences)}"
        for parameters, counts in runs.items()
        if (differences := unlike_ours(parameters))
    ]
    if len(lines) > NAMED:
        lines[NAMED:] = [f"other constants: {len(lines) - NAMED:,} more sets"]
    unlike = [
        world
        for world, sides in met.items()
        if any(one.isdisjoint(other) for one, other in combinations(sides.values(), 2))
    ]
    if unlike:
        seed, scenario, fleet_size, run = unlike[0]
        lines.append(
            f"no pairs: under {len(unlike):,} of {len(met):,} combinations of seed, scenario, fleet size and run "
            f"two architectures or configurations met no constants in common, first under {seed}, {scenario}, "
            f"{fleet_size}, {run}; `statistics` does not compare those two there"
        )
    return tuple(lines)


def _kind(differences: Iterable[str]) -> str:
    return "another load" if all(one.startswith("load.") for one in differences) else "other constants"
