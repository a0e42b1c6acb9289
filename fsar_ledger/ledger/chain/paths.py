"""Where the files of a ledger are."""

from fsar_ledger.ledger.chain.record import Placement
from fsar_ledger.ledger.store.paths import CHAIN as CHAIN
from fsar_ledger.ledger.store.paths import JOURNAL as JOURNAL

SEALING = "sealing.jsonl"
"""What was the journal, while its rows are put into a segment and further commits go into another one."""
NODES = "nodes"
INDEX = "index.jsonl"


def segment_name(first: int, end: int) -> str:
    """Return the name within the ledger of the segment that holds these events, once it is in place."""
    return f"segments/{first:012d}-{end:012d}.parquet"


def segment_of(placement: Placement) -> str:
    """Return the name within the ledger of this placement's segment, once it is in place."""
    return segment_name(placement.first, placement.end)
