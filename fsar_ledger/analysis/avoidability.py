"""Avoidability: how likely an outcome can still be avoided from each moment of a run, and when it no longer can.

Each future redraws the world from a moment: what has begun keeps its end, and what begins or is asked later is drawn
with another seed. Tasks keep their times, since they are the work and not part of the world's chance.
"""

from bisect import bisect_left
from collections.abc import Sequence

import msgspec

from fsar_ledger.analysis.causes import Outcome
from fsar_ledger.analysis.fork_base import Rerun
from fsar_ledger.base.memory import without_collection
from fsar_ledger.base.progress import Progress
from fsar_ledger.events.world import OutsiderRequestInjected, TaskArrived
from fsar_ledger.metrics.robustness import wilson
from fsar_ledger.runtime.changeable import continued
from fsar_ledger.runtime.forks import kernel_of
from fsar_ledger.runtime.ports import Fact, World
from fsar_ledger.runtime.simulation import environment_of

MOMENTS = 24
"""Evenly spaced moments of the curve."""
STEPS = 8
"""Approximate number of further moments needed to find the point of no return."""
FUTURES = 50
MOST_AT_ONCE = 250
_WORK = TaskArrived | OutsiderRequestInjected


class Chance(msgspec.Struct, frozen=True):
    """The share of futures from one moment in which the outcome was avoided; 95 % Wilson interval.

    `undefined` further futures had no value to compare and do not count. None: all of them.
    """

    at_s: float
    futures: int
    avoided: int
    undefined: int
    share: float | None
    low: float | None
    high: float | None


class Curve(msgspec.Struct, frozen=True):
    """The chances by moment, in order, and the point of no return: the event after which no future avoids the outcome.

    `last_open_s`: the last moment found from which a future avoids it. `closing_seq`: the first event after which none
    does; the moments of both are among `chances`.
    None: none does from any moment (`last_open_s`), or some do to the end (`closing_seq`).
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
    """Return the chances of avoiding the outcome from moments of the run, in order of time.

    The moments are `moments` evenly spaced times, and events between the last two around the point of no return.
    `progress` is called with the number of futures played, and the total.

    Raises: QueryFailed as `Outcome.of`.
    """
    times_us = repeated.base.record.times_us
    chances = _Chances(repeated, outcome, futures, moments, progress)
    chances.add([times_us[-1] * number // (moments - 1) for number in range(moments)])
    while True:
        last_us = max((at_us for at_us, chance in chances.found.items() if chance.avoided), default=None)
        if last_us is None:
            return Curve(chances.in_order, None, 0)
        closed = [at_us for at_us in chances.found if at_us > last_us]
        if not closed:
            return Curve(chances.in_order, last_us / 1_000_000, None)
        # The last moment is that of an event, so some event is at or after every closed moment.
        end_us = times_us[bisect_left(times_us, min(closed))]
        event_us = chances.first_closed(sorted({at_us for at_us in times_us if last_us < at_us <= end_us}))
        if not chances.found[event_us].avoided:
            last_us = max(at_us for at_us, chance in chances.found.items() if chance.avoided)
            return Curve(chances.in_order, last_us / 1_000_000, times_us.index(event_us))


class _Chances:
    """The chances by moment, each computed once over the same redrawn worlds."""

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
        """Return the first of these moments from which no future avoids the outcome; the last if there is none."""
        low, high = 0, len(between) - 1
        while low < high:
            middle = (low + high) // 2
            self.add([between[middle]])
            low, high = (middle + 1, high) if self.found[between[middle]].avoided else (low, middle)
        self.add([between[low]])
        return between[low]

    def add(self, times_us: Sequence[int]) -> None:
        """Play the futures from these moments. Raises: QueryFailed."""
        pending = [(at_us, world) for at_us in times_us for world in self._worlds if at_us not in self.found]
        avoided: dict[int, list[bool | None]] = {}
        for begin in range(0, len(pending), MOST_AT_ONCE):
            batch = pending[begin : begin + MOST_AT_ONCE]
            with without_collection():
                runs = [_future(self._repeated, at_us, world) for at_us, world in batch]
            for (at_us, _), has_it in zip(batch, self._outcome.of(runs), strict=True):
                avoided.setdefault(at_us, []).append(None if has_it is None else not has_it)
            self._played += len(batch)
            if self._progress is not None:
                self._progress(min(self._played, self._total), self._total)
        self.found |= {at_us: _chance(at_us, results) for at_us, results in avoided.items()}


def _other_world(repeated: Rerun, number: int) -> World:
    """Return the world of another seed, under the same constants."""
    recipe = repeated.base.recipe
    return environment_of(msgspec.structs.replace(recipe.spec, seed=recipe.spec.seed + 1 + number), recipe.constants)


def _future(repeated: Rerun, at_us: int, world: World) -> tuple[Sequence[int], Sequence[int | None], Sequence[object]]:
    """Play one future from this moment."""
    recipe = repeated.base.recipe
    environment = environment_of(recipe.spec, recipe.constants)
    environment.facts = _facts(environment.facts, world.facts, at_us)
    kernel = kernel_of(recipe, environment)
    kernel.run(at_us)
    kernel.set_environment(world)
    kernel.run()
    return kernel.times_us, kernel.caused_by, kernel.events


def _facts(base: Sequence[Fact], other: Sequence[Fact], at_us: int) -> tuple[Fact, ...]:
    """Return the facts begun by then with their ends, the tasks at their times, and the other world's later facts."""
    tasks = [fact for fact in base if isinstance(fact[1], _WORK)]
    others = [fact for fact in other if not isinstance(fact[1], _WORK)]
    return continued(tuple(base), tuple(sorted((*tasks, *others), key=lambda fact: fact[0])), at_us + 1)


def _chance(at_us: int, avoided: Sequence[bool | None]) -> Chance:
    avoided_count, count = avoided.count(True), avoided.count(False) + avoided.count(True)
    return Chance(at_us / 1_000_000, count, avoided_count, avoided.count(None), *wilson(avoided_count, count))
