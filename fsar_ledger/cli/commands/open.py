"""The command `open`."""

from pathlib import Path
from typing import Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import LedgerArgument, VerifiedOption, examples
from fsar_ledger.cli.progress import Progress
from fsar_ledger.cli.terminal import show

EXAMPLES = examples("fsar-ledger open out/ledger --out out/ledger.duckdb")


def open(  # named as the command is
    ledger: LedgerArgument,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FILE",
            help="A .duckdb file; replaced if `open` wrote it.",
            show_default="LEDGER.duckdb here",
        ),
    ] = None,
    verified: VerifiedOption = False,
) -> None:
    """Write a small DuckDB file for other programs: every event view and query under its name.

    DuckDB, notebooks, Polars and BI tools read the ledger through it and can join tables of their own. It reads the
    segments in their present place, at the present head; `open` again after the ledger grew or moved.
    """
    from fsar_ledger.cli.answering import opened, warn

    asked = opened(ledger, verified=verified)
    with Progress("written", "views and queries") as progress:
        written = asked.open(out, progress=progress)
    warn(ledger, written.provenance)
    show(
        printable.line(
            f"{written.file}: {written.relations:,} relations and {written.macros:,} macros over "
            f"{written.provenance.head.size if written.provenance.head else 0:,} events"
        )
    )
    show(printable.line("a macro is called by its parameters, as `FROM denials(run := 1)`"))
    if written.not_included:
        show(printable.line(f"not included: {', '.join(written.not_included)}, which need fsar-ledger itself"))
