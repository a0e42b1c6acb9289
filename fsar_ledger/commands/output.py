"""Answers as text: a table for people, JSON and CSV for programs. Nothing here prints.

A row is a mapping from column to value; all rows of an answer have the same columns. NULL is `-` in a
table, `null` in JSON and an empty field in CSV. Lists are JSON text in CSV and in tables.
"""

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import msgspec
from msgspec import to_builtins

from fsar_ledger.errors import UsageError

from .terminal import escaped

if TYPE_CHECKING:
    from fsar_ledger.ledger.verify import VerifyReport

Row = Mapping[str, object]


class HeadLike(Protocol):
    """The tree head that an answer was given for: number of events and root hash, in hexadecimal."""

    @property
    def size(self) -> int: ...  # noqa: D102
    @property
    def root(self) -> str: ...  # noqa: D102


def table_text(rows: Sequence[Row], columns: Sequence[str], limit: int = 0) -> str:
    """The rows aligned under their columns, numbers to the right; after `limit` rows (0: all) the rest is only counted."""
    if not columns:
        return ""
    shown = rows[:limit] if limit else rows
    cells = [[_cell(row[column]) for column in columns] for row in shown]
    is_number = [all(isinstance(row[column], int | float | None) for row in shown) for column in columns]
    widths = [max(len(column), *(len(line[at]) for line in cells)) if cells else len(column) for at, column in enumerate(columns)]

    def line_of(texts: Sequence[str]) -> str:
        return "  ".join(text.rjust(width) if right else text.ljust(width) for text, width, right in zip(texts, widths, is_number, strict=True)).rstrip()

    lines = [line_of(columns), line_of(["-" * width for width in widths]), *map(line_of, cells)]
    return "\n".join(lines) + "\n" + (more_text(len(rows) - len(shown)) if len(shown) < len(rows) else "")


def more_text(count: int) -> str:
    """The line that says how many rows are not shown."""
    return f"... {count:,} more rows; --limit 0 shows all, --csv and --json always do\n"


def json_text(head: HeadLike | None, answer: Mapping[str, object], rows_verified: bool | None = None) -> str:
    """One JSON object: the head (size, root) that the answer holds for, null where there is none to speak of, then the answer.

    Of an answer from rows, `rows_verified` says whether they were compared with that root.
    """
    standing = {} if rows_verified is None else {"rows_verified": rows_verified}
    return _pretty({"head": head and {"size": head.size, "root": head.root}, **standing, **answer})


def csv_text(rows: Sequence[Row], columns: Sequence[str]) -> str:
    """The rows as comma-separated values under one line of column names."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_field(row[column]) for column in columns] for row in rows)
    return text.getvalue()


def verdict_text(ledger: Path, report: "VerifyReport") -> str:
    """What `verify` found, for people: one line for each problem, or that there is none and what that covers."""
    if not report.ok:
        count = f"{len(report.problems)} problem{'' if len(report.problems) == 1 else 's'}{' at a quick look' if report.is_quick else ''}"
        return "\n".join([*map(str, report.problems), f"{ledger}: {count}; do not rely on this ledger, restore it from a copy that verifies"])
    counts = f"{report.events:,} events{'' if report.is_quick else f' of {report.runs:,} runs'} in {report.commits:,} commits"
    looked = "consistent at a quick look, which reads no rows" if report.is_quick else "consistent"
    lines = [f"{ledger}: {looked}, {signature_text(report.signature, report.signer)}: {counts}", f"root {report.root}"]
    lines += [f"signed commits: {report.signed:,} of {report.commits:,}"] if report.signed else []
    lines += (
        [f"only grew since the anchor's {report.anchored:,} events"] if report.anchored is not None and not report.is_quick else []
    )  # there a remark says it
    return "\n".join([*lines, *report.remarks, ""])


def signature_text(state: str, signer: str | None) -> str:
    """What the signature of a note is worth, for people: `signer` is the trusted key that made it, or whom the note names."""
    if state == "signed":
        return f"signed by {signer}"
    return "unsigned" if signer is None else f"signed, signer not checked (it names {signer})"


def verdict_json(report: "VerifyReport") -> str:
    """What `verify` found, for programs: the head is the one that the rows themselves give, its root null where some cannot be read."""
    document = {"head": {"size": report.events, "root": report.root}, **to_builtins(report)}
    return _pretty(document)


def plain(rows: Sequence[msgspec.Struct]) -> list[Row]:
    """The typed rows as mappings."""
    return [msgspec.structs.asdict(row) for row in rows]


def answer_text(
    head: HeadLike | None, rows: Sequence[Row], columns: Sequence[str] = (), *, rows_verified: bool | None, as_json: bool, as_csv: bool, limit: int = 0
) -> str:
    """The rows as a table for people, or as what --json or --csv asks for. Raises: UsageError when both are asked for."""
    if as_json and as_csv:
        raise UsageError("found --json and --csv, expected one of them")
    names = columns or (list(rows[0]) if rows else ())
    if as_json:
        return json_text(head, {"rows": rows}, rows_verified)
    return csv_text(rows, names) if as_csv else table_text(rows, names, limit) or "no rows\n"


def queries_text(*, as_json: bool, as_csv: bool) -> str:
    """Every packaged query with its title and parameters."""
    from fsar_ledger.metrics.library import library

    columns = ("name", "title", "parameters")
    rows: list[Row] = [
        {"name": query.name, "title": query.header["Title"], "parameters": " ".join(f"{name}={value or ''}" for name, value in query.parameters.items())}
        for query in library().queries.values()
    ]
    if as_json:
        return json_text(None, {"queries": rows})
    return csv_text(rows, columns) if as_csv else table_text([{**row, "title": str(row["title"]).partition(". ")[0]} for row in rows], columns)


def _pretty(document: object) -> str:
    """The document as JSON; a name of a file that is not UTF-8 has each such byte escaped, `\\udcff` for ff."""
    return msgspec.json.format(msgspec.json.encode(_encodable(to_builtins(document))), indent=2).decode() + "\n"


def _encodable(value: object) -> object:
    if isinstance(value, str):
        return escaped(value)
    if isinstance(value, dict):
        return {_encodable(name): _encodable(one) for name, one in value.items()}
    return [_encodable(one) for one in value] if isinstance(value, list | tuple) else value


def _cell(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:.6g}"
    return _field(value)


def _field(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list | tuple | dict):
        return msgspec.json.encode(value).decode()
    return repr(value) if isinstance(value, float) else str(value)
