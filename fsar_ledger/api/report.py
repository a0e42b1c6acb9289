"""The verb `report`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from .answers import Lines
from .names import Place, pools_seeds
from .verbs import Gives, Option, PoolOption, WorkersOption, declare, verb
from .workload import readers_of

if TYPE_CHECKING:
    from fsar_ledger.base.progress import Showing

    from .ledger import Ledger


@verb(
    "report out/ledger --out out/report.pdf",
    "report out/ledger --with out/workflows --with out/untrusting --out out/report.pdf",
    "report out/ledger --out out/report.pdf --numbers out/numbers.json",
    takes=(),
)
def report(
    ledger: "Ledger",
    out: Annotated[Place, Option("--out", "FILE", "The PDF; replaced if it exists.")],
    *,
    beside: Sequence[Place] = declare(
        "LEDGER",
        "Another ledger to show, of ablations, larger fleets or workflows; may be repeated.",
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
    pool: PoolOption = None,
    workers: WorkersOption = None,
    showing: Annotated["Showing | None", Gives("showing")] = None,
) -> Lines:
    """Typeset the evaluation as a PDF.

    Each number of the paper stands beside the ledger's, with its interval and a verdict. Ablations, larger fleets and
    workflows have sections of their own where this ledger, or one given by --with, holds them. All rows are compared
    with their root first, as `verify` does.

    Raises:
        LedgerCorrupted: The comparison found something.
        WriteFailed: The PDF cannot be written.
    """
    from fsar_ledger.base.progress import unseen
    from fsar_ledger.report.build import write_report

    def path(place: Place | None) -> Path | None:
        return None if place is None else Path(place)

    write_report(
        ledger.path,
        Path(out),
        path(workflows),
        readers_of(workers, ledger.path),
        showing or unseen,
        beside=list(map(Path, beside or ())),
        pools_seeds=pools_seeds(pool),
        sensitivity=path(sensitivity),
        numbers_out=path(numbers),
    )
    return Lines(*(f"{one}" for one in (out, numbers) if one is not None))
