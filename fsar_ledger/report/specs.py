"""Read the packaged files of `reports/`: what the report says, and the numbers that the paper prints.

Words and layout are data, so that a table can be reworded without touching code. The only numbers under `reports/` are
the paper's own (`paper/*.csv`, `quotes.toml`) and the record of the fit.
"""

import csv
import tomllib
from functools import cache
from importlib.resources import files
from typing import Literal, TypeVar

import msgspec

T = TypeVar("T")


class Column(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One column of a table: which value it shows, under which heading, in which format.

    `digits` counts decimals; with `group` a value is printed only where it differs from the row above.
    """

    key: str
    head: str
    format: str = "text"
    digits: int = 2
    align: str = "right"
    group: bool = False


class TableSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One table: caption, columns, and the packaged query behind its numbers (None: the paper alone, or a record)."""

    title: str
    caption: str
    column: tuple[Column, ...]
    query: str | None = None
    paper: str | None = None
    size: float = 8.5


class FigureSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One figure: caption, alternative text, size in inches, and the packaged query behind its numbers."""

    title: str
    caption: str
    alt: str
    query: str
    width_in: float
    height_in: float
    paper: str | None = None


class Passage(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One titled paragraph in Typst markup; `id` names it, `paper` is the label of the place it refers to."""

    id: str
    title: str
    text: str
    paper: str = ""


class Contradiction(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One contradiction: what the paper says, and the arithmetic, with `{name}` for each computed number."""

    id: str
    title: str
    claim: str
    arithmetic: str
    paper: str = ""
    table: str | None = None


class Quote(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One number of the paper's running text: where it stands, and in which words."""

    value: float
    where: str
    words: str


class CaseCell(msgspec.Struct, frozen=True, forbid_unknown_fields=True, rename={"kind": "class"}):
    """One number of the paper's four cases: which claim of `queries/cases` it is, in which words, counted over what.

    `other` is the claim in its other reading, `of` the words for its denominator, `kind` the class of the cell.
    """

    case: int
    architecture: str
    claim: str
    said: str
    unit: str
    kind: Literal["by construction", "informed"]
    other: str | None = None
    of: str | None = None


def text(*path: str) -> str:
    """Return the text of a packaged file of `reports/`."""
    return files("fsar_ledger.reports").joinpath(*path).read_text(encoding="utf-8")


def _toml(cls: type[T], *path: str) -> T:
    return msgspec.convert(tomllib.loads(text(*path)), cls)


def table(name: str) -> TableSpec:
    """Return the spec of one table."""
    return _toml(TableSpec, "tables", f"{name}.toml")


def figure(name: str) -> FigureSpec:
    """Return the spec of one figure."""
    return _toml(FigureSpec, "figures", f"{name}.toml")


def passages(name: str) -> tuple[Passage, ...]:
    """Return the paragraphs of one packaged file, in its order."""
    return tuple(_toml(dict[str, list[Passage]], f"{name}.toml")["passage"])


@cache
def labels(kind: str) -> dict[str, str]:
    """Return the labels of one kind (feature, mechanism, workflow, difference) by the names of the queries."""
    return _toml(dict[str, dict[str, str]], "labels.toml")[kind]


def contradictions() -> tuple[Contradiction, ...]:
    """Return the contradictions in the paper, in the order in which the report prints them."""
    return tuple(_toml(dict[str, list[Contradiction]], "contradictions.toml")["contradiction"])


def quotes() -> dict[str, dict[str, Quote]]:
    """Return the numbers of the paper's running text, by topic and name."""
    return _toml(dict[str, dict[str, Quote]], "quotes.toml")


def cases() -> tuple[CaseCell, ...]:
    """Return the numbers of the paper's four cases, in its order."""
    return tuple(_toml(dict[str, list[CaseCell]], "cases.toml")["cell"])


def paper_table(name: str) -> tuple[dict[str, str], ...]:
    """Return the rows of one of the paper's tables, as printed."""
    return tuple(csv.DictReader(text("paper", f"{name}.csv").splitlines()))
