"""Rows as comma-separated values, a value at a time: what text that is made a column at a time is held against."""

import csv
import io
from collections.abc import Sequence

from fsar_ledger.api.answers import Row
from fsar_ledger.api.texts import field_text


def csv_text(rows: Sequence[Row], columns: Sequence[str], *, raw: bool = False) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    quoting = csv.writer(text, lineterminator="\n", quoting=csv.QUOTE_ALL)
    for values in (columns, *([row[column] for column in columns] for row in rows)):
        fields = [field_text(value, raw=raw) for value in values]
        (quoting if any("\r" in field for field in fields) else writer).writerow(fields)
    return text.getvalue()
