"""The command `calibrate`."""

from pathlib import Path
from typing import Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import WorkersOption, examples
from fsar_ledger.cli.progress import Progress
from fsar_ledger.cli.terminal import show

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
    """Fit the constants again as registered; takes the better part of an hour.

    The fit is to the paper's results table alone. `reports/registration.toml` names the constants and their ranges. The
    record says where the fit began, what the data identify and what was accepted.
    """
    from fsar_ledger.studies.calibration import calibrate as fit

    with Progress("tried", "parameter sets") as progress:
        fit(out, workers=workers, progress=progress)
    show(printable.line(f"{out}"))
