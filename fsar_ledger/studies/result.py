"""Write the result file of a study, and say whether one still holds for this version of the package."""

from hashlib import sha256
from pathlib import Path

from fsar_ledger.base import printable
from fsar_ledger.base.publishing import publish, require_place
from fsar_ledger.designs.constants import Constants, write_constants
from fsar_ledger.ledger.store.paths import require_outside
from fsar_ledger.metrics.effects import About
from fsar_ledger.metrics.study_results import Calibration, Comparison, Predictions, changed, encoded
from fsar_ledger.runtime.simulation import MODEL_VERSION


def require_out(out: Path) -> None:
    """Check, before minutes of work, that the result can be written.

    Raises:
        UsageError: The file lies inside a ledger.
        WriteFailed: It cannot be written.
    """
    require_outside(out, f"--out {out}")
    require_place(out)


def write(out: Path, result: Calibration | Predictions | Comparison) -> None:
    """Write the result, replacing the file. Raises: WriteFailed."""
    publish(out, encoded(result))


def stale(result: Calibration | Predictions | Comparison | About) -> str | None:
    """Return which part of what a result rests on is another one in this version; None if none is.

    That is the model, the constants (but for the calibration, which found them) and the queries.
    """
    if result.model_version != MODEL_VERSION:
        return f"of model {result.model_version!r:.80}, expected model {MODEL_VERSION!r}"
    today = write_constants(Constants())
    parameters = today if isinstance(result, Calibration) else result.parameters
    if parameters != today:
        return f"with the constants {_digest(parameters)} (SHA-256), expected those of this version, {_digest(today)}"
    if result.rules is None:
        return "that name no queries, expected a digest of each query that judged their runs"
    if judged_otherwise := changed(result.rules):
        return (
            "that other queries made, expected those of this version; changed since: "
            f"{printable.some(map(printable.value, judged_otherwise))}"
        )
    return None


def _digest(parameters: str) -> str:
    return sha256(parameters.encode("utf-8", "surrogatepass")).hexdigest()[:12]
