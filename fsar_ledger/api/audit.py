"""Check whether the invariants hold on a ledger."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import msgspec

from fsar_ledger.metrics.database import Slices, connect_view
from fsar_ledger.metrics.invariants import AuditRow, audit_rows, chosen
from fsar_ledger.metrics.models import models

from .names import known
from .provenance import Provenance, of_judgement
from .table import Table, of_structs

if TYPE_CHECKING:
    from fsar_ledger.ledger.chain.read import View
    from fsar_ledger.metrics.progress import Progress


_ARCHITECTURES = "SELECT DISTINCT architecture FROM runs WHERE architecture IS NOT NULL ORDER BY ALL"


class Audit(msgspec.Struct, frozen=True):
    """The findings of `audit`: a row for each invariant, architecture and configuration.

    `holds` is True if cases show that every invariant holds on all runs, False if an event offends one, and None if
    neither can be told. `runs_unreadable` counts runs whose parameters cannot be read; their recovery budgets are not
    judged.
    """

    rows: list[AuditRow]
    holds: bool | None
    runs_unreadable: int
    provenance: Provenance

    def table(self) -> Table:
        """Return the rows as a table."""
        return Table(of_structs(self.rows, AuditRow), self.provenance)


def audit_runs(
    view: "View",
    demanded: str | None,
    invariants: Sequence[str],
    architectures: Sequence[str],
    progress: "Progress | None" = None,
) -> Audit:
    """Check these invariants (none named: all) on the runs of these architectures (none named: all).

    Raises:
        LedgerCorrupted, SequenceConflict: As `connect_view`.
        InvalidExperiment: An architecture is unknown, to this version and to the ledger.
        UnknownQuery: An invariant is unknown.
        UsageError: The ledger has no run of these architectures.
    """
    from fsar_ledger.runtime.architectures import REGISTERED

    queries = chosen(invariants)
    with connect_view(view, demanded=demanded) as database:
        there = [str(row["architecture"]) for row in database.rows(_ARCHITECTURES)]
        unreadable = sum(one.runs for one in models(database) if one.parameters is None)
        provenance = of_judgement(database)
        wanted = known("architecture", architectures, tuple(dict.fromkeys([*REGISTERED, *there])))
        slices = Slices(view, demanded)
        is_one = len(slices) == 1
        rows = audit_rows([database], queries, wanted, progress) if is_one else []
    if not is_one:  # what the first held is no longer in memory
        rows = audit_rows(slices, queries, wanted, progress)
    holds = False if any(row.holds is False for row in rows) else all_shown(rows) or None
    return Audit(rows, holds, unreadable, provenance)


def is_empty(row: AuditRow) -> bool:
    """Return whether everything was observed, and nothing happened that the invariant is about."""
    return row.holds is None and not row.runs_not_observed


def all_shown(rows: Sequence[AuditRow]) -> bool:
    """Return whether a case of some architecture shows each invariant to hold, and none is broken or not observable."""
    shown = {row.invariant for row in rows if row.holds}
    return all(row.holds or (is_empty(row) and row.invariant in shown) for row in rows)
