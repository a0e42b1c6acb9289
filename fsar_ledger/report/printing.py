"""Format values for the report: scale, decimals, signs and spaces are the same everywhere.

A cell keeps the value beside its printed form, so that tests and readers of the data can compare the two.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.metrics.definitions import metric_named
from fsar_ledger.report import specs

NOTHING = "–"
MINUS = "\u2212"
THIN_SPACE = "\u2009"
GRADES = {"full": "\u25cf", "partial": "\u25cb", "none": "\u2014"}  # as in the paper: present, partial, absent
MAX_ROWS, MAX_WORDS = 200, 400  # rows of a table, characters of a cell; what exceeds them is counted
SMALLEST_P = 0.0001  # smaller p are printed as "<.0001", as the paper does

Row = Mapping[str, Any]


class Cell(msgspec.Struct, frozen=True):
    """One cell: the value in stored units, its printed form, and the tone in which it is set."""

    value: Any
    printed: str
    tone: str = "plain"


class Table(msgspec.Struct, frozen=True):
    """One table ready to be typeset: spec, headings, alignment, rows of cells, and the rows that begin a group."""

    name: str
    title: str
    caption: str
    source: str
    size: float
    heads: tuple[str, ...]
    aligns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    begins: tuple[int, ...]


def number(value: float, decimals: int) -> str:
    """Format the value with this many decimals, a real minus sign, and never a negative zero."""
    printed = f"{value:.{decimals}f}"
    if float(printed) == 0:
        printed = printed.lstrip("-")
    return printed.replace("-", MINUS)


def significant(value: float, digits: int) -> str:
    """Format the value with about this many significant digits, never in exponent form."""
    if value == 0:
        return "0"
    magnitude = math.floor(math.log10(abs(value))) + 1
    return number(value, max(0, digits - magnitude))


def integer(value: float) -> str:
    """Format the integer with a thin space between thousands, from five digits on."""
    grouped = f"{int(value):,}" if abs(value) >= 10_000 else str(int(value))
    return grouped.replace(",", THIN_SPACE).replace("-", MINUS)


def probability(value: float) -> str:
    """Format the p value with four decimals, or as smaller than the smallest printed one."""
    return "<.0001" if value < SMALLEST_P else number(value, 4)


def in_metric(name: str, value: float) -> str:
    """Format the value of a metric in its printed unit."""
    spec = metric_named(name)
    return number(value * spec.factor, spec.decimals)


def _interval(value: Sequence[float], name: str) -> str:
    low, high = (in_metric(name, end) for end in value)
    return f"{low} to {high}"


def _counted(value: float, name: str) -> str:
    counted = metric_named(name).counted
    return f"{integer(value)} {counted.removesuffix('s') if value == 1 else counted}"


def words(value: object, most: int = MAX_WORDS) -> str:
    """Return the text as a page shows it.

    Everything is escaped except the thin spaces of our numbers, and the text is cut after `most` characters.
    """
    text = str(value)
    cut = text if len(text) <= most else f"{text[:most]}... ({len(text) - most:,} more)"
    return THIN_SPACE.join(printable.value(part, len(part)) for part in cut.split(THIN_SPACE))


def configuration(name: str) -> str:
    """Name a configuration as the paper's table does: "full", or what is taken out after a minus sign."""
    return f"{MINUS} {name.removeprefix('without-').replace('-', ' ')}" if name.startswith("without-") else name


Formatter = Callable[[Any, specs.Column, Row], str]

FORMATS: Mapping[str, Formatter] = {
    "text": lambda value, _column, _row: words(value),
    "code": lambda value, _column, _row: words(value),
    "architecture": lambda value, _column, _row: words(value).upper(),
    "pair": lambda value, _column, _row: " vs ".join(words(value).upper().split("-")),
    "title": lambda value, _column, _row: metric_named(str(value)).title,
    "short": lambda value, _column, _row: metric_named(str(value)).short,
    "configuration": lambda value, _column, _row: configuration(words(value)),
    "scenario": lambda value, _column, _row: words(value).replace("-", " ").capitalize(),
    "number": lambda value, column, _row: number(value, column.digits),
    "significant": lambda value, column, _row: significant(value, column.digits + 1),
    "integer": lambda value, _column, _row: integer(value),
    "probability": lambda value, _column, _row: probability(value),
    "exact": lambda value, _column, _row: printable.number(value).replace("-", MINUS),
    "own-metric": lambda value, column, _row: in_metric(column.key, value),
    "metric": lambda value, _column, row: in_metric(row["metric"], value),
    "interval": lambda value, _column, row: _interval(value, row["metric"]),
    "span": lambda value, column, _row: f"{number(value[0], column.digits)} to {number(value[1], column.digits)}",
    "counted": lambda value, _column, row: _counted(value, row["metric"]),
    "grade": lambda value, _column, _row: GRADES[value],
    "feature": lambda value, _column, _row: specs.labels("feature")[value],
    "mechanism": lambda value, _column, _row: specs.labels("mechanism")[value],
    "agreement": lambda value, _column, _row: "yes" if value else "no",
    "filled later": lambda _value, _column, _row: "",
    "verdict": lambda value, _column, _row: words(value),
}


def _tone(column: specs.Column, value: Any) -> str:
    if column.format == "code":
        return "code"
    if (
        value in ("differs", "no")
        or str(value).startswith("differs: ")
        or (column.format == "agreement" and value is False)
    ):
        return "strong"
    return "quiet" if value in ("undecided", None) else "plain"


def cell(column: specs.Column, row: Row) -> Cell:
    """Return the cell of a row under a column; a missing value is printed as a dash.

    Raises: KeyError if the row lacks the column's key or the spec names an unknown format.
    """
    value = row[column.key]
    if value is None:
        return Cell(value=None, printed=NOTHING, tone="quiet")
    return Cell(value=value, printed=FORMATS[column.format](value, column, row), tone=_tone(column, value))


def table(name: str, rows: Sequence[Row], source: str = "") -> Table:
    """Return the table of this spec filled with these rows. Raises: KeyError as `cell` does."""
    spec = specs.table(name)
    filled, begins = [], []
    before: Row = {}
    for position, row in enumerate(rows[:MAX_ROWS]):
        cells = []
        for column in spec.column:
            one = cell(column, row)
            repeats = column.group and before.get(column.key) == row[column.key]
            if column.group and not repeats and position and position not in begins:
                begins.append(position)
            cells.append(msgspec.structs.replace(one, printed="") if repeats else one)
        filled.append(tuple(cells))
        before = row
    return Table(
        name=name,
        title=spec.title,
        caption=spec.caption,
        source=source
        if len(rows) <= MAX_ROWS
        else f"{source}{'; ' if source else ''}{len(rows) - MAX_ROWS:,} more rows are not shown",
        size=spec.size,
        heads=tuple(column.head for column in spec.column),
        aligns=tuple(column.align for column in spec.column),
        rows=tuple(filled),
        begins=tuple(begins),
    )


def flat(name: str, value: object) -> Iterator[tuple[str, str]]:
    """Yield nested constants as dotted names and printed values, sorted by name within each level.

    A mapping of low_s and high_s is a range of seconds; a list of [name, value] pairs is read as a mapping.
    """
    if (
        isinstance(value, list)
        and value
        and all(isinstance(item, list) and len(item) == 2 and isinstance(item[0], str) for item in value)
    ):
        value = dict(value)
    if isinstance(value, Mapping):
        if value.keys() == {"low_s", "high_s"}:
            yield name, f"{_plain(value['low_s'])} to {_plain(value['high_s'])} s"
            return
        for key, inner in sorted(value.items()):
            yield from flat(f"{name}.{key}" if name else str(key), inner)
        return
    yield name, ", ".join(map(_plain, value)) if isinstance(value, list) else _plain(value)


def _plain(value: object) -> str:
    """Format a constant: integers in groups of three, other numbers with the digits they have."""
    if isinstance(value, int) and not isinstance(value, bool):
        return integer(value)
    return printable.number(value).replace("-", MINUS) if isinstance(value, float) else str(value)
