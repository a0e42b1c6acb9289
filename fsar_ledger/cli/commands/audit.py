"""The command `audit`."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import (
    AuditedOption,
    InvariantOption,
    JsonOption,
    LedgerArgument,
    VerifiedOption,
    WideOption,
    examples,
)
from fsar_ledger.cli.terminal import show

if TYPE_CHECKING:
    from fsar_ledger.api.fields import Row
    from fsar_ledger.metrics.invariants import AuditRow

EXAMPLES = examples(
    "fsar-ledger audit out/ledger --architecture fsar",
    "fsar-ledger audit out/ledger --architecture fsar --invariant i4 --json",
)


def audit(
    ledger: LedgerArgument,
    invariant: InvariantOption = None,
    architecture: AuditedOption = None,
    verified: VerifiedOption = False,
    as_json: JsonOption = False,
    wide: WideOption = False,
) -> None:
    """Check the invariants I1 to I5 and A1 to A5.

    For each invariant, architecture and configuration: how many events offend it, and the first of them. Exit code 0 if
    all hold on all runs, else 1.
    """
    from fsar_ledger.api.plans import runs
    from fsar_ledger.cli.answering import opened, warn
    from fsar_ledger.cli.output import answer_json
    from fsar_ledger.cli.tables import table

    found = opened(ledger, verified=verified).audit(invariant, architecture)
    provenance, rows = found.provenance, found.rows
    if as_json:
        answer = {
            "ledger": str(ledger),
            "holds": found.holds,
            "runs_unreadable": found.runs_unreadable,
            "rows": rows,
        }
        show(answer_json(provenance, answer))
    else:
        of_budgets = (
            [
                f"{runs(found.runs_unreadable)} with parameters that cannot be read: their recovery budgets are "
                "unknown, and none is judged"
            ]
            if found.runs_unreadable
            else []
        )
        said = printable.lines("", *_verdict(rows), *of_budgets)
        show(printable.joined(table([_shown(row) for row in rows], list(_shown(rows[0])), wide=wide), said))
    warn(ledger, provenance)
    if not found.holds:
        raise typer.Exit(1)


def _shown(row: "AuditRow") -> "Row":
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
    """Return the verdict on one invariant, with the number of cases that it rests on."""
    cases = "1 case" if row.cases == 1 else f"{row.cases or 0:,} cases"
    from fsar_ledger.api.audit import is_empty

    if is_empty(row):
        return "no case"
    if row.holds is None:
        return f"not observable: {row.not_observed}" + (
            f" ({row.runs_not_observed} of {row.runs} runs)" if row.runs_not_observed < row.runs else ""
        )
    return f"{'holds' if row.holds else 'broken'} ({cases})" if row.cases is not None else "broken"


def _verdict(rows: "Sequence[AuditRow]") -> Iterator[str]:
    """Yield how many invariants hold, which ones had no case or are not observable, and how to see more."""
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
        yield (
            f"{len(unseen)} cannot be told, because runs do not observe what they rest on: {_short(unseen)}; that "
            "is no pass"
        )
    if empty:
        yield f"nothing to judge was on record for {_short(empty)}; that is no pass"


def _short(names: Sequence[str]) -> str:
    return ", ".join(name.partition("_")[0].upper() for name in names)
