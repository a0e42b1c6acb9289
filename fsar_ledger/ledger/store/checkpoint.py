"""The file `checkpoint` of a ledger: the note of a commit, the newest when the ledger was closed.

It is written after each append to the chain, and when a writer closes the ledger, not for each commit in the journal.
So it may be behind by the commits that the journal holds, and, after a crash, by the last append to the chain.
"""

import msgspec

from fsar_ledger.base.errors import LedgerCorrupted
from fsar_ledger.ledger.store.paths import CHECKPOINT
from fsar_ledger.ledger.store.problem import Problem
from fsar_ledger.ledger.store.read import View


def behind(view: View) -> int:
    """Return how many of the newest commits the checkpoint does not cover.

    Raises: LedgerCorrupted if it is the note of none of them, or of none that a crash leaves.
    """
    back = covered(view)
    if isinstance(back, Problem):
        raise LedgerCorrupted(
            f"{view.path}/{back}; run fsar-ledger verify, and fsar-ledger maintain recover if it says so"
        )
    return back


def covered(view: View) -> int | Problem:
    """Return how many of the newest commits the checkpoint does not cover, or why it is no note that a crash leaves."""
    if isinstance(kept := view.checkpoint, Problem):
        return kept
    commits, origin = view.commits, view.manifest.origin
    for back in range(len(commits) + 1):
        number = len(commits) - back
        note = str(commits[number - 1].note(origin)) if number else None
        if kept == note:
            return back
        if number and commits[number - 1].tree_size <= view.chain.settled:
            break
    return Problem(
        CHECKPOINT,
        "no file" if kept is None else f"{kept!r:.400}",
        "the note of the newest commit, or of one since which a crash leaves none",
    )


def check_chain_checkpoint(view: View) -> list[Problem]:
    """Compare the file with the notes of the newest commits. Returns the problems."""
    back = covered(view)
    number = len(view.commits) - 1 if view.commits else None
    return [msgspec.structs.replace(back, commit=number)] if isinstance(back, Problem) else []
