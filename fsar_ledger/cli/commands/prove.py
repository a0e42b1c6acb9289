"""The command `prove`."""

import os
from pathlib import Path
from typing import Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import LedgerArgument, VerifiedOption, examples
from fsar_ledger.cli.terminal import show
from fsar_ledger.errors import UsageError
from fsar_ledger.printable import Shown

EXAMPLES = examples(
    "fsar-ledger prove out/ledger 1234 --out out/event-1234.tlog-proof",
    "fsar-ledger prove out/ledger 1:12",
)


def prove(
    ledger: LedgerArgument,
    event: Annotated[
        str,
        typer.Argument(
            metavar="EVENT",
            help=(
                "RUN:SEQ, a run (its number, its name, or a part of it that no other run has) and a seq in it; a bare "
                "number is the event's place in the ledger, from 0."
            ),
            show_default=False,
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FILE",
            help="A new file, .tlog-proof by convention; never replaced.",
            show_default="print it",
        ),
    ] = None,
    verified: VerifiedOption = False,
) -> None:
    """Prove that one event is in a ledger.

    The proof is one small text, a C2SP tlog-proof: the event, the hashes from it to the root, and the newest
    checkpoint. `verify-proof` checks it without the ledger.
    """
    from fsar_ledger.api.files import write_text
    from fsar_ledger.cli.answering import opened
    from fsar_ledger.ledger.store.paths import require_outside

    if out is not None:
        if os.path.lexists(out):
            raise UsageError(f"--out {out}: found a file, expected a free name; a proof is never overwritten")
        require_outside(out, f"--out {out}")
    proof = opened(ledger, verified=verified).prove(event)
    if out is None:
        show(Shown(str(proof)), raw=True)
        return
    write_text(out, str(proof))
    tree = proof.note.checkpoint
    show(printable.lines(f"{out}: event {proof.index:,} of {tree.size:,}", f"root {tree.root.hex()}"))
