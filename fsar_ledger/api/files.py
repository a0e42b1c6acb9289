"""Write answers to CSV, Parquet and JSON files, and ledgers in the formats of other systems, each whole or not at all.

A file is written under a temporary name beside its place and renamed when it is complete, so that neither Ctrl-C nor a
full disk leaves half of one.
"""

import os
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from fsar_ledger.base.errors import UsageError, WriteFailed, option
from fsar_ledger.base.memory import unfinished
from fsar_ledger.base.progress import Progress, each
from fsar_ledger.base.publishing import require_file, unfinished_name
from fsar_ledger.exports import ExportedFile, documents
from fsar_ledger.exports.rows import write_delta, write_mcap
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.rows.schema import SCHEMA
from fsar_ledger.ledger.store.locations import chain_of, event_count, record_of, whole_runs, wholes_of
from fsar_ledger.ledger.store.paths import require_outside
from fsar_ledger.metrics.provenance import Provenance
from fsar_ledger.metrics.sandbox import SENT_BYTES, slices
from fsar_ledger.metrics.verified import is_verified

from .lookup import present, resolve_run
from .names import Run
from .table import Table
from .texts import csv_header, csv_lines, harmless, in_turn, json_lines, json_texts
from .verbs import either
from .view import require_picture, trace

if TYPE_CHECKING:
    from fsar_ledger.ledger.rows.codec import LedgerRun
    from fsar_ledger.ledger.store.read import View

    from .ledger import Ledger

LINES = (".ndjson", ".jsonl")
SUFFIXES = (".csv", ".parquet", *LINES)
GROUP_ROWS, GROUP_BYTES = 122_880, 64 << 20
"""Rows of a row group of Parquet, as many as in DuckDB; bytes in memory at which a group is written unfilled."""


def write_events(
    ledger: Path, out: Path, *, raw: bool = False, demanded: str | None = None, progress: Progress | None = None
) -> tuple[int, Provenance]:
    """Write every event as it is stored, retired types too, in commit order; return their number and provenance.

    Text in CSV is as `printable.field` makes it, unless `raw`. `progress` is called with the commits that were written
    and their number.

    Raises:
        UsageError: The name of the file ends in none of `SUFFIXES`, or it lies inside a ledger.
        WriteFailed: The file cannot be written.
    """
    require_place(out)
    view = open_for_answers(ledger)
    rows_verified = is_verified(view, demanded)
    tables = (table for table, _ in zip(view.tables(), each(view.releases, progress), strict=True))
    return _write_tables(out, SCHEMA, tables, raw=raw), Provenance(view.head, rows_verified)


def write_table(out: Path, table: pa.Table, *, raw: bool = False) -> int:
    """Write the rows, text as in `write_events`; return their number. Raises: As `write_events`."""
    return _write_tables(out, table.schema, [table], raw=raw)


def write_csv(out: Path, rows: Table) -> None:
    """Write the rows as `--csv` shows them. Raises: WriteFailed if the file cannot be written."""
    write_bytes(out, "".join([csv_header(rows.columns), *map(csv_lines, rows.batches())]).encode())


def write_bytes(out: Path, content: bytes) -> None:
    """Write the content. Raises: WriteFailed if the file cannot be written."""
    with whole_file(out) as temporary:
        temporary.write_bytes(content)


def require_place(out: Path) -> None:
    """Check the name of a file before anything is read, because a wrong name should not cost minutes.

    Raises: UsageError if rows cannot be written there.
    """
    _format_of(out)
    require_outside(out, option("out", out))


def _format_of(out: Path) -> str:
    if out.suffix not in SUFFIXES:
        raise UsageError(
            f"{out}: found a file name that ends in {out.suffix or 'nothing'!r}, expected .csv, .parquet, .ndjson or "
            ".jsonl; choose one of them"
        )
    return out.suffix


def _write_tables(out: Path, schema: pa.Schema, tables: Iterable[pa.Table], *, raw: bool) -> int:
    """Write the tables one after the other and return the number of rows; memory holds a few megabytes of text."""
    rows = 0

    def counted() -> Iterator[pa.Table]:
        nonlocal rows
        for table in tables:
            rows += table.num_rows
            yield table

    with whole_file(out) as temporary:
        if _format_of(out) == ".parquet":
            _write_parquet(temporary, schema, counted())
        elif out.suffix in LINES:
            with temporary.open("w", encoding="utf-8", newline="\n") as file:
                file.writelines(in_turn(json_lines, _slices(counted())))
        else:
            _write_csv(temporary, schema, counted(), raw=raw)
    return rows


def _write_parquet(path: Path, schema: pa.Schema, tables: Iterable[pa.Table]) -> None:
    dictionary, encoding = _parquet_columns(schema)
    with (
        path.open("wb") as file,  # pyarrow would expand a leading `~`
        pq.ParquetWriter(
            file, schema, compression="zstd", use_dictionary=dictionary, column_encoding=encoding
        ) as writer,
    ):
        for table in _in_groups(tables, schema):
            writer.write_table(table)


def _in_groups(tables: Iterable[pa.Table], schema: pa.Schema) -> Iterator[pa.Table]:
    """Yield the rows in tables for row groups of Parquet: small ones together, since a group costs some kilobytes."""
    waiting = schema.empty_table()
    for table in tables:
        waiting = pa.concat_tables([waiting, table])
        while len(waiting) >= GROUP_ROWS:
            yield waiting.slice(0, GROUP_ROWS)
            waiting = waiting.slice(GROUP_ROWS)
        if waiting.nbytes >= GROUP_BYTES:
            yield waiting
            waiting = schema.empty_table()
    if len(waiting):
        yield waiting


def _parquet_columns(schema: pa.Schema) -> tuple[list[str], dict[str, str]]:
    """Return the columns that repeat their values, which are texts, and the encoding of integers, which often grow."""
    sink = pa.BufferOutputStream()
    pq.write_table(schema.empty_table(), sink)
    stored = pq.ParquetFile(sink.getvalue()).schema
    columns = [stored.column(index) for index in range(len(stored))]
    encoding = {column.path: "DELTA_BINARY_PACKED" for column in columns if column.physical_type in ("INT32", "INT64")}
    return [column.path for column in columns if column.physical_type == "BYTE_ARRAY"], encoding


def _write_csv(path: Path, schema: pa.Schema, tables: Iterable[pa.Table], *, raw: bool) -> None:
    fields = partial(_fields, raw=raw)
    # Text is quoted and NULL is not, so that an empty text differs from NULL; names of columns need no quotes.
    options = pa_csv.WriteOptions(quoting_header="none")
    empty = fields(pa.RecordBatch.from_pylist([], schema)).schema
    with path.open("wb") as file, pa_csv.CSVWriter(file, empty, write_options=options) as writer:
        for batch in in_turn(fields, _slices(tables)):
            writer.write_batch(batch)


def _slices(tables: Iterable[pa.Table]) -> Iterator[pa.RecordBatch]:
    """Yield the rows a few at a time, because text that is checked and quoted takes several times its bytes."""
    return (part for table in tables for batch in table.to_batches() for part in slices(batch, SENT_BYTES))


def _fields(batch: pa.RecordBatch, *, raw: bool) -> pa.RecordBatch:
    """Return the rows as CSV writes them: each list as JSON text, and text harmless unless `raw`."""
    columns = []
    for column in batch.columns:
        if pa.types.is_nested(column.type):
            column = pc.if_else(column.is_valid(), json_texts(column), None)
        elif pa.types.is_string(column.type) and not raw:
            column = harmless(column)
        columns.append(column)
    return pa.RecordBatch.from_arrays(columns, names=batch.schema.names)


@contextmanager
def whole_file(out: Path) -> Iterator[Path]:
    """Yield a temporary name beside the file, which takes its place at the end. Raises: WriteFailed."""
    temporary = unfinished_name(out)
    unfinished.add(temporary)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        require_file(out)
        yield temporary
        os.replace(temporary, out)
    except OSError as problem:
        raise WriteFailed(
            f"{out}: cannot be written ({problem.strerror or problem}); the file was not changed: make room or "
            "choose another place"
        ) from problem
    finally:
        with suppress(OSError):  # it may never have been made
            temporary.unlink(missing_ok=True)
        unfinished.discard(temporary)


FORMATS: Mapping[str, str] = {"ocel": ".json", "otlp": ".json", "mcap": ".mcap", "perfetto": ".json", "delta": ""}
"""The file suffix of each format; the last is a folder."""
EXTRAS = {"mcap": "mcap", "deltalake": "lake"}
"""The extra of the package for each library that only one format needs."""


def write_as(
    ledger: "Ledger", file: Path, format: str, run: Run | None, progress: Progress | None
) -> "tuple[ExportedFile, Provenance]":
    """Write a run, or without one all of them, in a format of `FORMATS`; return what was written, and its provenance.

    Raises:
        UsageError: There is no such format or run; the file has another suffix or lies inside a ledger; the format
            needs a library that is not installed, one run and no other, or all of them.
        LedgerCorrupted: A segment is not as committed.
        WriteFailed: The file cannot be written.
    """
    if format not in FORMATS:
        raise UsageError(f"{option('format', format)}: found no such format, expected {either(FORMATS)}; choose one")
    if format != "delta":
        require_picture(file, FORMATS[format], "out")
    elif file.suffix:
        raise UsageError(
            f"{option('out', file)}: found a name that ends in {file.suffix!r}, expected the name of a new folder, "
            "without a suffix; choose another name"
        )
    if format == "delta" and run is not None:
        raise UsageError(
            f"{option('run', run)} and {option('format', format)}: a Delta table has whole segments, which hold other "
            "runs, too; expected one of them: leave the run out, and select it in the table"
        )
    view, provenance = present(ledger)
    name = None if run is None else resolve_run(view, run, ledger.demanded, is_whole=True)
    if format == "perfetto":
        name = name or _only_run(view)
        trace(ledger, file, name)
        runs = [] if name is None else chain_of(view, name)
        events = sum(event_count(view.parts(run)) for run in runs)
        return ExportedFile(events - len(runs[1:]), ()), provenance
    try:
        return _write_export(view, file, format, name, progress), provenance
    except ImportError as error:
        library = (error.name or "").partition(".")[0]
        if library not in EXTRAS:
            raise
        raise UsageError(
            f"{option('format', format)}: found no library {library}, expected it; install it with "
            f'`pip install "fsar-ledger[{EXTRAS[library]}]"`'
        ) from error


def _write_export(view: "View", file: Path, format: str, run: str | None, progress: Progress | None) -> ExportedFile:
    if format == "delta":
        return write_delta(file, view)
    with whole_file(file) as temporary:
        if format == "mcap":
            return write_mcap(temporary, view, _tables(view, run, progress))
        runs = _runs(view, progress) if run is None else [record_of(view, run)]
        if format == "otlp":
            return documents.write_otlp(temporary, runs)
        return documents.write_ocel(
            temporary, runs, {name: number for number, name in enumerate(view.run_names.runs, start=1)}
        )


def _runs(view: "View", progress: Progress | None) -> "Iterator[LedgerRun]":
    """Yield every run, and report progress in commits."""
    ends, done = [commit.tree_size for commit in view.commits], 0
    for run in whole_runs(view):
        yield run
        done += len(run.events)
        if progress is not None:
            progress(bisect_right(ends, done), len(ends))


def _tables(view: "View", run: str | None, progress: Progress | None) -> Iterable[pa.Table]:
    """Yield the stored rows, or those of one run, a table for each segment that has any."""
    runs = [] if run is None else chain_of(view, run)
    parts = [part for name in runs for part in view.parts(name)]
    for number in each(range(len(view.releases)) if run is None else view.segments_of(parts), progress):
        table = view.table(number)
        yield table if run is None else table.filter(pc.is_in(table.column("run_id"), pa.array(runs)))


def _only_run(view: "View") -> str | None:
    """Return the only run; None if there is none at all. Raises: UsageError if there are several."""
    wholes = wholes_of(view)
    names = [name for name in view.run_names.runs if wholes.get(name, name) == name]
    if len(names) > 1:
        raise UsageError(
            f"{option('format', 'perfetto')}: found {len(names):,} runs, expected one, since a trace shows one run; "
            f"name it with {option('run')}"
        )
    return names[0] if names else None
