"""Why an event happened, and which events made a verdict of SQL, in words."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from fsar_ledger import printable
from fsar_ledger.analysis.why import Made, reasons
from fsar_ledger.analysis.words import Line, lines_of
from fsar_ledger.errors import UsageError, option
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.paths import require_outside
from fsar_ledger.metrics.database import Database
from fsar_ledger.metrics.invariants import invariants

from .provenance import Provenance, of_rows
from .table import Table

if TYPE_CHECKING:
    from os import PathLike

JUDGES = {
    "violation": "policy_violations",
    "conflict": "authority_conflicts",
    "late": "coordination_success",
    "unattributed": "audit_attributability",
}
"""By kind of verdict, the metric that counts such verdicts."""

_OF_METRICS = """
    SELECT seq, time_us / 1e6 AS time_s, action_id, about, found, made_by
    FROM verdict_events
    WHERE run_id = $run AND verdict = $kind
    ORDER BY seq, action_id, about
"""
_OF_INVARIANT = """
    SELECT seq, time_us / 1e6 AS time_s, action_id, type AS about, found, [seq] AS made_by
    FROM {relation}
    WHERE run_id = $run
    ORDER BY seq
"""


class Why(msgspec.Struct, frozen=True, kw_only=True):
    """Why an event of a run happened.

    Attributes:
        run: The name of the run.
        seq: The event.
        triggers: The chain of triggers: the event's, the trigger of that one, and so on to a fact of the world, a
            command from outside or event 0.
        made: How the event came about, then the events that it rests on, as deep as was asked for.
        lines: Every event that is named, in the words of `log`, by seq.
        provenance: What the answer holds for.
    """

    run: str
    seq: int
    triggers: tuple[int, ...]
    made: tuple[Made, ...]
    lines: dict[int, Line]
    provenance: Provenance

    def draw(self, file: "str | PathLike[str]") -> None:
        """Draw the event and what it rests on, as SVG or PDF by the suffix; the file is replaced if it exists.

        Raises:
            UsageError: The name has another suffix, or the file lies inside a ledger.
            WriteFailed: The file cannot be written.
        """
        from fsar_ledger.report import typeset
        from fsar_ledger.view.why import figure

        place = Path(file)
        if place.suffix not in (".svg", ".pdf"):
            raise UsageError(f"{place}: expected a name that ends in .svg or .pdf")
        require_outside(place, str(place))
        typeset.publish(place, figure(self.seq, self.made, self.lines, place.suffix[1:]))


def why_of(record: LedgerRun, provenance: Provenance, seq: int, depth: int | None) -> Why:
    """Return why the event of the run happened.

    Raises:
        UsageError: There is no such event, the depth is not positive, or the run cannot be made again as recorded.
    """
    if depth is not None and depth < 1:
        raise UsageError(f"{option('depth', depth)}: expected 1 or more")
    if not 0 <= seq < len(record.events):
        raise UsageError(
            f"EVENT {printable.value(record.run_id)}:{seq}: found {len(record.events):,} events in the run, expected a "
            f"seq from 0 to {len(record.events) - 1}"
        )
    found = reasons(record, seq, depth)
    lines = lines_of([record], [(record.run_id, one) for one in found.seqs])
    return Why(
        run=found.run,
        seq=found.seq,
        triggers=found.triggers,
        made=found.made,
        lines={seq: line for (_, seq), line in sorted(lines.items())},
        provenance=provenance,
    )


def kinds() -> dict[str, str]:
    """Return the kinds of verdicts, each with the metric or invariant that judges."""
    return JUDGES | {query.relation.partition("_")[0]: query.relation for query in invariants()}


def verdicts_of(database: Database, run: str, kind: str) -> Table:
    """Return the verdicts of this kind on a run, with the events that made each.

    Raises:
        UsageError: There is no such kind.
    """
    judges = kinds()
    if kind not in judges:
        hint = printable.did_you_mean(kind, judges) or ";"
        raise UsageError(
            f"{option('verdict', printable.value(kind))}: there is no such kind of verdict{hint} expected one of "
            f"{', '.join(judges)}"
        )
    judge = judges[kind]
    if kind in JUDGES:
        values: dict[str, Any] = {"run": run, "kind": kind}
        rows, query = database.table(_OF_METRICS, values), f"metrics/{judge}"
    else:
        rows, query = database.table(_OF_INVARIANT.format(relation=judge), {"run": run}), f"invariants/{judge}"
    return Table(rows, of_rows(database, database.library.find(query), run))
