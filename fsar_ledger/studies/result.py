"""Write the result file of a study, and check whether one is still valid for this version of the package."""

from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from fsar_ledger.base import printable
from fsar_ledger.base.publishing import ADVICE, publish, require_place
from fsar_ledger.designs.constants import Constants, write_constants
from fsar_ledger.ledger.store.paths import require_outside
from fsar_ledger.metrics.effects import Sensitivity
from fsar_ledger.metrics.registration import Sample, registration
from fsar_ledger.metrics.robustness import Ensemble, Placebo, Ranking, Systems
from fsar_ledger.metrics.study_results import (
    Calibration,
    Comparison,
    GroundedResult,
    Predictions,
    Result,
    changed,
    encoded,
    rules,
)
from fsar_ledger.runtime.simulation import MODEL_VERSION

from .factors import FREE, constants_at

KINDS: dict[str, type[Result]] = {
    "ranking": Ranking,
    "calibration": Calibration,
    "ensemble": Ensemble,
    "predictions": Predictions,
    "comparison": Comparison,
    "sensitivity": Sensitivity,
    "placebo": Placebo,
    "systems": Systems,
}
"""The studies whose results are files, in the order in which they are made."""
RESUME_ADVICE = "make room and run it again, to continue from there"
"""The advice where a result cannot be written but its evaluations are kept."""


def require_out(out: Path) -> None:
    """Check, before minutes of work, that the result can be written.

    Raises:
        UsageError: The file lies inside a ledger.
        WriteFailed: It cannot be written.
    """
    require_outside(out, f"--out {out}")
    require_place(out)


def write(out: Path, result: Result, advice: str = ADVICE) -> None:
    """Write the result, replacing the file. Raises: WriteFailed, with the advice."""
    publish(out, encoded(result), advice)


def grounds(kind: type[GroundedResult]) -> dict[str, Any]:
    """Return the fields that name what a result of this kind rests on in this version."""
    constants = constants_at(np.zeros(len(FREE))) if kind is Ranking else Constants()
    return {
        "model_version": MODEL_VERSION,
        "parameters": write_constants(constants),
        "rules": rules(*kind.RELATIONS),
    }


def ranges() -> dict[str, tuple[float, float]]:
    """Return the ends of the registered range of each free constant."""
    return {free.name: (free.range.low, free.range.high) for free in FREE}


def stale(result: Result) -> str | None:
    """Return which part of what a result rests on differs in this version; None if none does.

    The parts are the model, the constants (except for the calibration, which found them, and the ranking, which has
    only those that are not free), the sample and the ranges as registered, and the queries.
    """
    assert isinstance(result, GroundedResult | Calibration)
    if result.model_version != MODEL_VERSION:
        return f"of model {result.model_version!r:.80}, expected model {MODEL_VERSION!r}"
    if isinstance(result, GroundedResult):
        expected = grounds(type(result))["parameters"]
        if result.parameters != expected:
            return (
                f"with the constants {_digest(result.parameters)} (SHA-256), expected those of this version, "
                f"{_digest(expected)}"
            )
    if difference := _registered_otherwise(result):
        return difference
    if result.rules is None:
        return "that name no queries, expected a digest of each query that judged their runs"
    if changed_queries := changed(result.rules):
        return (
            "that other queries made, expected those of this version; changed since: "
            f"{printable.list_few(map(printable.value, changed_queries))}"
        )
    return None


def _registered_otherwise(result: Result) -> str | None:
    """Return what in the registration differs from that of the result."""
    if isinstance(result, Ranking | Ensemble | Placebo):
        expected: Sample = getattr(registration(), type(result).FILE.removesuffix(".json"))
        if result.sample != expected:
            return f"over {result.sample}, expected the registered {expected}"
    if isinstance(result, Ranking) and result.ranges != ranges():
        return "over other ranges, expected the registered ones"
    return None


def _digest(parameters: str) -> str:
    return sha256(parameters.encode("utf-8", "surrogatepass")).hexdigest()[:12]
