"""The command `predict`."""

from pathlib import Path
from typing import Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import WorkersOption, examples
from fsar_ledger.cli.progress import Progress
from fsar_ledger.cli.terminal import show

EXAMPLES = examples("fsar-ledger predict --out out/predictions.json")


def predict(
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FILE", help="The predicted numbers, as JSON; replaced if it exists.", show_default=False
        ),
    ],
    workers: WorkersOption = None,
) -> None:
    """Simulate the experiments registered for prediction, and write their numbers; takes minutes.

    These are ablations, larger fleets, loads, encounter rates, other seeds and pairs of ablations, with the constants
    as they are. No number of the paper is read. `reports/registration.toml` says what is predicted, and what the
    paper's claims imply for it.
    """
    from fsar_ledger.studies.predictions import predict as write

    with Progress("played", "experiments") as progress:
        write(out, workers=workers, progress=progress)
    show(printable.line(f"{out}"))
