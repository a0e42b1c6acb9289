"""Futures: how likely an outcome still can be avoided from each moment of a run on, and from when on it cannot.

From a moment on the world goes on as it might have: what has begun keeps its end, and what begins or is asked later is
drawn again, for another seed each time. Tasks keep their times, since they are the work and not the world's doing.
"""

from bisect import bisect_left
from collections.abc import Sequence

import msgspec

from fsar_ledger.analysis.causes import Outcome
from fsar_ledger.analysis.fork_base import Rerun
from fsar_ledger.base.memory import without_collection
from fsar_ledger.base.progress import Progress
from fsar_ledger.designs.constants import END_US
from fsar_ledger.events.world import OutsiderRequestInjected, TaskArrived
from fsar_ledger.metrics.robustness import wilson
from fsar_ledger.runtime.changeable import facts_by_name
from fsar_ledger.runtime.forks import kernel_of
from fsar_ledger.runtime.ports import Fact, World
from fsar_ledger.runtime.simulation import environment_of

MOMENTS = 24
"""Moments of the curve at even distances."""
STEPS = 8
"""About how many more it takes to find the event after which the outcome was not avoided any more."""
FUTURES = 50
MOST_AT_ONCE = 250


class Chance(msgspec.Struct, frozen=True):
    """In `avoided` of `futures` from this moment on the outcome did not come about; 95 % interval after Wilson.

    `undefined` more had no value to compare, and avoided nothing. None: all of them.
    """

    at_s: float
    futures: int
    avoided: int
    undefined: int
    share: float | None
    low: float | None
    high: float | None


class Curve(msgspec.Struct, frozen=True):
    """The chances by moment, in order, and the point of no return: the event from which on no future avoided it.

    `last_open_s`: the last moment found from which some future did. `closing_seq`: the first event after which none
    did; the moments of both are among `chances`.
    None: none did from any moment on (`last_open_s`), or some did to the end (`closing_seq`).
    """

    chances: tuple[Chance, ...]
    last_open_s: float | None
    closing_seq: int | None


def curve(
    repeated: Rerun,
    outcome: Outcome,
    futures: int = FUTURES,
    moments: int = MOMENTS,
    progress: Progress | None = None,
) -> Curve:
    """Return the chances to avoid the outcome from moments of the run on, in order of time.

    The moments are `moments` times at even distances, and events between the last two around the point of no return.
    `progress` is called with the futures that were played, and their number.

    Raises: QueryFailed as `Outcome.of`.
    """
    times_us = repeated.base.record.times_us
    chances = _Chances(repeated, outcome, futures, moments, progress)
    chances.add([times_us[-1] * number // (moments - 1) for number in range(moments)])
    while True:
        last_us = max((at_us for at_us, found in chances.found.items() if found.avoided), default=None)
        if last_us is None:
            return Curve(chances.in_order, None, 0)
        closed = [at_us for at_us in chances.found if at_us > last_us]
        if not closed:
            return Curve(chances.in_order, last_us / 1_000_000, None)
        # The last moment is that of an event, so there is one to close what is closed at a moment between two.
        end_us = times_us[bisect_left(times_us, min(closed))]
        event_us = chances.first_closed(sorted({at_us for at_us in times_us if last_us < at_us <= end_us}))
        if not chances.found[event_us].avoided:
            last_us = max(at_us for at_us, found in chances.found.items() if found.avoided)
            return Curve(chances.in_order, last_us / 1_000_000, times_us.index(event_us))


class _Chances:
    """The chances from moments on, each found once over the same other worlds."""

    def __init__(
        self, repeated: Rerun, outcome: Outcome, futures: int, moments: int, progress: Progress | None
    ) -> None:
        self.found: dict[int, Chance] = {}
        self._repeated, self._outcome, self._progress = repeated, outcome, progress
        self._worlds = [_other_world(repeated, number) for number in range(futures)]
        self._played, self._total = 0, (moments + STEPS) * futures

    @property
    def in_order(self) -> tuple[Chance, ...]:
        """Return the chances in order of time."""
        return tuple(self.found[at_us] for at_us in sorted(self.found))

    def first_closed(self, between: Sequence[int]) -> int:
        """Return the first of these moments from which no future avoids the outcome; the last if some always does."""
        low, high = 0, len(between) - 1
        while low < high:
            middle = (low + high) // 2
            self.add([between[middle]])
            low, high = (middle + 1, high) if self.found[between[middle]].avoided else (low, middle)
        self.add([between[low]])
        return between[low]

    def add(self, times_us: Sequence[int]) -> None:
        """Play the futures from these moments on. Raises: QueryFailed."""
        asked = [(at_us, world) for at_us in times_us for world in self._worlds if at_us not in self.found]
        avoided: dict[int, list[bool | None]] = {}
        for begin in range(0, len(asked), MOST_AT_ONCE):
            part = asked[begin : begin + MOST_AT_ONCE]
            with without_collection():
                runs = [_played(self._repeated, at_us, world) for at_us, world in part]
            for (at_us, _), has_it in zip(part, self._outcome.of(runs), strict=True):
                avoided.setdefault(at_us, []).append(None if has_it is None else not has_it)
            self._played += len(part)
            if self._progress is not None:
                self._progress(min(self._played, self._total), self._total)
        self.found |= {at_us: _chance(at_us, one) for at_us, one in avoided.items()}


def _other_world(repeated: Rerun, number: int) -> World:
    """Return the world of another seed, under the same constants."""
    recipe = repeated.base.recipe
    return environment_of(msgspec.structs.replace(recipe.spec, seed=recipe.spec.seed + 1 + number), recipe.constants)


def _played(repeated: Rerun, at_us: int, world: World) -> tuple[Sequence[int], Sequence[int | None], Sequence[object]]:
    """Play one future from this moment on."""
    recipe = repeated.base.recipe
    own = environment_of(recipe.spec, recipe.constants)
    own.facts = _facts(own.facts, world.facts, at_us)
    kernel = kernel_of(recipe, own)
    kernel.run(at_us)
    kernel.set_environment(world)
    kernel.run()
    return kernel.times_us, kernel.caused_by, kernel.events


def _facts(own: Sequence[Fact], other: Sequence[Fact], at_us: int) -> tuple[Fact, ...]:
    """Return what has begun by then, each with its end, the tasks at their times, and the other world's later facts."""
    places = facts_by_name(tuple(own))
    is_kept = {
        at
        for its in places.values()
        if own[its[0]][0] <= at_us or isinstance(own[its[0]][1], TaskArrived | OutsiderRequestInjected)
        for at in its
    }
    kept = [fact for at, fact in enumerate(own) if at in is_kept]
    names = {name for name, its in places.items() if its[0] in is_kept}
    later = [
        other[at]
        for name, its in facts_by_name(tuple(other)).items()
        if other[its[0]][0] > at_us and name not in names
        for at in its
    ]
    apart: list[Fact] = []
    last_us = 0
    for time_us, fact in sorted((*kept, *later), key=lambda one: one[0]):
        last_us = max(time_us, last_us + 1)
        if last_us <= END_US:
            apart.append((last_us, fact))
    return tuple(apart)


def _chance(at_us: int, avoided: Sequence[bool | None]) -> Chance:
    found, n = avoided.count(True), avoided.count(False) + avoided.count(True)
    return Chance(at_us / 1_000_000, n, found, avoided.count(None), *wilson(found, n))
