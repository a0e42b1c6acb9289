"""Compare what the chain says of where runs are with the rows, as nothing that is signed vouches for it.

Signatures bind roots. Whoever can write the folder can chain a line of the index anew that leaves a run out, or a part
of one; its rows are there, and lead to the root.
"""

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.chain.index import require_lines
from fsar_ledger.ledger.chain.read import View


def compare_index(view: View) -> bool:
    """Compare the lines of the index for each segment that is not believed; return whether all could be read.

    Raises: LedgerCorrupted if the rows of a segment have other lines than the chain says.
    """
    is_read = True
    for number in range(len(view.chain.placed)):
        if number in view.believed:
            continue
        try:
            lines = view.index_lines(number)
        except LedgerCorrupted:  # whoever reads its rows is told
            is_read = False
            continue
        require_lines(view.path, view.chain.placed_in(number), lines)
        view.believed.add(number)
    return is_read


def require_index(view: View) -> None:
    """Require that the chain says of all rows where runs are.

    Raises: LedgerCorrupted if it does not, or some cannot be read.
    """
    view.require_index(*range(len(view.chain.placed)))
