"""What `query` and `sql` answer: packaged queries here, a SELECT of the user's own in the locked process."""

import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import pyarrow as pa

from fsar_ledger import printable
from fsar_ledger.errors import QueryFailed, UsageError
from fsar_ledger.metrics.database import plain_rows
from fsar_ledger.metrics.locked import Limits, slices
from fsar_ledger.metrics.untrusted import stream_untrusted
from fsar_ledger.printable import Shown

from .answering import answering, demanded_head, not_observed, warn
from .output import Row, check_form
from .pieces import Kept, answer_pieces

MEMORY_MIB_MIN = 1024
Asked = Mapping[str, int | None]
"""The values of --seconds and --memory (in MiB), None where the option was not given."""


def limits_of(asked: Asked) -> Limits:
    """The limits that the options ask for, the default ones for the rest.

    Raises:
        UsageError: no second, or less memory than the process needs for the packaged queries.
    """
    default = Limits()
    seconds = default.seconds if asked["--seconds"] is None else asked["--seconds"]
    memory_mib = default.memory_bytes >> 20 if asked["--memory"] is None else asked["--memory"]
    if seconds < 1:
        raise UsageError(f"--seconds {seconds}: expected at least 1")
    if memory_mib < MEMORY_MIB_MIN:
        raise UsageError(
            f"--memory {memory_mib}: expected at least {MEMORY_MIB_MIN} (MiB), of which the process itself takes 400"
        )
    return Limits(seconds=seconds, memory_bytes=memory_mib << 20)


def answer_select(
    ledger: Path,
    select: str,
    limits: Limits,
    *,
    as_json: bool,
    as_csv: bool,
    raw: bool,
    limit: int,
    verified: bool = False,
) -> Iterable[Shown]:
    """The answer of the SELECT as text, a piece at a time; the limit of time holds for making all of it.

    Raises:
        FsarLedgerError: as `stream_untrusted`.
        UsageError: both JSON and CSV are asked for.
    """
    check_form(as_json=as_json, as_csv=as_csv, raw=raw)
    with stream_untrusted(ledger, select, limits, demanded_head(ledger, verified=verified)) as answer:
        known = answer.rows_verified
        pieces = answer_pieces(
            answer.head,
            answer.columns,
            answer.parts,
            rows_verified=known,
            as_json=as_json,
            as_csv=as_csv,
            raw=raw,
            limit=limit,
        )
        text = Kept(pieces)
    warn(ledger, rows_verified=known)
    return text


def answer_query(
    places: tuple[str | None, Path | None],
    file: Path | None,
    parameters: Mapping[str, str],
    asked: Asked,
    *,
    as_json: bool,
    as_csv: bool,
    raw: bool,
    limit: int,
    verified: bool = False,
) -> Iterable[Shown]:
    """The answer of the named query, or of the SELECT in the file, as text, a piece at a time; `places` are NAME and LEDGER, or LEDGER alone beside a file.

    Raises:
        UsageError: an argument or option is missing, or does not belong to the others.
        FsarLedgerError: as `Database.query`, or as `stream_untrusted`, then with the name of the file before the message.
    """
    name, ledger = places
    if file is None:
        if asked["--seconds"] is not None:
            raise UsageError(
                f"--seconds {asked['--seconds']}: expected only with --file; a packaged query takes as long as it takes"
            )
        if name is None or ledger is None:
            raise UsageError(
                "query: expected NAME and LEDGER, as in `fsar-ledger query failures out/ledger`; `fsar-ledger query --list` shows the names"
            )
        check_form(as_json=as_json, as_csv=as_csv, raw=raw)
        with answering(ledger, verified=verified) as database:
            table, known = database.query(name, parameters), database.rows_verified
            more = not_observed(database, name)
            names = table.column_names
            return answer_pieces(
                database.head,
                names,
                _parts(table),
                rows_verified=known,
                as_json=as_json,
                as_csv=as_csv,
                raw=raw,
                limit=limit,
                more=more,
            )
    if parameters:
        raise UsageError(
            f"--param {next(iter(parameters))}=... and --file {file}: only a packaged query has parameters; write the value into the file"
        )
    if name is None or ledger is not None:
        raise UsageError(
            f"query --file {file}: expected one argument, LEDGER, as in `fsar-ledger query --file {printable.word(file)} out/ledger`"
        )
    limits = limits_of(asked)
    try:
        return answer_select(
            Path(name),
            _text_of(file, limits.sql_bytes),
            limits,
            as_json=as_json,
            as_csv=as_csv,
            raw=raw,
            limit=limit,
            verified=verified,
        )
    except QueryFailed as problem:
        raise QueryFailed(f"{file}: {problem}") from problem


def _parts(table: pa.Table) -> Iterator[list[Row]]:
    """The rows, some at a time."""
    for batch in table.to_batches():
        for part in slices(batch):
            yield list(plain_rows(pa.Table.from_batches([part])))


def _text_of(file: Path, most: int) -> str:
    """What the file holds, up to one byte more than SQL may have. Raises: UsageError, QueryFailed."""
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
