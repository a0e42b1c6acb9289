"""Make the report of a ledger: gather, lay out, typeset, publish.

Data reaches the Typst template as JSON and is never read as markup; only the packaged texts of `reports/` are. The same
input gives the same bytes.
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path

from fsar_ledger.base.errors import WriteFailed
from fsar_ledger.base.progress import Showing, unseen
from fsar_ledger.base.publishing import publish, require_another, require_place
from fsar_ledger.ledger.store.paths import require_outside
from fsar_ledger.metrics.effects import Sensitivity
from fsar_ledger.metrics.study_results import Calibration, packaged, read
from fsar_ledger.metrics.verified import ensure_verified
from fsar_ledger.report import specs
from fsar_ledger.report.audit import AuditDocument, gather_audit, kind_of
from fsar_ledger.report.document import Document
from fsar_ledger.report.read import gather
from fsar_ledger.report.records import robustness


def write_report(
    ledger: Path,
    out: Path,
    workflows: Path | None = None,
    workers: int = 1,
    showing: Showing = unseen,
    demanded: str | None = None,
    *,
    beside: Sequence[Path] = (),
    sensitivity: Path | None = None,
    numbers_out: Path | None = None,
    kind: specs.Kind | None = "paper",
) -> None:
    """Write the PDF and its numbers about the present heads of the ledger and of the ledgers beside it.

    First every row of each ledger is compared with its root. Each file appears complete at its path, or not at all. The
    same heads and versions give the same bytes.

    Args:
        ledger: The folder of the ledger.
        out: The PDF.
        workflows: The folder of the ledger of workflows.
        beside: The folders of other ledgers: of ablations, of larger fleets, of workflows. Each fills the sections that
            it has runs for.
        workers: Processes that compare rows.
        showing: Called with a verb and a unit for each step; returns a context that yields a progress function.
        sensitivity: The file of `fsar-ledger study run sensitivity`; None: the one in this package. If it is of other
            runs, a note on the first page says so.
        numbers_out: Where the same numbers are written for programs (`Document.reproduction`); None: nowhere.
        kind: The report of the paper's evaluation, or the audit report of this ledger alone; None: `kind_of` tells.
        demanded: The newest record of the ledger, if `ensure_verified` has just checked it; None checks it now.

    Raises:
        UsageError: The ledger of workflows holds no workflow, one beside it has nothing for the report, `out` lies
            inside a ledger or equals `numbers_out`, or `sensitivity` cannot be read.
        FsarLedgerError: `sensitivity` is another kind of file.
        NotALedger, FormatVersionMismatch, LedgerCorrupted: A ledger cannot be read, or its rows are not those under its
            root.
        SequenceConflict: Somebody appended in the meantime.
        WriteFailed: `out` cannot be written.
    """
    require_outside(out, f"--out {out}")
    if numbers_out is not None:
        require_outside(numbers_out, f"--numbers {numbers_out}")
        require_another(numbers_out, f"--numbers {numbers_out}", out, f"--out {out}")
    for place in filter(None, (out, numbers_out)):
        require_place(place)
    given = packaged(Sensitivity) if sensitivity is None else read(sensitivity, Sensitivity)
    demanded = demanded or _compared(ledger, workers, showing)
    if (kind or kind_of(ledger, demanded)) == "audit":
        _publish(AuditDocument(gather_audit(ledger, demanded)), out, numbers_out)
        return
    theirs = {one: _compared(one, workers, showing) for one in (*filter(None, [workflows]), *beside)}
    findings = gather(ledger, demanded, theirs, workflows=workflows, reads_every_way=True, showing=showing)
    document = Document(findings, packaged(Calibration), given, robustness(findings))
    _publish(document, out, numbers_out)


def _publish(document: Document | AuditDocument, out: Path, numbers_out: Path | None) -> None:
    """Write the PDF and its numbers; replace nothing before both are made."""
    made = {out: pdf(document.encoded(), document.drawings)}
    if numbers_out is not None:
        made[numbers_out] = document.reproduction()
    for place, content in made.items():
        publish(place, content)


def _compared(ledger: Path, workers: int, showing: Showing) -> str:
    """Compare all rows with their root; return the newest record. Raises: As `ensure_verified`."""
    with showing("verified", "segments") as progress:
        return ensure_verified(ledger, workers, progress)


def result_figure_svg(ledger: Path, out: Path) -> None:
    """Write the figure "Evaluation results" of the ledger as SVG. Raises: as `write_report`."""
    require_outside(out, str(out))
    publish(out, Document(gather(ledger)).drawing("evaluation-results"))


def pdf(data: bytes, figures: dict[str, bytes]) -> bytes:
    """Return the report as a PDF. `data` is JSON, `figures` are SVG by file name.

    Raises: WriteFailed if the folder for temporary files is full.
    """
    try:
        with tempfile.TemporaryDirectory() as folder:
            root = Path(folder)
            (root / "report.typ").write_text(specs.text("templates", "report.typ"), encoding="utf-8")
            (root / "data.json").write_bytes(data)
            for name, svg in figures.items():
                (root / name).write_bytes(svg)
            return _compiled(root)
    except OSError as error:
        raise WriteFailed(
            f"{tempfile.gettempdir()}: temporary files cannot be written: {error.strerror}. Nothing was changed; free "
            "space or set TMPDIR."
        ) from error


def _compiled(root: Path) -> bytes:
    """Compile `report.typ` in this folder; it can read nothing outside, and only Typst's own fonts."""
    import typst

    compiled: bytes = typst.compile(
        root / "report.typ", root=root, timestamp=0, font_paths=typst.Fonts(include_system_fonts=False)
    )
    return compiled
