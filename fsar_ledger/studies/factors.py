"""Define what is varied, and how far: factors, and points in the registered ranges of the free constants.

Factors are every number of the world and the structure, the load, and the fleet size. One rule applies to all, whether
the paper prints a constant, the fit found it or we chose it: a length, a rate or a range is halved to doubled; a share
or a probability has its odds halved to doubled, so that it stays between 0 and 1; a count takes every integer from half
to double. Load and fleet size have two settings each, the first of which is the base. Outages are not factors: their
rates are 0 by default, and doubling 0 changes nothing.

A point has a coordinate for each free constant, in the order of the registration: 0 is the middle of its range, -1 and
1 are its ends, on a logarithmic scale.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import msgspec
import numpy as np

from fsar_ledger.base import printable
from fsar_ledger.designs.constants import Constants, Load, Range, origins
from fsar_ledger.metrics.registration import Free, registration

if TYPE_CHECKING:
    from .factor_effects import Matrix, Vector

SHARES = (
    "world.context_window_share",
    "world.review_share",
    "world.motion_share",
    "world.degradation_probability",
    "world.degraded_reliability",
    "structure.ordering_response_ppm",
    "structure.hop_ppm",
)
"""Constants that lie between 0 and 1, or 0 and a million parts."""

COUNTS = (
    "world.floor_teams",
    "structure.expiry_budgets",
    "structure.local_attempts",
    "structure.negotiation_rounds",
    "structure.peer_helpers",
    "structure.fleet_reassignments",
    "structure.human_calls",
)

SETTINGS: dict[str, tuple[Any, Any]] = {"load.teams_working": (None, 1), "load.task_sets": (1, 2), "fleet.size": (4, 8)}
"""The factors with two settings.

All teams work, or one; each team has its tasks once, or twice; the fleet is of one team, or of two.
"""

PPM = 1_000_000
Kind = Literal["scaled", "share", "count", "settings"]


class Factor(msgspec.Struct, frozen=True):
    """A varied constant or setting.

    `origin` is the origin of its value according to `constants.py`; `value` is its base.
    """

    name: str
    kind: Kind
    value: Any
    origin: str

    @property
    def settings(self) -> tuple[Any, ...]:
        """Return all values that the factor can have, in order; empty if it has a continuous range."""
        if self.kind == "settings":
            return SETTINGS[self.name]
        return tuple(range((self.value + 1) // 2, 2 * self.value + 1)) if self.kind == "count" else ()

    @property
    def is_switch(self) -> bool:
        """Return whether there are exactly two settings."""
        return len(self.settings) == 2

    def value_at(self, position: float) -> Any:
        """Return the value at a position from 0 (lowest) to 1 (highest), which settings divide equally."""
        if settings := self.settings:
            return settings[min(int(position * len(settings)), len(settings) - 1)]
        factor = 2.0 ** (2 * position - 1)
        if self.kind == "share":
            scale = PPM if isinstance(self.value, int) else 1
            odds = factor * self.value / (scale - self.value)
            return _like(self.value, scale * odds / (1 + odds))
        if isinstance(self.value, Range):
            return Range(*(_like(end, end * factor) for end in msgspec.structs.astuple(self.value)))
        return _like(self.value, self.value * factor)

    def value_text(self, position: float | None = None) -> str:
        """Return the base, or the value at a position, as text."""
        value = self.value if position is None else self.value_at(position)
        if isinstance(value, Range):
            return f"{printable.number(value.low_s)} to {printable.number(value.high_s)}"
        return "all" if value is None else printable.number(value) if isinstance(value, float) else str(value)


class Setting(msgspec.Struct, frozen=True):
    """The setting of one evaluation: constants, and the size of the fleet."""

    constants: Constants
    fleet_size: int


def _like(base: float, value: float) -> Any:
    """Round to six significant digits, and to an integer if the base is one.

    This keeps the last bits of an exponential out of the parameters in a ledger.
    """
    return round(value) if isinstance(base, int) else float(f"{value:.6g}")


def factors() -> tuple[Factor, ...]:
    """Return all factors around the package's constants, in the order of `constants.py`; load and fleet come last."""
    base, words = Constants(), origins()
    listed: list[Factor] = []
    for group in ("world", "structure"):
        part = getattr(base, group)
        for name in part.__struct_fields__:
            value, dotted = getattr(part, name), f"{group}.{name}"
            if name == "durations":
                listed += [
                    Factor(f"{dotted}.{capability}", "scaled", duration, words[f"{dotted}.{capability}"])
                    for capability, duration in value
                ]
            else:
                listed.append(Factor(dotted, _kind(dotted), value, words[dotted]))
    listed += [Factor(name, "settings", settings[0], words.get(name, "chosen")) for name, settings in SETTINGS.items()]
    return (*listed, Factor("load.interval_s", "scaled", Load().interval_s, words["load.interval_s"]))


def _kind(name: str) -> Kind:
    return "share" if name in SHARES else "count" if name in COUNTS else "scaled"


def setting(all_factors: Iterable[Factor], positions: Mapping[str, float]) -> Setting:
    """Return the setting with these factors at these positions, and everything else as in this package."""
    fleet_size, base = 4, Constants()
    durations = dict(base.world.durations)
    groups: dict[str, dict[str, Any]] = {"world": {}, "structure": {}, "load": {}}
    for factor in all_factors:
        if factor.name not in positions:
            continue
        value = factor.value_at(positions[factor.name])
        group, _, name = factor.name.partition(".")
        if group == "fleet":
            fleet_size = value
        elif name.startswith("durations."):
            durations[name.removeprefix("durations.")] = value
        else:
            groups[group][name] = value
    replace = msgspec.structs.replace
    constants = Constants(
        replace(base.world, durations=tuple(durations.items()), **groups["world"]),
        replace(base.structure, **groups["structure"]),
        load=Load(**groups["load"]),
    )
    return Setting(_without_unused(constants, fleet_size), fleet_size)


def _without_unused(constants: Constants, fleet_size: int) -> Constants:
    """Return the constants in their canonical form.

    They have no load if one team has its tasks once, and no interval if there is only one set.
    """
    load = constants.load
    assert load is not None
    teams = None if fleet_size == 4 else load.teams_working
    interval_s = Load().interval_s if load.task_sets == 1 else load.interval_s
    used = Load(teams, load.task_sets, interval_s)
    return msgspec.structs.replace(constants, load=None if used == Load() else used)


FREE = registration().free


def sobol(size: int, seed: int) -> "Matrix":
    """Return `size` points of a scrambled Sobol sequence over the unit cube, a coordinate per free constant."""
    from scipy.stats.qmc import Sobol

    return np.asarray(Sobol(len(FREE), rng=seed).random_base2((size - 1).bit_length())[:size])


def points_over_ranges(size: int, seed: int) -> "list[Vector]":
    """Return `size` points that cover the ranges evenly."""
    return [np.asarray(2.0 * point - 1.0) for point in sobol(size, seed)]


def constants_at(point: "Vector") -> Constants:
    """Return the constants at a point."""
    return with_values(
        [
            free.range.middle * (free.range.high / free.range.middle) ** float(coordinate)
            for free, coordinate in zip(FREE, point, strict=True)
        ]
    )


def point_of(values: Sequence[float]) -> "Vector":
    """Return the point at which the free constants have these values; inverts `constants_at`, apart from rounding."""
    return np.array(
        [
            np.log(value / free.range.middle) / np.log(free.range.high / free.range.middle)
            for free, value in zip(FREE, values, strict=True)
        ]
    )


def with_values(values: Sequence[float]) -> Constants:
    """Return the constants with these values for the free ones, in the order of the registration."""
    changes: dict[str, dict[str, Any]] = {"world": {}, "structure": {}}
    for free, value in zip(FREE, values, strict=True):
        part, _, name = free.name.partition(".")
        changes[part][name] = rounded(value) if part == "world" else int(rounded(value))
    base = Constants()
    replace = msgspec.structs.replace
    return Constants(replace(base.world, **changes["world"]), replace(base.structure, **changes["structure"]))


def value_of(constants: Constants, free: Free) -> float:
    """Return the value of a free constant."""
    part, _, name = free.name.partition(".")
    return getattr(getattr(constants, part), name)  # type: ignore[no-any-return]


def rounded(value: float) -> float:
    """Return the value with three significant digits; the data do not determine more."""
    return float(f"{value:.3g}")
