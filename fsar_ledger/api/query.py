"""The verbs `query` and `sql`: a packaged query, or a SELECT of your own."""

import sys
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from itertools import groupby
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from fsar_ledger.base import printable
from fsar_ledger.base.errors import QueryFailed, UsageError, option
from fsar_ledger.base.printable import SafeText

from .answers import Answer, Plain, Screen
from .names import Place
from .verbs import STREAM, ParameterOption, argument, declare, switch, verb

if TYPE_CHECKING:
    from fsar_ledger.metrics.library import Query
    from fsar_ledger.metrics.sandbox import Limits

    from .ledger import Ledger
    from .table import Rows, Table


MEMORY_MIB_MIN = 1024
SECONDS_MAX = 365 * 86_400


class Queries(Answer):
    """The packaged queries; with `events` also the views of the events."""

    def __init__(self, *, events: bool) -> None:
        from fsar_ledger.metrics.own_sql import listed

        self._events, self._found = events, listed(events=events)

    def document(self, _: Screen) -> Mapping[str, object]:
        """Return a row for each query."""
        return {"head": None, "queries": list(map(_row, self._found))}

    def table(self) -> "Table":
        """Return a row for each query."""
        import pyarrow as pa

        from .table import Table

        return Table(pa.Table.from_pylist(list(map(_row, self._found))))

    def text(self, screen: Screen) -> Iterator[SafeText]:
        """Yield a table for each group, and the commands to run next."""
        from fsar_ledger.metrics.library import library
        from fsar_ledger.metrics.own_sql import GROUPS, group_of, is_event_view

        row_of = _on_a_terminal if screen.is_fitted else _plain
        for group, queries in groupby(self._found, key=group_of):
            rows = list(map(row_of, queries))
            has_parameters = any(row.get("parameters") for row in rows)
            columns = ["name", "title", *(["parameters"] if has_parameters else [])]
            yield printable.lines(f"{group}: {GROUPS[group]}" if group in GROUPS else group, "")
            yield screen.table(rows, columns)
            yield printable.line("")
        hidden = sum(map(is_event_view, library().queries.values()))
        yield printable.lines(
            *([] if self._events else [f"{hidden} views of events are not listed; --all lists them, too"]),
            "`fsar-ledger query NAME --show` prints the SQL of one, and what its rows and its NULLs mean",
        )


def _row(query: "Query") -> dict[str, str]:
    from fsar_ledger.metrics.own_sql import group_of

    parameters = " ".join(map(str, query.parameters.values()))
    return {"group": group_of(query), "name": query.name, "title": query.header["Title"], "parameters": parameters}


def _plain(query: "Query") -> dict[str, str]:
    return {**_row(query), "title": _title(query)}


def _on_a_terminal(query: "Query") -> dict[str, str]:
    """Return the last part of the name, which is enough, and the title with the names of the parameters."""
    parameters = f" ({', '.join(query.parameters)})" if query.parameters else ""
    return {"name": query.name.rpartition("/")[2], "title": f"{_title(query)}{parameters}"}


def _title(query: "Query") -> str:
    return query.header["Title"].partition(". ")[0]


def _arrange(values: dict[str, Any]) -> None:
    """With --file the first argument is the ledger. Raises: UsageError if the arguments contradict each other."""
    name, ledger, file, parameters = (values[key] for key in ("name", "ledger", "file", "parameters"))
    if values["all"] and not values["list"]:
        raise UsageError("found --all without --list, expected both or neither")
    if values["list"]:
        return
    if values["show"]:
        if name is None:
            raise UsageError("query --show: expected NAME, as in `fsar-ledger query failures --show`")
        return
    if file is None:
        if (seconds := values["seconds"]) is not None:
            raise UsageError(f"--seconds {seconds}: expected only with --file; a packaged query has no time limit")
        if name is None or ledger is None:
            raise UsageError(
                "query: expected NAME and LEDGER, as in `fsar-ledger query failures out/ledger`; `fsar-ledger query "
                "--list` shows the names"
            )
        return
    if parameters:
        raise UsageError(
            f"--param {next(iter(parameters))}=... and --file {file}: only a packaged query has parameters; write the "
            "value into the file"
        )
    if name is None or ledger is not None:
        raise UsageError(
            f"query --file {file}: expected one argument, LEDGER, as in `fsar-ledger query --file "
            f"{printable.word(file)} out/ledger`"
        )
    values["ledger"] = Path(name)


@verb(
    "query --list",
    "query policy_at --show",
    "query metrics/policy_violations out/ledger --csv",
    "query failures out/ledger --limit 20",
    "query --file question.sql out/ledger --seconds 10",
    takes=STREAM,
    arrange=_arrange,
    is_apart=lambda given: given["file"] is not None,
)
def query(
    name: str | None = argument("NAME", "A name of `query --list`; its last part is enough.", complete="queries"),
    ledger: "Ledger | Place | None" = argument("LEDGER", "The folder of a ledger."),
    parameters: ParameterOption = None,
    *,
    file: Place | None = declare("FILE", "Answer the SELECT in this file instead of NAME; `-` reads standard input."),
    list: bool = switch("List the queries by group, with titles and parameters."),
    all: bool = switch("With --list: also the view of each event type and of each concern."),
    show: bool = switch("Print the SQL of NAME, with the header that says what its rows mean."),
    seconds: int | None = declare("N", "The time limit for a SELECT of your own.", "60"),
    memory_mib: int | None = declare(
        "MIB",
        "The memory limit; for a SELECT of your own at least 1024.",
        "4096 for a SELECT of your own; else as for `metrics`",
        flag="--memory",
    ),
) -> "Answer | Table | AbstractContextManager[Rows]":
    """Answer a packaged query, or a SELECT in a file.

    The packaged queries are SQL files; the header of each says what its rows and its NULLs mean. They have no time
    limit, only that of --memory. A file of your own runs locked down, as with `sql`.
    """
    if list:
        return Queries(events=all)
    if show:
        from fsar_ledger.metrics.own_sql import text_of

        refusal = f"query {name} --show: found --json, --csv or --ndjson, expected none of them; SQL is text"
        return Plain(text_of(f"{name}"), refusal)
    assert not isinstance(ledger, str | PathLike | None)  # `_arrange` requires it, and the command line opens it
    if file is not None:
        return _of_file(ledger, Path(file), seconds, memory_mib)
    return ledger.query(f"{name}", **(parameters or {}))


@contextmanager
def _of_file(ledger: "Ledger", file: Path, seconds: int | None, memory_mib: int | None) -> "Iterator[Rows]":
    """Yield the answer to the SELECT in the file. Raises: As `sql`, and UsageError if the file cannot be read."""
    try:
        select = _text_of(file, limits_of(seconds, memory_mib).sql_bytes)
        with rows_of_select(ledger, select, seconds, memory_mib) as rows:
            yield rows
    except QueryFailed as problem:
        raise QueryFailed(f"{file}: {problem}") from problem


def _text_of(file: Path, limit: int) -> str:
    """Read the SELECT in the file, or in standard input.

    Raises:
        UsageError: The file cannot be read.
        QueryFailed: It is too long, or not UTF-8.
    """
    try:
        if str(file) == "-":
            data = sys.stdin.buffer.read(limit + 1)
        else:
            with file.open("rb") as stream:
                data = stream.read(limit + 1)
    except OSError as problem:
        raise UsageError(
            f"{file}: cannot be read ({problem.strerror}), expected a file that holds one SELECT"
        ) from problem
    if len(data) > limit:
        raise QueryFailed(f"SQL: found more than {limit:,} bytes of text, the limit; split the query")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        raise QueryFailed(
            f"SQL: found a byte that is not UTF-8 at {problem.start}, expected text; save it as UTF-8"
        ) from problem


def limits_of(seconds: int | None, memory_mib: int | None) -> "Limits":
    """Return these limits, with defaults for the rest.

    Raises:
        UsageError: Less than a second or more than a year; or less memory than the process needs for the packaged
            queries, or more than a machine has.
    """
    from fsar_ledger.base.memory import MOST_MIB
    from fsar_ledger.metrics.sandbox import Limits

    default = Limits()
    seconds = default.seconds if seconds is None else seconds
    memory_mib = default.memory_bytes >> 20 if memory_mib is None else memory_mib
    if not 1 <= seconds <= SECONDS_MAX:
        raise UsageError(f"{option('seconds', seconds)}: expected at least 1 and at most {SECONDS_MAX}, a year")
    if not MEMORY_MIB_MIN <= memory_mib <= MOST_MIB:
        raise UsageError(
            f"{option('memory_mib', memory_mib)}: expected at least {MEMORY_MIB_MIN} (MiB), of which the process "
            f"itself takes 400, and at most {MOST_MIB}"
        )
    return Limits(seconds=seconds, memory_bytes=memory_mib << 20)


@contextmanager
def rows_of_select(ledger: "Ledger", select: str, seconds: int | None, memory_mib: int | None) -> "Iterator[Rows]":
    """Yield the answer to a SELECT; the time limit covers all of it. Raises: As `sql`."""
    from fsar_ledger.metrics.provenance import Provenance
    from fsar_ledger.metrics.untrusted import stream_untrusted

    from .table import Rows

    limits = limits_of(seconds, memory_mib)
    with stream_untrusted(ledger.path, select, limits, ledger.demanded) as result:
        yield Rows(Provenance(result.head, result.rows_verified), result.columns, result.batches)


@verb(
    'sql out/ledger "SELECT type, count(*) AS events FROM events GROUP BY type ORDER BY events DESC"',
    "sql out/ledger \"SELECT * FROM request_denied WHERE run_id LIKE '%door-relay%'\" --csv",
    'sql out/ledger "SELECT denied_by, count(*) AS denials FROM denials(run := 1) GROUP BY denied_by"',
    'sql out/ledger "SHOW TABLES"',
    takes=STREAM,
    call=rows_of_select,
    is_apart=lambda _: True,
)
def sql(
    ledger: "Ledger",
    select: Annotated[str, argument("SELECT", "One SELECT in DuckDB's SQL.")],
    *,
    seconds: int | None = declare("N", "The time limit for a SELECT of your own.", "60"),
    memory_mib: int | None = declare(
        "MIB", "The memory limit for a SELECT of your own; at least 1024.", "4096", flag="--memory"
    ),
) -> "Table":
    """Answer a SELECT of your own.

    It can read `events`, one view for each event type, and all of `query --list`; a query with parameters is called
    like `FROM denials(run := 1)`. `SHOW TABLES` lists them all, `DESCRIBE NAME` the columns of one. It runs in a
    locked-down process that can read this ledger and nothing else.

    Raises:
        QueryFailed: It is not one SELECT, fails, needs something outside the ledger, or meets a limit.
    """
    from fsar_ledger.metrics.provenance import Provenance
    from fsar_ledger.metrics.untrusted import table_untrusted

    from .table import Table

    rows, head, rows_verified = table_untrusted(ledger.path, select, limits_of(seconds, memory_mib), ledger.demanded)
    return Table(rows, Provenance(head, rows_verified))
