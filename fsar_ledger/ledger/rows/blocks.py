"""The blocks of a table: the runs in it and the rows of each, where runs may begin or end in other tables.

In a ledger a run may span commits and segments. Each table is checked on its own (`check.first_flaw`);
`Runs` checks across tables, block by block.
"""

from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import NamedTuple

import msgspec
import numpy as np
import pyarrow as pa

from fsar_ledger.events.fleet import RunContinued
from fsar_ledger.ledger.rows.check import run_starts
from fsar_ledger.ledger.rows.runs import Flaw
from fsar_ledger.ledger.rows.schema import CONCERNED, STANDS_ALONE, concerns_admitted

from . import as_one_array, coded, numbers, places

_CONTINUED = f"{RunContinued.__struct_config__.tag}"


class Block(msgspec.Struct, frozen=True, omit_defaults=True):
    """Consecutive rows of one run: the seq of the first, their number, and the times of the first and the last.

    `observes` are the concerns that the run's events may have, from event 0; None if that is elsewhere or allows all.
    `concerns` are those of the block's events, omitted if event 0 is in the block, because the table alone shows
    whether they fit. `is_alone` is true for a single event that stands alone. `goes_on_from` comes from event 1, if it
    is in the block: the run that this one continues, and its last seq.
    """

    run: str
    first: int
    rows: int
    first_us: int
    last_us: int
    observes: tuple[str, ...] | None = None
    concerns: tuple[str, ...] = ()
    is_alone: bool = False
    goes_on_from: tuple[str, int] | None = None

    @property
    def end(self) -> int:
        """Return the seq after the last row."""
        return self.first + self.rows


def by_run(blocks: Iterable[Block]) -> tuple[Block, ...]:
    """Return one block for each run, without `observes` and `concerns`; `blocks` are in the order of their rows."""
    joined: dict[str, Block] = {}
    for block in blocks:
        previous = joined.get(block.run)
        joined[block.run] = Block(
            block.run,
            previous.first if previous else block.first,
            block.rows + (previous.rows if previous else 0),
            previous.first_us if previous else block.first_us,
            block.last_us,
            is_alone=block.is_alone,
            goes_on_from=previous.goes_on_from or block.goes_on_from if previous else block.goes_on_from,
        )
    return tuple(joined.values())


def blocks_of(table: pa.Table) -> Iterator[Block]:
    """Yield the blocks of a table without flaws, in order; string columns may be dictionaries."""
    if not table.num_rows:
        return
    runs = as_one_array(table.column("run_id"))
    starts = run_starts(runs).tolist()
    seqs, times = (numbers(as_one_array(table.column(name))) for name in ("seq", "time_us"))
    types, observes = coded(as_one_array(table.column("type"))), as_one_array(table.column("observes"))
    records = as_one_array(table.column("records"))
    tags, codes = types.dictionary.to_pylist(), places(types)
    for start, end in pairwise([*starts, table.num_rows]):
        first = int(seqs[start])
        concerns: set[str] = set()
        if first:
            concerns = {CONCERNED.get(tags[code], "") for code in np.unique(codes[start:end]).tolist()} - {""}
        has_second = first <= 1 < first + end - start and _CONTINUED in tags
        admitted = None if first else concerns_admitted(observes[start].as_py(), records[start].as_py())
        yield Block(
            runs[start].as_py(),
            first,
            end - start,
            int(times[start]),
            int(times[end - 1]),
            admitted,
            tuple(sorted(concerns)),
            tags[codes[start]] in STANDS_ALONE,
            _goes_on_from(table, start + 1 - first) if has_second else None,
        )


def _goes_on_from(table: pa.Table, row: int) -> tuple[str, int] | None:
    """Return `goes_on_from` of a block, from this row, event 1 of a run; None for another type of event."""
    values = [table.column(name)[row].as_py() for name in ("type", "continues", "continues_seq")]
    return (f"{values[1]}", int(values[2])) if values[0] == _CONTINUED else None


BLOCK_COLUMNS = ["run_id", "seq", "time_us", "type", "observes", "records", "continues", "continues_seq"]
"""The columns that `blocks_of` reads."""


class Known(NamedTuple):
    """The state of a run so far: the seq of its next event, the time of its last, and what it observes."""

    next: int
    last_us: int
    observes: tuple[str, ...] | None
    is_alone: bool


class Runs:
    """The runs of a ledger, built up from its blocks in order."""

    def __init__(self) -> None:
        self.known: dict[str, Known] = {}
        self.continued: dict[str, str] = {}  # the run that continues each run, by name

    def flaw(self, block: Block) -> Flaw | None:
        """Return why the block cannot follow those added so far; None if it can."""
        state = self.known.get(block.run)
        expected = 0 if state is None else state.next
        if state is not None and state.is_alone:
            return Flaw(-1, block.run, block.first, "type", "more events of its run", "the only event of its run")
        if block.first != expected:
            if state is not None and block.first == 0:
                return Flaw(-1, block.run, 0, "run_id", f"run {block.run} once more", f"its seq {expected}, or no more")
            return Flaw(-1, block.run, block.first, "seq", f"{block.first}", f"{expected}")
        if (flaw := self._wrongly_continued(block, state)) is not None:
            return flaw
        if state is None or state.observes is None:
            return None
        for concern in block.concerns:
            if concern not in state.observes:
                return Flaw(
                    -1,
                    block.run,
                    block.first,
                    "type",
                    f"an event of {concern} there or later",
                    "an event of a concern that its run observes, as event 0 says",
                )
        return None

    # See docs/decisions/cut-runs-are-judged-whole.md.
    def _wrongly_continued(self, block: Block, state: Known | None) -> Flaw | None:
        """Return why the block conflicts with which run continues which; None if it does not.

        A run that is not in the ledger is not checked, but it must not come later.
        """
        if (successor := self.continued.get(block.run)) is not None:
            found = "its first event" if state is None else "more events of the run"
            expected = f"none after run {successor!r}, which continues it"
            return Flaw(-1, block.run, block.first, "run_id", found, expected)
        if block.goes_on_from is None:
            return None
        run, last = block.goes_on_from
        earlier, successor = self.known.get(run), self.continued.get(run)
        if run == block.run or (earlier is not None and earlier.is_alone):
            return Flaw(-1, block.run, 1, "continues", repr(run), "another run")
        if earlier is None:
            return None
        if successor is not None:
            return Flaw(-1, block.run, 1, "continues", repr(run), f"a run that none continues, as {successor!r} does")
        if earlier.next != last + 1:
            return Flaw(-1, block.run, 1, "continues_seq", f"{last}", f"{earlier.next - 1}, the last of run {run!r}")
        if (start_us := state.last_us if state else block.first_us) < earlier.last_us:
            return Flaw(-1, block.run, 1, "time_us", f"{start_us}", f"no less than at the end of run {run!r}")
        return None

    def backwards(self, block: Block) -> Flaw | None:
        """Return the flaw if the block begins before the run's last event in time, which no writer stores."""
        state = self.known.get(block.run)
        if state is None or block.first_us >= state.last_us:
            return None
        return Flaw(-1, block.run, block.first, "time_us", f"{block.first_us}", "no less than at the event before")

    def add(self, block: Block) -> None:
        """Add the block."""
        state = self.known.get(block.run)
        observes = block.observes if state is None else state.observes
        self.known[block.run] = Known(block.end, block.last_us, observes, block.is_alone)
        if block.goes_on_from is not None:
            self.continued[block.goes_on_from[0]] = block.run
