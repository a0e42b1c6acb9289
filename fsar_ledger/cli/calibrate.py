"""The command `calibrate`: the fit that is registered, made again."""

from pathlib import Path
from typing import Annotated

import typer

from fsar_ledger import printable

from .options import WorkersOption, examples
from .progress import Progress
from .terminal import show

EXAMPLES = examples("fsar-ledger calibrate --out out/calibration.json")


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

    The fit is to the paper's results table alone, of the constants and within the ranges that
    `reports/registration.toml` names. The record of it says where it began, what the data identify and what was
    accepted.
    """
    from fsar_ledger.api.functions import calibrate as fit

    with Progress("tried", "parameter sets") as progress:
        fit(out, workers=workers, progress=progress)
    show(printable.line(f"{out}"))
