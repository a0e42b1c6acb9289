"""The result of the sensitivity study: the effect of each constant on each cell."""

from collections.abc import Iterator
from typing import ClassVar

import msgspec

from fsar_ledger.events.configuration import PAPER_ARCHITECTURES

from .definitions import published_metrics
from .study_results import GroundedResult, Row

MADE_BY = "fsar-ledger study run sensitivity --out FILE"
NUMBERS = ("effects", "mu", "mu_star", "sigma", "mu_star_conf")


class VariedCell(msgspec.Struct, frozen=True, kw_only=True):
    """One cell: its mean at the base, in the metric's unit, and the possible effect of chance alone.

    `by_chance` is the largest `mu_star` of a factor if only chance moved the cell, `by_chance_of_switch` that of a
    switch. `emulator_r2` is how well the polynomial behind the Sobol indices predicts unseen points. None: the cell was
    undefined, or there is no such polynomial.
    """

    metric: str
    architecture: str
    margin: float
    base_mean: float | None
    by_chance: float | None
    by_chance_of_switch: float | None
    emulator_r2: float | None


class VariedFactor(msgspec.Struct, frozen=True, kw_only=True):
    """One factor, the origin of its value, and its effect on each cell over its whole range, `low` to `high`.

    For a switch it is the change between its two settings. The tuples have a number for each cell, in their order:
    `mu`, `mu_star`, `sigma` and `mu_star_conf` (half of the 95 % interval of `mu_star`) are in the metric's unit, over
    `effects` moves. `sobol_first` and `sobol_total` are parts of the cell's variance while the factors that matter most
    vary together. None: the cell was undefined, or the factor is not among those.
    """

    name: str
    origin: str
    low: str
    base: str
    high: str
    is_switch: bool
    effects: tuple[int, ...]
    mu: tuple[float | None, ...]
    mu_star: tuple[float | None, ...]
    sigma: tuple[float | None, ...]
    mu_star_conf: tuple[float | None, ...]
    sobol_first: tuple[float | None, ...] | None = None
    sobol_total: tuple[float | None, ...] | None = None


class Effect(msgspec.Struct, frozen=True, kw_only=True):
    """The effect of one factor on one cell, as in `VariedFactor`, in margins of the metric."""

    metric: str
    architecture: str
    factor: str
    effects: int
    mu_margins: float | None
    mu_star_margins: float | None
    sigma_margins: float | None
    mu_star_conf_margins: float | None
    by_chance_margins: float | None


class Sensitivity(GroundedResult, frozen=True, kw_only=True):
    """The effects around the constants `parameters`, and the number of evaluations and runs behind them.

    `dozen` names the factors that matter most (`that_matter`), the one that moves a cell furthest first.
    """

    FILE: ClassVar[str] = "sensitivity.json"
    MADE_BY: ClassVar[str] = MADE_BY

    command: str = MADE_BY
    fleet_size: int
    seed: int
    trajectories: int
    runs: int
    points: int
    repeats: int
    evaluations: int
    cpu_minutes: float
    dozen: tuple[str, ...]
    cells: tuple[VariedCell, ...]
    factors: tuple[VariedFactor, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        expected = [
            (metric.name, architecture) for metric in published_metrics() for architecture in PAPER_ARCHITECTURES
        ]
        if [(cell.metric, cell.architecture) for cell in self.cells] != expected:
            raise ValueError("the cells are not those of the results table")
        names = [factor.name for factor in self.factors]
        if len(set(names)) != len(names) or not set(self.dozen) <= set(names):
            raise ValueError("a factor stands twice, or is not there")
        for factor in self.factors:
            parts = [getattr(factor, name) for name in NUMBERS] + [
                factor.sobol_first or expected,
                factor.sobol_total or expected,
            ]
            if any(len(part) != len(expected) for part in parts):
                raise ValueError(f"factor {factor.name}: not a number for each cell")

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Return the effect of each factor on each cell, cell by cell."""
        return tuple(self._effects())

    def _effects(self) -> Iterator[Effect]:
        for at, cell in enumerate(self.cells):
            for factor in self.factors:
                chance = cell.by_chance_of_switch if factor.is_switch else cell.by_chance
                lengths = {name: getattr(factor, name)[at] for name in NUMBERS[1:]} | {"by_chance": chance}
                yield Effect(
                    metric=cell.metric,
                    architecture=cell.architecture,
                    factor=factor.name,
                    effects=factor.effects[at],
                    **{
                        f"{name}_margins": None if length is None else length / cell.margin
                        for name, length in lengths.items()
                    },
                )

    def tables(self) -> Iterator[list[Row]]:
        """Yield the dozen."""
        yield dozen(self)

    def summary(self) -> str:
        """Return how much was varied, in one line."""
        still = sum(furthest == 0 for furthest in reach(self).values())
        return (
            f"{len(self.factors)} factors, {self.evaluations:,} evaluations in {self.cpu_minutes} minutes of one core; "
            f"{still} factors move nothing; in margins of the cell moved furthest:"
        )


def reach(found: Sensitivity) -> dict[str, float]:
    """Return the furthest that each factor moves any cell, in margins, the largest first.

    Equal ones keep the order of the file.
    """
    furthest = dict.fromkeys((factor.name for factor in found.factors), 0.0)
    for effect in found.effects:
        furthest[effect.factor] = max(furthest[effect.factor], effect.mu_star_margins or 0.0)
    return dict(sorted(furthest.items(), key=lambda item: -item[1]))


def that_matter(found: Sensitivity, most: int) -> tuple[str, ...]:
    """Return the `most` factors that matter most, the one with the longest reach first.

    They are the one that moves each metric furthest, then those that move any cell furthest. By reach alone, a metric
    with a narrow margin would fill the list.
    """
    furthest: dict[str, tuple[float, str]] = {}
    for effect in found.effects:
        if effect.mu_star_margins and effect.mu_star_margins > furthest.get(effect.metric, (0.0, ""))[0]:
            furthest[effect.metric] = effect.mu_star_margins, effect.factor
    by_reach = [name for name, margins in reach(found).items() if margins > 0]
    chosen = dict.fromkeys([*(name for _, name in furthest.values()), *by_reach])
    return tuple(sorted(list(chosen)[:most], key=by_reach.index))


def dozen(found: Sensitivity) -> list[Row]:
    """Return a row for each factor that matters most: the cell it moves furthest, how far, its part of the variance."""
    rows: list[Row] = []
    effects = found.effects
    by_name = {factor.name: factor for factor in found.factors}
    for name in found.dozen:
        factor, of_factor = by_name[name], [effect for effect in effects if effect.factor == name]
        index = max(range(len(of_factor)), key=lambda cell: of_factor[cell].mu_star_margins or 0.0)
        largest = of_factor[index]
        rows.append(
            {
                "factor": name,
                "from": factor.origin,
                "range": f"{factor.low} to {factor.high}"
                if " to " not in factor.low
                else f"({factor.low}) to ({factor.high})",
                "cells": sum((effect.mu_star_margins or 0.0) >= 1 for effect in of_factor),
                "metric": largest.metric,
                "architecture": largest.architecture,
                "mu_margins": largest.mu_margins,
                "mu_star_margins": largest.mu_star_margins,
                "conf": largest.mu_star_conf_margins,
                "by_chance": largest.by_chance_margins,
                "sobol_first": None if factor.sobol_first is None else factor.sobol_first[index],
                "sobol_total": None if factor.sobol_total is None else factor.sobol_total[index],
                "r2": found.cells[index].emulator_r2,
            }
        )
    return rows
