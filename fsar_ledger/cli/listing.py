"""The packaged queries as a list: by group for people, flat for programs. Nothing here prints."""

from collections.abc import Iterator
from itertools import groupby

from fsar_ledger import printable
from fsar_ledger.api.fields import Row, csv_text
from fsar_ledger.metrics.groups import GROUPS, group_of, is_event_view, listed
from fsar_ledger.metrics.library import Query, library
from fsar_ledger.printable import Shown

from .output import json_rows, json_text
from .streaming import Form
from .tables import table

COLUMNS = ("group", "name", "title", "parameters")


def queries_text(form: Form, *, events: bool) -> Shown:
    """Return the packaged queries with titles and parameters; with `events`, also the views of the events."""
    found = listed(events=events)
    rows = [_row(query) for query in found]
    if form.as_json:
        return json_text(None, {"queries": rows})
    if form.as_ndjson:
        return json_rows(rows)
    if form.as_csv:
        return csv_text(rows, COLUMNS, raw=form.raw)
    return printable.joined(*_by_group(found, wide=form.wide), _end(events=events))


def _row(query: Query) -> Row:
    parameters = " ".join(map(str, query.parameters.values()))
    return {"group": group_of(query), "name": query.name, "title": query.header["Title"], "parameters": parameters}


def _by_group(found: list[Query], *, wide: bool) -> Iterator[Shown]:
    for group, queries in groupby(found, key=group_of):
        rows = [_row(query) for query in queries]
        short = [{**row, "title": str(row["title"]).partition(". ")[0]} for row in rows]
        has_parameters = any(row["parameters"] for row in rows)
        yield printable.line(f"{group}: {GROUPS[group]}" if group in GROUPS else group)
        yield printable.line("")
        yield table(short, COLUMNS[1:] if has_parameters else COLUMNS[1:-1], wide=wide)
        yield printable.line("")


def _end(*, events: bool) -> Shown:
    hidden = sum(map(is_event_view, library().queries.values()))
    return printable.lines(
        *([] if events else [f"{hidden} views of events are not listed; --all lists them, too"]),
        "`fsar-ledger query NAME --show` prints the SQL of one, and what its rows and its NULLs mean",
    )
