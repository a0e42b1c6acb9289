"""Answers as text: a table for people, JSON and CSV for programs. Nothing here prints.

A row is a mapping from column to value; all rows of an answer have the same columns. NULL is `-` in a table, `null` in
JSON and an empty field in CSV. Lists are JSON text in CSV and in tables. Text from a ledger is escaped when it becomes
a cell, a field or a line (`printable`), so whatever these functions return is safe to show.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Protocol

import msgspec
from msgspec import to_builtins

from fsar_ledger import printable
from fsar_ledger.api.fields import Row, field_text, json_bytes
from fsar_ledger.errors import UsageError
from fsar_ledger.printable import Shown

if TYPE_CHECKING:
    from fsar_ledger.api.provenance import Provenance


class HeadLike(Protocol):
    """The tree head that an answer holds for: the number of events and the root hash in hex."""

    @property
    def size(self) -> int: ...  # noqa: D102
    @property
    def root(self) -> str: ...  # noqa: D102


def table_text(rows: Sequence[Row], columns: Sequence[str], limit: int = 0) -> Shown:
    """Align the rows under their columns, numbers to the right; count the rows beyond `limit` (0: show all)."""
    if not columns:
        return Shown("")
    shown = rows[:limit] if limit else rows
    names = [printable.cell(column) for column in columns]
    cells = [[cell_text(row[column]) for column in columns] for row in shown]
    is_number = [all(isinstance(row[column], int | float | None) for row in shown) for column in columns]
    widths = [
        max(len(name), *(len(line[at]) for line in cells)) if cells else len(name) for at, name in enumerate(names)
    ]

    def line_of(texts: Sequence[str]) -> str:
        return "  ".join(
            text.rjust(width) if right else text.ljust(width)
            for text, width, right in zip(texts, widths, is_number, strict=True)
        ).rstrip()

    lines = [line_of(names), line_of(["-" * width for width in widths]), *map(line_of, cells)]
    rest = [more_text(len(rows) - len(shown))] if len(shown) < len(rows) else [] if rows else [Shown("(no rows)\n")]
    return printable.joined(Shown("\n".join(lines) + "\n"), *rest)


def more_text(count: int) -> Shown:
    """Return the line that counts the rows that are not shown."""
    return printable.line(f"... {count:,} more rows; --limit 0 shows all, --csv and --json always do")


def run_text(run: str, number: int | None) -> str:
    """Return the words that name a run: `run 12, NAME`; `run NAME` where it has no number."""
    return f"run {printable.value(run)}" if number is None else f"run {number}, {printable.value(run)}"


def run_word(run: str, number: int | None) -> str:
    """Return what names the run in a command that people may copy: its number, where it has one."""
    return printable.word(run if number is None else number)


def json_text(head: HeadLike | None, answer: Mapping[str, object], rows_verified: bool | None = None) -> Shown:
    """Return one JSON object: the head (size, root) that the answer holds for, or null, then the answer.

    For an answer from rows, `rows_verified` says whether they were compared with that root.
    """
    standing = {} if rows_verified is None else {"rows_verified": rows_verified}
    return pretty({"head": head and {"size": head.size, "root": head.root}, **standing, **answer})


def answer_json(provenance: "Provenance", answer: Mapping[str, object]) -> Shown:
    """Return one JSON object: what the answer holds for, then the answer."""
    return json_text(provenance.head, {**provenance.answer(), **answer}, provenance.rows_verified)


def check_form(*, as_json: bool, as_csv: bool, raw: bool, as_ndjson: bool = False) -> None:
    """Check the form of an answer. Raises: UsageError for two forms at once, or --raw without --csv."""
    asked = {"--json": as_json, "--csv": as_csv, "--ndjson": as_ndjson}
    if len(found := [option for option, is_asked in asked.items() if is_asked]) > 1:
        raise UsageError(f"found {' and '.join(found)}, expected one of them")
    if raw and not as_csv:
        raise UsageError(
            "found --raw without --csv, expected both or neither; --json always gives the values themselves"
        )


def pretty(document: object) -> Shown:
    """Return the document as JSON in ASCII; bytes of a file name that are not UTF-8 are escaped, `\\udcff` for ff."""
    return printable.ascii_json(msgspec.json.format(json_bytes(to_builtins(document)), indent=2).decode() + "\n")


def cell_text(value: object) -> str:
    """Return the value as a cell of a table."""
    if isinstance(value, str):
        return printable.cell(value)
    if value is None:
        return "-"
    if isinstance(value, float):
        return printable.number(value)
    shown = field_text(value, raw=False)
    return (
        shown
        if len(shown) <= printable.MAX_VALUE
        else f"{shown[: printable.MAX_VALUE]}... ({len(shown) - printable.MAX_VALUE:,} more)"
    )
