"""The command `info`."""

from fsar_ledger import printable

from .options import JsonOption, LedgerArgument, VerifiedOption, examples
from .terminal import show

EXAMPLES = examples("fsar-ledger info out/ledger", "fsar-ledger info out/ledger --json")


def info(ledger: LedgerArgument, verified: VerifiedOption = False, as_json: JsonOption = False) -> None:
    """Show what a ledger holds, and whether it is complete.

    Its head, what was planned and what of it is there, its runs by model, seed, fleet size, architecture and
    configuration, and (with --json) the parameters of its worlds. Without a plan on record nothing says what is
    missing.
    """
    from .answering import opened, warn
    from .output import json_text, table_text

    found = opened(ledger, verified=verified).info()
    head, rows_verified = found.provenance.head, found.provenance.rows_verified
    assert head is not None  # only rows in memory have none
    warn(ledger, found.provenance)
    if as_json:
        show(json_text(head, {"ledger": str(ledger), "commits": head.commits, **found.answer()}, rows_verified))
        return
    standing = "" if rows_verified else " (the rows were not compared with it)"
    show(
        printable.lines(
            f"{ledger}: {printable.counted(head.size, 'event')} in {printable.counted(head.commits, 'commit')}",
            f"root {head.root}{standing}",
            *found.summary(),
        )
    )
    if rows := found.rows():
        show(printable.joined(printable.line(""), table_text(rows, list(rows[0]))))
