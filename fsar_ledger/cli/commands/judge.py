"""The command `judge`."""

from pathlib import Path
from typing import Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import examples
from fsar_ledger.cli.terminal import show

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
    """Compare predicted numbers with the paper's, and with what its claims were registered to imply.

    Nothing is simulated. In the source of this package, `reports/predictions.json` holds the predictions made right
    after the fit, and `reports/comparison.json` their comparison.
    """
    from fsar_ledger.studies.comparison import judge as compare

    compare(predictions, out)
    show(printable.line(f"{out}"))
