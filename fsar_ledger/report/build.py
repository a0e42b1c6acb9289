"""A ledger becomes the report: gather, lay out, typeset, publish."""

from collections.abc import Callable, Sequence
from pathlib import Path

from fsar_ledger.ledger.store.paths import require_outside
from fsar_ledger.metrics.verified import required_look
from fsar_ledger.recording import require_another
from fsar_ledger.report import document, figures, typeset
from fsar_ledger.report.calibration import recorded
from fsar_ledger.report.gather import gather
from fsar_ledger.report.reproduction import reproduction
from fsar_ledger.report.sensitivity import open_effects, section


def write_report(
    ledger: Path,
    out: Path,
    workflows: Path | None = None,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
    demanded: str | None = None,
    *,
    beside: Sequence[Path] = (),
    pools_seeds: bool = False,
    sensitivity: Path | None = None,
    reads_every_way: bool = True,
    numbers_out: Path | None = None,
) -> None:
    """The PDF about the ledger's present head, and about those of the ledgers beside it, is at `out`, complete or not at all; so are its numbers.

    First every row of each is compared with its root. Same heads and versions, same bytes.

    Args:
        ledger: The folder of the ledger.
        out: The PDF.
        workflows: The folder of the ledger of workflows.
        beside: The folders of other ledgers: of ablations, of larger fleets, of workflows. Each is asked what it holds.
        workers: Processes that compare rows.
        progress: Told of segments compared, done and in all.
        pools_seeds: Whether the tables are of the runs of all seeds together.
        sensitivity: The file of `fsar-ledger sensitivity`; the report has it if it is of these runs, else it says how to make it.
        reads_every_way: Whether the cells are shown under every reading of the text, too.
        numbers_out: Where the same numbers go for programs (`reproduction`); None: nowhere.
        demanded: The newest record of the ledger, if a whole look just saw it (`required_look`); None looks now.

    Raises:
        UsageError: The ledger of workflows holds no workflow, one beside it nothing for the report, `out` lies inside a ledger or is `numbers_out`,
            too, or `sensitivity` is something else.
        NotALedger, FormatVersionMismatch, LedgerCorrupted: The ledger cannot be read, or its rows are not those under its root.
        SequenceConflict: Somebody appended meanwhile.
        WriteFailed: `out` cannot be written.
    """
    require_outside(out, f"--out {out}")
    if numbers_out is not None:
        require_outside(numbers_out, f"--numbers {numbers_out}")
        require_another(numbers_out, f"--numbers {numbers_out}", out, f"--out {out}")
    for place in filter(None, (out, numbers_out)):
        typeset.require_place(place)
    given = None if sensitivity is None else open_effects(sensitivity)
    demanded = demanded or required_look(ledger, workers, progress)
    theirs = {
        one: required_look(one, workers, progress) for one in (*([] if workflows is None else [workflows]), *beside)
    }
    findings = gather(ledger, workflows, demanded, theirs, pools_seeds=pools_seeds, reads_every_way=reads_every_way)
    effects = section(given, findings.model_version, [findings.parameters_sha256 or "unknown"])
    record = recorded()
    laid_out = document.encoded(document.data(findings, record, effects))
    made = {out: typeset.pdf(laid_out, document.drawings(findings, effects))}
    if numbers_out is not None:
        made[numbers_out] = reproduction(findings, document.counted(findings, record))
    for place, content in made.items():  # nothing is replaced before all is made
        typeset.publish(place, content)


def result_figure_svg(ledger: Path, out: Path) -> None:
    """The figure "Evaluation results" of the ledger is at `out` as SVG. Raises: as `write_report`."""
    require_outside(out, str(out))
    typeset.publish(out, figures.evaluation_results(gather(ledger).cells, "svg"))


def result_figure_png(ledger: Path, out: Path) -> None:
    """The figure "Evaluation results" of the ledger is at `out` as PNG. Raises: as `write_report`."""
    require_outside(out, str(out))
    typeset.publish(out, figures.evaluation_results(gather(ledger).cells, "png"))
