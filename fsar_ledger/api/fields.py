"""Rows as comma-separated values. Text from a ledger is escaped as it becomes a field (`printable`), unless raw."""

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import msgspec

from fsar_ledger import printable
from fsar_ledger.errors import QueryFailed
from fsar_ledger.printable import SafeText

Row = Mapping[str, object]


def csv_text(rows: Sequence[Row], columns: Sequence[str], *, raw: bool = False) -> SafeText:
    """Return the rows as comma-separated values under one line of column names.

    Text is harmless for terminals and spreadsheets unless `raw`.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    quoting = csv.writer(text, lineterminator="\n", quoting=csv.QUOTE_ALL)
    for values in (columns, *([row[column] for column in columns] for row in rows)):
        fields = [field_text(value, raw=raw) for value in values]
        # A bare CR ends a row for some readers.
        (quoting if any("\r" in field for field in fields) else writer).writerow(fields)
    return SafeText(text.getvalue())


@contextmanager
def as_python() -> Iterator[None]:
    """Say what to do about a value of Arrow that Python cannot hold. Raises: QueryFailed for a date or time."""
    try:
        yield
    except (OverflowError, ValueError) as error:
        raise QueryFailed(
            "the answer: found a date or time that Python cannot hold, expected years 1 to 9999 and whole "
            "microseconds; make it text, as in CAST(... AS VARCHAR), or take it in Python with arrow()"
        ) from error


def plain(rows: Sequence[msgspec.Struct]) -> list[Row]:
    """Return typed rows as mappings."""
    return [msgspec.structs.asdict(row) for row in rows]


def json_bytes(document: object) -> bytes:
    """Return the document as JSON; bytes of file names that are not UTF-8 are escaped, `\\udcff` for ff."""
    try:
        return msgspec.json.encode(document)
    except UnicodeEncodeError:  # rare, and to look for it in every value takes most of the time
        return msgspec.json.encode(encodable(document))


def encodable(value: object) -> object:
    """Return the value with those bytes of file names escaped that are not UTF-8: `\\udcff` for ff."""
    if isinstance(value, str):
        return value if value.isascii() else value.encode("utf-8", "backslashreplace").decode()
    if isinstance(value, dict):
        return {encodable(name): encodable(one) for name, one in value.items()}
    return [encodable(one) for one in value] if isinstance(value, list | tuple) else value


def field_text(value: object, *, raw: bool) -> str:
    """Return the value as a field of CSV."""
    if isinstance(value, str):
        return value if raw else printable.field(value)
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list | tuple | dict):
        text = json_bytes(value).decode()
        return text if raw else printable.ascii_json(text)
    return repr(value) if isinstance(value, float) else str(value)


def json_rows(rows: Sequence[Row]) -> SafeText:
    """Return a JSON object for each row, one a line, in ASCII."""
    return printable.ascii_json("".join(f"{json_bytes(row).decode()}\n" for row in rows))
