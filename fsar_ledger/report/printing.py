"""Format values for the report, with the same scale, decimals, signs and spaces everywhere.

A cell keeps the value beside its printed form, so that tests and readers of the data can compare the two.
"""

import math
import string
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.metrics.definitions import metric_named
from fsar_ledger.metrics.verdicts import share_text
from fsar_ledger.report import specs
from fsar_ledger.report.judge import FAILS, OPEN, STANDS, UNDECIDED

NOTHING = "–"
MINUS = "\u2212"
GRADES = {"full": "\u25cf", "partial": "\u25cb", "none": "\u2014"}  # as in the paper: present, partial, absent
OUTCOMES = {STANDS: "comes out", FAILS: "does not", UNDECIDED: "undecided", OPEN: "open"}
MAX_ROWS, MAX_WORDS = 200, 400  # rows of a table, characters of a cell; what exceeds them is counted
SMALLEST_P = 0.0001  # smaller p are printed as "<.0001", as the paper does

Row = Mapping[str, Any]


class Cell(msgspec.Struct, frozen=True):
    """One cell: the value in stored units, its printed form, and its typographic tone."""

    value: Any
    printed: str
    tone: str = "plain"


class Table(msgspec.Struct, frozen=True):
    """One table ready for typesetting: headings and keys of columns, rows of cells, and the rows that begin a group."""

    name: str
    title: str
    caption: str
    source: str
    size: float
    heads: tuple[str, ...]
    keys: tuple[str, ...]
    aligns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    begins: tuple[int, ...]


def number(value: float, decimals: int) -> str:
    """Format the value with this many decimals, commas, a real minus sign, and never a negative zero."""
    return f"{value:z,.{decimals}f}".replace("-", MINUS)


def significant(value: float, digits: int) -> str:
    """Format the value with about this many significant digits, never in exponent form."""
    if value == 0:
        return "0"
    magnitude = math.floor(math.log10(abs(value))) + 1
    return number(value, max(0, digits - magnitude))


def integer(value: float) -> str:
    """Format the integer with a comma between thousands, as every command does, and a real minus sign."""
    return f"{int(value):,}".replace("-", MINUS)


def probability(value: float) -> str:
    """Format the p value with four decimals, or as less than the smallest printed one."""
    return "<.0001" if value < SMALLEST_P else number(value, 4)


def in_metric(name: str, value: float) -> str:
    """Format the value of a metric in its printed unit."""
    spec = metric_named(name)
    return number(value * spec.factor, spec.decimals)


def words(value: object, most: int = MAX_WORDS) -> str:
    """Return the text for a page, escaped, and cut after `most` characters."""
    text = str(value)
    cut = text if len(text) <= most else f"{text[:most]}... ({len(text) - most:,} more)"
    return printable.value(cut, len(cut))


def configuration(name: str) -> str:
    """Return a configuration's name as in the paper's table: "full", or the removed mechanism after a minus sign."""
    return f"{MINUS} {name.removeprefix('without-').replace('-', ' ')}" if name.startswith("without-") else name


Formatter = Callable[[Any, specs.Column, Row], str]

FORMATS: Mapping[str, Formatter] = {
    "text": lambda value, _column, _row: words(", ".join(value) if isinstance(value, list) else value),
    "code": lambda value, _column, _row: words(value),
    "architecture": lambda value, _column, _row: words(value).upper(),
    "pair": lambda value, _column, _row: " vs ".join(words(value).upper().split("-")),
    "title": lambda value, _column, _row: metric_named(str(value)).title,
    "short": lambda value, _column, _row: metric_named(str(value)).short,
    "configuration": lambda value, _column, _row: configuration(words(value)),
    "spaced": lambda value, _column, _row: words(value).replace("-", " ").replace("_", " "),
    "number": lambda value, column, _row: number(value, column.digits),
    "significant": lambda value, column, _row: significant(value, column.digits + 1),
    "integer": lambda value, _column, _row: integer(value),
    "chance": lambda value, _column, _row: share_text(value),
    "probability": lambda value, _column, _row: probability(value),
    "own-metric": lambda value, column, _row: in_metric(column.key, value),
    "metric": lambda value, _column, row: in_metric(row["metric"], value),
    "signed": lambda value, column, row: signed(row.get("metric", column.key), value),
    "interval": lambda value, _column, row: " to ".join(in_metric(row["metric"], end) for end in value),
    "span": lambda value, column, _row: " to ".join(number(end, column.digits) for end in value),
    "counted": lambda value, _column, row: _counted(value, row["metric"]),
    "grade": lambda value, _column, _row: GRADES[value],
    "yes": lambda value, _column, _row: "yes" if value else "no",
    "outcome": lambda value, _column, _row: OUTCOMES[value],
}


def _counted(value: float, name: str) -> str:
    counted = metric_named(name).counted
    return f"{integer(value)} {counted.removesuffix('s') if value == 1 else counted}"


def signed(metric: str, value: float) -> str:
    """Format a difference in the metric's printed unit, with its sign."""
    printed = in_metric(metric, value)
    return printed if value <= 0 or not any(digit in "123456789" for digit in printed) else f"+{printed}"


def _tone(column: specs.Column, value: Any) -> str:
    if column.format == "code":
        return "code"
    if value is False or value in ("no", "does not") or str(value).startswith("differs"):
        return "strong"
    return "quiet" if value in ("undecided", "open", None) else "plain"


def cell(column: specs.Column, row: Row) -> Cell:
    """Return the cell of a row under a column; a missing value is a dash, which as a grade would mean absent.

    Raises: KeyError if the row lacks the column's key or the spec names an unknown format.
    """
    value = row[column.key]
    if value is None:
        return Cell(value=None, printed="n/a" if column.format == "grade" else NOTHING, tone="quiet")
    return Cell(value=value, printed=FORMATS[column.format](value, column, row), tone=_tone(column, value))


def table(spec: specs.Table, rows: Sequence[Row]) -> Table:
    """Return the table of this spec filled with these rows. Raises: KeyError, as `cell`."""
    columns = [
        column for column in spec.columns if not column.optional or any(row[column.key] is not None for row in rows)
    ]
    filled, begins = [], []
    previous: Row = {}
    for position, row in enumerate(rows[:MAX_ROWS]):
        cells = []
        for column in columns:
            cell_here = cell(column, row)
            repeats = column.group and previous.get(column.key) == row[column.key]
            if column.group and not repeats and position and position not in begins:
                begins.append(position)
            cells.append(msgspec.structs.replace(cell_here, printed="") if repeats else cell_here)
        filled.append(tuple(cells))
        previous = row
    more = f"{len(rows) - MAX_ROWS:,} more rows are not shown" if len(rows) > MAX_ROWS else ""
    return Table(
        name=spec.name,
        title=spec.title,
        caption=spec.caption,
        source="; ".join(filter(None, (f"queries/{spec.query}.sql" if spec.query else "", more))),
        size=spec.size,
        heads=tuple(column.head for column in columns),
        keys=tuple(column.key for column in columns),
        aligns=tuple(column.align for column in columns),
        rows=tuple(filled),
        begins=tuple(begins),
    )


class _Sentences(string.Formatter):
    """Fills markup with values: texts escaped, lists as "a, b and c", numbers as in the tables.

    A format is one of `FORMATS`, or one of Python's for numbers; `many|one` adds the word that fits the number;
    `markup` is for texts of `reports/`, which are ours.
    """

    def format_field(self, value: Any, spec: str) -> str:
        if isinstance(value, list | tuple):
            return printable.every([self.format_field(item, spec) for item in value], "none")
        if "|" in spec:
            plural, singular = spec.split("|")
            return f"{_plain(value)} {singular if value == 1 else plural}"
        if spec == "markup":
            return str(value)
        if spec == "raw":  # between backticks, where nothing is escaped
            return words(value).replace("`", "'")
        if spec == "lower":
            return markup(metric_named(value).title.partition(" (")[0].lower())
        if spec in FORMATS:
            return markup(FORMATS[spec](value, specs.Column("", ""), {}))
        if isinstance(value, int | float) and not isinstance(value, bool):
            return number(value, int(spec[1:-1])) if spec else _plain(value)
        return markup(words(value))


def sentence(template: str, row: Row) -> str:
    """Return the markup filled with the values of the row. Raises: KeyError for a name that is no column."""
    return _Sentences().format(template, **row)


def markup(text: str) -> str:
    """Return the text as Typst markup for exactly this text: ASCII punctuation is escaped."""
    return "".join(
        f"\\{character}"
        if character.isascii() and character.isprintable() and not character.isalnum() and character != " "
        else character
        for character in text
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
    """Format a constant: integers in groups of three, other numbers with all their digits."""
    if isinstance(value, int) and not isinstance(value, bool):
        return integer(value)
    return printable.number(value).replace("-", MINUS) if isinstance(value, float) else str(value)
