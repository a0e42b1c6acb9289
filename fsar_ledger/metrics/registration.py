"""The registration, written before the fit: `reports/registration.toml`.

It lists the free constants and their ranges, the rules of the verdicts, and the predictions.
"""

from collections.abc import Mapping
from functools import cache
from importlib.resources import files

import msgspec

UNNAMED = "informed"
"""The class of cells that the registration does not name."""


class Fit(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The settings of the fit: the table it aims at, its rule in words, its seed, and the number of points judged.

    Counts of runs are for each scenario and architecture.

    `starts` searches of at most `rough_steps` begin at the best of the `screened` points; one of at most `most_steps`
    continues from the best of them.
    """

    aims_at: str
    rule: str
    seed: int
    screened: int
    screened_runs: int
    starts: int
    rough_runs: int
    rough_steps: int
    runs: int
    most_steps: int
    enough: float
    judged_runs: int


class Sample(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The sample of a study: its seed, its size, and the runs of each scenario and architecture in each draw.

    Each draw has worlds of its own seed, counting up from `seed`.
    """

    seed: int
    size: int
    runs: int


class SampleAround(Sample, frozen=True, forbid_unknown_fields=True):
    """A sample around the fit, `spread` times as wide as if a margin were one standard deviation of a cell."""

    spread: float


class Kind(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A kind of constant: the range within which the fit may choose values, and the reason for that range."""

    unit: str
    low: float
    high: float
    because: str

    @property
    def middle(self) -> float:
        """Return the geometric mean of the range's ends."""
        return float((self.low * self.high) ** 0.5)


class Free(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One constant that the fit may choose, and its kind."""

    name: str
    kind: str
    meaning: str

    @property
    def range(self) -> Kind:
        """Return the range within which the fit may choose it."""
        return registration().kinds[self.kind]


class Verdicts(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The rules of the verdicts in words, their level, the draws, which n decides, and the seeds of the runs."""

    alpha: float
    model: str
    experiment: str
    draws: int
    decided: int
    seeds: tuple[int, ...]


class Declaration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, rename={"kind": "class"}):
    """The entry of some printed cells: where they are, their class, why, and what they depend on."""

    table: str
    where: dict[str, str | int | list[int]]
    kind: str
    because: str | None = None
    dial: str | None = None

    def covers(self, table: str, place: Mapping[str, object]) -> bool:
        """Return whether the entry includes the cell at this place of a table."""
        return self.table == table and all(
            place.get(name) in (wanted if isinstance(wanted, list) else [wanted]) for name, wanted in self.where.items()
        )


class Prediction(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A prediction of something not yet observed, what the paper's claims imply for it, and where these are made."""

    name: str
    of: str
    implies: str
    claim: str


class Registration(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The whole registration; `margins` by metric, in the metric's unit.

    `ranking`, `ensemble` and `placebo` are the samples of these studies. `discrepancy` is how far the model may be from
    the truth beyond the margin, by metric and architecture, in the metric's unit. `classes` has the meaning of each
    class of cells, `cells` the class of a whole table, `cell` that of single cells.
    """

    model_version: str
    fit: Fit
    ranking: Sample
    ensemble: SampleAround
    placebo: Sample
    kinds: dict[str, Kind]
    free: tuple[Free, ...]
    verdicts: Verdicts
    margins: dict[str, float]
    classes: dict[str, str]
    cells: dict[str, str]
    cell: tuple[Declaration, ...]
    prediction: tuple[Prediction, ...]
    discrepancy: dict[str, dict[str, float]] = {}

    def tolerance(self, metric: str, architecture: str) -> float:
        """Return how far a plausible model may be from the printed cell: margin plus discrepancy, in its unit."""
        return self.margins[metric] + self.discrepancy.get(metric, {}).get(architecture, 0.0)

    def declaration_for(self, table: str, place: Mapping[str, object]) -> Declaration:
        """Return the entry for the cell at this place of a table (names as in `where`).

        An entry for the cell takes precedence over one for its table; without either, the cell is `informed`.
        """
        of_table = Declaration(table, {}, self.cells.get(table, UNNAMED))
        return next((entry for entry in self.cell if entry.covers(table, place)), of_table)


@cache
def registration() -> Registration:
    """Return the packaged registration."""
    return msgspec.toml.decode(
        files("fsar_ledger.reports").joinpath("registration.toml").read_bytes(), type=Registration
    )
