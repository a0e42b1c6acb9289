"""Which runs a ledger of format 2 holds, and how far, for its writer: a run goes on where it stopped."""

from collections.abc import Container, Sequence

from fsar_ledger.ledger.chain.read import ChainView
from fsar_ledger.ledger.rows.blocks import Block, Runs, blocks_of
from fsar_ledger.ledger.rows.runs import Flaw
from fsar_ledger.ledger.store.held import Held

_COLUMNS = ["run_id", "seq", "time_us", "type", "observes"]


class HeldRuns:
    """The runs of a ledger. Raises: LedgerCorrupted if a segment is missing or cannot be read."""

    def __init__(self, view: ChainView) -> None:
        self._runs = Runs()
        self.add_from(view, 0)

    def add_from(self, view: ChainView, first: int) -> None:
        """Add the events of this view from that index on. Raises: LedgerCorrupted if they cannot be read."""
        for table in view.tables_from(first, _COLUMNS):
            self.add(list(blocks_of(table)))

    def add(self, blocks: Sequence[Block]) -> None:
        """Add what was committed."""
        for block in blocks:
            self._runs.add(block)

    def told(self) -> Held:
        """Return the names of these runs, and of the plans."""
        plans = frozenset(run for run, known in self._runs.known.items() if known.is_alone)
        return Held(frozenset(self._runs.known.keys() - plans), plans)

    def events(self, run: str) -> int:
        """Return how many events of this run the ledger holds."""
        known = self._runs.known.get(run)
        return 0 if known is None else known.next

    def refused(self, blocks: Sequence[Block], going_on: Container[str]) -> Flaw | None:
        """Return why these blocks cannot be the next of the ledger, some of whose runs go on; None if they can."""
        seen: set[str] = set()
        for block in blocks:
            if block.run in seen:
                return Flaw(-1, block.run, block.first, "run_id", "the run twice in one commit", "each run once")
            seen.add(block.run)
            if (flaw := self._runs.flaw(block) or self._runs.backwards(block)) is not None:
                return flaw
            if block.first and block.run not in going_on:
                return Flaw(-1, block.run, block.first, "seq", f"{block.first}", "no more of a run that has ended")
        return None
