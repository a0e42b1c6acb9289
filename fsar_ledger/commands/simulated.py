"""What `simulate` says it did."""

from pathlib import Path
from typing import TYPE_CHECKING

from fsar_ledger import printable
from fsar_ledger.printable import Shown

from .output import json_text

if TYPE_CHECKING:
    from fsar_ledger.runtime.experiment import Made


def simulated_text(out: Path, made: "Made", signed: list[str], *, as_json: bool) -> Shown:
    """The head of the ledger, what was there before, and the lines on its signature."""
    head = made.head
    if as_json:
        counts = {"runs_asked": made.asked, "runs_made": made.made, "runs_held": made.held}
        return json_text(head, {"ledger": str(out), "commits": head.commits, **counts})
    return printable.lines(f"{out}: {head.size:,} events in {head.commits:,} commits", f"root {head.root}", *before(made), *signed)


def before(made: "Made") -> list[str]:
    """A line on the runs that were there already, if there were any."""
    others = f", and {made.held - made.asked:,} more" if made.held > made.asked else ""
    if not made.made:
        return [f"nothing to do: all {made.asked:,} runs that were asked for are there{others}"]
    if made.made < made.asked:
        return [f"made {made.made:,} runs; {made.asked - made.made:,} of the {made.asked:,} that were asked for were there already{others}"]
    return [f"made {made.made:,} runs; {made.held - made.asked:,} others were there already"] if others else []
