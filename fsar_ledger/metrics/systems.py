"""The result of the study of systems: every architecture at several fleet sizes, over its dials, in other worlds."""

from collections.abc import Iterator
from typing import ClassVar

import msgspec

from .definitions import metrics
from .study_results import GroundedResult, Row, rows_of


class SystemNumber(msgspec.Struct, frozen=True, kw_only=True):
    """One metric of one architecture: at a fleet size, or with one of its dials at another value.

    `dial` and `value` are None for the dials as they are declared. Units: `mean`, `sd` over runs and the 95 % interval
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
    """What the events of an architecture show of a feature: full, partial or none; None where nothing could show it."""

    architecture: str
    feature: str
    grade: str | None


class NamedShares(msgspec.Struct, frozen=True, kw_only=True):
    """In what share of its executions an architecture names who it was, by field. None: there was nobody to name."""

    architecture: str
    origin: float | None
    executor: float | None
    supervisor: float | None


class HeldRank(msgspec.Struct, frozen=True, kw_only=True):
    """How FSAR stands beside another architecture when one constant is moved: in how many settings it is told apart.

    In `higher` of the `settings` its 95 % interval lies above the other's, in `lower` below; in the rest they meet.
    A setting in which the metric is undefined for one of them does not count. `against` names those of the rarer kind.
    """

    architecture: str
    metric: str
    settings: int
    higher: int
    lower: int
    against: tuple[str, ...]


class Systems(GroundedResult, frozen=True, kw_only=True):
    """What every architecture does in the same worlds; nothing of it is fitted.

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
        """Say what was run."""
        sizes = ", ".join(f"{size} robots ({runs} runs)" for size, runs in self.runs.items())
        return f"{sizes} of each scenario in {len(self.seeds)} seeds, in {self.cpu_minutes} minutes of one core"
