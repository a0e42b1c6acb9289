"""Write answers to CSV, Parquet and JSON files, each whole or not at all.

A file is written under a temporary name beside its place and renamed when it is complete, so that neither Ctrl-C nor a
full disk leaves half of one.
"""

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

import msgspec
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from fsar_ledger.errors import UsageError, WriteFailed, option
from fsar_ledger.ledger.rows.schema import SCHEMA
from fsar_ledger.ledger.store.opening import open_for_answers
from fsar_ledger.ledger.store.paths import require_outside
from fsar_ledger.memory import unfinished
from fsar_ledger.metrics.progress import Progress, each
from fsar_ledger.metrics.sandbox import SENT_BYTES, slices
from fsar_ledger.metrics.verified import is_verified

from .provenance import Provenance
from .texts import harmless, json_lines, json_texts

LINES = (".ndjson", ".jsonl")
SUFFIXES = (".csv", ".parquet", *LINES)
GROUP_ROWS, GROUP_BYTES = 122_880, 64 << 20
"""Rows of a row group of Parquet, as many as DuckDB takes; bytes in memory after which none waits for more."""


class Written(msgspec.Struct, frozen=True):
    """The number of rows that were written to a file, and their provenance."""

    row_count: int
    provenance: Provenance


def write_events(
    ledger: Path, out: Path, *, raw: bool = False, demanded: str | None = None, progress: Progress | None = None
) -> Written:
    """Write every event as it is stored, retired types too, in commit order; return their number.

    Text in CSV is as `printable.field` makes it, unless `raw`. `progress` is called with the commits that were written
    and their number.

    Raises:
        UsageError: The name of the file ends in none of `SUFFIXES`, or it lies inside a ledger.
        WriteFailed: The file cannot be written.
    """
    require_place(out)
    view = open_for_answers(ledger)
    rows_verified = is_verified(view, demanded)
    tables = (table for table, _ in zip(view.tables(), each(view.records, progress), strict=True))
    return Written(_write_tables(out, SCHEMA, tables, raw=raw), Provenance(view.head, rows_verified))


def write_table(out: Path, table: pa.Table, *, raw: bool = False) -> int:
    """Write the rows, text as in `write_events`; return their number. Raises: As `write_events`."""
    return _write_tables(out, table.schema, [table], raw=raw)


def write_text(out: Path, text: str) -> None:
    """Write the text in UTF-8.

    Raises:
        WriteFailed: The file cannot be written.
    """
    with whole_file(out) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


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
    """Write the tables one after the other; memory holds one of them at a time."""
    rows = 0
    with whole_file(out) as temporary, _writer(out, temporary, schema, raw=raw) as write:
        for table in _in_groups(tables, schema) if out.suffix == ".parquet" else tables:
            write(table)
            rows += table.num_rows
    return rows


@contextmanager
def _writer(out: Path, temporary: Path, schema: pa.Schema, *, raw: bool) -> Iterator[Callable[[pa.Table], None]]:
    if _format_of(out) == ".parquet":
        dictionary, encoding = _parquet_columns(schema)
        with pq.ParquetWriter(
            temporary, schema, compression="zstd", use_dictionary=dictionary, column_encoding=encoding
        ) as writer:
            yield lambda table: writer.write_table(table)
    elif out.suffix in LINES:
        with temporary.open("w", encoding="utf-8", newline="\n") as file:
            yield lambda table: _write_lines(file, table)
    else:
        # Text is quoted and NULL is not, so that an empty text differs from NULL; names of columns need no quotes.
        options = pa_csv.WriteOptions(quoting_header="none")
        empty = _fields(schema.empty_table(), raw=raw).schema
        with pa_csv.CSVWriter(temporary, empty, write_options=options) as writer:
            yield lambda table: _write_fields(writer, table, raw=raw)


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
    columns = [stored.column(at) for at in range(len(stored))]
    encoding = {one.path: "DELTA_BINARY_PACKED" for one in columns if one.physical_type in ("INT32", "INT64")}
    return [one.path for one in columns if one.physical_type == "BYTE_ARRAY"], encoding


def _write_lines(file: TextIO, table: pa.Table) -> None:
    for batch in table.to_batches():
        file.writelines(map(json_lines, slices(batch, SENT_BYTES)))


def _write_fields(writer: pa_csv.CSVWriter, table: pa.Table, *, raw: bool) -> None:
    for batch in table.to_batches():
        for part in slices(batch, SENT_BYTES):  # text that is checked and quoted takes several times its bytes
            writer.write_table(_fields(pa.Table.from_batches([part]), raw=raw))


def _fields(table: pa.Table, *, raw: bool) -> pa.Table:
    """Return the table as CSV writes it: each list as JSON text, and text harmless unless `raw`."""
    for at, field in enumerate(table.schema):
        if pa.types.is_nested(field.type):
            chunks = [pc.if_else(chunk.is_valid(), json_texts(chunk), None) for chunk in table.column(at).chunks]
        elif pa.types.is_string(field.type) and not raw:
            chunks = list(map(harmless, table.column(at).chunks))
        else:
            continue
        table = table.set_column(at, field.name, pa.chunked_array(chunks, pa.string()))
    return table


@contextmanager
def whole_file(out: Path) -> Iterator[Path]:
    """Yield a temporary name beside the file, which takes its place at the end. Raises: WriteFailed."""
    temporary = out.with_name(f".{out.name}.{os.getpid()}.part")
    unfinished.add(temporary)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        os.replace(temporary, out)
    except OSError as problem:
        raise WriteFailed(
            f"{out}: cannot be written ({problem.strerror or problem}); the file is as it was before: make room or "
            "choose another place"
        ) from problem
    finally:
        with suppress(OSError):  # it may never have been made
            temporary.unlink(missing_ok=True)
        unfinished.discard(temporary)
