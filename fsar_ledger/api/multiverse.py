"""Compute the results table under every reading that the paper's text allows."""

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import structs

from fsar_ledger.metrics.multiverse import Cell, Multiverse, multiverse

from .names import known
from .provenance import Provenance, of_judgement
from .table import Table, of_structs

if TYPE_CHECKING:
    from fsar_ledger.metrics.database import Database
    from fsar_ledger.metrics.progress import Progress


class MultiverseResult(Multiverse, frozen=True, kw_only=True):
    """A `Multiverse` with its provenance."""

    provenance: Provenance

    def table(self) -> Table:
        """Return the cells as a table."""
        return Table(of_structs(self.cells, Cell), self.provenance)

    def draw(self, file: str | PathLike[str]) -> None:
        """Draw every cell under every combination of readings as SVG.

        Raises: WriteFailed if the file cannot be written.
        """
        from fsar_ledger.publishing import publish
        from fsar_ledger.report import specification_curves

        publish(Path(file), specification_curves.curves(self))


def read_multiverse(
    database: "Database", metrics: Sequence[str] | None, *, pools_seeds: bool, progress: "Progress | None" = None
) -> MultiverseResult:
    """Compute the table for all metrics or those named. Raises: InvalidExperiment if one is unknown."""
    every = tuple(row["metric"] for row in database.rows("SELECT metric FROM metric_definitions ORDER BY position"))
    found = multiverse(database, known("metric", metrics, every), pools_seeds=pools_seeds, progress=progress)
    return MultiverseResult(**structs.asdict(found), provenance=of_judgement(database))
