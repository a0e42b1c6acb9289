"""Read the record of the fit, `reports/calibration.json`.

Every part is optional and unknown keys are skipped, so that a report can be made before, during and after a fit; the
report says which parts are absent. Units are those of the queries (shares in [0, 1], seconds).
"""

from importlib.resources import files
from importlib.resources.abc import Traversable

import msgspec

from fsar_ledger.errors import FsarLedgerError


class Objective(msgspec.Struct, frozen=True):
    """What the fit minimised: a description, and its value before and after."""

    description: str
    start: float | None = None
    accepted: float | None = None


class Parameter(msgspec.Struct, frozen=True):
    """One fitted constant: start and accepted value in `unit`, its meaning, and whether the data identify it."""

    name: str
    unit: str
    start: float
    accepted: float
    meaning: str = ""
    identified: bool | None = None


class Residual(msgspec.Struct, frozen=True):
    """One cell after the fit: paper and fitted mean (stored units), and their distance in margins of the metric."""

    metric: str
    architecture: str
    paper: float
    ours: float
    distance_margins: float | None = None


class Direction(msgspec.Struct, frozen=True):
    """One direction of the parameter space: its singular value in the scaled Jacobian, and the largest weights."""

    singular_value: float
    identified: bool
    weights: dict[str, float] = {}


class Record(msgspec.Struct, frozen=True):
    """The record of a fit; lists are empty where it recorded nothing. `rules`: the queries that judged its runs."""

    objective: Objective | None = None
    seeds: list[int] = []
    runs_per_scenario: int | None = None
    evaluations: int | None = None
    model_version: str | None = None
    rules: dict[str, str] | None = None
    command: str | None = None
    parameters: list[Parameter] = []
    residuals: list[Residual] = []
    directions: list[Direction] = []


def recorded(folder: Traversable | None = None) -> Record | None:
    """Return the record of the fit in this folder (default: the packaged one), or None if there is none.

    Raises: FsarLedgerError if the file is not such a record.
    """
    path = (folder or files("fsar_ledger.reports")).joinpath("calibration.json")
    if not path.is_file():
        return None
    try:
        return msgspec.json.decode(path.read_bytes(), type=Record)
    except msgspec.DecodeError as error:
        raise FsarLedgerError(
            f"reports/calibration.json: {error}; expected what `fsar-ledger calibrate --out FILE` writes; write it "
            "again"
        ) from error
