"""The command `audit`."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
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
from fsar_ledger.cli.progress import Progress
from fsar_ledger.cli.terminal import show
from fsar_ledger.printable import Shown

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
    from fsar_ledger.cli.tables import is_fitted, table

    asked = opened(ledger, verified=verified)
    with Progress("judged", "invariants") as progress:
        found = asked.audit(invariant, architecture, progress=progress)
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
        said = printable.lines("", *_footer(rows, ledger), *of_budgets)
        if is_fitted(wide=wide):
            findings = _on_a_terminal(rows, asked.numbers(), ledger)
        else:
            findings = table([_shown(row) for row in rows], list(_shown(rows[0])), wide=wide)
        show(printable.joined(findings, said))
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
        "verdict": _word(row) if row.holds is None or row.cases is None else f"{_word(row)} ({_cases(row.cases)})",
        "offending events": row.events,
        "first offending event": first,
    }


def _on_a_terminal(rows: "Sequence[AuditRow]", numbers: Mapping[str, int], ledger: Path) -> Shown:
    """Return the verdicts as a table, and under it what the first offending events are, as `prove` names them."""
    from fsar_ledger.cli.tables import table

    verdicts, first = [], []
    for row in rows:
        verdict = {"architecture": row.architecture, "configuration": row.configuration}
        counts = {"cases": row.cases, "offending events": row.events}
        verdicts.append({"invariant": row.invariant, **verdict, "runs": row.runs, "verdict": _word(row), **counts})
        if row.first_run is not None:
            event = f"{numbers.get(row.first_run, row.first_run)}:{row.first_seq}"
            first.append({"invariant": _short([row.invariant]), **verdict, "event": event, "found": row.first_found})
    judged = table(verdicts, list(verdicts[0]))
    if not first:
        return judged
    proven = f"`fsar-ledger prove {printable.word(ledger)} RUN:SEQ`"
    above = printable.lines("", f"the first offending events, as {proven} takes them", "")
    return printable.joined(judged, above, table(first, list(first[0])))


def _word(row: "AuditRow") -> str:
    """Return the verdict on one invariant."""
    from fsar_ledger.api.audit import is_empty

    if is_empty(row):
        return "no case"
    if row.holds is None:
        return f"not observable: {row.not_observed}" + (
            f" ({row.runs_not_observed} of {row.runs} runs)" if row.runs_not_observed < row.runs else ""
        )
    return "holds" if row.holds else "broken"


def _cases(count: int) -> str:
    return "1 case" if count == 1 else f"{count:,} cases"


def _footer(rows: "Sequence[AuditRow]", ledger: Path) -> Iterator[str]:
    """Yield how many invariants hold, for each architecture (and configuration) if there are several, and what next."""
    configurations = {row.configuration for row in rows}
    judged: dict[str, list[AuditRow]] = {}
    for row in rows:
        name = [row.architecture, row.configuration] if len(configurations) > 1 else [row.architecture]
        judged.setdefault(" ".join(filter(None, name)) or "runs of no architecture", []).append(row)
    for named, of_it in judged.items():
        yield from (f"{named}: {line}" if len(judged) > 1 else line for line in _verdict(of_it))
    if broken := [row.invariant for row in rows if row.holds is False]:
        yield (
            f"`fsar-ledger query {broken[0]} {printable.word(ledger)}` lists every offending event of the first that "
            "does not hold"
        )


def _verdict(rows: "Sequence[AuditRow]") -> Iterator[str]:
    """Yield how many invariants hold under one architecture, and which ones had no case or are not observable."""
    from fsar_ledger.api.audit import is_empty

    unseen = [row.invariant for row in rows if row.holds is None and not is_empty(row)]
    empty = [row.invariant for row in rows if is_empty(row)]
    held = sum(row.holds is True for row in rows)
    yield f"{held} of {len(rows)} hold, {len(empty)} had no case" if empty else f"{held} of {len(rows)} invariants hold"
    if unseen:
        yield (
            f"{len(unseen)} cannot be told, because runs do not observe what they rest on: {_short(unseen)}; that "
            "is no pass"
        )
    if empty:
        yield f"nothing to judge was on record for {_short(empty)}; that is no pass"


def _short(names: Sequence[str]) -> str:
    return ", ".join(name.partition("_")[0].upper() for name in names)
