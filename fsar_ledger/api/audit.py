"""The verb `audit`: whether the invariants hold on a ledger."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.progress import Progress

from .answers import Answer, Row, Screen
from .names import names_of
from .verbs import WIDE, ArchitectureOption, InvariantOption, Shows, verb

if TYPE_CHECKING:
    from fsar_ledger.metrics.invariants import AuditRow
    from fsar_ledger.metrics.provenance import Provenance

    from .ledger import Ledger
    from .table import Table

_ARCHITECTURES = "SELECT DISTINCT architecture FROM runs WHERE architecture IS NOT NULL ORDER BY ALL"


class Audit(Answer, msgspec.Struct, frozen=True):
    """The findings of `audit`: a row for each invariant, architecture and configuration.

    `holds` is True if cases show that every invariant holds on all runs, False if an event violates one, and None if
    neither is known. `runs_unreadable` counts runs whose parameters cannot be read; their recovery budgets are not
    judged.
    """

    rows: list["AuditRow"]
    holds: bool | None
    runs_unreadable: int
    provenance: "Provenance"

    def table(self) -> "Table":
        """Return the rows as a table."""
        from fsar_ledger.metrics.invariants import AuditRow

        from .table import Table, of_structs

        return Table(of_structs(self.rows, AuditRow), self.provenance)

    @property
    def exit_code(self) -> int:
        """0 if all hold on all runs, else 1."""
        return 0 if self.holds else 1

    def document(self, screen: Screen) -> Mapping[str, object]:
        """Return the findings."""
        return {
            "ledger": str(screen.path),
            "holds": self.holds,
            "runs_unreadable": self.runs_unreadable,
            "rows": self.rows,
        }

    def text(self, screen: Screen) -> Iterator[printable.SafeText]:
        """Yield the verdicts, how many invariants hold, and the commands to run next."""
        if screen.is_fitted:
            yield from _on_a_terminal(self.rows, screen)
        else:
            yield screen.table([_display_row(row) for row in self.rows])
        yield printable.lines("", *_footer(self.rows, screen.path))
        if self.runs_unreadable:
            runs = printable.counted(self.runs_unreadable, "run")
            yield printable.line(
                f"{runs} with unreadable parameters: their recovery budgets are unknown and are not judged"
            )


@verb(
    "audit out/ledger --architecture fsar",
    "audit out/ledger --architecture fsar --invariant i4 --json",
    takes=("cluster", *WIDE),
)
def audit(
    ledger: "Ledger",
    invariant: InvariantOption = None,
    architecture: ArchitectureOption = None,
    *,
    progress: Annotated[Progress | None, Shows("judged", "invariants")] = None,
) -> Audit:
    """Check the invariants I1 to I5 and A1 to A5.

    Shows, for each invariant, architecture and configuration, how many events violate it and the first of them. Exit
    code 0 if all hold on all runs, else 1.

    Raises:
        LedgerCorrupted, SequenceConflict: As `connect_view`.
        InvalidExperiment: An architecture is unknown, to this version and to the ledger.
        UnknownQuery: An invariant is unknown.
        UsageError: The ledger has no run of these architectures.
    """
    from fsar_ledger.designs.registered import known_names
    from fsar_ledger.events.configuration import ARCHITECTURES
    from fsar_ledger.ledger.opening import open_for_answers
    from fsar_ledger.metrics.database import connect_view
    from fsar_ledger.metrics.invariants import all_shown, audit_rows, chosen
    from fsar_ledger.metrics.provenance import of_audit
    from fsar_ledger.metrics.results import models

    view = open_for_answers(ledger.path)
    queries = chosen(names_of(invariant) or ())
    with connect_view(view, demanded=ledger.demanded) as database:
        recorded = [str(row["architecture"]) for row in database.rows(_ARCHITECTURES)]
        unreadable = sum(model.runs for model in models(database) if model.parameters is None)
        provenance = of_audit(database)
        architectures = known_names(
            "architecture", names_of(architecture), tuple(dict.fromkeys([*ARCHITECTURES, *recorded]))
        )
        slices = database.slices
        rows = [] if slices is not None else audit_rows(database, queries, architectures, progress)
    if slices is not None:  # after closing the first database, so that the slices can use its memory
        rows = audit_rows(slices, queries, architectures, progress)
    holds = False if any(row.holds is False for row in rows) else all_shown(rows) or None
    return Audit(rows, holds, unreadable, provenance)


def _display_row(row: "AuditRow") -> Row:
    first = None if row.first_run is None else f"{row.first_run} seq {row.first_seq}: {row.first_found}"
    cases = "" if row.holds is None or row.cases is None else f" ({printable.counted(row.cases, 'case')})"
    return {
        "invariant": row.invariant,
        "architecture": row.architecture,
        "configuration": row.configuration,
        "runs": row.runs,
        "verdict": _word(row) + cases,
        "offending events": row.events,
        "first offending event": first,
    }


def _on_a_terminal(rows: "Sequence[AuditRow]", screen: Screen) -> Iterator[printable.SafeText]:
    """Yield the verdicts as a table, and below it the first offending events, as `prove` takes them."""
    numbers = screen.numbers()
    verdicts, first = [], []
    for row in rows:
        verdict = {"architecture": row.architecture, "configuration": row.configuration}
        counts = {"cases": row.cases, "offending events": row.events}
        verdicts.append({"invariant": row.invariant, **verdict, "runs": row.runs, "verdict": _word(row), **counts})
        if row.first_run is not None:
            event = f"{numbers.get(row.first_run, row.first_run)}:{row.first_seq}"
            first.append({"invariant": _short([row.invariant]), **verdict, "event": event, "found": row.first_found})
    yield screen.table(verdicts)
    if first:
        command = f"`fsar-ledger prove {printable.word(screen.path)} RUN:SEQ`"
        yield printable.lines("", f"the first offending events, for {command}", "")
        yield screen.table(first)


def _word(row: "AuditRow") -> str:
    if row.is_empty:
        return "no case"
    if row.holds is None:
        return f"not observable: {row.not_observed}" + (
            f" ({row.runs_not_observed} of {row.runs} runs)" if row.runs_not_observed < row.runs else ""
        )
    return "holds" if row.holds else "broken"


def _footer(rows: "Sequence[AuditRow]", ledger: Path) -> Iterator[str]:
    """Yield how many invariants hold, for each architecture (and configuration) if several, and the next commands."""
    configurations = {row.configuration for row in rows}
    groups: dict[str, list[AuditRow]] = {}
    for row in rows:
        name = [row.architecture, row.configuration] if len(configurations) > 1 else [row.architecture]
        groups.setdefault(" ".join(filter(None, name)) or "runs without an architecture", []).append(row)
    for label, group in groups.items():
        yield from (f"{label}: {line}" if len(groups) > 1 else line for line in _verdict(group))
    if any(row.invariant.startswith("i5") and row.runs_not_observed for row in rows):
        folder = printable.word(ledger)
        yield f"`fsar-ledger query attributability_by_field {folder}` shows requester, executor and supervisor apart"
        yield f"`fsar-ledger query record_gaps {folder}` lists what the record would need for each invariant"
    if broken := [row.invariant for row in rows if row.holds is False]:
        yield (
            f"`fsar-ledger query {broken[0]} {printable.word(ledger)}` lists all offending events of the first broken "
            "invariant"
        )


def _verdict(rows: "Sequence[AuditRow]") -> Iterator[str]:
    """Yield how many invariants hold under one architecture, and which ones had no case or are not observable."""
    unseen = [row.invariant for row in rows if row.holds is None and not row.is_empty]
    empty = [row.invariant for row in rows if row.is_empty]
    passed = sum(row.holds is True for row in rows)
    yield (
        f"{passed} of {len(rows)} hold, {len(empty)} had no case"
        if empty
        else f"{passed} of {len(rows)} invariants hold"
    )
    if unseen:
        yield (
            f"{len(unseen)} cannot be judged, because runs do not observe what they need: {_short(unseen)}; that is "
            "not a pass"
        )
    if empty:
        yield f"the record has nothing to judge for {_short(empty)}; that is not a pass"


def _short(names: Sequence[str]) -> str:
    return ", ".join(name.partition("_")[0].upper() for name in names)
