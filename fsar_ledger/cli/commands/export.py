"""The command `export`."""

from pathlib import Path
from typing import Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli import completing
from fsar_ledger.cli.options import LedgerArgument, ParameterOption, RawOption, VerifiedOption, examples, parameters_of
from fsar_ledger.cli.progress import Progress
from fsar_ledger.cli.terminal import show

EXAMPLES = examples(
    "fsar-ledger export out/ledger --out out/events.parquet",
    "fsar-ledger export out/ledger --query metrics/run_metrics --out out/run_metrics.csv",
    "fsar-ledger export out/ledger --tiles --out out/tiles",
)


def export(
    ledger: LedgerArgument,
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            metavar="FILE",
            help="A .csv, .parquet, .ndjson or .jsonl file; replaced if it exists. With --tiles a new folder.",
            show_default=False,
        ),
    ],
    name: Annotated[
        str | None,
        typer.Option(
            "--query",
            metavar="NAME",
            help="Export the answer of this query.",
            show_default="every event",
            autocompletion=completing.queries,
        ),
    ] = None,
    param: ParameterOption = None,
    raw: RawOption = False,
    tiles: Annotated[
        bool,
        typer.Option("--tiles", help="Write the hashes of the tree and the checkpoint instead, as C2SP tlog-tiles."),
    ] = False,
    verified: VerifiedOption = False,
) -> None:
    """Write events, or the answer of a query, to a file.

    The name of the file decides the format: CSV, Parquet, or JSON with one row a line. In CSV, lists are JSON text, and
    text is made harmless for spreadsheets and terminals unless --raw is given. The others hold the values themselves.
    """
    from fsar_ledger.api.files import require_place
    from fsar_ledger.cli.answering import opened, warn

    if not tiles:
        require_place(out)
    asked = opened(ledger, verified=verified)
    with Progress("exported", "commits") as progress:
        written = asked.export(out, name, parameters_of(param), raw=raw, tiles=tiles, progress=progress)
    warn(ledger, written.provenance)
    show(printable.line(f"{out}: {written.row_count:,} {'tiles' if tiles else 'rows'}"))
