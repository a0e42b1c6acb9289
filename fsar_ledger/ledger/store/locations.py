"""Where in a ledger the events of a run are, and whether the index agrees with the rows.

Signatures bind roots. Whoever can write the folder can chain a line of the index anew that leaves a run out, or a part
of one; its rows are there, and lead to the root.
"""

import msgspec
import pyarrow.compute as pc

from fsar_ledger.base.errors import LedgerCorrupted
from fsar_ledger.ledger.rows import segment
from fsar_ledger.ledger.store.index import require_lines
from fsar_ledger.ledger.store.read import View


def place_of(view: View, run: str, seq: int) -> int:
    """Return the index in the ledger of this event of the run.

    Raises:
        KeyError: The run has no such event; the argument is how many it has.
        LedgerCorrupted: A segment cannot be read, or does not hold the event.
    """
    parts = view.parts(run)
    part = next((part for part in parts if part.block.first <= seq < part.block.end), None)
    events = sum(part.block.rows for part in parts)
    if part is None and seq >= events:
        raise KeyError(events)
    for number in view.segments_of(parts if part is None else [part]):
        table = segment.read_table(view.segment(number), ["run_id", "seq"])
        row = pc.index(pc.and_(pc.equal(table["run_id"], run), pc.equal(table["seq"], seq)), True).as_py()
        if row >= 0:
            return view.first(number) + int(row)
    raise LedgerCorrupted(
        f"{view.path}: found no event {seq} of run {run} where the index says that it is; run fsar-ledger verify"
    )


def event_at(view: View, place: int) -> dict[str, object]:
    """Return the event with this index in the ledger, as it is stored. Raises: LedgerCorrupted."""
    return msgspec.json.decode(view.event(place), type=dict[str, object])


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
