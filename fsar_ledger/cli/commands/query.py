"""The command `query`: a packaged query, or a SELECT in a file."""

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli import completing
from fsar_ledger.cli.memory import bounded
from fsar_ledger.cli.options import (
    SHOWN_ROWS,
    CsvOption,
    FileOption,
    JsonOption,
    LimitOption,
    NdjsonOption,
    ParameterOption,
    QueryMemoryOption,
    RawOption,
    SecondsOption,
    VerifiedOption,
    WideOption,
    examples,
    parameters_of,
)
from fsar_ledger.cli.terminal import show
from fsar_ledger.errors import QueryFailed, UsageError
from fsar_ledger.printable import Shown

if TYPE_CHECKING:
    from fsar_ledger.cli.streaming import Form

EXAMPLES = examples(
    "fsar-ledger query --list",
    "fsar-ledger query policy_at --show",
    "fsar-ledger query metrics/policy_violations out/ledger --csv",
    "fsar-ledger query failures out/ledger --limit 20",
    "fsar-ledger query --file question.sql out/ledger --seconds 10",
)


def query(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME",
            help="A name of `query --list`; its last part is enough.",
            show_default=False,
            autocompletion=completing.queries,
        ),
    ] = None,
    ledger: Annotated[
        Path | None, typer.Argument(metavar="LEDGER", help="The folder of a ledger.", show_default=False)
    ] = None,
    param: ParameterOption = None,
    file: FileOption = None,
    list_named: Annotated[
        bool, typer.Option("--list", help="List the queries by group, with titles and parameters.")
    ] = False,
    list_all: Annotated[
        bool, typer.Option("--all", help="With --list: also the view of each event type and of each concern.")
    ] = False,
    as_sql: Annotated[
        bool, typer.Option("--show", help="Print the SQL of NAME, with the header that says what its rows mean.")
    ] = False,
    as_json: JsonOption = False,
    as_csv: CsvOption = False,
    as_ndjson: NdjsonOption = False,
    raw: RawOption = False,
    limit: LimitOption = SHOWN_ROWS,
    wide: WideOption = False,
    verified: VerifiedOption = False,
    seconds: SecondsOption = None,
    memory: QueryMemoryOption = None,
) -> None:
    """Answer a packaged query, or a SELECT in a file.

    The packaged queries are SQL files; the header of each says what its rows and its NULLs mean. They have no time
    limit, only that of --memory. A file of your own runs locked down, as with `sql`.
    """
    from fsar_ledger.cli.streaming import Form

    form = Form(as_json=as_json, as_csv=as_csv, as_ndjson=as_ndjson, raw=raw, limit=limit, wide=wide)
    if list_all and not list_named:
        raise UsageError("found --all without --list, expected both or neither")
    if list_named:
        from fsar_ledger.cli.listing import queries_text

        show(queries_text(form, events=list_all), raw=raw)
    elif as_sql:
        _show_sql(name, form)
    elif file is not None:
        form.show(_of_file(name, ledger, file, param, (seconds, memory), form, verified=verified))
    else:
        if seconds is not None:
            raise UsageError(
                f"--seconds {seconds}: expected only with --file; a packaged query takes as long as it takes"
            )
        with bounded(memory, ledger):
            form.show(_of_name(name, ledger, param, form, verified=verified))


def _show_sql(name: str | None, form: "Form") -> None:
    """Show the SQL of the packaged query. Raises: UsageError, UnknownQuery."""
    from fsar_ledger.metrics.groups import text_of

    if name is None:
        raise UsageError("query --show: expected NAME, as in `fsar-ledger query failures --show`")
    if form.as_json or form.as_csv or form.as_ndjson:
        raise UsageError(f"query {name} --show: found --json, --csv or --ndjson, expected none of them; SQL is text")
    show(Shown(text_of(name)))


def _of_name(
    name: str | None, ledger: Path | None, param: list[str] | None, form: "Form", *, verified: bool
) -> Iterable[Shown]:
    """Answer the packaged query."""
    from fsar_ledger.cli.answering import opened, warn

    parameters = parameters_of(param)
    if name is None or ledger is None:
        raise UsageError(
            "query: expected NAME and LEDGER, as in `fsar-ledger query failures out/ledger`; `fsar-ledger query "
            "--list` shows the names"
        )
    asked = opened(ledger, verified=verified)
    found = asked.query(name, **parameters)
    warn(ledger, found.provenance)
    return form.pieces(found.provenance, found.columns, found.batches(), asked.numbers)


def _of_file(
    name: str | None,
    ledger: Path | None,
    file: Path,
    param: list[str] | None,
    most: tuple[int | None, int | None],
    form: "Form",
    *,
    verified: bool,
) -> Iterable[Shown]:
    """Answer the SELECT in the file; LEDGER is then the first argument."""
    from fsar_ledger.api.limits import limits_of
    from fsar_ledger.api.sql import rows_of_select
    from fsar_ledger.cli.answering import opened, warn
    from fsar_ledger.cli.streaming import Kept

    if parameters := parameters_of(param):
        raise UsageError(
            f"--param {next(iter(parameters))}=... and --file {file}: only a packaged query has parameters; write the "
            "value into the file"
        )
    if name is None or ledger is not None:
        raise UsageError(
            f"query --file {file}: expected one argument, LEDGER, as in `fsar-ledger query --file "
            f"{printable.word(file)} out/ledger`"
        )
    select = _text_of(file, limits_of(*most).sql_bytes)
    asked = opened(Path(name), verified=verified)
    try:
        with rows_of_select(asked, select, *most) as rows:
            text = Kept(form.pieces(rows.provenance, rows.columns, rows.batches(), asked.numbers))
        warn(asked.path, rows.provenance)
        return text
    except QueryFailed as problem:
        raise QueryFailed(f"{file}: {problem}") from problem


def _text_of(file: Path, most: int) -> str:
    """Read the SELECT in the file, or in standard input.

    Raises:
        UsageError: The file cannot be read.
        QueryFailed: It is too long, or not UTF-8.
    """
    try:
        if str(file) == "-":
            data = sys.stdin.buffer.read(most + 1)
        else:
            with file.open("rb") as stream:
                data = stream.read(most + 1)
    except OSError as problem:
        raise UsageError(
            f"{file}: cannot be read ({problem.strerror}), expected a file that holds one SELECT"
        ) from problem
    if len(data) > most:
        raise QueryFailed(f"SQL: found more than {most:,} bytes of text, the limit; split the question")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        raise QueryFailed(
            f"SQL: found a byte that is not UTF-8 at {problem.start}, expected text; save it as UTF-8"
        ) from problem
