"""What `simulate` and `reproduce` say of the runs that they made and those that were there."""

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
    return printable.lines(
        f"{out}: {printable.counted(head.size, 'event')} in {printable.counted(head.commits, 'commit')}",
        f"root {head.root}",
        *before(made),
        *signed,
    )


def before(made: "Made") -> list[str]:
    """A line on the runs that were there already, if there were any."""
    more = made.held - made.asked
    others = f", and {more:,} more" if more else ""
    if not made.made:
        return [f"nothing to do: the {runs(made.asked)} asked for {'is' if made.asked == 1 else 'are'} there{others}"]
    if made.made < made.asked:
        return [
            f"made {runs(made.made)}; of the {made.asked:,} asked for {made.asked - made.made:,} were there already{others}"
        ]
    return [f"made {runs(made.made)}, beside {more:,} of other experiments"] if more else []


def beyond(made: "Made") -> list[str]:
    """A line if the ledger holds runs beyond those asked for, so that what is judged rests on them, too."""
    more = made.held - made.asked
    return (
        [
            f"the ledger holds {runs(more)} beyond the {made.asked:,} of the paper's experiment, and they are judged here, too"
        ]
        if more
        else []
    )


def runs(count: int) -> str:
    """So many runs, in words."""
    return printable.counted(count, "run")
