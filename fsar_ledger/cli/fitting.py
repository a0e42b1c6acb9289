"""The commands `calibrate`, `predict` and `judge`: the fit, the numbers that are written down with it before they are compared, and the comparison."""

from pathlib import Path
from typing import Annotated

import typer

from fsar_ledger import printable

from .options import WorkersOption, examples, workers_of
from .progress import Progress
from .terminal import show

CALIBRATE = examples("fsar-ledger calibrate --out out/calibration.json")
PREDICT = examples("fsar-ledger predict --out out/predictions.json")
JUDGE = examples("fsar-ledger judge out/predictions.json --out out/comparison.json")


def calibrate(
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FILE", help="The record of the fit, as JSON; replaced if it exists.", show_default=False
        ),
    ],
    workers: WorkersOption = None,
) -> None:
    """Make the fit that is registered again; takes the better part of an hour.

    The fit is to the paper's results table alone, of the constants and within the ranges that `reports/registration.toml` names. The record of it
    says where it began, what the data identify and what was accepted.
    """
    from fsar_ledger.calibration import calibrate as fit

    with Progress("tried", "parameter sets") as progress:
        fit(out, progress, workers_of(workers))
    show(printable.line(f"{out}"))


def predict(
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FILE", help="The predicted numbers, as JSON; replaced if it exists.", show_default=False
        ),
    ],
    workers: WorkersOption = None,
) -> None:
    """Play what is registered to be predicted, and write down the numbers; takes minutes.

    Ablations, larger fleets, loads, encounter rates, other seeds and pairs of ablations, with the constants as they are. No number of the paper is
    read. What is predicted, and what the paper's claims imply for it, is in `reports/registration.toml`.
    """
    from fsar_ledger.prediction import predict as write

    with Progress("played", "experiments") as progress:
        write(out, progress, workers_of(workers))
    show(printable.line(f"{out}"))


def judge(
    predictions: Annotated[
        Path, typer.Argument(metavar="PREDICTIONS", help="What `predict` wrote.", show_default=False)
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FILE", help="The comparison, as JSON; replaced if it exists.", show_default=False
        ),
    ],
) -> None:
    """Lay predicted numbers beside the paper's, and beside what was registered that its claims imply.

    Nothing is played. `reports/predictions.json` in the source of this package holds the predictions that were made right after the fit,
    `reports/comparison.json` what became of them.
    """
    from fsar_ledger.comparison import compare_predictions

    compare_predictions(predictions, out)
    show(printable.line(f"{out}"))
