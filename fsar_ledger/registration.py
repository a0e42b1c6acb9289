"""What was written down before the fit, `reports/registration.toml`: which constants are free and how far, the verdict rules, what is predicted."""

from functools import cache
from importlib.resources import files

import msgspec


class Fit(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How the fit is made: the table it aims at, its rule in words, its seed, and how many runs a scenario and architecture judge a point."""

    aims_at: str
    rule: str
    seed: int
    screened: int
    screened_runs: int
    runs: int
    judged_runs: int
    most_steps: int


class Kind(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A kind of constant: the range within which the fit may place those of this kind, and why that range."""

    unit: str
    low: float
    high: float
    because: str

    @property
    def middle(self) -> float:
        """The geometric middle of the range."""
        return float((self.low * self.high) ** 0.5)


class Free(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One constant that the fit may choose, and of which kind it is."""

    name: str
    kind: str
    meaning: str

    @property
    def range(self) -> Kind:
        """The range within which the fit may place it."""
        return registration().kinds[self.kind]


class Verdicts(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The rules of the verdicts in words, their level, how many experiments are drawn, and how many cells the choice of n is to decide."""

    alpha: float
    model: str
    experiment: str
    draws: int
    decided: int


class Registration(msgspec.Struct, frozen=True):
    """The registration as far as the fit and the verdicts need it; `margins` by metric, in the metric's unit."""

    model_version: str
    fit: Fit
    kinds: dict[str, Kind]
    free: tuple[Free, ...]
    verdicts: Verdicts
    margins: dict[str, float]


@cache
def registration() -> Registration:
    """Return the packaged registration."""
    return msgspec.toml.decode(files("fsar_ledger.reports").joinpath("registration.toml").read_bytes(), type=Registration)
