"""The file `checkpoint` of a ledger: the note of a commit, the newest when the ledger was closed.

It is written after each append to the chain, and when a writer closes the ledger, not for each commit in the journal.
So it may be behind by the commits that the journal holds, and, after a crash, by the last append to the chain.
"""

import msgspec

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.store.paths import CHECKPOINT
from fsar_ledger.ledger.store.problem import Problem
from fsar_ledger.ledger.store.read import View


def behind(view: View) -> int:
    """Return how many of the newest commits the checkpoint does not cover.

    Raises: LedgerCorrupted if it is the note of none of them, or of none that a crash leaves.
    """
    found = covered(view)
    if isinstance(found, Problem):
        raise LedgerCorrupted(
            f"{view.path}/{found}; run fsar-ledger verify, and fsar-ledger maintain recover if it says so"
        )
    return found


def covered(view: View) -> int | Problem:
    """Return how many of the newest commits the checkpoint does not cover, or why it is no note that a crash leaves."""
    if isinstance(found := view.checkpoint, Problem):
        return found
    commits, origin = view.commits, view.manifest.origin
    for back in range(len(commits) + 1):
        number = len(commits) - back
        note = str(commits[number - 1].note(origin)) if number else None
        if found == note:
            return back
        if number and commits[number - 1].tree_size <= view.chain.settled:
            break
    return Problem(
        CHECKPOINT,
        "no file" if found is None else f"{found!r:.400}",
        "the note of the newest commit, or of one since which a crash leaves none",
    )


def check_chain_checkpoint(view: View) -> list[Problem]:
    """Compare the file with the notes of the newest commits. Returns the problems."""
    found = covered(view)
    number = len(view.commits) - 1 if view.commits else None
    return [msgspec.structs.replace(found, commit=number)] if isinstance(found, Problem) else []
