"""Compare two sides over paired runs, from one ledger or two."""

from collections.abc import Sequence
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from msgspec import structs

from fsar_ledger.errors import UsageError
from fsar_ledger.metrics.sides import Paired, Side, SideRow, chosen, paired, sides

from .provenance import Provenance, of_judgement
from .table import Table, of_structs

if TYPE_CHECKING:
    from fsar_ledger.metrics.database import Database


class Held(Protocol):
    """A ledger that can be queried."""

    path: Path

    def database(self) -> "AbstractContextManager[Database]":
        """Open a connection over its events and the packaged queries."""


class Comparison(Paired, frozen=True, kw_only=True):
    """A `Paired` with both sides, and the provenance of each ledger."""

    sides: tuple[Side, Side]
    provenances: tuple[Provenance, ...]

    def table(self) -> Table:
        """Return the rows as a table; its provenance is that of the first ledger."""
        return Table(of_structs(self.rows, SideRow), self.provenances[0])


def compare_sides(
    ledgers: Sequence[Held], names: tuple[str | None, str | None], *, by_scenario: bool, pooled: bool
) -> Comparison:
    """Compare the sides of these names, from one ledger or two.

    Raises:
        UsageError: A side does not exist, or both are the same events.
    """
    places = [str(ledger.path) for ledger in ledgers]
    with ExitStack() as stack:
        held = [stack.enter_context(ledger.database()) for ledger in ledgers]
        both = chosen([sides(database) for database in held], names, places)
        if len(held) > 1 and both[0].side == both[1].side and held[0].head == held[1].head:
            raise UsageError(
                f"{' and '.join(places)}: found the same events in both, and {both[0]} as both sides, expected two "
                "that differ"
            )
        found = paired(held, both, pools_seeds=pooled, by_scenario=by_scenario)
        return Comparison(**structs.asdict(found), sides=both, provenances=tuple(map(of_judgement, held)))
