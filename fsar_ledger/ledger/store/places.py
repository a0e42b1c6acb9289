"""Where in a ledger the events of a run are."""

from bisect import bisect_right
from collections.abc import Sequence
from itertools import takewhile

import msgspec
import pyarrow.compute as pc

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.rows import segment
from fsar_ledger.ledger.store.view import Part, View


def segments_of(view: View, parts: Sequence[Part]) -> list[int]:
    """Return the numbers of the segments that hold these parts of a run, in order."""
    found: set[int] = set()
    for one in parts:
        found.update(segments_between(view, one.first, one.end))
    return sorted(found)


def segments_between(view: View, first: int, end: int) -> list[int]:
    """Return the numbers of the segments that hold events from this index of the ledger up to that, in order."""
    count = len(view.releases)
    start = bisect_right(range(count), first, key=view.end)
    return list(takewhile(lambda number: view.first(number) < end, range(start, count)))


def place_of(view: View, run: str, seq: int) -> int:
    """Return the index in the ledger of this event of the run.

    Raises:
        KeyError: The run has no such event; the argument is how many it has.
        LedgerCorrupted: A segment cannot be read, or does not hold the event.
    """
    parts = view.parts(run)
    part = next((one for one in parts if one.block.first <= seq < one.block.end), None)
    events = sum(one.block.rows for one in parts)
    if part is None and seq >= events:
        raise KeyError(events)
    for number in segments_of(view, parts if part is None else [part]):
        table = segment.read_table(view.segment(number), ["run_id", "seq"])
        place = pc.index(pc.and_(pc.equal(table["run_id"], run), pc.equal(table["seq"], seq)), True).as_py()
        if place >= 0:
            return view.first(number) + int(place)
    raise LedgerCorrupted(
        f"{view.path}: found no event {seq} of run {run} where the index says that it is; run fsar-ledger verify"
    )


def event_at(view: View, place: int) -> dict[str, object]:
    """Return the event with this index in the ledger, as it is stored. Raises: LedgerCorrupted."""
    return msgspec.json.decode(view.event(place), type=dict[str, object])
