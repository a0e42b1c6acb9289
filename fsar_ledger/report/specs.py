"""Define the structure of a section of the report, and read the packaged files of `reports/`.

A section is data (`reports/sections/*.toml`): a title and its parts in order. A part gets its rows from a SELECT over
the relations that `relations.toml` and `Findings` define, and has one of five shapes: text, table, bars, curve or
sequence. The only numbers under `reports/` are the paper's own (`paper/*.csv`, `quotes.toml`) and the records of
studies.
"""

import csv
import tomllib
from functools import cache
from importlib.resources import files
from typing import Any, Literal

import msgspec

Kind = Literal["paper", "audit"]
"""The kinds of reports: of the paper's evaluation, and of what a ledger records."""


class Column(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One column of a table: the key of its value, its heading, and its format (`printing.FORMATS`).

    `digits` counts decimals; with `group` a value is printed only where it differs from the row above; an `optional`
    column is left out where no row has a value.
    """

    key: str
    head: str
    format: str = "text"
    digits: int = 2
    align: Literal["left", "right", "center"] = "right"
    group: bool = False
    optional: bool = False


class Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="shape", tag=str.lower):
    """Common to all parts: the SELECT. A part without rows, or with a missing relation, is left out."""

    rows: str | None = None


class Text(Part, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Typst markup with `{name}` for each value, printed once for each row; without `rows`, once.

    `follows` appends it to the paragraph of the text before; `id` names it for tests. A section that has only texts
    without `rows` is not printed.
    """

    text: str
    follows: bool = False
    id: str = ""


class Table(Part, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table with its caption; `query` is the packaged query behind its numbers."""

    name: str
    title: str
    columns: tuple[Column, ...]
    caption: str = ""
    query: str | None = None
    size: float = 8.0


class Figure(Part, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Common to all figures: caption, alternative text, size in inches, and the packaged query behind its numbers."""

    name: str
    title: str
    alt: str
    caption: str = ""
    query: str | None = None
    width_in: float = 7.2
    height_in: float = 3.9


class Bars(Figure, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Bars with intervals in panels, a diamond at the paper's value (`figures.bars`).

    `lying` draws points with intervals on lines instead, at distances from the paper's value (`figures.distances`).
    """

    panels: tuple[int, int] = (1, 1)
    lying: bool = False
    legend: bool = True


class Curve(Figure, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Lines with intervals in panels (`figures.curve`); `styles` has the meaning of each line style, for the legend.

    A scale of 2 or 10 is logarithmic, with this base.
    """

    panels: tuple[int, int] = (1, 1)
    x_label: str = ""
    y_label: str = ""
    x_scale: Literal[0, 2, 10] = 0
    y_scale: Literal[0, 2, 10] = 0
    shaded_from: float | None = None
    styles: dict[str, str] = {}
    hollow: str | None = None


class Sequence(Figure, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The messages of a request (`sequence.sequence`), or with `ladder` the steps of recovery (`sequence.ladder`)."""

    ladder: bool = False


AnyPart = Text | Table | Bars | Curve | Sequence


class Section(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One section: its title ("" on the first page), its parts, and whether it belongs to the appendix."""

    title: str
    part: tuple[AnyPart, ...]
    is_appendix: bool = False


def text(*path: str) -> str:
    """Return the text of a packaged file of `reports/`."""
    return files("fsar_ledger.reports").joinpath(*path).read_text(encoding="utf-8")


class Titles(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The titles of a document: in the PDF and above each page, on the first page, and the line below.

    `breaks`: its first page has only the section without a title, if that fits on it.
    """

    title: str
    heading: str
    subtitle: str
    breaks: bool = False


def titles() -> dict[Kind, Titles]:
    """Return the titles of each kind of report."""
    return msgspec.toml.decode(text("titles.toml"), type=dict[Kind, Titles])


@cache
def sections(folder: str = "sections") -> dict[str, Section]:
    """Return the sections by the name of their file, in order; a number in front of the name gives the order.

    The folder is `sections` for the paper's report, `audit` for the audit report.
    """
    names = sorted(entry.name for entry in files("fsar_ledger.reports").joinpath(folder).iterdir())
    return {
        name.removesuffix(".toml"): msgspec.toml.decode(text(folder, name), type=Section)
        for name in names
        if name.endswith(".toml")
    }


def relations(file: str = "relations.toml") -> dict[str, str]:
    """Return the relations that several sections share, each after those that it reads."""
    return dict(tomllib.loads(text(file)))


def rows(name: str) -> list[dict[str, Any]]:
    """Return the entries of a packaged list, a TOML file with one array of tables."""
    [entries] = tomllib.loads(text(f"{name}.toml")).values()
    return list(entries)


def quotes() -> list[dict[str, Any]]:
    """Return the numbers of the paper's running text, with their topic and name."""
    topics = tomllib.loads(text("quotes.toml"))
    return [{"topic": topic, "name": name, **quote} for topic, names in topics.items() for name, quote in names.items()]


def labels() -> list[dict[str, str]]:
    """Return the report's labels for names in the queries, with their kind."""
    kinds = tomllib.loads(text("labels.toml"))
    return [
        {"kind": kind, "name": name, "label": label} for kind, names in kinds.items() for name, label in names.items()
    ]


def paper_table(name: str) -> tuple[dict[str, str], ...]:
    """Return the rows of one of the paper's tables, as printed."""
    return tuple(csv.DictReader(text("paper", f"{name}.csv").splitlines()))
