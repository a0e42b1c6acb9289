"""Lay out the sections: select the rows of each part and put them into its shape.

Everything that was read becomes a relation of one small database in memory: what the ledgers gave, the paper's own
tables, the records of the studies. A section selects from these (`reports/sections/*.toml`, `reports/relations.toml`).
The result is JSON for the template `reports/templates/report.typ`, and the figures as SVG.
"""

import platform
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from importlib.metadata import version
from typing import Any

import msgspec
import pyarrow as pa

import fsar_ledger
from fsar_ledger.metrics.database import Database
from fsar_ledger.metrics.definitions import published_metrics
from fsar_ledger.metrics.effects import Sensitivity
from fsar_ledger.metrics.library import Library
from fsar_ledger.metrics.study_results import Calibration
from fsar_ledger.report import charts, printing, records, sequence, specs
from fsar_ledger.report.findings import Findings, arrow
from fsar_ledger.report.judge import AIMED_AT, INFORMED, Number

Row = Mapping[str, Any]
PACKAGES = ("duckdb", "pyarrow", "numpy", "scipy", "msgspec", "matplotlib", "typst")
PAPER_TABLES = (
    *("results", "significance", "ablation", "ablation_text", "scaling", "cases"),
    *("architecture_features", "mechanism_coverage"),
)
MAX_NOTE = 2_000  # characters of a note
_SOURCE = re.compile(r"(?<!DISTINCT )\b(?:FROM|JOIN)\s+([a-z_][a-z0-9_]*)\b(?!\()", re.IGNORECASE)
_NAME = re.compile(r"(?<!\\)@(?:tab|fig)-[a-z-]+[a-z]")
_NAMES = re.compile(r" \(((?:@[a-z-]+)(?:, @[a-z-]+)*)\)")
_STEP = re.compile(r"(?:\bWITH|,)\s+([a-z_][a-z0-9_]*)(?:\([^)]*\))?\s+AS\s+\(", re.IGNORECASE)


class Document:
    """The sections of one report, laid out for the template, and its figures, drawn when they are asked for."""

    def __init__(
        self,
        findings: Findings,
        record: Calibration | None = None,
        effects: Sensitivity | None = None,
        ranking: tuple[records.RankingHeld, ...] = (),
    ) -> None:
        self.findings = findings
        self._figures: dict[str, tuple[specs.Figure, Sequence[Row]]] = {}
        self._held: set[str] = set()
        with Database(None, (), threads=1, queries=Library(())) as self._database:
            self._hold(_relations(findings, record, effects, ranking))
            self.numbers = self.rows("SELECT * EXCLUDE (position) FROM numbers ORDER BY position")
            self.tally = self.rows(
                "SELECT * EXCLUDE (position) REPLACE (coalesce(class, '') AS class) FROM tally ORDER BY position"
            )
            self.tests = self.rows("SELECT * FROM tests ORDER BY position")
            self.claims = self.rows("SELECT * FROM claims ORDER BY position")
            found = [one for name, spec in specs.sections().items() if (one := self._section(name, spec))]
            self.sections = _naming_what_is_shown(found)

    def _hold(self, relations: Mapping[str, pa.Table]) -> None:
        for name, table in relations.items():
            self._database.hold(name, table)
            self._held.add(name)
        for name, sql in specs.relations().items():
            if not self.missing(sql):
                self._database.define(name, sql, is_stored=True)
                self._held.add(name)

    def missing(self, sql: str) -> set[str]:
        """Return the names that the SELECT reads and that are neither a relation here nor a step of its own."""
        return set(_SOURCE.findall(sql)) - set(_STEP.findall(sql)) - self._held

    def rows(self, sql: str) -> list[dict[str, Any]]:
        """Return the rows of a SELECT over the relations; none if one is missing. Raises: as `Database.rows`."""
        return [] if self.missing(sql) else self._database.rows(sql)

    def _section(self, name: str, spec: specs.Section) -> dict[str, Any] | None:
        """Return the section; None if no part of it that selects rows has any."""
        parts: list[dict[str, Any]] = []
        has_rows = False
        for part in spec.part:
            rows = [{}] if part.rows is None else self.rows(part.rows)
            has_rows |= part.rows is not None and bool(rows)
            if rows:
                parts += self._part(part, rows)
        return (
            {"name": name, "title": spec.title, "is_appendix": spec.is_appendix, "parts": parts} if has_rows else None
        )

    def _part(self, part: specs.AnyPart, rows: Sequence[Row]) -> Iterator[dict[str, Any]]:
        match part:
            case specs.Text():
                for row in rows:
                    filled = printing.sentence(part.text, row)
                    yield {"shape": "text", "text": filled, "follows": part.follows, "id": part.id}
            case specs.Table():
                yield {"shape": "table", **msgspec.structs.asdict(printing.table(part, rows))}
            case specs.Figure():
                self._figures[part.name] = (part, rows)
                said = {name: getattr(part, name) for name in ("name", "title", "caption", "alt", "width_in")}
                source = f"queries/{part.query}.sql" if part.query else ""
                yield {"shape": "figure", "file": f"{part.name}.svg", "source": source, **said}

    def drawing(self, name: str) -> bytes:
        """Return the figure of this name as SVG. Raises: KeyError if it is not shown."""
        return _drawn(*self._figures[name])

    @cached_property
    def drawings(self) -> dict[str, bytes]:
        """Return all figures as SVG, by file name."""
        return {f"{name}.svg": self.drawing(name) for name in self._figures}

    def encoded(self) -> bytes:
        """Return what the template prints, as JSON with sorted names."""
        head = self.findings.heads["results"]
        said = {
            "events": printing.integer(head.events),
            "runs": printing.integer(head.runs),
            "root": head.root,
            "version": fsar_ledger.__version__,
            "incomplete": head.completeness if head.completeness.startswith("not complete") else None,
            "sections": self.sections,
        }
        return msgspec.json.encode(said, order="deterministic")

    def reproduction(self) -> bytes:
        """Return the numbers for programs, as JSON.

        It holds heads, model, all printed numbers beside ours (`numbers`), the tests, the multiverse and the digests of
        the queries. Values are in the units of the queries, shares in [0, 1]; null is what is undefined, not judged or
        not drawn.
        """
        found, read = self.findings, self.findings.multiverse
        differences = found.relations["differences"] if "mechanisms" in found.heads else None
        said: dict[str, Any] = {
            "versions": versions(),
            "ledgers": {name: _head(found, name) for name in found.heads},
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
            "queries": {one.name: one.sha256 for one in found.sources},
        }
        return msgspec.json.format(msgspec.json.encode(said, order="deterministic"), indent=1) + b"\n"


def _naming_what_is_shown(sections: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the sections without references to tables and figures that are not there.

    Those in brackets of their own are dropped, and a text that names another one is left out.
    """
    kinds = {"table": "tab", "figure": "fig"}
    every = [part for section in sections for part in section["parts"]]
    shown = {f"@{kinds[part['shape']]}-{part['name']}" for part in every if part["shape"] in kinds}

    def kept(match: re.Match[str]) -> str:
        names = [name for name in match[1].split(", ") if name in shown]
        return f" ({', '.join(names)})" if names else ""

    for section in sections:
        for part in section["parts"]:
            if part["shape"] == "text":
                part["text"] = _NAMES.sub(kept, part["text"])
        section["parts"] = [
            part for part in section["parts"] if part["shape"] != "text" or set(_NAME.findall(part["text"])) <= shown
        ]
    return sections


def _head(found: Findings, name: str) -> dict[str, str | int]:
    """Return the head of the ledger that these numbers are from."""
    one = found.heads[name]
    return {"commits": one.commits, "events": one.events, "root": one.root, "runs": one.runs}


def versions() -> dict[str, str]:
    """Return the versions of the software that made the report, by name."""
    ours = {"fsar-ledger": fsar_ledger.__version__, "Python": platform.python_version()}
    return ours | {name: version(name) for name in PACKAGES}


def _drawn(part: specs.Figure, rows: Sequence[Row]) -> bytes:
    """Return the figure as SVG."""
    match part:
        case specs.Bars():
            return charts.distances(part, rows) if part.lying else charts.bars(part, rows)
        case specs.Curve():
            return charts.curve(part, rows)
        case specs.Sequence():
            return sequence.ladder(rows) if part.ladder else sequence.sequence(rows)
    raise TypeError(f"{type(part).__name__}: found a figure that nothing draws")


def _relations(
    findings: Findings,
    record: Calibration | None,
    effects: Sensitivity | None,
    ranking: tuple[records.RankingHeld, ...],
) -> dict[str, pa.Table]:
    """Return what the sections select from, beside the relations that rest on these, by name."""
    is_fitted = record is None or records.fit_changed(findings, record) is None
    judged = [
        msgspec.structs.replace(one, kind=INFORMED) if one.kind in AIMED_AT and not is_fitted else one
        for one in findings.numbers
    ]
    measured, said = records.effects_of(findings, effects)
    notes = [{"text": printing.words(row["text"], MAX_NOTE)} for row in records.notes(findings, record, said)]
    heads = [{"part": name, **msgspec.structs.asdict(head)} for name, head in findings.heads.items()]
    return {
        **findings.relations,
        **records.fit_relations(findings, record),
        **records.predictions(records.judged(findings)),
        **measured,
        **{f"paper_{name}": _listed(specs.paper_table(name)) for name in PAPER_TABLES},
        **{name: _listed(specs.rows(name)) for name in ("reasons", "mechanisms")},
        "case_cells": _listed(specs.rows("cases")),
        "quotes": _listed(specs.quotes()),
        "labels": _listed(specs.labels()),
        "metrics": _metrics(),
        "judged": _numbered(arrow(judged, Number)),
        "heads": _listed(heads),
        "notes": pa.table({"text": pa.array([row["text"] for row in notes], pa.string())}),
        "ranking": arrow(ranking, records.RankingHeld),
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
