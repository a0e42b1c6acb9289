"""The answer of `audit`, as a table or JSON, and whether everything holds. Nothing here prints."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from fsar_ledger import printable
from fsar_ledger.events.envelope import Architecture
from fsar_ledger.metrics.invariants import audit_rows, chosen
from fsar_ledger.metrics.models import models
from fsar_ledger.printable import Shown

from .answering import answering, of_plans, warn_of_missing
from .options import known
from .output import Row, json_text, table_text
from .simulated import runs

if TYPE_CHECKING:
    from fsar_ledger.metrics.invariants import AuditRow


def audit(
    ledger: Path, invariants: Sequence[str], architectures: Sequence[str], *, as_json: bool, verified: bool = False
) -> tuple[Shown, bool]:
    """The text of the answer, and whether every invariant that was asked for was shown to hold, by a case, and by every run that was asked for.

    Raises:
        InvalidExperiment: an architecture is unknown, to this version and to the ledger.
        UnknownQuery: an invariant is unknown.
        UsageError: the ledger has no run of these architectures.
        NotALedger, FormatVersionMismatch, LedgerCorrupted: as `answering`.
    """
    queries = chosen(invariants)
    with answering(ledger, verified=verified) as database:
        there = [
            str(row["architecture"])
            for row in database.rows(
                "SELECT DISTINCT architecture FROM runs WHERE architecture IS NOT NULL ORDER BY ALL"
            )
        ]
        wanted = known("architecture", architectures, tuple(dict.fromkeys([*get_args(Architecture), *there])))
        unreadable = sum(one.runs for one in models(database) if one.parameters is None)
        rows = audit_rows(database, queries, wanted)
        holds = False if any(row.holds is False for row in rows) else _all_shown(rows) or None
        warn_of_missing(ledger, database)
        if as_json:
            answer = {
                "ledger": str(ledger),
                "holds": holds,
                **of_plans(database),
                "runs_unreadable": unreadable,
                "rows": rows,
            }
            return json_text(database.head, answer, database.rows_verified), bool(holds)
    of_budgets = (
        [
            f"{runs(unreadable)} with parameters that cannot be read: recovery budgets that they set are unknown, and none is judged"
        ]
        if unreadable
        else []
    )
    said = printable.lines("", *_verdict(rows), *of_budgets)
    return printable.joined(table_text([_shown(row) for row in rows], list(_shown(rows[0]))), said), bool(holds)


def _shown(row: "AuditRow") -> Row:
    first = None if row.first_run is None else f"{row.first_run} seq {row.first_seq}: {row.first_found}"
    return {
        "invariant": row.invariant,
        "architecture": row.architecture,
        "configuration": row.configuration,
        "runs": row.runs,
        "verdict": _word(row),
        "offending events": row.events,
        "first offending event": first,
    }


def _word(row: "AuditRow") -> str:
    """What was shown of one invariant, and by how many cases."""
    cases = "1 case" if row.cases == 1 else f"{row.cases or 0:,} cases"
    if _is_empty(row):
        return "no case"
    if row.holds is None:
        return f"not observable: {row.not_observed}" + (
            f" ({row.runs_not_observed} of {row.runs} runs)" if row.runs_not_observed < row.runs else ""
        )
    return f"{'holds' if row.holds else 'broken'} ({cases})" if row.cases is not None else "broken"


def _is_empty(row: "AuditRow") -> bool:
    """Whether all was observed that could offend, and there was nothing."""
    return row.holds is None and not row.runs_not_observed


def _all_shown(rows: "Sequence[AuditRow]") -> bool:
    """Whether each invariant holds by a case: of some architecture, and no other has anything but no case."""
    shown = {row.invariant for row in rows if row.holds}
    return all(row.holds or (_is_empty(row) and row.invariant in shown) for row in rows)


def _verdict(rows: "Sequence[AuditRow]") -> Iterator[str]:
    """How many invariants hold; which of them had no case, cannot be observed or do not hold, and how to see more."""
    names = list(dict.fromkeys(row.invariant for row in rows))
    broken = [name for name in names if any(row.holds is False for row in rows if row.invariant == name)]
    unseen = [
        name
        for name in names
        if name not in broken
        and any(row.holds is None and row.runs_not_observed for row in rows if row.invariant == name)
    ]
    empty = [
        name
        for name in names
        if name not in (*broken, *unseen) and not any(row.holds for row in rows if row.invariant == name)
    ]
    held = len(names) - len(broken) - len(unseen) - len(empty)
    hint = (
        f"; `fsar-ledger query {broken[0]} LEDGER` lists every offending event of the first that does not"
        if broken
        else ""
    )
    yield (
        f"{held} of {len(names)} hold, {len(empty)} had no case" if empty else f"{held} of {len(names)} invariants hold"
    ) + hint
    if unseen:
        yield f"{len(unseen)} cannot be told, because runs do not observe what they rest on: {_short(unseen)}; that is no pass"
    if empty:
        yield f"nothing to judge was on record for {_short(empty)}; that is no pass"


def _short(names: Sequence[str]) -> str:
    return ", ".join(name.partition("_")[0].upper() for name in names)
