"""The command `info`."""

from fsar_ledger import printable
from fsar_ledger.cli.options import JsonOption, LedgerArgument, VerifiedOption, WideOption, examples
from fsar_ledger.cli.terminal import show

EXAMPLES = examples("fsar-ledger info out/ledger", "fsar-ledger info out/ledger --json")


def info(
    ledger: LedgerArgument, verified: VerifiedOption = False, as_json: JsonOption = False, wide: WideOption = False
) -> None:
    """Show what a ledger holds, and whether it is complete.

    Shows the head, which planned runs are there, the runs by model, seed, fleet size, architecture and configuration,
    and (with --json) the parameters of their worlds. Without a plan on record nothing shows what is missing.
    """
    from fsar_ledger.cli.answering import opened, warn
    from fsar_ledger.cli.output import answer_json
    from fsar_ledger.cli.tables import table

    found = opened(ledger, verified=verified).info()
    head = found.provenance.head
    assert head is not None  # only rows in memory have none
    warn(ledger, found.provenance)
    if as_json:
        show(answer_json(found.provenance, {"ledger": str(ledger), "commits": head.commits, **found.answer()}))
        return
    standing = "" if found.provenance.rows_verified else " (the rows were not compared with it)"
    show(
        printable.lines(
            f"{ledger}: {printable.counted(head.size, 'event')} in {printable.counted(head.commits, 'commit')}",
            f"root {head.root}{standing}",
            *found.summary(),
        )
    )
    if rows := found.rows():
        show(printable.joined(printable.line(""), table(rows, list(rows[0]), wide=wide)))
