"""Lay out sections: select the rows of each part from relations, and bring them into its shape.

The relations are in one small database in memory. The template prints `sections` under the titles of the kind of
report, and the figures as SVG.
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
from fsar_ledger.metrics.library import Library, sources
from fsar_ledger.report import figures, printing, sequence, specs
from fsar_ledger.report.findings import Head, Source
from fsar_ledger.report.printing import Row

PACKAGES = ("duckdb", "pyarrow", "numpy", "scipy", "msgspec", "matplotlib", "typst")
_NAME = re.compile(r"(?<!\\)@(?:tab|fig)-[a-z-]+[a-z]")
_NAMES = re.compile(r" \(((?:@[a-z-]+)(?:, @[a-z-]+)*)\)")
_STEP = re.compile(r"(?:\bWITH|,)\s+([a-z_][a-z0-9_]*)(?:\([^)]*\))?\s+AS\s+\(", re.IGNORECASE)


class Layout:
    """Sections filled from relations, and their figures, drawn on first use.

    `answers` are the rows of other SELECTs over the same relations, by name.
    """

    def __init__(
        self,
        relations: Mapping[str, pa.Table],
        defined: Mapping[str, str],
        sections: Mapping[str, specs.Section],
        asked: Mapping[str, str],
    ) -> None:
        self._figures: dict[str, tuple[specs.Figure, Sequence[Row]]] = {}
        self._held: set[str] = set()
        with Database(None, (), threads=1, queries=Library(())) as self._database:
            self._hold(relations, defined)
            self.answers = {name: self.rows(sql) for name, sql in asked.items()}
            self.sections = _naming_what_is_shown(
                [section for name, spec in sections.items() if (section := self._section(name, spec))]
            )

    def _hold(self, relations: Mapping[str, pa.Table], defined: Mapping[str, str]) -> None:
        for name, table in relations.items():
            self._database.hold(name, table)
            self._held.add(name)
        for name, sql in defined.items():
            if not self.missing(sql):
                self._database.define(name, sql, is_stored=True)
                self._held.add(name)

    def missing(self, sql: str) -> set[str]:
        """Return the names that the SELECT reads that are neither a relation here nor one of its own steps."""
        return sources(sql) - set(_STEP.findall(sql)) - self._held

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
                fields = {name: getattr(part, name) for name in ("name", "title", "caption", "alt", "width_in")}
                source = f"queries/{part.query}.sql" if part.query else ""
                yield {"shape": "figure", "file": f"{part.name}.svg", "source": source, **fields}

    def template_data(self, titles: specs.Titles, head: Head) -> bytes:
        """Return the template's input, as JSON with sorted names; `head` is the one shown on the first page."""
        data = {
            **msgspec.structs.asdict(titles),
            "events": printing.integer(head.events),
            "runs": printing.integer(head.runs),
            "root": head.root,
            "version": fsar_ledger.__version__,
            "incomplete": head.completeness if head.completeness.startswith("not complete") else None,
            "sections": self.sections,
        }
        return msgspec.json.encode(data, order="deterministic")

    @cached_property
    def drawings(self) -> dict[str, bytes]:
        """Return all figures as SVG, by file name."""
        return {f"{name}.svg": _figure_svg(*figure) for name, figure in self._figures.items()}


def for_programs(said: Mapping[str, Any], queries: Sequence[Source]) -> bytes:
    """Return these numbers as JSON with sorted names, with the versions and the digests of queries behind them."""
    data = {"versions": versions(), **said, "queries": {query.name: query.sha256 for query in queries}}
    return msgspec.json.format(msgspec.json.encode(data, order="deterministic"), indent=1) + b"\n"


def head_for_programs(head: Head) -> dict[str, str | int]:
    """Return the fields of a head that are written with numbers."""
    return {"commits": head.commits, "events": head.events, "root": head.root, "runs": head.runs}


def versions() -> dict[str, str]:
    """Return the versions of the software that made the report, by name."""
    ours = {"fsar-ledger": fsar_ledger.__version__, "Python": platform.python_version()}
    return ours | {name: version(name) for name in PACKAGES}


def _naming_what_is_shown(sections: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the sections without references to missing tables and figures.

    References in parentheses of their own are dropped, and texts with other such references are left out.
    """
    kinds = {"table": "tab", "figure": "fig"}
    parts = [part for section in sections for part in section["parts"]]
    targets = {f"@{kinds[part['shape']]}-{part['name']}" for part in parts if part["shape"] in kinds}

    def existing_names(match: re.Match[str]) -> str:
        names = [name for name in match[1].split(", ") if name in targets]
        return f" ({', '.join(names)})" if names else ""

    for section in sections:
        for part in section["parts"]:
            if part["shape"] == "text":
                part["text"] = _NAMES.sub(existing_names, part["text"])
        section["parts"] = [
            part for part in section["parts"] if part["shape"] != "text" or set(_NAME.findall(part["text"])) <= targets
        ]
    return sections


def _figure_svg(part: specs.Figure, rows: Sequence[Row]) -> bytes:
    """Return the figure as SVG."""
    match part:
        case specs.Bars():
            return figures.distances(part, rows) if part.lying else figures.bars(part, rows)
        case specs.Curve():
            return figures.curve(part, rows)
        case specs.Sequence():
            return sequence.ladder(rows) if part.ladder else sequence.sequence(rows)
    raise TypeError(f"{type(part).__name__}: found a figure that nothing draws")
