"""The answer of `audit`, as a table or JSON, and whether everything holds. Nothing here prints."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from fsar_ledger import printable
from fsar_ledger.events.envelope import Architecture
from fsar_ledger.metrics.database import connect
from fsar_ledger.metrics.invariants import audit_rows, chosen
from fsar_ledger.printable import Shown

from .options import known
from .output import Row, json_text, table_text

if TYPE_CHECKING:
    from fsar_ledger.metrics.invariants import AuditRow


def audit(ledger: Path, invariants: Sequence[str], architectures: Sequence[str], *, as_json: bool) -> tuple[Shown, bool]:
    """The text of the answer, and whether every invariant that was asked for holds on every run that was asked for.

    Raises:
        InvalidExperiment: an architecture is unknown.
        UnknownQuery: an invariant is unknown.
        UsageError: the ledger has no run of these architectures.
        NotALedger, FormatVersionMismatch, LedgerCorrupted: as `connect`.
    """
    queries, wanted = chosen(invariants), known("architecture", architectures, get_args(Architecture))
    with connect(ledger) as database:
        rows = audit_rows(database, queries, wanted)
        holds = not any(row.events for row in rows)
        if as_json:
            return json_text(database.head, {"ledger": str(ledger), "holds": holds, "rows": rows}), holds
    return printable.joined(table_text([_shown(row) for row in rows], list(_shown(rows[0]))), printable.lines("", _verdict(rows))), holds


def _shown(row: "AuditRow") -> Row:
    first = None if row.first_run is None else f"{row.first_run} seq {row.first_seq}: {row.first_found}"
    return {
        "invariant": row.invariant,
        "architecture": row.architecture,
        "configuration": row.configuration,
        "runs": row.runs,
        "offending events": row.events,
        "first offending event": first,
    }


def _verdict(rows: "Sequence[AuditRow]") -> str:
    """One line: everything holds, or which invariants do not and how to see all their events."""
    broken = list(dict.fromkeys(row.invariant for row in rows if row.events))
    count = len({row.invariant for row in rows})
    if not broken:
        return f"{count} of {count} invariants hold"
    return f"{count - len(broken)} of {count} invariants hold; `fsar-ledger query {broken[0]} LEDGER` lists every offending event of the first that does not"
