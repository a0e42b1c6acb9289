"""The command `upgrade`."""

from pathlib import Path
from typing import Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import JsonOption, LedgerArgument, examples
from fsar_ledger.cli.progress import Progress
from fsar_ledger.cli.terminal import show

EXAMPLES = examples(
    "fsar-ledger maintain upgrade out/old --into out/upgraded",
    "fsar-ledger maintain upgrade out/old --into out/upgraded --json",
)
AFTER_INTERRUPTION = "the commits written so far stay; run it again to go on"


def upgrade(
    ledger: LedgerArgument,
    into: Annotated[Path, typer.Option("--into", metavar="NEW", help="The new folder of the ledger.")],
    as_json: JsonOption = False,
) -> None:
    """Write a ledger of format 1, of fsar-ledger up to 0.8, in today's format: the same events, commits and root.

    LEDGER is verified first, and stays as it is. Signatures are kept.
    """
    from fsar_ledger.api.ledger import Ledger

    with Progress("written", "commits") as progress:
        head = Ledger(ledger).upgrade(into, progress=progress)
    if as_json:
        from fsar_ledger.cli.output import json_text

        show(json_text(head, {"ledger": str(into), "from": str(ledger), "commits": head.commits}))
        return
    show(
        printable.lines(
            f"{into}: {printable.counted(head.size, 'event')} in {printable.counted(head.commits, 'commit')}",
            f"root {head.root}",
        )
    )
