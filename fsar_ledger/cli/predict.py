"""The command `predict`: the numbers that are written down with the fit before they are compared."""

from pathlib import Path
from typing import Annotated

import typer

from fsar_ledger import printable

from .options import WorkersOption, examples
from .progress import Progress
from .terminal import show

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
    """Play what is registered to be predicted, and write down the numbers; takes minutes.

    Ablations, larger fleets, loads, encounter rates, other seeds and pairs of ablations, with the constants as they
    are. No number of the paper is read. What is predicted, and what the paper's claims imply for it, is in
    `reports/registration.toml`.
    """
    from fsar_ledger.api.functions import predict as write

    with Progress("played", "experiments") as progress:
        write(out, workers=workers, progress=progress)
    show(printable.line(f"{out}"))
