"""The report of the paper's evaluation: what its sections select from, and the numbers for programs.

That is what the ledgers gave, the paper's own tables and the records of the studies. The sections are in
`reports/sections/`, the relations that they share in `reports/relations.toml`.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import pyarrow as pa

from fsar_ledger.metrics.definitions import metrics, published_metrics
from fsar_ledger.metrics.effects import Sensitivity
from fsar_ledger.metrics.study_results import Calibration
from fsar_ledger.report import printing, records, specs
from fsar_ledger.report.findings import Findings, arrow
from fsar_ledger.report.judge import AIMED_AT, INFORMED, Number
from fsar_ledger.report.layout import Layout, for_programs, head_for_programs, versions

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
        """Return what the template prints, as JSON with sorted names."""
        return self.template_data(specs.titles()["paper"], self.findings.heads["results"])

    def reproduction(self) -> bytes:
        """Return the numbers for programs, as JSON.

        It holds heads, model, all printed numbers beside ours (`numbers`), the tests, the multiverse and the digests of
        the queries. Values are in the units of the queries, shares in [0, 1]; null is what is undefined, not judged or
        not drawn.
        """
        found, read = self.findings, self.findings.multiverse
        differences = found.relations["differences"] if "mechanisms" in found.heads else None
        said: dict[str, Any] = {
            "ledgers": {name: head_for_programs(head) for name, head in found.heads.items()},
            "model_version": found.model_version,
            "constants": found.parameters,
            "parameters_sha256": found.parameters_sha256,
            "claims": self.claims,
            "tally": self.tally,
            "numbers": self.numbers,
            "table_share": found.table_share,
            "tests": self.tests,
            "measured": found.relations["measured"].to_pylist() if "measured" in found.relations else [],
            "mechanisms": None if differences is None else differences.to_pylist(),
            "multiverse": None
            if read is None
            else {
                "readings": read.readings,
                "cells": read.cells,
                "rankings": read.rankings,
                "universes": read.universes,
            },
        }
        return for_programs(said, found.sources)


def _relations(
    findings: Findings,
    record: Calibration | None,
    effects: Sensitivity | None,
    robustness: Mapping[str, pa.Table] | None,
) -> dict[str, pa.Table]:
    """Return what the sections select from, beside the relations that rest on these, by name."""
    is_fitted = record is None or records.fit_changed(findings, record) is None
    judged = [
        msgspec.structs.replace(one, kind=INFORMED) if one.kind in AIMED_AT and not is_fitted else one
        for one in findings.numbers
    ]
    measured, said = records.effects_of(findings, effects)
    notes = [printing.words(one, MAX_NOTE) for one in records.notes(findings, record, said)]
    heads = [{"part": name, **msgspec.structs.asdict(head)} for name, head in findings.heads.items()]
    return {
        **findings.relations,
        **records.fit_relations(findings, record),
        **records.predictions(records.judged(findings)),
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
        "versions": _listed([{"name": name, "version": one} for name, one in versions().items()]),
    }


def _listed(rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Return the rows as a table; a column is there if any row has it."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    return _numbered(pa.Table.from_pylist([{name: row.get(name) for name in names} for row in rows]))


def _numbered(table: pa.Table) -> pa.Table:
    """Return the table with the position of each row."""
    return table.append_column("position", pa.array(range(table.num_rows), pa.int64()))


def _measures() -> pa.Table:
    """Return every metric, also those that the paper does not have."""
    fields = ("title", "short", "factor", "decimals", "better")
    return _listed([{"metric": one.name} | {name: getattr(one, name) for name in fields} for one in metrics()])


def _metrics() -> pa.Table:
    rows = [
        {
            **{name: getattr(one, name) for name in ("title", "short", "factor", "decimals", "better", "is_pooled")},
            "metric": one.name,
            "in_results": one.printed.results,
            "in_significance": one.printed.significance,
            "elsewhere": one.printed.elsewhere,
            "margin": one.printed.margin,
        }
        for one in published_metrics()
    ]
    return _listed(rows)
