"""The packaged queries as a list: by group for people, flat for programs. Nothing here prints."""

from collections.abc import Iterator
from itertools import groupby

from fsar_ledger import printable
from fsar_ledger.api.fields import Row, csv_text, json_rows
from fsar_ledger.metrics.groups import GROUPS, group_of, is_event_view, listed
from fsar_ledger.metrics.library import Query, library
from fsar_ledger.printable import Shown

from .output import json_text
from .streaming import Form
from .tables import is_fitted, table

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
    row_of = _on_a_terminal if is_fitted(wide=wide) else _plain
    for group, queries in groupby(found, key=group_of):
        rows = [row_of(query) for query in queries]
        columns = [name for name in COLUMNS[1:] if name != "parameters" or any(row.get(name) for row in rows)]
        yield printable.line(f"{group}: {GROUPS[group]}" if group in GROUPS else group)
        yield printable.line("")
        yield table(rows, columns, wide=wide)
        yield printable.line("")


def _plain(query: Query) -> Row:
    return {**_row(query), "title": _title(query)}


def _on_a_terminal(query: Query) -> Row:
    """Return the last part of the name, which is enough, and the title with the names of the parameters."""
    parameters = f" ({', '.join(query.parameters)})" if query.parameters else ""
    return {"name": query.name.rpartition("/")[2], "title": f"{_title(query)}{parameters}"}


def _title(query: Query) -> str:
    return query.header["Title"].partition(". ")[0]


def _end(*, events: bool) -> Shown:
    hidden = sum(map(is_event_view, library().queries.values()))
    return printable.lines(
        *([] if events else [f"{hidden} views of events are not listed; --all lists them, too"]),
        "`fsar-ledger query NAME --show` prints the SQL of one, and what its rows and its NULLs mean",
    )
