"""Tables for people: fitted to a terminal, plain everywhere else. Nothing here prints.

On a terminal a column that is the same in every row is said once above, run ids lose the parts that they share, long
cells continue on further lines behind a mark, and columns for which there is no room are named below. A single row that
does not fit is shown as a list. With `--wide`, or where the output is no terminal, a table is `output.table_text`.

Cells are escaped (`printable`) before they are measured, and rich never reads them as markup.
"""

import re
import shlex
from collections.abc import Sequence
from typing import NamedTuple

from fsar_ledger import printable
from fsar_ledger.api.fields import Row
from fsar_ledger.printable import Shown

from .output import cell_text, more_text, table_text
from .terminal import aligned, columns_of, width_of_output

GAP = 2
"""Columns of the terminal between two columns of a table."""
MARK = "|"
"""What begins a line that continues the row above, so that it does not begin with text from a ledger."""
NAMED_ITEMS, LONGEST_LIST = 3, 48
"""The items of a list that a cell names if all of them take more characters than this."""
LEAST, LONGEST_WORD = 12, 20
"""Characters below which a column of text is not narrowed, or the longest word in it up to the second."""
NAMED_EMPTY = 12
"""How many columns without a value are named."""
_BREAKS = re.compile(r"[^ /._,:;=-]*(?: +|[/._,:;=-]+|$)")
_PARTED = re.compile(r"[\s,;:'\"]|^$")
_RUNS = ("run_id", "first_run")


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
        """Return the least width to read it at: a number stays whole, text has some room."""
        cells = max(map(_width, self.cells))
        word = max(_width(piece) for cell in self.cells for piece in _BREAKS.findall(cell))
        text = min(cells, max(LEAST, min(word, LONGEST_WORD)))
        return max(cells if self.is_number else text, *map(_width, _BREAKS.findall(self.name)))


def table(rows: Sequence[Row], columns: Sequence[str], limit: int = 0, *, wide: bool = False) -> Shown:
    """Return the rows as a table for where the output goes; count the rows beyond `limit` (0: show all)."""
    width = None if wide else width_of_output()
    return table_text(rows, columns, limit) if width is None else fitted(rows, columns, width, limit)


def fitted(rows: Sequence[Row], columns: Sequence[str], width: int, limit: int = 0) -> Shown:
    """Return the rows as a table that is no wider than a terminal of this width."""
    shown = rows[:limit] if limit else rows
    if not shown or not columns:
        return table_text(rows, columns, limit)
    found = [_column(name, [row[name] for row in shown]) for name in columns]
    rest = [more_text(len(rows) - len(shown))] if len(shown) < len(rows) else []
    if len(shown) == 1 and _total([column.natural for column in found]) > width:
        return printable.joined(_listed(found), *rest)
    above, telling = _said_once(found, "every row shown" if rest else "every row") if len(shown) > 1 else ([], found)
    widths = _widths(telling, width)
    left_out = [_quoted(column.name) for column in telling[len(widths) :]]
    below = [f"not shown: {_some(left_out)}; --wide shows all"] if left_out else []
    lines = printable.lines(*above, *([""] if above else []))
    return printable.joined(lines, _laid_out(telling, widths), *map(printable.line, below), *rest)


def _column(name: str, values: Sequence[object]) -> Column:
    is_number = all(isinstance(value, int | float | None) for value in values)
    cells = [_items(value) if isinstance(value, list | tuple) else cell_text(value) for value in values]
    return Column(printable.cell(name), cells, is_number)


def _items(values: Sequence[object]) -> str:
    """Return the items of a list, or the first few and how many more there are."""
    items = [_quoted(cell_text(value)) if "," in cell_text(value) else cell_text(value) for value in values]
    whole = ", ".join(items) or "none"
    if len(whole) <= LONGEST_LIST or len(items) <= NAMED_ITEMS:
        return whole if len(whole) <= printable.MAX_VALUE else f"{whole[: printable.MAX_VALUE]}..."
    return f"{', '.join(items[:NAMED_ITEMS])} and {len(items) - NAMED_ITEMS:,} more"


def _quoted(text: str) -> str:
    """Return the text as one word, so that none can look like two."""
    return shlex.quote(text) if _PARTED.search(text) else text


def _said_once(columns: Sequence[Column], where: str) -> tuple[list[str], list[Column]]:
    """Return lines on what is the same in every row, and the columns that differ; one at least."""
    same = [column for column in columns if len(set(column.cells)) == 1]
    differing = [column for column in columns if column not in same]
    if not differing:
        differing, same = [columns[0]], list(columns[1:])
    valued = [f"{_quoted(one.name)} {_quoted(one.cells[0])}" for one in same if one.cells[0] != "-"]
    empty = [_quoted(one.name) for one in same if one.cells[0] == "-"]
    lines = [f"in {where}: {', '.join(valued)}"] if valued else []
    lines += [f"NULL in {where}: {_some(empty)}"] if empty else []
    for place, column in enumerate(differing):
        if column.name in _RUNS and (short := _shortened(column.cells)) is not None:
            pattern, cells = short
            differing[place] = column._replace(cells=cells)
            lines.append(f"{column.name} {_quoted(pattern)}: rows show what stands for each *")
    return lines, differing


def _some(names: Sequence[str]) -> str:
    more = len(names) - NAMED_EMPTY
    return ", ".join(names[:NAMED_EMPTY]) + (f" and {printable.counted(more, 'other column')}" if more > 0 else "")


def _shortened(runs: Sequence[str]) -> tuple[str, list[str]] | None:
    """Return the parts that the names of these runs share, with * for the others, and of each name only the others.

    None if the names do not have equally many parts, or share none.
    """
    split = [run.split(".") for run in runs]
    if len({len(parts) for parts in split}) > 1:
        return None
    shared = [len(set(parts)) == 1 for parts in zip(*split, strict=True)]
    if not any(shared):
        return None
    pattern = ".".join(part if same else "*" for part, same in zip(split[0], shared, strict=True))
    cells = [" ".join(part for part, same in zip(parts, shared, strict=True) if not same) for parts in split]
    return (pattern, cells) if len(set(cells)) == len(set(runs)) else None


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
    found = [_narrowed(cell, low, most) for cell, low in zip(cells, least, strict=True)]
    for place, column in enumerate(columns[: len(found)]):  # what is left goes to names, from the left
        found[place] += max(0, min(column.natural - found[place], room - _total(found)))
    return found


def _narrowed(cell: int, low: int, most: int) -> int:
    return max(low, min(cell, most))


def _total(widths: Sequence[int]) -> int:
    return sum(widths) + GAP * (len(widths) - 1)


def _laid_out(columns: Sequence[Column], widths: Sequence[int]) -> Shown:
    """Return the columns as lines; those that continue a row begin with the mark."""
    chosen = list(zip(columns, widths, strict=False))
    head = [_broken(column.name, wide) for column, wide in chosen]
    rule = [["-" * wide] for _, wide in chosen]
    body = [[_broken(column.cells[row], wide) for column, wide in chosen] for row in range(len(columns[0].cells))]
    lines = aligned([head, rule, *body], widths, [column.is_number for column, _ in chosen], GAP)
    heights = [max(map(len, row)) for row in (head, rule, *body)]
    if max(heights) == 1:
        return Shown("".join(lines))
    marks = [mark for height in heights for mark in (" ", *MARK * (height - 1))]
    return Shown("".join(f"{mark} {line}" for mark, line in zip(marks, lines, strict=True)))


def _listed(columns: Sequence[Column]) -> Shown:
    """Return the only row as a list, a line for each column."""
    widest = max(_width(column.name) for column in columns)
    return printable.lines(
        *(f"{column.name}{' ' * (widest - _width(column.name))}  {column.cells[0]}" for column in columns)
    )


def _broken(text: str, width: int) -> list[str]:
    """Break the text into lines of at most this width, behind blanks and punctuation where there are any."""
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
