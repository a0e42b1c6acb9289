"""The causes of an outcome of a run, and the chances to avoid it."""

import msgspec

from fsar_ledger.analysis.bases import base_of_record, repeated
from fsar_ledger.analysis.causes import Element, cause
from fsar_ledger.analysis.futures import MOMENTS, Chance, curve
from fsar_ledger.analysis.outcomes import outcome_of
from fsar_ledger.errors import UsageError, option
from fsar_ledger.ledger.rows.codec import LedgerRun

from .provenance import Provenance
from .table import Table, of_structs
from .workload import Progress

MOST_FUTURES = 10_000


class Caused(msgspec.Struct, frozen=True, kw_only=True):
    """A smallest cause of an outcome of a run, and how its chances went.

    `elements` are facts of the world and answers at ports that suffice for the outcome together, of `candidates`; it
    falls without any one of them. `presupposed`: what else the set needs for the outcome to have a value at all, and
    no cause of it. `also_necessary`: others without any one of which it falls in the whole run.
    `chances`: by moment, in how many futures from then on the outcome is avoided; none if no futures were asked for.
    `last_open_s`: the last moment found from which some future avoids it; `closing_seq`: the event from which on none
    does. `forks`: runs that were played for this.
    """

    run: str
    outcome: str
    elements: tuple[Element, ...]
    presupposed: tuple[Element, ...]
    also_necessary: tuple[Element, ...]
    candidates: int
    forks: int
    chances: tuple[Chance, ...]
    last_open_s: float | None
    closing_seq: int | None
    closing_s: float | None
    provenance: Provenance

    def table(self) -> Table:
        """Return a row for each element."""
        return Table(of_structs(self.elements, Element), self.provenance)

    def curve(self) -> Table:
        """Return a row for each moment."""
        return Table(of_structs(self.chances, Chance), self.provenance)


def cause_of(
    record: LedgerRun,
    provenance: Provenance,
    outcome: str,
    *,
    lengths: bool,
    futures: int,
    progress: Progress | None,
) -> Caused:
    """Return a smallest cause of the outcome of this run of a ledger.

    Raises:
        UsageError: There is no such metric or invariant, or the run does not have the outcome or cannot be made again.
        QueryFailed: The SELECT of the outcome fails.
    """
    if not 0 <= futures <= MOST_FUTURES:
        raise UsageError(f"{option('futures', futures)}: expected 0 (no curve) to {MOST_FUTURES:,}")
    asked = outcome_of(outcome)
    assert provenance.head is not None
    base = repeated(base_of_record(record, provenance.head.root))
    counted = None if progress is None else lambda done: progress(done, done)
    found = cause(base, asked, lengths=lengths, progress=counted)
    chances = None if not futures else curve(base, asked, futures, MOMENTS, progress)
    closing = None if chances is None else chances.closing_seq
    return Caused(
        run=record.run_id,
        outcome=found.outcome,
        elements=found.elements,
        presupposed=found.presupposed,
        also_necessary=found.also_necessary,
        candidates=found.candidates,
        forks=found.forks + (0 if chances is None else sum(one.futures + one.undefined for one in chances.chances)),
        chances=() if chances is None else chances.chances,
        last_open_s=None if chances is None else chances.last_open_s,
        closing_seq=closing,
        closing_s=None if closing is None else record.times_us[closing] / 1_000_000,
        provenance=provenance,
    )
