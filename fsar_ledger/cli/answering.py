"""Open the ledger that a command reads, and warn on stderr of what its answer leaves open."""

from pathlib import Path
from typing import TYPE_CHECKING

from fsar_ledger import printable

from .progress import Progress
from .terminal import say

if TYPE_CHECKING:
    from fsar_ledger.api.ledger import Ledger
    from fsar_ledger.api.provenance import Provenance


def opened(ledger: Path, *, verified: bool) -> "Ledger":
    """Open the ledger; with `verified`, its rows are compared with the root when it is first read.

    Raises: As `demanded_head`, then.
    """
    from fsar_ledger.api.ledger import Ledger
    from fsar_ledger.api.opening import demanded_head

    def compared() -> str | None:
        with Progress("verified", "segments") as progress:
            return demanded_head(ledger, verified=True, progress=progress)

    return Ledger(ledger, demanded=compared if verified else None)


def warn(ledger: Path, provenance: "Provenance") -> None:
    """Warn, a line each, of what runs do not observe, of missing planned runs, and of rows that were not compared."""
    from fsar_ledger.metrics.observing import told

    if (line := told(provenance.not_observed)) is not None:
        say(line)
    if provenance.plans is not None and (missing := provenance.plans.warning()) is not None:
        say(f"{ledger}: {missing}; `fsar-ledger info {printable.word(ledger)}` says how to go on")
    if not provenance.rows_verified:
        say(
            f"the rows of {ledger} were not compared with its root; `fsar-ledger verify {printable.word(ledger)}` does "
            "that, and --verified demands it"
        )
