"""The file `checkpoint` of a ledger of format 2: the note of a commit, the newest when the ledger was closed.

It is written after each append to the chain, and when a writer closes the ledger, not for each commit in the journal.
So it may be behind by the commits that the journal holds, and, after a crash, by the last append to the chain.
"""

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.chain.read import ChainView
from fsar_ledger.ledger.store.derived import read_checkpoint
from fsar_ledger.ledger.store.paths import CHECKPOINT
from fsar_ledger.ledger.store.problem import Problem, refusal


def behind(view: ChainView) -> int:
    """Return how many of the newest commits the checkpoint does not cover.

    Raises: LedgerCorrupted if it is the note of none of them, or of none that a crash leaves.
    """
    found = read_checkpoint(view.path)
    commits, origin = view.commits, view.manifest.origin
    for back in range(len(commits) + 1):
        number = len(commits) - back
        note = str(commits[number - 1].note(origin)) if number else None
        if found == note:
            return back
        if number and commits[number - 1].tree_size <= view.chain.settled:
            break
    raise LedgerCorrupted(
        f"{CHECKPOINT}: found {'no file' if found is None else f'{found!r:.400}'}, expected the note of the newest "
        "commit, or of one since which a crash leaves none"
    )


def check_chain_checkpoint(view: ChainView) -> list[Problem]:
    """Compare the file with the notes of the newest commits. Returns the problems."""
    try:
        behind(view)
    except LedgerCorrupted as error:
        number = len(view.commits) - 1 if view.commits else None
        found, _, expected = refusal(CHECKPOINT, error)[1:-1].removeprefix("found ").partition(", expected ")
        return [Problem(CHECKPOINT, found, expected or "the newest note", commit=number)]
    return []
