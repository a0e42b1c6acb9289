"""The command `compact`."""

from fsar_ledger import printable
from fsar_ledger.cli.options import JsonOption, LedgerArgument, examples
from fsar_ledger.cli.terminal import show
from fsar_ledger.printable import counted

EXAMPLES = examples("fsar-ledger maintain compact out/reviewed", "fsar-ledger maintain compact out/reviewed --json")
AFTER_INTERRUPTION = "nothing is lost; run it again to go on"


def compact(ledger: LedgerArgument, as_json: JsonOption = False) -> None:
    """Put small segments together, and what is in the journal into one.

    Answers from few large segments are quicker than from many small ones. No event, root, commit or proof changes.
    """
    from fsar_ledger.api.ledger import Ledger

    found = Ledger(ledger).compact()
    if as_json:
        from fsar_ledger.cli.output import json_text

        show(json_text(found.head, {"ledger": str(ledger), "before": found.before, "after": found.after}))
        return
    done = (
        f"{counted(found.before, 'segment')} put into {found.after:,}"
        if found.after < found.before
        else f"nothing to do: {counted(found.after, 'segment')}"
    )
    show(printable.lines(f"{ledger}: {done}", f"root {found.head.root}"))
