"""The record of the fit, `reports/calibration.json`, as far as it is there.

Every part is optional and unknown keys are skipped, so that a report can be made before, during and after a
fit; a part that is absent is said to be absent. Percentages and seconds are as in the queries (shares in [0, 1]).
"""

from importlib.resources import files
from importlib.resources.abc import Traversable

import msgspec

from fsar_ledger.errors import FsarLedgerError


class Objective(msgspec.Struct, frozen=True):
    """What the fit made small: in words, its value before and after."""

    description: str
    start: float | None = None
    accepted: float | None = None


class Parameter(msgspec.Struct, frozen=True):
    """One fitted constant: start and accepted value in `unit`, what it means, and whether the data identify it."""

    name: str
    unit: str
    start: float
    accepted: float
    meaning: str = ""
    identified: bool | None = None


class Residual(msgspec.Struct, frozen=True):
    """One cell after the fit: paper and fitted mean (stored units) and their distance in margins of the metric."""

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
    """The whole record; lists are empty where the fit recorded nothing."""

    objective: Objective | None = None
    seeds: list[int] = []
    runs_per_scenario: int | None = None
    evaluations: int | None = None
    model_version: str | None = None
    command: str | None = None
    parameters: list[Parameter] = []
    residuals: list[Residual] = []
    directions: list[Direction] = []


def recorded(folder: Traversable | None = None) -> Record | None:
    """The record of the fit in this folder (default: the packaged one), or None when there is none.

    Raises: FsarLedgerError when the file is there and is not such a record.
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
