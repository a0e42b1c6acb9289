"""The verb `report`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from .answers import Lines
from .names import KindOfReport, Place
from .verbs import Gives, Option, WorkersOption, declare, readers_of, verb

if TYPE_CHECKING:
    from fsar_ledger.base.progress import Showing

    from .ledger import Ledger


@verb(
    "report out/ledger --out out/report.pdf",
    "report out/ledger --with out/workflows --with out/untrusting --out out/report.pdf",
    "report out/ledger --out out/report.pdf --numbers out/numbers.json",
    "report out/ledger --kind audit --out out/audit.pdf",
    takes=(),
    hunger=3,
)
def report(
    ledger: "Ledger",
    out: Annotated[Place, Option("--out", "FILE", "The PDF; replaced if it exists.")],
    *,
    beside: Sequence[Place] = declare(
        "LEDGER",
        "Another ledger to show, of ablations, larger fleets, workflows or the scenario churn; may be repeated.",
        "none; their sections are omitted",
        flag="--with",
        value=(),
    ),
    workflows: Place | None = declare(
        "LEDGER", "A ledger of the paper's three workflows.", "none; the section is omitted"
    ),
    sensitivity: Place | None = declare("FILE", "A file of `study run sensitivity`.", "the one in this package"),
    numbers: Place | None = declare(
        "FILE", "Write all numbers of the report, as JSON; replaced if it exists.", "not written"
    ),
    kind: KindOfReport = declare(
        "KIND",
        "`paper`: the evaluation beside the paper's. `audit`: what this ledger records, and what is broken or open.",
        "paper if all runs are of its experiment, or another option asks for a part of that report; else audit",
    ),
    workers: WorkersOption = None,
    showing: Annotated["Showing | None", Gives("showing")] = None,
) -> Lines:
    """Typeset the evaluation, or an audit of the ledger, as a PDF.

    In the paper's report each number of the paper stands beside the ledger's, with its interval and a verdict; the runs
    of all seeds are taken together. Ablations, larger fleets, workflows and members that come and go have sections of
    their own where this ledger, or one given by --with, holds them. The audit report is about any ledger: who asked
    whom, what was denied under which rule, what supervisors decided, violations, conflicts and invariants with the
    events behind them, and what was not observed. All rows are compared with their root first, as `verify` does.

    Raises:
        UsageError: The kind is unknown, or options of the paper's report are given for an audit report.
        LedgerCorrupted: The comparison found something.
        WriteFailed: The PDF cannot be written.
    """
    from fsar_ledger.base.errors import UsageError, option
    from fsar_ledger.base.printable import value
    from fsar_ledger.base.progress import unseen
    from fsar_ledger.report.build import write_report

    def path(place: Place | None) -> Path | None:
        return None if place is None else Path(place)

    given: dict[str, object] = {"with": beside, "workflows": workflows, "sensitivity": sensitivity}
    of_the_paper = [name for name, one in given.items() if one]
    if kind not in (None, "paper", "audit"):
        raise UsageError(f"{option('kind', value(kind))}: expected paper or audit")
    if kind == "audit" and of_the_paper:
        raise UsageError(
            f"{option(of_the_paper[0])}: the audit report is of one ledger; leave it out, or {option('kind')}"
        )
    write_report(
        ledger.path,
        Path(out),
        path(workflows),
        readers_of(workers, ledger.path),
        showing or unseen,
        beside=list(map(Path, beside or ())),
        sensitivity=path(sensitivity),
        numbers_out=path(numbers),
        kind="paper" if kind is None and of_the_paper else kind,
    )
    return Lines(*(f"{one}" for one in (out, numbers) if one is not None))
