"""The command `judge`: predicted numbers beside the paper's."""

from pathlib import Path
from typing import Annotated

import typer

from fsar_ledger import printable

from .options import examples
from .terminal import show

EXAMPLES = examples("fsar-ledger judge out/predictions.json --out out/comparison.json")


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

    Nothing is played. `reports/predictions.json` in the source of this package holds the predictions that were made
    right after the fit, `reports/comparison.json` what became of them.
    """
    from fsar_ledger.api.functions import judge as compare

    compare(predictions, out)
    show(printable.line(f"{out}"))
