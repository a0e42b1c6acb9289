"""Which segments of a ledger are put together, and the segment that holds their rows."""

from collections.abc import Iterator, Sequence

import pyarrow as pa

from fsar_ledger.base.errors import LedgerCorrupted
from fsar_ledger.ledger.rows import canonical, segment
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.record import Placement
from fsar_ledger.ledger.store.staging import Staged
from fsar_ledger.ledger.store.tables import made_of, stage_made

MERGED_ROWS = 1 << 14
"""The most events of a segment that others are put into."""
MERGED_BYTES = 1 << 20
"""The most bytes of the segments that are put together; a tenth of what a segment may have."""


def mergeable(placed: Sequence[Placement]) -> Iterator[Sequence[Placement]]:
    """Yield groups of at least two neighbouring segments that fit into one, greedily from the first on."""
    group: list[Placement] = []
    rows = size = 0
    for placement in placed:
        rows, size = rows + placement.rows, size + placement.segment_bytes
        if rows > MERGED_ROWS or size > MERGED_BYTES:
            if len(group) > 1:
                yield group
            group, rows, size = [], placement.rows, placement.segment_bytes
        group.append(placement)
    if len(group) > 1:
        yield group


def merged_segment(view: View, old: Sequence[Placement]) -> Staged:
    """Write the rows of these neighbouring segments into one, in the staging folder.

    Raises: LedgerCorrupted if their rows do not lead from the tree before them to the tree after.
    """
    tables: list[pa.Table] = [segment.read_table(view.placed_segment(placement)) for placement in old]
    table = pa.concat_tables(tables).combine_chunks()
    leaves = canonical.leaves(table)
    before = view.chain.tree_at(old[0].first)
    after = before.extend(leaves)
    if after != old[-1].tree():
        raise LedgerCorrupted(
            f"{view.path}: events {old[0].first} to {old[-1].end - 1}: found rows that lead to root "
            f"{after.root().hex()}, expected {old[-1].tree().root().hex()} as placed; run fsar-ledger verify"
        )
    unstaged = made_of(table, leaves)
    stage_made(view.path, unstaged)
    return unstaged.staged
