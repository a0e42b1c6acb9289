"""The results of the studies of how far the evaluation depends on what was chosen.

Ranking, ensemble and placebo cover a registered sample (`registration.Sample`): points in the ranges of the free
constants, or repetitions, which are counted. Undefined or equal outcomes at a point are counted separately, never as a
yes or a no. Systems covers every architecture at several fleet sizes, over its dials, and in other worlds.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import msgspec

from .definitions import metrics
from .registration import Sample, SampleAround
from .results import named_setting, setting_of
from .study_results import GroundedResult, Row, rows_of

if TYPE_CHECKING:
    from .multiverse import Universe

Z_95 = 1.959963984540054


class Share(NamedTuple):
    """A share, and the ends of its 95 % interval; None if nothing was counted."""

    share: float | None
    low: float | None
    high: float | None

    def rounded(self, digits: int = 4) -> "Share":
        """Return it rounded to `digits` decimals."""
        return Share(*(None if value is None else round(value, digits) for value in self))


# See docs/decisions/intervals-keep-their-coverage.md.
def wilson(found: int, of: int) -> Share:
    """Return the share `found` of `of`, with its interval. Wilson, Probable Inference (1927)."""
    if not of:
        return Share(None, None, None)
    share, part = found / of, Z_95 * Z_95 / of
    centre = (share + part / 2) / (1 + part)
    half = math.sqrt(share * (1 - share) * part + part * part / 4) / (1 + part)
    return Share(share, 0.0 if not found else centre - half, 1.0 if found == of else centre + half)


class RankCounts(msgspec.Struct, frozen=True, kw_only=True):
    """How FSAR ranks over the points in one metric, or in several at once, as `metric` then says.

    `is_best_in_paper`: whether the paper prints FSAR as the best. At a point FSAR is `best` (better than both others;
    `clearly_best` by at least a margin), `beaten`, `tied` with the better of them, or `undefined` if a cell is.
    `close` are the points where it differs from the better of the others by less than a margin. `ordered` are those
    with all three in the paper's order, `disordered` those without; `tied` or undefined points are neither. The shares
    are of those that are one or the other, with 95 % intervals. In several metrics at once: best in all, beaten in any,
    else undefined in any, else tied; ordered in all, disordered in any; close in any.
    """

    metric: str
    is_best_in_paper: bool
    best: int
    clearly_best: int
    beaten: int
    tied: int
    undefined: int
    close: int
    best_share: float | None
    best_low: float | None
    best_high: float | None
    ordered: int
    disordered: int
    ordered_share: float | None
    ordered_low: float | None
    ordered_high: float | None


class Ranking(GroundedResult, frozen=True, kw_only=True):
    """How FSAR ranks over the registered ranges, without any fit.

    `parameters` are the constants in the middle of all ranges; `ranges` are their ends. A Sobol sequence covers the
    ranges more evenly than independent points, which the intervals assume.
    """

    FILE: ClassVar[str] = "ranking.json"
    MADE_BY: ClassVar[str] = "fsar-ledger study run ranking --out FILE"

    command: str = MADE_BY
    sample: Sample
    ranges: dict[str, tuple[float, float]]
    cpu_minutes: float
    ranks: list[RankCounts]

    def tables(self) -> Iterator[list[Row]]:
        """Yield the ranks."""
        yield rows_of(self.ranks)

    def summary(self) -> str:
        """Return what was sampled, and the time it took."""
        return (
            f"{self.sample.size} points of the registered ranges, {self.sample.runs} runs of each scenario and "
            f"architecture at each, in {self.cpu_minutes} minutes of one core"
        )


class CellSpread(msgspec.Struct, frozen=True, kw_only=True):
    """One cell over the points around the fit: how often it is near the printed number, and its quartiles.

    `within_margin` and `within_tolerance` (margin plus discrepancy) count points, `only_miss` those where it is the one
    cell beyond its tolerance, `plausible_within_margin` plausible points. The quartiles are of the points where it is
    defined.
    """

    metric: str
    architecture: str
    paper: float
    margin: float
    discrepancy: float
    undefined: int
    within_margin: int
    within_tolerance: int
    only_miss: int
    plausible_within_margin: int
    lower_quartile: float | None
    median: float | None
    upper_quartile: float | None


class SignCount(msgspec.Struct, frozen=True, kw_only=True):
    """One comparison of two architectures: at how many points its sign is that of the t that the paper prints.

    `same`, `other` and `neither` (equal, or a mean is undefined) count the plausible points, or all where none is.
    """

    metric: str
    comparison: str
    paper_t: float
    same: int
    other: int
    neither: int


class Ensemble(GroundedResult, frozen=True, kw_only=True):
    """The results at points around the accepted one, drawn where the fit's slopes leave them undetermined.

    `plausible` counts those at which each of the 24 cells is within margin plus discrepancy. `ranks` and `signs` are of
    these alone, and of all points where none is plausible. `clipped` is the share of coordinates moved to the end of
    their range.
    """

    FILE: ClassVar[str] = "ensemble.json"
    MADE_BY: ClassVar[str] = "fsar-ledger study run ensemble --out FILE"

    command: str = MADE_BY
    sample: SampleAround
    cpu_minutes: float
    clipped: float
    plausible: int
    cells: list[CellSpread]
    signs: list[SignCount]
    ranks: list[RankCounts]

    def tables(self) -> Iterator[list[Row]]:
        """Yield the cells, the signs of the comparisons and the ranks."""
        for part in (self.cells, self.signs, self.ranks):
            yield rows_of(part)

    def summary(self) -> str:
        """Return how many points are plausible, in words."""
        count = f"{self.plausible} of {self.sample.size} points are plausible" if self.plausible else "no point of "
        count += "" if self.plausible else f"{self.sample.size} is plausible: signs and ranks are of all points"
        return f"{count}; {self.sample.runs} runs at each, in {self.cpu_minutes} minutes of one core"


class Rejections(msgspec.Struct, frozen=True, kw_only=True):
    """How often a test of one metric rejects at `alpha` between runs that differ only in their worlds.

    `test` is a p of `statistics/pairwise_tests`; with metric `any of the eight`, of the smallest of all metrics.
    `undefined` repetitions have no p, and `share` is of the others, with its 95 % interval.
    """

    metric: str
    test: str
    rejected: int
    kept: int
    undefined: int
    share: float | None
    low: float | None
    high: float | None


class Placebo(GroundedResult, frozen=True, kw_only=True):
    """FSAR compared with FSAR under the name of another architecture.

    On the same seeds, `pairs` pairs of runs met the same world, and `largest_difference` is the largest mean difference
    of the eight metrics; it is 0 if nothing depends on the name. On other seeds, `tests` count rejections.
    """

    FILE: ClassVar[str] = "placebo.json"
    MADE_BY: ClassVar[str] = "fsar-ledger study run placebo --out FILE"
    RELATIONS: ClassVar[tuple[str, ...]] = ("pairwise_tests",)

    command: str = MADE_BY
    sample: Sample
    cpu_minutes: float
    alpha: float
    pairs: int
    largest_difference: float | None
    tests: list[Rejections]

    def tables(self) -> Iterator[list[Row]]:
        """Yield the tests."""
        yield rows_of(self.tests)

    def summary(self) -> str:
        """Return what differs on the same seeds, in words."""
        return (
            f"on the same seeds {self.pairs} pairs differ by {self.largest_difference} at most; on others, "
            f"{self.sample.size} repetitions at {self.alpha}, in {self.cpu_minutes} minutes of one core"
        )


class SystemNumber(msgspec.Struct, frozen=True, kw_only=True):
    """One metric of one architecture: at a fleet size, or with one of its dials at another value.

    `dial` and `value` are None for the declared dials. Units: `mean`, `sd` over runs and the 95 % interval
    `low` to `high` in the metric's; `n` runs in which it is defined.
    None: undefined in every run.
    """

    architecture: str
    fleet_size: int
    dial: str | None
    value: int | None
    metric: str
    n: int
    mean: float | None
    low: float | None
    high: float | None
    sd: float | None


class SystemGrade(msgspec.Struct, frozen=True, kw_only=True):
    """How far the events of an architecture show a feature: full, partial or none; None where nothing could show it."""

    architecture: str
    feature: str
    grade: str | None


class NamedShares(msgspec.Struct, frozen=True, kw_only=True):
    """The share of its executions in which an architecture names each principal. None: there was none to name."""

    architecture: str
    origin: float | None
    executor: float | None
    supervisor: float | None


class HeldRank(msgspec.Struct, frozen=True, kw_only=True):
    """FSAR beside another architecture when one constant is moved: in how many settings they can be distinguished.

    In `higher` of the `settings` its 95 % interval lies above the other's, in `lower` below; in the rest they overlap.
    A setting in which the metric is undefined for one of them does not count. `against` names those of the rarer kind.
    """

    architecture: str
    metric: str
    settings: int
    higher: int
    lower: int
    against: tuple[str, ...]


class Systems(GroundedResult, frozen=True, kw_only=True):
    """The metrics of every architecture in the same worlds; nothing is fitted.

    `runs` are those of each scenario and seed, by fleet size; a dial is tried with the runs of the first seed.
    `moved_runs` are those of each scenario where a constant is moved.
    """

    FILE: ClassVar[str] = "systems.json"
    MADE_BY: ClassVar[str] = "fsar-ledger study run systems --out FILE"
    RELATIONS: ClassVar[tuple[str, ...]] = (
        "metric_summary",
        "architecture_features",
        "true_principals",
        *(metric.name for metric in metrics()),
    )

    command: str = MADE_BY
    seeds: tuple[int, ...]
    runs: dict[str, int]
    cpu_minutes: float
    numbers: list[SystemNumber]
    grades: list[SystemGrade]
    named: list[NamedShares]
    moved_runs: int
    held: list[HeldRank]

    def tables(self) -> Iterator[list[Row]]:
        """Yield the numbers, the grades, the shares of names, and where ranks hold."""
        for part in (self.numbers, self.grades, self.named, self.held):
            yield rows_of(part)

    def summary(self) -> str:
        """Return what was run, in words."""
        sizes = ", ".join(f"{size} robots ({runs} runs)" for size, runs in self.runs.items())
        return f"{sizes} of each scenario in {len(self.seeds)} seeds, in {self.cpu_minutes} minutes of one core"


class OrderUnderReadings(msgspec.Struct, frozen=True, kw_only=True):
    """How stable the order of the architectures by one metric is under all combinations of readings.

    `order` is the one under our reading, the best first, `=` between equals; it orders means without regard to chance.
    `same_order` and `fsar_best` count combinations; `changed_under` and `fsar_not_best_under` name the smallest
    combinations under which the order differs, or FSAR is not the best.
    None: fewer than two architectures have a mean, or FSAR is not among them.
    """

    metric: str
    better: str
    configuration: str | None
    fleet_size: int | None
    seed: int | None
    kind: str
    source: str | None
    model_version: str | None
    constants: str | None
    order: str | None
    combinations: int
    same_order: int | None
    fsar_best: int | None
    changed_under: tuple[tuple[str, ...], ...] | None
    fsar_not_best_under: tuple[tuple[str, ...], ...] | None


def rankings(found: "Iterable[Universe]", better: Mapping[str, str]) -> Iterator[OrderUnderReadings]:
    """Return whether each ranking survives, in the order of the universes of our reading."""
    by_setting: dict[tuple[object, ...], dict[tuple[str, ...], list[Universe]]] = {}
    for universe in found:
        by_setting.setdefault((universe.metric, setting_of(universe)), {}).setdefault(universe.readings, []).append(
            universe
        )
    for by_readings in by_setting.values():
        first = by_readings[()][0]
        orders = {names: ranked(universes, better[first.metric]) for names, universes in by_readings.items()}
        ours = orders[()]
        changed = [names for names, order in orders.items() if order != ours]
        not_best = [names for names, order in orders.items() if not order or order[0] != ("fsar",)]
        is_ranked = sum(map(len, ours)) > 1
        has_fsar = is_ranked and any("fsar" in equals for equals in ours)
        yield OrderUnderReadings(
            metric=first.metric,
            better=better[first.metric],
            **named_setting(first),
            order=" > ".join(" = ".join(equals) for equals in ours) if is_ranked else None,
            combinations=len(orders),
            same_order=len(orders) - len(changed) if is_ranked else None,
            fsar_best=len(orders) - len(not_best) if has_fsar else None,
            changed_under=smallest(changed) if is_ranked else None,
            fsar_not_best_under=smallest(not_best) if has_fsar else None,
        )


def ranked(mine: "Iterable[Universe]", better: str) -> tuple[tuple[str, ...], ...]:
    """Return the architectures that have a mean, the best first; equal ones together, by name."""
    sign = -1 if better == "higher" else 1
    ordered = sorted(
        (sign * steady(universe.mean), universe.architecture or "unnamed")
        for universe in mine
        if universe.mean is not None
    )
    return tuple(tuple(name for _, name in equals) for _, equals in groupby(ordered, key=lambda entry: entry[0]))


def steady(mean: float) -> float:
    """Return the mean without its last bits, which depend on the order in which the values of runs are added."""
    return float(f"{mean:.12g}")


def smallest(sets: Sequence[tuple[str, ...]]) -> tuple[tuple[str, ...], ...]:
    """Return those combinations that contain no other one."""
    return tuple(names for names in sets if not any(set(other) < set(names) for other in sets))
