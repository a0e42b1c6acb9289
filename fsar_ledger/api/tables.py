"""Tables for people: fitted to a terminal, plain everywhere else. Nothing here prints.

A row is a mapping from column to value; all rows of an answer have the same columns. NULL is `-`, and a list JSON text.
On a terminal a column that is the same in every row of the answer is stated once above, runs are shown by their
numbers, or their ids lose the parts that they share, long cells continue on further lines after a mark, and columns
that do not fit are named below. A single row that does not fit is shown as a list. With `--wide`, or if the output is
not a terminal, a table is plain (`table_text`). Cells are escaped (`printable`) before they are measured.
"""

import re
import shlex
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

from fsar_ledger.base import printable
from fsar_ledger.base.printable import SafeText, columns_of

from .answers import Row
from .texts import field_text

if TYPE_CHECKING:
    import pyarrow as pa

GAP = 2
"""Columns of the terminal between two columns of a table."""
MARK = "|"
"""The beginning of a line that continues the row above, so that it does not begin with text from a ledger."""
NAMED_ITEMS, LONGEST_LIST = 3, 48
"""The number of items that a cell names of a list that is longer than the second, in characters."""
LEAST, LONGEST_WORD = 12, 20
"""The least width of a column of text, or its longest word up to the second, in characters."""
SHORT, LONGEST_NAME = 9, 16
"""The longest name of a column, and name in a cell, that stays on one line, in characters."""
TALLEST = 8
"""The most lines of a cell; of a longer one the beginning is shown."""
NAMED_EMPTY = 12
"""The number of columns without a value that are named."""
_BREAKS = re.compile(r"[^ /._,:;=-]*(?: +|[/._,:;=-]+|$)")
_PARTED = re.compile(r"[\s,;:'\"]|^$")
_RUNS = ("run_id", "first_run")

Numbers = Callable[[], Mapping[str, int]]
"""Returns the number of each numbered run by name."""


class Column(NamedTuple):
    """A column as text: its name, its cells, whether they are numbers, and the widths that it can take."""

    name: str
    cells: list[str]
    is_number: bool

    @property
    def natural(self) -> int:
        """Return the width that holds the name and every cell on one line."""
        return max(map(_width, (self.name, *self.cells)))

    @property
    def least(self) -> int:
        """Return the least readable width: a number stays whole, text has some room."""
        cells = max(map(_width, self.cells))
        word = max(_width(piece) for cell in self.cells for piece in _pieces(cell, LONGEST_NAME))
        text = min(cells, max(LEAST, min(word, LONGEST_WORD)))
        name = max(
            _width(piece) for piece in ([self.name] if _width(self.name) <= SHORT else _BREAKS.findall(self.name))
        )
        return max(cells if self.is_number else text, name)


def table_text(rows: Sequence[Row], columns: Sequence[str]) -> SafeText:
    """Align the rows under their columns, numbers to the right."""
    if not columns:
        return SafeText("")
    names = [printable.cell(column) for column in columns]
    cells = [[_cell_text(row[column]) for column in columns] for row in rows]
    is_number = [all(isinstance(row[column], int | float | None) for row in rows) for column in columns]
    widths = [max(map(len, texts)) for texts in zip(names, *cells, strict=True)]

    def line_of(texts: Sequence[str]) -> str:
        return "  ".join(
            text.rjust(width) if right else text.ljust(width)
            for text, width, right in zip(texts, widths, is_number, strict=True)
        ).rstrip()

    lines = [line_of(names), line_of(["-" * width for width in widths]), *map(line_of, cells)]
    return SafeText("\n".join([*lines, *([] if rows else ["(no rows)"]), ""]))


def more_text(count: int) -> SafeText:
    """Return the line that counts the rows that are not shown."""
    return printable.line(f"... {count:,} more rows; --limit 0 shows all, --csv and --json always do")


def fitted(
    rows: Sequence[Row],
    columns: Sequence[str],
    width: int | None,
    numbers: Numbers = dict,
    constant: Collection[str] | None = None,
) -> SafeText:
    """Return the rows as a table that is no wider than a terminal of this width; None: a plain table.

    A fitted table names runs by their `numbers`, unless it has a column of these itself. If the answer has more rows
    than these, `constant` are the columns that are the same in all of them.
    """
    if width is None or not rows or not columns:
        return table_text(rows, columns)
    values = [[row[name] for row in rows] for name in columns]
    same = [
        all(cell == cells[0] for cell in cells) and (constant is None or name in constant)
        for name, cells in zip(columns, values, strict=True)
    ]
    number_lines = _numbered(columns, values, numbers() if set(columns) & set(_RUNS) else {})
    laid = [_column(name, cells) for name, cells in zip(columns, values, strict=True)]
    if len(rows) == 1 and _total([column.natural for column in laid]) > width:
        return printable.joined(_listed(laid), *map(printable.line, number_lines))
    above, differing = _said_once(laid, same) if len(rows) > 1 else ([], laid)
    above += number_lines
    widths = _widths(differing, width)
    left_out = [_quoted(column.name) for column in differing[len(widths) :]]
    below = [f"not shown: {_first_names(left_out)}; --wide shows all"] if left_out else []
    lines = printable.lines(*above, *([""] if above else []))
    return printable.joined(lines, _laid_out(differing, widths), *map(printable.line, below))


def _numbered(columns: Sequence[str], values: list[list[object]], numbers: Mapping[str, int]) -> list[str]:
    """Replace the names of runs by numbers, and return lines that say what one of them stands for.

    A column stays as it is if another text in it could be taken for a number, or another column has the numbers.
    """
    lines = []
    for index, name in enumerate(columns):
        if name not in _RUNS:
            continue
        mapped = [numbers.get(value) if isinstance(value, str) else None for value in values[index]]
        mixed = [value if number is None else number for value, number in zip(values[index], mapped, strict=True)]
        is_doubtful = any(number is None and str(cell).isdecimal() for cell, number in zip(mixed, mapped, strict=True))
        if not any(mapped) or is_doubtful or any(mapped == cells for cells in values):
            continue
        number, run = next((number, value) for number, value in zip(mapped, values[index], strict=True) if number)
        lines.append(f"{name} {number} is {_quoted(printable.cell(str(run)))}; --wide shows the names")
        values[index] = mixed
    return lines


def _column(name: str, values: Sequence[object]) -> Column:
    is_number = all(isinstance(value, int | float | None) for value in values)
    cells = [_items(value) if isinstance(value, list | tuple) else _cell_text(value) for value in values]
    return Column(printable.cell(name), cells, is_number)


def _items(values: Sequence[object]) -> str:
    """Return the items of a list, or the first few and how many more there are."""
    items = [_quoted(_cell_text(value)) if "," in _cell_text(value) else _cell_text(value) for value in values]
    whole = ", ".join(items) or "none"
    if len(whole) <= LONGEST_LIST or len(items) <= NAMED_ITEMS:
        return whole if len(whole) <= printable.MAX_VALUE else f"{whole[: printable.MAX_VALUE]}..."
    return f"{', '.join(items[:NAMED_ITEMS])} and {len(items) - NAMED_ITEMS:,} more"


def _quoted(text: str) -> str:
    """Return the text as one word, so that none can look like two."""
    return shlex.quote(text) if _PARTED.search(text) else text


def _said_once(columns: Sequence[Column], is_same: Sequence[bool]) -> tuple[list[str], list[Column]]:
    """Return lines on what is the same in every row, and the columns that differ, at least one."""
    is_constant = [False, *is_same[1:]] if all(is_same) else is_same
    same = [column for column, constant in zip(columns, is_constant, strict=True) if constant]
    differing = [column for column, constant in zip(columns, is_constant, strict=True) if not constant]
    valued = [f"{_quoted(column.name)} {_quoted(column.cells[0])}" for column in same if column.cells[0] != "-"]
    empty = [_quoted(column.name) for column in same if column.cells[0] == "-"]
    lines = [f"in every row: {', '.join(valued)}"] if valued else []
    lines += [f"NULL in every row: {_first_names(empty)}"] if empty else []
    for index, column in enumerate(differing):
        others = [other for other in columns if other.name != column.name]
        if column.name in _RUNS and (short := _shortened(column.cells, others)) is not None:
            pattern, cells = short
            differing[index] = column._replace(cells=cells)
            lines.append(f"{column.name} {_quoted(pattern)}: rows show what stands for each *")
    return lines, differing


def _first_names(names: Sequence[str]) -> str:
    more = len(names) - NAMED_EMPTY
    return ", ".join(names[:NAMED_EMPTY]) + (f" and {printable.counted(more, 'other column')}" if more > 0 else "")


def _shortened(runs: Sequence[str], columns: Sequence[Column]) -> tuple[str, list[str]] | None:
    """Return a pattern for the names of these runs, and for each name the text that the * stands for.

    The pattern has the parts that all names share, and the name of a column for a part that this column gives. None if
    there is only one name, if the names differ in their number of parts, or if each part would be a *.
    """
    split = [run.split(".") for run in runs]
    if len(set(runs)) == 1 or len({len(parts) for parts in split}) > 1:
        return None
    pattern = [_part(texts, columns) for texts in zip(*split, strict=True)]
    cells = [" ".join(part for part, symbol in zip(parts, pattern, strict=True) if symbol == "*") for parts in split]
    fixed = [[part for part, symbol in zip(parts, pattern, strict=True) if symbol != "*"] for parts in split]
    distinct = {(cell, *parts) for cell, parts in zip(cells, fixed, strict=True)}
    return (".".join(pattern), cells) if any(fixed) and len(distinct) == len(set(runs)) else None


def _part(texts: Sequence[str], columns: Sequence[Column]) -> str:
    """Return the text if all are the same, else the column that gives them, else *."""
    if len(set(texts)) == 1:
        return texts[0]
    return next((f"<{column.name}>" for column in columns if column.cells == [*texts]), "*")


def _widths(columns: Sequence[Column], width: int) -> list[int]:
    """Return the widths of as many of the columns as there is room for, from the left.

    All have their natural widths if these fit. Else names wrap first, and then the widest columns of text.
    """
    natural = [column.natural for column in columns]
    if _total(natural) <= width:
        return natural
    room = width - len(MARK) - 1
    least = [min(column.least, room) for column in columns]
    while len(least) > 1 and _total(least) > room:
        least.pop()
    cells = [max(column.least, *map(_width, column.cells)) for column in columns[: len(least)]]
    most = max(cells)
    while most > 1 and _total([_narrowed(cell, low, most) for cell, low in zip(cells, least, strict=True)]) > room:
        most -= 1
    widths = [_narrowed(cell, low, most) for cell, low in zip(cells, least, strict=True)]
    for index, column in enumerate(columns[: len(widths)]):  # what is left goes to names, from the left
        widths[index] += max(0, min(column.natural - widths[index], room - _total(widths)))
    return widths


def _narrowed(cell: int, low: int, most: int) -> int:
    return max(low, min(cell, most))


def _total(widths: Sequence[int]) -> int:
    return sum(widths) + GAP * (len(widths) - 1)


def _laid_out(columns: Sequence[Column], widths: Sequence[int]) -> SafeText:
    """Return the columns as lines; those that continue a row begin with the mark."""
    chosen = list(zip(columns, widths, strict=False))
    head = [_broken(column.name, wide) for column, wide in chosen]
    rule = [["-" * wide] for _, wide in chosen]
    body = [[_cut(_broken(column.cells[row], wide)) for column, wide in chosen] for row in range(len(columns[0].cells))]
    lines = []
    for row in (head, rule, *body):
        for cell_line in range(max(map(len, row))):
            cells = (_padded(cell[cell_line : cell_line + 1], *slot) for cell, slot in zip(row, chosen, strict=True))
            lines.append((MARK if cell_line else " ", (" " * GAP).join(cells).rstrip(" ")))
    is_marked = any(mark == MARK for mark, _ in lines)
    return SafeText("".join(f"{mark} {line}\n" if is_marked else f"{line}\n" for mark, line in lines))


def _padded(lines: Sequence[str], column: Column, width: int) -> str:
    """Return the line of a cell, or none, as wide as its column."""
    text = "".join(lines)
    blanks = " " * (width - _width(text))
    return blanks + text if column.is_number else text + blanks


def _listed(columns: Sequence[Column]) -> SafeText:
    widest = max(_width(column.name) for column in columns)
    return printable.lines(
        *(f"{column.name}{' ' * (widest - _width(column.name))}  {column.cells[0]}" for column in columns)
    )


def _pieces(text: str, most: int) -> list[str]:
    """Return the pieces between which the text may be broken; a name of at most `most` characters is one."""
    return [text] if len(text) <= most and " " not in text else _BREAKS.findall(text)


def _cut(lines: list[str]) -> list[str]:
    return lines if len(lines) <= TALLEST else [*lines[: TALLEST - 1], "..."]


def _broken(text: str, width: int) -> list[str]:
    """Break the text into lines of at most this width, after blanks and punctuation if there are any."""
    lines, line = [], ""
    for piece in _BREAKS.findall(text):
        if _width(line + piece.rstrip(" ")) <= width:
            line += piece
            continue
        if line:
            lines.append(line.rstrip(" "))
        line = ""
        for character in piece:
            if _width(line + character) > width:
                lines.append(line)
                line = ""
            line += character
    return [*lines, line.rstrip(" ")]


def _width(text: str) -> int:
    return len(text) if text.isascii() else sum(map(columns_of, text))


def _cell_text(value: object) -> str:
    if isinstance(value, str):
        return printable.cell(value)
    if value is None:
        return "-"
    if isinstance(value, float):
        return printable.number(value)
    text = field_text(value, raw=False)
    return (
        text
        if len(text) <= printable.MAX_VALUE
        else f"{text[: printable.MAX_VALUE]}... ({len(text) - printable.MAX_VALUE:,} more)"
    )


class Constant:
    """The columns with one value in every row seen so far, shown or not."""

    def __init__(self, names: Iterable[str]):
        self.names = set(names)
        self._last: pa.RecordBatch | None = None

    def see(self, batch: "pa.RecordBatch") -> None:
        """Drop the columns that differ in these rows, or from earlier ones."""
        if not len(batch):
            return
        previous = batch if self._last is None else self._last
        self._last = batch.slice(len(batch) - 1)
        for name in sorted(self.names):
            column, last = batch[name], previous[name].slice(len(previous) - 1)
            is_same = column.slice(1).equals(column.slice(0, len(column) - 1))
            if not (is_same and column.slice(len(column) - 1).equals(last)):
                self.names.discard(name)
