"""Make the report of a ledger: gather, lay out, typeset, publish.

The report of the paper's evaluation (`Document`) combines the findings of the ledgers, the paper's own tables and the
records of the studies. Its sections are in `reports/sections/`, the relations that they share in
`reports/relations.toml`; the same numbers are written for programs.

Data reaches the Typst template as JSON and is never read as markup; only the packaged texts of `reports/` are. The same
input gives the same bytes.
"""

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa

from fsar_ledger.base.memory import temporary_files
from fsar_ledger.base.progress import Showing, unseen
from fsar_ledger.base.publishing import publish, require_another, require_place
from fsar_ledger.ledger.store.paths import require_outside
from fsar_ledger.metrics.definitions import metrics, published_metrics
from fsar_ledger.metrics.effects import Sensitivity
from fsar_ledger.metrics.study_results import Calibration, Comparison, packaged, read
from fsar_ledger.metrics.verified import ensure_verified
from fsar_ledger.report import printing, records, specs
from fsar_ledger.report.audit import AuditDocument, gather_audit, kind_of
from fsar_ledger.report.findings import Findings, arrow
from fsar_ledger.report.judge import AIMED_AT, INFORMED, Number
from fsar_ledger.report.layout import Layout, for_programs, head_for_programs, versions
from fsar_ledger.report.read import gather
from fsar_ledger.report.records import robustness

PAPER_TABLES = (
    *("results", "significance", "ablation", "ablation_text", "scaling", "cases"),
    *("architecture_features", "mechanism_coverage"),
)
MAX_NOTE = 2_000  # characters of a note
ASKED = {
    "numbers": "SELECT * EXCLUDE (position) FROM numbers ORDER BY position",
    "tally": "SELECT * EXCLUDE (position) REPLACE (coalesce(class, '') AS class) FROM tally ORDER BY position",
    "tests": "SELECT * FROM tests ORDER BY position",
    "claims": "SELECT * FROM claims ORDER BY position",
}


class Document(Layout):
    """The report of the paper's evaluation, laid out for the template."""

    def __init__(
        self,
        findings: Findings,
        record: Calibration | None = None,
        effects: Sensitivity | None = None,
        robustness: Mapping[str, pa.Table] | None = None,
    ) -> None:
        self.findings = findings
        super().__init__(_relations(findings, record, effects, robustness), specs.relations(), specs.sections(), ASKED)
        self.numbers, self.tally, self.tests, self.claims = (self.answers[name] for name in ASKED)

    def encoded(self) -> bytes:
        """Return the template's input, as JSON with sorted names."""
        return self.template_data(specs.titles()["paper"], self.findings.heads["results"])

    def reproduction(self) -> bytes:
        """Return the numbers for programs, as JSON.

        It has heads, model, all printed numbers beside ours (`numbers`), the tests, the multiverse and the digests of
        the queries. Values are in the units of the queries, shares in [0, 1]; null: undefined, not judged or not drawn.
        """
        findings, multiverse = self.findings, self.findings.multiverse
        differences = findings.relations["differences"] if "mechanisms" in findings.heads else None
        content: dict[str, Any] = {
            "ledgers": {name: head_for_programs(head) for name, head in findings.heads.items()},
            "model_version": findings.model_version,
            "constants": findings.parameters,
            "parameters_sha256": findings.parameters_sha256,
            "claims": self.claims,
            "tally": self.tally,
            "numbers": self.numbers,
            "table_share": findings.table_share,
            "tests": self.tests,
            "measured": findings.relations["measured"].to_pylist() if "measured" in findings.relations else [],
            "mechanisms": None if differences is None else differences.to_pylist(),
            "multiverse": None
            if multiverse is None
            else {
                "readings": multiverse.readings,
                "cells": multiverse.cells,
                "rankings": multiverse.rankings,
                "universes": multiverse.universes,
            },
        }
        return for_programs(content, findings.sources)


def _relations(
    findings: Findings,
    record: Calibration | None,
    effects: Sensitivity | None,
    robustness: Mapping[str, pa.Table] | None,
) -> dict[str, pa.Table]:
    """Return the base relations that the sections select from, by name."""
    is_fitted = record is None or records.fit_changed(findings, record) is None
    judged = [
        msgspec.structs.replace(number, kind=INFORMED) if number.kind in AIMED_AT and not is_fitted else number
        for number in findings.numbers
    ]
    measured, summary = records.effects_of(findings, effects)
    notes = [printing.words(note, MAX_NOTE) for note in records.notes(findings, record, summary)]
    heads = [{"part": name, **msgspec.structs.asdict(head)} for name, head in findings.heads.items()]
    return {
        **findings.relations,
        **records.fit_relations(findings, record),
        **records.predictions(records.packaged_for(findings, Comparison)),
        **measured,
        **{f"paper_{name}": _listed(specs.paper_table(name)) for name in PAPER_TABLES},
        **{name: _listed(specs.rows(name)) for name in ("reasons", "mechanisms", "structural")},
        "case_cells": _listed(specs.rows("cases")),
        "quotes": _listed(specs.quotes()),
        "labels": _listed(specs.labels()),
        "metrics": _metrics(),
        "measures": _measures(),
        "judged": _numbered(arrow(judged, Number)),
        "heads": _listed(heads),
        "notes": pa.table({"text": pa.array(notes, pa.string())}),
        **(records.robustness_relations() if robustness is None else robustness),
        "own_constants": records.own_constants(findings.parameters),
        "whole": pa.table(
            {
                "table_share": pa.array([findings.table_share], pa.float64()),
                "parameters_sha256": pa.array([findings.parameters_sha256], pa.string()),
            }
        ),
        "versions": _listed([{"name": name, "version": note} for name, note in versions().items()]),
    }


def _listed(rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Return the rows as a table, with every column that any row has."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    return _numbered(pa.Table.from_pylist([{name: row.get(name) for name in names} for row in rows]))


def _numbered(table: pa.Table) -> pa.Table:
    """Return the table with the position of each row."""
    return table.append_column("position", pa.array(range(table.num_rows), pa.int64()))


def _measures() -> pa.Table:
    """Return every metric, including those that the paper does not have."""
    fields = ("title", "short", "factor", "decimals", "better")
    return _listed([{"metric": metric.name} | {name: getattr(metric, name) for name in fields} for metric in metrics()])


def _metrics() -> pa.Table:
    rows = [
        {
            **{name: getattr(metric, name) for name in ("title", "short", "factor", "decimals", "better", "is_pooled")},
            "metric": metric.name,
            "in_results": metric.printed.results,
            "in_significance": metric.printed.significance,
            "elsewhere": metric.printed.elsewhere,
            "margin": metric.printed.margin,
        }
        for metric in published_metrics()
    ]
    return _listed(rows)


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
    """Write the PDF and its numbers about the current heads of the ledger and of the ledgers beside it.

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
        sensitivity: The file of `fsar-ledger study run sensitivity`; if it is of other runs, a note on the first page
            says so. None: the one in this package, if it is of these runs.
        numbers_out: Where the same numbers are written for programs (`Document.reproduction`); None: nowhere.
        kind: The report of the paper's evaluation, or the audit report of this ledger alone; None: as by `kind_of`.
        demanded: The newest record of the ledger, if `ensure_verified` has just checked it; None checks it now.

    Raises:
        UsageError: The ledger of workflows holds no workflow, one beside it has nothing for the report, `out` lies
            inside a ledger or equals `numbers_out`, or `sensitivity` cannot be read.
        FsarLedgerError: `sensitivity` is another kind of file.
        NotALedger, FormatVersionMismatch, LedgerCorrupted: A ledger cannot be read, or its rows are not those under its
            root.
        SequenceConflict: A ledger was appended to in the meantime.
        WriteFailed: `out` cannot be written.
    """
    require_outside(out, f"--out {out}")
    if numbers_out is not None:
        require_outside(numbers_out, f"--numbers {numbers_out}")
        require_another(numbers_out, f"--numbers {numbers_out}", out, f"--out {out}")
    for path in filter(None, (out, numbers_out)):
        require_place(path)
    given = None if sensitivity is None else read(sensitivity, Sensitivity)
    demanded = demanded or _compared(ledger, workers, showing)
    if (kind or kind_of(ledger, demanded)) == "audit":
        _publish(AuditDocument(gather_audit(ledger, demanded)), out, numbers_out)
        return
    heads = {other: _compared(other, workers, showing) for other in (*filter(None, [workflows]), *beside)}
    findings = gather(ledger, demanded, heads, workflows=workflows, reads_every_way=True, showing=showing)
    effects = given or records.packaged_for(findings, Sensitivity)
    document = Document(findings, packaged(Calibration), effects, robustness(findings))
    _publish(document, out, numbers_out)


def _publish(document: Document | AuditDocument, out: Path, numbers_out: Path | None) -> None:
    """Write the PDF and its numbers; replace no file before both are made."""
    contents = {out: pdf(document.encoded(), document.drawings)}
    if numbers_out is not None:
        contents[numbers_out] = document.reproduction()
    for path, content in contents.items():
        publish(path, content)


def _compared(ledger: Path, workers: int, showing: Showing) -> str:
    """Compare all rows with their root; return the newest record. Raises: As `ensure_verified`."""
    with showing("verified", "segments") as progress:
        return ensure_verified(ledger, workers, progress)


def pdf(data: bytes, figures: dict[str, bytes]) -> bytes:
    """Return the report as a PDF. `data` is JSON, `figures` are SVG by file name.

    Raises: WriteFailed if the folder for temporary files is full.
    """
    with temporary_files(), tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        (root / "report.typ").write_text(specs.text("templates", "report.typ"), encoding="utf-8")
        (root / "data.json").write_bytes(data)
        for name, svg in figures.items():
            (root / name).write_bytes(svg)
        return _compiled(root)


def _compiled(root: Path) -> bytes:
    """Compile `report.typ` in this folder, which can read no other files, with only Typst's own fonts."""
    import typst

    compiled: bytes = typst.compile(
        root / "report.typ", root=root, timestamp=0, font_paths=typst.Fonts(include_system_fonts=False)
    )
    return compiled
